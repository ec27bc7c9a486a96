"""From a node graph to steps: links resolved, types converted, constants folded, coordinates' footprints derived."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.shading.nodes import NODES, SHADERS
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, NodeType, varies_with
from pointmr_engine.shading.values import LUMINANCE


class Constant(NamedTuple):
    """A value known when the graph is compiled: (1,) or (1, 3) float32."""

    value: np.ndarray
    type: str


class Slot(NamedTuple):
    """A value that a step computes."""

    step: int
    output: str
    type: str


Source = Constant | Slot


class Step(NamedTuple):
    """One node of the program. Inputs come from earlier steps only."""

    type: NodeType
    inputs: dict[str, Source]
    params: dict[str, Any]


def constant(value: Any, kind: str) -> Constant:
    """A literal as a Constant of type `kind`; tuples of 4 lose their alpha, wrong shapes are converted."""
    a = np.atleast_1d(np.asarray(value, np.float32)).ravel()[:3]
    if kind == FLOAT:
        if len(a) == 3:
            a = a @ LUMINANCE
        return Constant(np.asarray(a, np.float32).reshape(-1)[:1], FLOAT)
    if len(a) != 3:
        a = np.repeat(a[:1], 3) if len(a) == 1 else np.append(a, 0)[:3].astype(np.float32)
    return Constant(np.ascontiguousarray(a.reshape(1, 3)), kind)


class Builder:
    """Turns what is asked of a graph into `steps`, each node once. `warnings` name what is not supported."""

    def __init__(self, graph: Graph, kind: str, filtered: bool = True) -> None:
        self.graph = graph
        self.kind = kind
        self.filtered = filtered
        self.steps: list[Step] = []
        self.warnings: list[str] = []
        self.normal: Source | None = None  # displacement seen as bump: what replaces the shading normal
        self._built: dict[str, dict[str, Source]] = {}
        self._footprints: dict[tuple[int, str], Source] = {}
        self._varying: list[dict[str, frozenset[str]]] = []

    # ---- asking for values

    def value(self, value: Any, kind: str, default: Any = 0.0) -> Source:
        """The source of an input: a Link, a constant, or None for `default` (a constant or From)."""
        if isinstance(value, Link):
            source = self._link(value)
            if source is not None:
                return self.convert(source, kind)
            value = None
        if value is None:
            value = default
        if isinstance(value, From):
            return self.convert(self.implicit(value.source), kind)
        try:
            return constant(value, kind)
        except (TypeError, ValueError):
            self.warn(f"value {value!r} is not a {kind}; 0 is used")
            return constant(0.0, kind)

    def implicit(self, source: str) -> Source:
        """What an unlinked input reads from the point."""
        if source == "normal" and self.normal is not None:
            return self.normal
        key = f"implicit:{source}"
        if key not in self._built:
            self._built[key] = self.add(NODES[key], {}, {})
        return self._built[key]["value"]

    def warn(self, message: str) -> None:
        """Note a warning once."""
        if message not in self.warnings:
            self.warnings.append(message)

    def varying(self, source: Source) -> frozenset[str]:
        """What a source varies with."""
        return frozenset() if isinstance(source, Constant) else self._varying[source.step][source.output]

    # ---- building

    def _link(self, link: Link) -> Source | None:
        """The source of a link, its whole subgraph built first (no recursion: graphs may be deep)."""
        stack = [link.node]
        open_: set[str] = set()
        while stack:
            key = stack[-1]
            node = self.graph.nodes.get(key)
            if key in self._built or node is None or node.kind in SHADERS or node.kind not in NODES:
                stack.pop()
                continue
            waiting = [
                v.node
                for v in node.inputs.values()
                if isinstance(v, Link) and self._waits_for(v.node) and v.node not in open_
            ]
            if waiting and key not in open_:
                open_.add(key)
                stack += waiting
                continue
            stack.pop()
            self._built[key] = {}  # a link back to this node finds nothing, so that a cycle ends
            self._built[key] = self._node(node)
        node = self.graph.nodes.get(link.node)
        if node is not None and node.kind not in NODES and node.kind not in SHADERS:
            self.warn(f"node '{node.kind}' is not supported; its default is used")
        outputs = self._built.get(link.node)
        return None if outputs is None else outputs.get(link.output)

    def _waits_for(self, key: str) -> bool:
        node = self.graph.nodes.get(key)
        return key not in self._built and node is not None and node.kind in NODES

    def _node(self, node: Node) -> dict[str, Source]:
        kind = NODES[node.kind]
        inputs = {
            name: self.value(node.inputs.get(name), type_, default)
            for name, (type_, default) in kind.inputs.items()
        }
        return self.add(kind, inputs, dict(node.params))

    def add(self, kind: NodeType, inputs: dict[str, Source], params: dict[str, Any]) -> dict[str, Source]:
        """The outputs of a node over given sources: constants where all it depends on is constant."""
        if kind.passes is not None:
            known = {name: s.value for name, s in inputs.items() if isinstance(s, Constant)}
            name = kind.passes(params, known)
            if name is not None:
                return {out: self.convert(inputs[name], type_) for out, type_ in kind.outputs.items()}
        if kind.prepare is not None:
            params = kind.prepare(params)
        every = frozenset(kind.outputs)
        needs = tuple(kind.reads(params, every))
        ignored = set(kind.ignores(params, every))
        used = [s for name, s in inputs.items() if name not in ignored]
        if not needs and not kind.differenced and all(isinstance(s, Constant) for s in used):
            if kind.footprint is not None:
                inputs = {**inputs, "footprint": constant(0.0, FLOAT)}
            values = {n: s.value for n, s in inputs.items() if isinstance(s, Constant)}
            call = Call(values, params, None, every)
            with np.errstate(all="ignore"):
                values = kind.evaluate(call)
            return {o: Constant(np.asarray(values[o], np.float32), t) for o, t in kind.outputs.items()}
        if kind.footprint is not None:
            inputs = {**inputs, "footprint": self.footprint(inputs[kind.footprint])}
        self.steps.append(Step(kind, inputs, params))
        self._varying.append({out: self._variation(kind, inputs, params, out) for out in kind.outputs})
        return {out: Slot(len(self.steps) - 1, out, t) for out, t in kind.outputs.items()}

    def _variation(
        self, kind: NodeType, inputs: dict[str, Source], params: dict[str, Any], output: str
    ) -> frozenset[str]:
        wanted = frozenset({output})
        ignored = kind.ignores(params, wanted)
        return kind.varying.union(
            *(self.varying(s) for name, s in inputs.items() if name not in ignored),
            *(varies_with(need) for need in kind.reads(params, wanted)),
        )

    def convert(self, source: Source, kind: str) -> Source:
        """Blender's implicit conversions: colour to float by luminance, vector to float by mean, float to both."""
        if source.type == kind:
            return source
        if {source.type, kind} == {COLOR, VECTOR}:
            return source._replace(type=kind)
        return self.add(NODES[f"convert:{source.type}_to_{kind}"], {"value": source}, {})["value"]

    def product(self, a: Source, b: Source) -> Source:
        """a * b of floats and colours, simplified where one is constant 0 or 1."""
        for first, second in ((a, b), (b, a)):
            if isinstance(first, Constant):
                if not first.value.any():
                    return constant(0.0, COLOR if COLOR in (a.type, b.type) else FLOAT)
                if (first.value == 1).all() and (first.type == FLOAT or second.type == COLOR):
                    return second
        if a.type == b.type == FLOAT:
            return self.add(NODES["weight:product"], {"a": a, "b": b}, {})["value"]
        inputs = {"a": self.convert(a, COLOR), "b": self.convert(b, COLOR)}
        return self.add(NODES["weight:product_color"], inputs, {})["value"]

    def total(self, sources: list[Source]) -> Source:
        """Sum of sources of one type."""
        kind = "weight:sum" if sources[0].type == FLOAT else "weight:sum_color"
        result = sources[0]
        for s in sources[1:]:
            result = self.add(NODES[kind], {"a": result, "b": s}, {})["value"]
        return result

    # ---- footprints of texture coordinates

    def footprint(self, source: Source) -> Source:
        """Width, in its own units, that the ray's footprint has in a texture coordinate."""
        if isinstance(source, Constant) or self.kind != "surface" or not self.filtered:
            return constant(0.0, FLOAT)
        key = (source.step, source.output)
        if key not in self._footprints:
            self._footprints[key] = self._derive_footprint(source)
        return self._footprints[key]

    def _derive_footprint(self, source: Slot) -> Source:
        step = self.steps[source.step]
        kind = step.type.kind
        if kind == "implicit:uv" or (kind in ("uv_map", "texture_coordinate") and source.output == "uv"):
            params = {"layer": step.params.get("layer", "")}
            return self.add(NODES["footprint:uv"], {}, params)["value"]
        if kind == "mapping" and isinstance(step.inputs["scale"], Constant):
            s = np.abs(step.inputs["scale"].value[0]).astype(np.float64)
            s = s[:2] if s[2] == 1 else s
            scale = float(np.exp(np.log(np.maximum(s, 1e-12)).mean()))
            if step.params.get("type", "POINT") in ("TEXTURE", "NORMAL"):
                scale = 1 / scale
            if step.params.get("type") != "NORMAL":
                return self.product(self.footprint(step.inputs["vector"]), constant(scale, FLOAT))
        if kind == "vector_math":
            op = step.params.get("operation", "ADD")
            if op == "SCALE" and isinstance(step.inputs["scale"], Constant):
                scale = constant(abs(float(step.inputs["scale"].value[0])), FLOAT)
                return self.product(self.footprint(step.inputs["vector"]), scale)
            if op in ("ADD", "SUBTRACT", "FRACTION"):
                others = [step.inputs[n] for n in ("vector", "vector_b")]
                moving = [s for s in others if isinstance(s, Slot)]
                if op == "FRACTION" or len(moving) == 1:
                    return self.footprint(others[0] if op == "FRACTION" else moving[0])
        return self.add(NODES["footprint:differences"], {"vector": source._replace(type=VECTOR)}, {})["value"]
