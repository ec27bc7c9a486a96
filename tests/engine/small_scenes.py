"""Small scenes, made without Blender."""

import numpy as np

from pointmr_engine import Camera, Group, Light, Mesh, Scene, World, principled, uniform_world
from pointmr_engine.scene.graph import Graph, Link, Node


def quad(size=1.0, z=0.0, material=None, name="quad") -> Mesh:
    """A square in the plane z, facing up."""
    s = size / 2
    corners = np.array([[-s, -s, z], [s, -s, z], [s, s, z], [-s, s, z]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(name, corners, triangles, materials=(material,))


def from_above(height=5.0, **values) -> Camera:
    """A camera over the origin that looks down."""
    m = np.eye(4)
    m[2, 3] = height
    return Camera(m, **values)


def at(x, y, z) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def lit_floor(*more: Mesh, world: World | None = None, **light) -> Scene:
    """A grey floor and what else is given, under one point light."""
    lamp = Light("POINT", at(0, 0, 3), **{"power": 100.0, "radius": 0.1, **light})
    floor = quad(20.0, material=principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0))
    group = Group("root", [floor, *more])
    return Scene(group, from_above(), [lamp], world or uniform_world((0, 0, 0)))


def half_a_sky(axis: str = "x") -> World:
    """White for directions of a negative coordinate."""
    nodes = {
        "place": Node("texture_coordinate"),
        "axes": Node("separate_xyz", {"vector": Link("place", "generated")}),
        "half": Node("math", {"value": Link("axes", axis), "value_b": 0.0}, {"operation": "LESS_THAN"}),
        "b": Node("background", {"strength": Link("half", "value")}),
    }
    return World(Graph(nodes, surface=Link("b", "background")))


def sky_with_a_sun(cosine: float, sun: float, sky: float = 0.0, axis: str = "z") -> World:
    """A disc about an axis, up to an angle of that cosine, before an even sky. Colour: the node's own, 0.8."""
    world = half_a_sky()
    nodes = world.graph.nodes
    nodes["half"] = Node(
        "math", {"value": Link("axes", axis), "value_b": cosine}, {"operation": "GREATER_THAN"}
    )
    nodes["sun"] = Node("math", {"value": Link("half", "value"), "value_b": sun}, {"operation": "MULTIPLY"})
    nodes["sky"] = Node("math", {"value": Link("sun", "value"), "value_b": sky}, {"operation": "ADD"})
    nodes["b"] = Node("background", {"strength": Link("sky", "value")})
    return world
