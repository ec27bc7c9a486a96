"""Trees of mix and add shaders flattened to leaves with weights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.shading import leaves as L
from pointmr_engine.shading.compiler import Builder, Constant, Source, Step, constant
from pointmr_engine.shading.leaf_plan import LeafPlan, leaf_template
from pointmr_engine.shading.nodes import NODES, SHADERS
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, From, ShaderType


class Flat(NamedTuple):
    """What a graph comes to. The values of several terms are added up."""

    steps: list[Step]
    leaves: list[LeafPlan]
    transparency: list[Source]  # terms of what passes straight through
    emission: list[Source]
    # terms of what is sent besides, by emission and by lobes, where that and the transparency may be more than one
    shown: list[Source]
    warnings: list[str]


def flatten(graph: Graph, kind: str, filtered: bool = True) -> Flat:
    """A graph's leaves, and the steps that they depend on."""
    builder = Builder(graph, kind, filtered)
    if graph.displacement is not None and kind == "surface":
        builder.normal = _displaced_normal(builder, graph.displacement, graph.raised)
    plans: list[LeafPlan] = []
    transparency: list[Source] = []
    emission: list[Source] = []
    shown: list[Source] = []
    for node, weight in _weighted_leaves(builder, graph):
        shader = SHADERS[node.kind]
        if shader.warning:
            builder.warn(shader.warning)
        made = _leaf(builder, shader, node, weight)
        if made is None:
            continue
        plan, passing, emitted, own = made
        plans.append(plan)
        transparency += passing
        emission += emitted
        shown += own
    adds = any(node.kind == "add_shader" for node in graph.nodes.values())
    return Flat(builder.steps, plans, transparency, emission, shown if adds else [], builder.warnings)


def _displaced_normal(builder: Builder, link: Link, raised: bool) -> Source | None:
    """Displacement as bump: the normal of the surface moved along the shading normal."""
    displacement = builder.value(link, VECTOR, (0.0, 0.0, 0.0))
    if isinstance(displacement, Constant):
        return None
    normal = builder.implicit("normal")
    height = builder.add(NODES["displacement_height"], {"vector": displacement, "normal": normal}, {})[
        "value"
    ]
    inputs = {
        "strength": constant(1.0, FLOAT),
        "distance": constant(1.0, FLOAT),
        "filter_width": constant(0.1, FLOAT),
        "height": height,
        "normal": normal,
    }
    return builder.add(NODES["bump"], inputs, {"raised": raised})["normal"]


def _weighted_leaves(builder: Builder, graph: Graph) -> list[tuple[Node, Source]]:
    """Leaf shader nodes with their weights; a node reached along several ways appears once, its weights added."""
    if graph.surface is None:
        return []
    order = _topological(graph, graph.surface.node, builder)
    weights: dict[str, list[Source]] = {graph.surface.node: [constant(1.0, FLOAT)]}
    found = []
    for key in order:
        node = graph.nodes[key]
        if key not in weights:
            continue
        weight = builder.total(weights[key])
        if isinstance(weight, Constant) and not weight.value.any():
            continue
        if node.kind == "add_shader":
            shares = [("shader", weight), ("shader_b", weight)]
        elif node.kind == "mix_shader":
            factor = builder.value(node.inputs.get("fac"), FLOAT, 0.5)
            share = builder.add(NODES["weight:share"], {"fac": factor}, {})
            shares = [
                ("shader", builder.product(weight, share["first"])),
                ("shader_b", builder.product(weight, share["second"])),
            ]
        else:
            found.append((node, weight))
            continue
        for name, w in shares:
            below = node.inputs.get(name)
            if isinstance(below, Link):
                weights.setdefault(below.node, []).append(w)
    return found


def _topological(graph: Graph, root: str, builder: Builder) -> list[str]:
    """Shader nodes below root, each before the shaders that it mixes."""
    done: list[str] = []
    state: dict[str, int] = {}
    stack = [root]
    while stack:
        key = stack[-1]
        node = graph.nodes.get(key)
        if node is None or node.kind not in SHADERS or state.get(key) == 2:
            if node is not None and node.kind not in SHADERS and node.kind not in NODES:
                builder.warn(f"shader node '{node.kind}' is not supported; it is left out")
            stack.pop()
            continue
        if state.get(key) == 1:
            state[key] = 2
            done.append(stack.pop())
            continue
        state[key] = 1
        if node.kind in ("mix_shader", "add_shader"):
            for name in ("shader", "shader_b"):
                below = node.inputs.get(name)
                if isinstance(below, Link) and state.get(below.node) != 1:
                    stack.append(below.node)
    return done[::-1]


def _leaf(
    builder: Builder, shader: ShaderType, node: Node, weight: Source
) -> tuple[LeafPlan, list[Source], list[Source], list[Source]] | None:
    """The plan of one leaf, what it lets pass, emits and shows; None for one that never does anything."""
    inputs: dict[str, Source] = {}
    for name, (type_, default) in shader.inputs.items():
        if isinstance(default, From) and not isinstance(node.inputs.get(name), Link):
            continue
        source = builder.value(node.inputs.get(name), type_, default)
        low, high = shader.limits.get(name, (None, None))
        if low is not None or high is not None:
            limit = NODES["limit" if type_ == FLOAT else "limit_color"]
            source = builder.add(limit, {"value": source}, {"low": low, "high": high})["value"]
        inputs[name] = source

    passing: list[Source] = []
    emitted: list[Source] = []
    shown: list[Source] = []
    if shader.tint is not None:
        weight = builder.product(weight, inputs[shader.tint])
    if shader.strength is not None:
        weight = builder.product(weight, inputs[shader.strength])
    if isinstance(weight, Constant) and not weight.value.any():
        return None
    values = dict(inputs)
    if shader.leaf == L.PRINCIPLED:
        values["emission"] = builder.product(inputs["emission_color"], inputs["emission_strength"])
        clear = builder.add(NODES["weight:share"], {"fac": inputs["alpha"]}, {})
        passed = builder.product(weight, clear["first"])
        shone = builder.product(builder.product(weight, inputs["alpha"]), values["emission"])
        passing += [] if _is_zero(passed) else [passed]
        emitted += [] if _is_zero(shone) else [shone]
        shown += [*emitted, builder.product(weight, clear["second"])]
    elif shader.leaf == L.TRANSPARENT:
        passing.append(weight)
    elif shader.leaf in (L.EMISSION, L.BACKGROUND):
        emitted.append(weight)
        shown.append(weight)
    elif shader.leaf != L.HOLDOUT:
        shown.append(weight)

    names = L.COLUMNS[shader.leaf]
    columns = [(0, 3, builder.convert(weight, COLOR) if isinstance(weight, Constant) else weight)]
    varying = {"weight": builder.varying(weight)}
    for column in names[3:]:
        name = column if column in values else column[:-2]
        if name in varying or name not in values:
            continue
        width = 1 if column == name else 3
        columns.append((names.index(column), width, values[name]))
        varying[name] = builder.varying(values[name])

    normals = _normals(builder, shader, inputs, node)
    for name, source in normals.items():
        varying[name] = builder.varying(source)
    distribution = node.params.get("distribution", "multi_ggx")
    lobes = _lobe_bound(shader.leaf, inputs)
    template = leaf_template(shader.leaf, columns)
    plan = LeafPlan(shader.leaf, tuple(columns), varying, normals, distribution, lobes, template)
    return plan, passing, emitted, shown


def _normals(
    builder: Builder, shader: ShaderType, inputs: dict[str, Source], node: Node
) -> dict[str, Source]:
    """Normals and tangents that differ from the point's own."""
    found: dict[str, Source] = {}
    if builder.normal is not None and "normal" in shader.inputs:
        found["surface_normal"] = builder.normal
    for name in ("normal", "coat_normal"):
        if name not in shader.inputs:
            continue
        if name == "coat_normal" and _is_zero(inputs["coat_weight"]):
            continue
        if name in inputs:
            if not _is_zero(inputs[name]):
                found[name] = inputs[name]
        elif builder.normal is not None:
            found[name] = builder.normal
    if shader.anisotropy is not None and not _is_zero(inputs[shader.anisotropy]):
        found["tangent"] = inputs.get("tangent") or builder.implicit("tangent")
    return found


def _is_zero(source: Source) -> bool:
    return isinstance(source, Constant) and not source.value.any()


def _is(source: Source, value: float) -> bool:
    return isinstance(source, Constant) and bool(np.all(source.value == np.float32(value)))


def _lobe_bound(leaf: int, inputs: dict[str, Source]) -> int:
    """At most so many BSDF lobes, transparent ones counted; glass is one lobe."""
    if leaf in (L.EMISSION, L.BACKGROUND, L.HOLDOUT):
        return 0
    if leaf != L.PRINCIPLED:
        return 1
    lobes = 0 if _is(inputs["alpha"], 1.0) else 1
    lobes += not _is_zero(inputs["sheen_weight"])
    lobes += not _is_zero(inputs["coat_weight"])
    lobes += not _is_zero(inputs["metallic"])
    if not _is(inputs["metallic"], 1.0):
        lobes += not _is_zero(inputs["transmission_weight"])
        lobes += 0 if _is(inputs["transmission_weight"], 1.0) else 2
        lobes += not (_is_zero(inputs["subsurface_weight"]) or _is_zero(inputs["diffuse_roughness"]))
    return lobes
