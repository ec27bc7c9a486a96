"""What a node type is, and the table of all of them.

Values are float32 arrays whose first axis is the batch: (n,) for floats, (n, 3) for colours and vectors, where n is the
number of points, or 1 where nothing varies; numpy's broadcasting does the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from pointmr_engine.shading.points import SurfacePoints

FLOAT, COLOR, VECTOR = "float", "color", "vector"


class From(NamedTuple):
    """Default of an input that nothing is linked to: read from the point. `source` is "normal", "uv", ..."""

    source: str


class Call:
    """One evaluation of one node: `call["name"]` is an input's value."""

    __slots__ = ("inputs", "params", "points", "wanted", "moved")

    def __init__(
        self,
        inputs: dict[str, np.ndarray],
        params: dict[str, Any],
        points: SurfacePoints | None,
        wanted: frozenset[str],
        moved: Callable[..., np.ndarray] | None = None,
    ) -> None:
        self.inputs = inputs
        self.params = params
        self.points = points
        self.wanted = wanted  # names of the outputs that somebody reads
        # moved(input, axis, width): the input's value at points moved along axis 0 or 1 by so many footprints;
        # one_normal=True: beneath the normals of the points themselves
        self.moved = moved

    def __getitem__(self, name: str) -> np.ndarray:
        return self.inputs[name]

    def vector(self, name: str) -> np.ndarray:
        """A float input as a column (n, 1), to combine with vectors."""
        return self.inputs[name][:, None]


def reads_nothing(params: dict[str, Any], wanted: frozenset[str]) -> Iterable[str]:
    """Most nodes read only their inputs."""
    return ()


def ignores_nothing(params: dict[str, Any], wanted: frozenset[str]) -> Iterable[str]:
    """Most nodes read all their inputs."""
    return ()


@dataclass(frozen=True)
class NodeType:
    """An operation. `evaluate(call)` returns its outputs by name (those in call.wanted at least).

    inputs: name -> (type, default constant or From); outputs: name -> type. reads(params, wanted): what it takes from
    the points, in the vocabulary of Program.needs. ignores(params, wanted): inputs that it then does not read.
    varying: what its outputs vary with beyond what it reads.
    differenced: inputs that it also evaluates at moved points. prepare(params): done once, when a graph is compiled.
    passes(params, constants): name of the input that is the result unchanged, or None.
    footprint: name of the vector input whose footprint it reads as the hidden input "footprint".
    fine: it may vary within a footprint, at which it is not filtered (shading.footprint_mean). stepped(params): it
    does so if its inputs differ from place to place.
    """

    kind: str
    inputs: dict[str, tuple[str, Any]]
    outputs: dict[str, str]
    evaluate: Callable[[Call], dict[str, np.ndarray]]
    reads: Callable[[dict[str, Any], frozenset[str]], Iterable[str]] = reads_nothing
    ignores: Callable[[dict[str, Any], frozenset[str]], Iterable[str]] = ignores_nothing
    varying: frozenset[str] = frozenset()
    differenced: tuple[str, ...] = ()
    prepare: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    passes: Callable[[dict[str, Any], dict[str, np.ndarray]], str | None] | None = None
    footprint: str | None = None
    fine: bool = False
    stepped: Callable[[dict[str, Any]], bool] | None = None


@dataclass(frozen=True)
class ShaderType:
    """A leaf shader. Inputs as in NodeType; `columns` says which input fills which column of the leaf's block.

    tint: the color input that multiplies the weight (and `strength` a float input that multiplies it too).
    limits: input -> (lowest, highest) as the shader clamps it. normals: inputs that are normals, by the Leaf's field.
    """

    kind: str
    leaf: int
    inputs: dict[str, tuple[str, Any]]
    columns: dict[str, str] = field(default_factory=dict)
    tint: str | None = None
    strength: str | None = None
    limits: dict[str, tuple[float | None, float | None]] = field(default_factory=dict)
    anisotropy: str | None = None  # the input that makes a tangent matter
    warning: str | None = None


NODES: dict[str, NodeType] = {}
SHADERS: dict[str, ShaderType] = {}


def node(kind: str, inputs: dict[str, tuple[str, Any]], outputs: dict[str, str], **options):
    """Decorator: register a function over a Call as node type `kind`.

    The function may return a dict by output name, or the array itself where there is one output.
    """

    def register(function):
        if len(outputs) == 1:
            (name,) = outputs

            def evaluate(call: Call) -> dict[str, np.ndarray]:
                return {name: function(call)}
        else:
            evaluate = function
        NODES[kind] = NodeType(kind, inputs, outputs, evaluate, **options)
        return function

    return register


# what each thing read from a point varies with; "surface" is what a sample stored with the surface can keep
VARIES: dict[str, frozenset[str]] = {
    "position": frozenset({"surface", "instance"}),
    "incoming": frozenset({"surface", "view", "instance"}),
    "backfacing": frozenset({"view"}),
    "world_from_part": frozenset({"instance"}),
    "object_location": frozenset({"instance"}),
    "object_color": frozenset({"instance"}),
    "object_index": frozenset({"instance"}),
    "object_random": frozenset({"instance"}),
    "camera_from_world": frozenset({"view"}),
    "window": frozenset({"view"}),
    "ray_kind": frozenset({"ray"}),
    "ray_length": frozenset({"ray", "view"}),
    "ray_depth": frozenset({"ray"}),
    "diffuse_depth": frozenset({"ray"}),
    "glossy_depth": frozenset({"ray"}),
    "transmission_depth": frozenset({"ray"}),
    "transparent_depth": frozenset({"ray"}),
}
_SURFACE = frozenset({"surface"})
_INSTANCE = frozenset({"instance"})


def varies_with(need: str) -> frozenset[str]:
    """What a value read from the points varies with, subset of {"surface", "view", "ray", "instance"}.

    Normals and tangents count as "surface": they turn with an instance as its geometry does. Footprints do too: a
    stored sample has its own.
    """
    if need.startswith("instance_attribute:"):
        return _INSTANCE
    return VARIES.get(need, _SURFACE)
