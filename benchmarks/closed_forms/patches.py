"""Flat patches of triangles far below a pixel: the coverage of their outline under the pixel filter.

A convex polygon's coverage is integral of w(y) (W(x_right(y)) - W(x_left(y))) dy, w the filter's profile and W its
cumulative share, since the filter is a product.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import (
    DARK,
    Case,
    View,
    filter_nodes,
    filter_share,
    glow,
    look_at,
    look_down,
)
from pointmr_engine import Group, Mesh, Scene

CELLS = 300  # a side: 180,000 triangles


def patch(cells: int = CELLS, size: float = 2.0, material=None) -> Mesh:
    """A square of cells x cells x 2 triangles in z = 0 about the origin, its inner vertices jittered."""
    a = np.linspace(-0.5 * size, 0.5 * size, cells + 1)
    x, y = np.meshgrid(a, a)
    jitter = np.random.default_rng(5).uniform(-0.3, 0.3, (2, cells + 1, cells + 1)) * size / cells
    jitter[:, [0, -1], :], jitter[:, :, [0, -1]] = 0.0, 0.0
    p = np.stack([x + jitter[0], y + jitter[1], np.zeros_like(x)], -1).reshape(-1, 3)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    triangles = np.concatenate(
        [np.stack([i, i + 1, i + cells + 2], 1), np.stack([i, i + cells + 2, i + cells + 1], 1)]
    ).astype(np.int32)
    return Mesh("patch", p, triangles, materials=(material or glow(),))


def polygon_coverage(view: View, corners: np.ndarray, count: int = 512) -> np.ndarray:
    """(height, width): coverage of a convex polygon, corners (N, 2) in pixels."""
    offsets, weights = filter_nodes(count)
    y = (np.arange(view.height)[:, None] + 0.5 + offsets).ravel()
    left, right = np.full_like(y, np.inf), np.full_like(y, -np.inf)
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        low, high = sorted((a[1], b[1]))
        inside = (y >= low) & (y < high)
        x = a[0] + (y - a[1]) * ((b[0] - a[0]) / (b[1] - a[1])) if high > low else np.zeros_like(y)
        left, right = (
            np.where(inside, np.minimum(left, x), left),
            np.where(inside, np.maximum(right, x), right),
        )
    centre = np.arange(view.width) + 0.5
    left, right = np.where(left > right, 0.0, left), np.where(left > right, 0.0, right)
    share = filter_share(right[:, None] - centre) - filter_share(left[:, None] - centre)
    return np.einsum("ysx,s->yx", share.reshape(view.height, count, view.width), weights)


def _case(name: str, what: str, view: View) -> Case:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)

    def exact() -> np.ndarray:
        return polygon_coverage(view, view.project(corners))

    def scene() -> Scene:
        return Scene(Group("root", [patch()]), view.camera(), [], DARK)

    return Case(name, what, view, scene, exact, range=1.0)


def cases() -> list[Case]:
    """Inside, at an edge and a corner seen straight on, and all of it seen from 70 degrees."""
    inside = View(24, 24, look_down(1.5, roll=0.2), 1.0)
    edge = View(24, 24, look_down(1.5, 0.9, 0.1, roll=0.2), 1.0)
    corner = View(24, 24, look_down(1.5, 0.95, 0.9, roll=0.2), 1.0)
    slanted = View(48, 24, look_at((1.0, -4.0, 1.5), (0.0, 0.0, 0.0), roll=0.15), 1.6)
    return [
        _case("flat patch, inside", "180,000 triangles seen straight on", inside),
        _case("flat patch, edge", "the same at its edge", edge),
        _case("flat patch, corner", "the same at its corner", corner),
        _case("flat patch, slanted", "all of it, seen at 70 degrees", slanted),
    ]
