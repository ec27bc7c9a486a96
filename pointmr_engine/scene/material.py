"""Materials: a node graph and what the engine must know beside it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pointmr_engine.scene.graph import Graph, Link, Node

# attribute (V, 3) per vertex: where vertices lay before they were displaced, which bumps of displacements read
RESTING = ".resting"
# ... (3T, 3) per corner: the normals of smooth triangles then, 0 of flat ones, which normal maps tilt
RESTING_NORMAL = ".resting normal"


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
    def mapped_at_rest(self) -> frozenset[str]:
        """UV layers ("": the active one) of normal maps that tilt the normals that vertices had before they moved."""
        nodes = self.graph.nodes.values() if self.moves_vertices else ()
        return frozenset(node.params.get("layer", "") for node in nodes if _is_tangent_map(node))

    @property
    def surface_graph(self) -> Graph:
        """The graph that shades: its displacement is no bump where vertices have been moved by it alone.

        Where it is both, the bump is that of the resting mesh, as are the tangents of normal maps in either case.
        Object Info nodes know the material's index.
        """
        nodes = dict(self.graph.nodes)
        for key, node in nodes.items():
            if node.kind == "object_info":
                nodes[key] = replace(node, params=node.params | {"material_index": self.pass_index})
            elif self.moves_vertices and _is_tangent_map(node):
                nodes[key] = replace(node, params=node.params | {"resting": True})
        if self.shades_moved:
            return replace(self.graph, nodes=nodes, displacement=None)
        graph = replace(self.graph, nodes=nodes)
        return _at_rest(graph) if self.moves_vertices else graph

    @property
    def reads_resting(self) -> bool:
        """Whether its surface reads the attribute RESTING."""
        return self.moves_vertices and RESTING in self.surface_graph.nodes


def resting_tangent(layer: str) -> str:
    """Attribute (3T, 4) per corner: tangents of a UV layer, in the object's space, before vertices were displaced."""
    return f".resting tangent {layer}"


def _is_tangent_map(node: Node) -> bool:
    return node.kind == "normal_map" and node.params.get("space", "TANGENT") == "TANGENT"


def _at_rest(graph: Graph) -> Graph:
    """The graph of a mesh that its displacement has moved.

    One that reads the object's coordinates has nodes of its own, which read RESTING, and bumps as of unmoved meshes.
    """
    reached, stack = set(), [graph.displacement.node]
    while stack:
        key = stack.pop()
        if key not in reached and key in graph.nodes:
            reached.add(key)
            stack += [v.node for v in graph.nodes[key].inputs.values() if isinstance(v, Link)]

    def own(value):
        if not isinstance(value, Link) or value.node not in reached:
            return value
        node = graph.nodes[value.node]
        moves = node.kind == "texture_coordinate" and node.params.get("object_from_world") is None
        if moves and value.output == "object":
            return Link(RESTING, "vector")
        return Link(f"{RESTING}:{value.node}", value.output)

    copies = {
        f"{RESTING}:{key}": replace(node, inputs={name: own(v) for name, v in node.inputs.items()})
        for key, node in graph.nodes.items()
        if key in reached
    }
    if not any(v == Link(RESTING, "vector") for node in copies.values() for v in node.inputs.values()):
        return replace(graph, raised=True)
    nodes = graph.nodes | copies | {RESTING: Node("attribute", params={"name": RESTING})}
    return replace(graph, nodes=nodes, displacement=own(graph.displacement))


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
