"""Node graphs of materials, worlds and lights, as plain data. `shading.program` compiles them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Link:
    """A connection from an output socket: node key and output name."""

    node: str
    output: str


@dataclass
class Node:
    """One node. `kind` names the operation (see shading.nodes); inputs are constants or Links; params are fixed."""

    kind: str
    inputs: dict[str, Any] = field(default_factory=dict)
    params: dict[str, Any] = field(default_factory=dict)


@dataclass
class Graph:
    """Nodes by key, and the links that leave the graph (None: nothing connected)."""

    nodes: dict[str, Node] = field(default_factory=dict)
    surface: Link | None = None
    displacement: Link | None = None
    # the displacement has moved vertices, too: from behind its bumps are bumps, and no dents
    raised: bool = False
