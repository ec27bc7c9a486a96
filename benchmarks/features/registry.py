"""The list of feature scenes, and what identifies each for a cache of references."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass, field

SIZE = (96, 72)


@dataclass(frozen=True)
class Feature:
    """A builder, the render settings that its subject needs (Cycles' names), and its usual size in pixels."""

    name: str
    build: Callable[[], None]
    overrides: dict = field(default_factory=dict)
    size: tuple[int, int] = SIZE


FEATURES: dict[str, Feature] = {}


def feature(size: tuple[int, int] = SIZE, **overrides):
    """Register a builder function under its own name, with the render settings that it needs."""

    def register(build: Callable[[], None]) -> Callable[[], None]:
        if build.__name__ in FEATURES:
            raise ValueError(f"two feature scenes are called '{build.__name__}'")
        FEATURES[build.__name__] = Feature(build.__name__, build, overrides, size)
        return build

    return register


def builder_text(build: Callable) -> str:
    """The source of a builder and of all in its module that is not another builder."""
    tree = ast.parse(inspect.getsource(sys.modules[build.__module__]))
    kept = []
    for node in tree.body:
        decorated = isinstance(node, ast.FunctionDef) and any(
            isinstance(d, ast.Call) and getattr(d.func, "id", "") == "feature" for d in node.decorator_list
        )
        if not decorated or node.name == build.__name__:
            kept.append(ast.unparse(node))
    return "\n".join(kept)


def source(name: str):
    """The feature scene as a Source of the judge."""
    from benchmarks.features import stage
    from benchmarks.sources import Source, text_hash

    item = FEATURES[name]

    def load() -> None:
        stage.empty_scene()
        item.build()

    content = text_hash(builder_text(item.build), inspect.getsource(stage))
    return Source(name, load, content, item.size, item.overrides, "feature")
