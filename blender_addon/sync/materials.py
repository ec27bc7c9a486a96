"""Blender's materials, worlds and lights to engine graphs, each once."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.material import Material, principled

from .images import ImageSync
from .nodes import translate

# nodes of Blender 5 that only Blender itself can unroll
_ZONES = ("Repeat", "Closure", "Bundle", "MenuSwitch", "EvaluateClosure", "IndexSwitch")


class MaterialSync:
    """Translates materials and keeps them, so that equal slots share one engine Material.

    report(level, message): level "INFO", "WARNING" or "ERROR". images: an ImageSync to share, else its own.
    """

    def __init__(self, report, images: ImageSync | None = None) -> None:
        self._report = report
        self.images = ImageSync(report) if images is None else images
        self._materials: dict[str, Material] = {}
        self._default: Material | None = None
        self._of_strands: dict[Material, Material] = {}

    def get(self, material) -> Material:
        """The engine's material for a bpy Material, or for None the default grey one."""
        if material is None:
            if self._default is None:
                self._default = default_material()
            return self._default
        key = material.name_full
        if key not in self._materials:
            self._materials[key] = self._translate(material)
        return self._materials[key]

    def of_strands(self, material) -> Material:
        """`get`, for strands: one surface to light that goes through them, though their tubes have two walls."""
        whole = self.get(material)
        if whole not in self._of_strands:
            graph = single_walled(whole.graph)
            self._of_strands[whole] = whole if graph is None else replace(whole, graph=graph)
        return self._of_strands[whole]

    def light_graph(self, light) -> Graph | None:
        """The node graph of a bpy Light, or None where it has no nodes that change its emission."""
        if not light.use_nodes or light.node_tree is None:
            return None
        graph = self._graph(light, f"light '{light.name_full}'", "from_light")
        return None if graph is None or is_plain_light(graph) else graph

    def world_graph(self, world) -> Graph:
        """The background graph of a bpy World; empty (black) for None."""
        if world is None:
            return Graph()
        if has_nodes(world):
            graph = self._graph(world, f"world '{world.name_full}'", "from_world")
            if graph is not None:
                return graph
        nodes = {"background": Node("background", {"color": tuple(world.color), "strength": 1.0})}
        return Graph(nodes, surface=Link("background", "background"))

    # ----

    def _translate(self, material) -> Material:
        name = material.name_full
        graph = None
        if has_nodes(material):
            graph = self._graph(material, f"material '{name}'", "from_material")
        if graph is None:
            graph = plain_surface(tuple(material.diffuse_color)[:3])
        settings = getattr(material, "cycles", None)
        method = getattr(material, "displacement_method", "BUMP")
        return Material(
            name,
            graph,
            pass_index=material.pass_index,
            emission_sampling=getattr(settings, "emission_sampling", "AUTO"),
            bump_method=method,
        )

    def _graph(self, owner, what: str, inline: str) -> Graph | None:
        """The graph of something with a node tree; None, and an error reported, where it cannot be translated."""

        def report(level: str, message: str) -> None:
            self._report(level, f"{what}: {message}")

        try:
            unrolled = unrolled_tree(owner, inline)
            tree = owner.node_tree if unrolled is None else unrolled.node_tree
            return translate(tree, report, self.images)
        except Exception as error:  # a material must never stop a render, whatever it is made of
            report("ERROR", f"its nodes cannot be translated: {type(error).__name__}: {error}")
            return None


def has_nodes(owner) -> bool:
    """Whether a material or world is made of nodes; since Blender 5 all are, and asking is deprecated."""
    return owner.node_tree is not None and (bpy.app.version >= (5, 0, 0) or owner.use_nodes)


def default_material() -> Material:
    """What surfaces without a material are made of in Cycles: since Blender 5 as a new material is, diffuse before."""
    if bpy.app.version >= (5, 0, 0):
        return principled("default")
    return Material("default", plain_surface((0.8, 0.8, 0.8)))


def plain_surface(color: tuple[float, ...]) -> Graph:
    """A diffuse surface of one colour."""
    color = tuple(float(v) for v in np.asarray(color, np.float64))
    return Graph({"diffuse": Node("diffuse", {"color": color})}, surface=Link("diffuse", "bsdf"))


def is_plain_light(graph: Graph) -> bool:
    """Whether a lamp's graph is a white emission of strength 1, as a new lamp has it."""
    node = graph.nodes.get(graph.surface.node) if graph.surface else None
    if node is None or node.kind != "emission":
        return False
    color, strength = node.inputs.get("color", (1.0, 1.0, 1.0)), node.inputs.get("strength", 1.0)
    return not isinstance(color, Link) and tuple(color)[:3] == (1.0, 1.0, 1.0) and strength == 1.0


def single_walled(graph: Graph) -> Graph | None:
    """The surface of a graph that lets light through, clear where it is seen from behind; None if it lets none."""

    def lets_through(node) -> bool:
        alpha, transmission = node.inputs.get("alpha", 1.0), node.inputs.get("transmission_weight", 0.0)
        if node.kind == "principled":
            return (
                isinstance(alpha, Link) or alpha < 1.0 or isinstance(transmission, Link) or transmission > 0.0
            )
        return node.kind in ("transparent", "translucent", "glass", "refraction")

    if graph.surface is None or not any(lets_through(node) for node in graph.nodes.values()):
        return None
    sides, clear, both = "strand/sides", "strand/clear", "strand/both"
    inputs = {"fac": Link(sides, "backfacing"), "shader": graph.surface, "shader_b": Link(clear, "bsdf")}
    nodes = {
        sides: Node("geometry"),
        clear: Node("transparent", {"color": (1.0, 1.0, 1.0)}),
        both: Node("mix_shader", inputs),
    }
    return replace(graph, nodes=graph.nodes | nodes, surface=Link(both, "shader"))


def unrolled_tree(owner, constructor: str):
    """Blender's own copy of a tree without zones and closures (5.0 and later), None where it is not needed.

    What is returned owns the tree: keep it while reading.
    """
    inliner = getattr(bpy.types, "InlineShaderNodes", None)
    if inliner is None or not _has_zones(owner.node_tree, set()):
        return None
    return getattr(inliner, constructor)(owner)


def _has_zones(tree, seen: set[str]) -> bool:
    for node in tree.nodes:
        if any(zone in node.bl_idname for zone in _ZONES):
            return True
        below = getattr(node, "node_tree", None)
        if below is not None and below.name_full not in seen:
            seen.add(below.name_full)
            if _has_zones(below, seen):
                return True
    return False
