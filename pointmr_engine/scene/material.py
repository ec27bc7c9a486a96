"""Materials: a node graph and what the engine must know beside it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pointmr_engine.scene.graph import Graph, Link, Node


@dataclass(eq=False)
class Material:
    """A surface material. Identity is the object: share it between meshes.

    pass_index feeds the Material Index pass, and Object Info nodes. emission_sampling: "AUTO", "NONE", "FRONT", "BACK",
    "FRONT_BACK", which sides of an emissive surface are sampled as a light. bump_method: what the graph's displacement
    does: "BUMP" changes normals, "DISPLACEMENT" moves vertices, "BOTH" both; "NONE": bumps are not corrected either.
    """

    name: str
    graph: Graph = field(default_factory=Graph)
    pass_index: int = 0
    emission_sampling: str = "AUTO"
    bump_method: str = "BUMP"

    @property
    def moves_vertices(self) -> bool:
        """Whether meshes of this material are displaced."""
        return self.graph.displacement is not None and self.bump_method in ("DISPLACEMENT", "BOTH")

    @property
    def shades_moved(self) -> bool:
        """Whether it shades the displaced surface; else the resting one, with its displacement as bump."""
        return self.moves_vertices and self.bump_method == "DISPLACEMENT"

    @property
    def surface_graph(self) -> Graph:
        """The graph that shades: its displacement is no bump where vertices have been moved by it.

        Its Object Info nodes know the material's index.
        """
        nodes = dict(self.graph.nodes)
        for key, node in nodes.items():
            if node.kind == "object_info":
                nodes[key] = replace(node, params=node.params | {"material_index": self.pass_index})
        return replace(
            self.graph, nodes=nodes, displacement=None if self.shades_moved else self.graph.displacement
        )


def principled(name: str = "Material", **inputs) -> Material:
    """A material of one Principled BSDF; inputs are its sockets in lower case with underscores, e.g. base_color."""
    graph = Graph({"bsdf": Node("principled", inputs)}, surface=Link("bsdf", "bsdf"))
    return Material(name, graph)


def emission(name: str = "Emission", color=(1.0, 1.0, 1.0), strength: float = 1.0) -> Material:
    """A material that only emits: radiance color * strength, in W/(m^2 sr)."""
    graph = Graph(
        {"emission": Node("emission", {"color": color, "strength": strength})},
        surface=Link("emission", "emission"),
    )
    return Material(name, graph)
