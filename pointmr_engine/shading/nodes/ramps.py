"""Color Ramp and curves, looked up in tables that were sampled when the graph was made."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.kernels.tables import fill_from_table
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, node
from pointmr_engine.shading.values import mix


def look_up(
    table: np.ndarray, t: np.ndarray, interpolate: bool = True, extrapolate: bool = False
) -> np.ndarray:
    """(n, k) values of a table (m, k) over 0..1 at t (n,), linear between entries or stepped."""
    out = np.empty((len(t), table.shape[1]), np.float32)
    table, t = np.ascontiguousarray(table, np.float32), np.ascontiguousarray(t, np.float32)
    fill_from_table(table, t, interpolate, extrapolate, out)
    return out


def _prepare(params: dict) -> dict:
    # a copy: for a table that is read-only, kernels would be compiled once more
    return {**params, "table": np.array(params["table"], np.float32, order="C")}


@node(
    "color_ramp",
    {"fac": (FLOAT, 0.5)},
    {"color": COLOR, "alpha": FLOAT},
    prepare=_prepare,
    stepped=lambda params: not params.get("interpolate", True),
)
def _color_ramp(c: Call) -> dict[str, np.ndarray]:
    """params: table (m, 4) over 0..1; interpolate False for constant steps."""
    rgba = look_up(c.params["table"], c["fac"], c.params.get("interpolate", True))
    return {"color": rgba[:, :3], "alpha": rgba[:, 3]}


def _curves(c: Call, name: str) -> np.ndarray:
    p, v = c.params, c[name]
    low, high = p.get("low", 0.0), p.get("high", 1.0)
    t = (v - np.float32(low)) / np.float32(high - low)
    table, extrapolate = p["table"], p.get("extrapolate", True)
    if v.ndim == 1:
        return mix(v, look_up(table.reshape(-1, 1), t, True, extrapolate)[:, 0], c["fac"])
    bent = np.concatenate([look_up(table[:, k : k + 1], t[:, k], True, extrapolate) for k in range(3)], 1)
    return mix(v, bent, c.vector("fac"))


@node("rgb_curves", {"fac": (FLOAT, 1.0), "color": (COLOR, 1.0)}, {"color": COLOR}, prepare=_prepare)
def _rgb_curves(c: Call) -> np.ndarray:
    """params: table (m, 3) over low..high, extrapolate."""
    return _curves(c, "color")


@node("vector_curves", {"fac": (FLOAT, 1.0), "vector": (VECTOR, 0.0)}, {"vector": VECTOR}, prepare=_prepare)
def _vector_curves(c: Call) -> np.ndarray:
    """params: table (m, 3) over low..high, extrapolate."""
    return _curves(c, "vector")


@node("float_curve", {"fac": (FLOAT, 1.0), "value": (FLOAT, 1.0)}, {"value": FLOAT}, prepare=_prepare)
def _float_curve(c: Call) -> np.ndarray:
    """params: table (m,) over low..high, extrapolate."""
    return _curves(c, "value")
