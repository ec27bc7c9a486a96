"""Triangle meshes: geometry and per-triangle attributes, in the mesh's own space."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.material import Material

DOMAINS = ("vertex", "corner", "face", "constant")
# attribute (V, 3) per vertex: "generated" coordinates that no box gives, of a deformed mesh
GENERATED = ".generated"


@dataclass(frozen=True, eq=False)
class Attribute:
    """Named values on a mesh. `values` float32 of shape (count, channels), channels 1 to 4.

    `domain` says what `count` is: "vertex" V, "corner" 3T (triangle-major), "face" T, "constant" 1.
    """

    values: np.ndarray
    domain: str = "corner"


@dataclass(eq=False)
class Mesh:
    """A triangle mesh in its own space (metres).

    positions (V, 3) float32 or float64; triangles (T, 3) int32 vertex indices; normals None (flat), (V, 3) per vertex
    or (T, 3, 3) per corner, float32, unit length; uvs: layer name -> (T, 3, 2) float32; attributes: name -> Attribute
    (colour attributes are linear RGBA); material_index (T,) int32 into `materials`, None meaning all 0.
    generated: (2, 3) float64, the box (lower, upper) that maps to 0..1 in "generated" texture coordinates;
    None takes the bounding box; the attribute GENERATED overrides it.
    terminator_offset: 0 to 1, the cosine between light and surface below which shadow rays from smooth triangles start
    above them, on the rounder surface that the normals suggest; 0: never.
    displaceable: whether materials may move its vertices; of strands and points they do not.
    Meshes that share the same arrays share one acceleration structure.
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    uvs: dict[str, np.ndarray] = field(default_factory=dict)
    attributes: dict[str, Attribute] = field(default_factory=dict)
    material_index: np.ndarray | None = None
    materials: tuple[Material | None, ...] = ()
    active_uv: str | None = None
    generated: np.ndarray | None = None
    terminator_offset: float = 0.0
    displaceable: bool = True

    def validate(self) -> list[str]:
        """Raise SceneError for what cannot be read; return warnings for what is tolerated (and will be skipped)."""
        p, t = self.positions, self.triangles
        if p.ndim != 2 or p.shape[1] != 3 or p.dtype.kind != "f":
            raise SceneError(f"mesh '{self.name}': positions must be float (V, 3), not {p.dtype} {p.shape}")
        if t.ndim != 2 or t.shape[1] != 3 or t.dtype.kind not in "iu":
            raise SceneError(f"mesh '{self.name}': triangles must be int (T, 3), not {t.dtype} {t.shape}")
        if len(t) and (t.min() < 0 or t.max() >= len(p)):
            bad = int(np.argmax((t < 0).any(1) | (t >= len(p)).any(1)))
            raise SceneError(f"mesh '{self.name}': triangle {bad} refers to a vertex outside 0..{len(p) - 1}")
        n = self.normals
        if n is not None and n.shape not in ((len(p), 3), (len(t), 3, 3)):
            raise SceneError(f"mesh '{self.name}': normals of shape {n.shape}; expected (V, 3) or (T, 3, 3)")
        for name, uv in self.uvs.items():
            if uv.shape != (len(t), 3, 2):
                raise SceneError(
                    f"mesh '{self.name}': UV layer '{name}' has shape {uv.shape}, expected {(len(t), 3, 2)}"
                )
        counts = {"vertex": len(p), "corner": 3 * len(t), "face": len(t), "constant": 1}
        for name, a in self.attributes.items():
            if a.domain not in counts:
                raise SceneError(f"mesh '{self.name}': attribute '{name}' has an unknown domain '{a.domain}'")
            if a.values.ndim != 2 or len(a.values) != counts[a.domain]:
                raise SceneError(
                    f"mesh '{self.name}': attribute '{name}' has shape {a.values.shape}, "
                    f"expected ({counts[a.domain]}, channels)"
                )
        m = self.material_index
        if m is not None and m.shape != (len(t),):
            raise SceneError(f"mesh '{self.name}': material_index has shape {m.shape}, expected {(len(t),)}")
        warnings = []
        if len(t) == 0:
            warnings.append(f"mesh '{self.name}' has no triangles")
        elif not np.isfinite(p).all():
            bad = ~np.isfinite(p).all(1)
            hit = int(bad[t].any(1).sum())
            warnings.append(
                f"mesh '{self.name}': vertex {int(np.argmax(bad))} is not finite; {hit} triangles are skipped"
            )
        return warnings
