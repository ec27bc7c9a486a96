"""How a program fills the leaves that its node graph ends in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointmr_engine.shading.compiler import Constant, Source
from pointmr_engine.shading.leaves import COLUMNS, GLASS, GLOSSY, METALLIC, PRINCIPLED, REFRACTION

GLOSSY_KINDS = (PRINCIPLED, GLOSSY, METALLIC, GLASS, REFRACTION)


@dataclass(frozen=True)
class LeafPlan:
    """How a leaf is filled: which source fills which columns, and what each varies with.

    columns: (first column, number of columns, source); column_varying: input name -> subset of {"surface", "view",
    "ray", "instance"}; normals: the Leaf's fields "normal", "coat_normal", "tangent",
    "surface_normal" -> source.
    """

    kind: int
    columns: tuple[tuple[int, int, Source], ...]
    column_varying: dict[str, frozenset[str]]
    normals: dict[str, Source]
    distribution: str
    max_lobes: int
    template: np.ndarray  # (1, columns) float32, the constant columns filled

    @property
    def roughness(self) -> Source | None:
        """Of what is glossy; None: nothing is."""
        at = COLUMNS[self.kind].index("roughness") if self.kind in GLOSSY_KINDS else -1
        return next((source for first, _, source in self.columns if first == at), None)

    @property
    def varying_with(self) -> frozenset[str]:
        """What anything of the leaf varies with."""
        return frozenset().union(*self.column_varying.values())


def leaf_template(kind: int, columns: list[tuple[int, int, Source]]) -> np.ndarray:
    """A leaf's block of one row, with what is constant filled in."""
    block = np.zeros((1, len(COLUMNS[kind])), np.float32)
    for first, width, source in columns:
        if isinstance(source, Constant):
            block[0, first : first + width] = source.value.ravel()
    block.flags.writeable = False
    return block
