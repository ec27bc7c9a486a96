"""What is compared with Cycles, node by node: name -> (case, tolerance)."""

from node_cases import arithmetic, images, points, procedural, shaders
from node_cases.images import image
from node_cases.registry import CASES

__all__ = ["CASES", "arithmetic", "image", "images", "points", "procedural", "shaders"]
