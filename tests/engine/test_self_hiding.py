"""What a sample's pieces hide of each other: nothing side by side, all but one of a stack, half of a thin body."""

from __future__ import annotations

import numpy as np
import pytest

from pointmr_engine.hierarchy import self_hiding
from pointmr_engine.hierarchy.pieces import cut
from pointmr_engine.hierarchy.self_hiding import seen_share
from pointmr_engine.hierarchy.surfels import AREA, COLUMNS, NX, NZ, XX, ZZ, X, Z

TIMES = 50  # samples that are averaged


def rows_of(triangles: np.ndarray, size: float) -> np.ndarray:
    """(C, 16) candidates: triangles (T, 3, 3) cut to pieces of `size`."""
    pieces = cut(triangles, size)
    row = np.zeros((len(pieces.area), COLUMNS), np.float32)
    row[:, X : Z + 1], row[:, AREA], row[:, XX : ZZ + 1] = pieces.position, pieces.area, pieces.covariance
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    row[:, NX : NZ + 1] = normal[pieces.triangle]
    return row


def quad(corner, u, v) -> np.ndarray:
    a, u, v = (np.asarray(p, float) for p in (corner, u, v))
    return np.array([[a, a + u, a + u + v], [a, a + u + v, a + v]])


def tube(sides: int, length: float, radius: float) -> np.ndarray:
    """(2 * sides, 3, 3): an open tube along x."""
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate(
        [quad((0, *ring[k]), (length, 0, 0), (0, *(ring[k + 1] - ring[k]))) for k in range(sides)]
    )


def share_of(row: np.ndarray) -> float:
    """The mean of many samples of the same pieces, each of which is looked at in other places."""
    owner = np.repeat(np.arange(TIMES, dtype=np.int32), len(row))
    return float(seen_share(np.tile(row, (TIMES, 1)), np.tile(row[:, AREA], TIMES), owner, TIMES).mean())


def test_a_surface_hides_nothing_of_itself_flat_or_bent():
    flat = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    assert share_of(rows_of(flat, 0.2)) == 1.0
    bent = np.concatenate([flat, quad((0, 0, 0), (0, 0, 1), (0, 1, 0))])
    assert share_of(rows_of(bent, 0.2)) > 0.7  # its wings are before each other in half of all directions


@pytest.mark.parametrize("sheets", [2, 5])
def test_of_a_stack_one_sheet_shows(sheets):
    # turned a little, so that their normals are not one: surfaces are not looked at
    stack = [quad((0, 0, 0.001 * k), (1, 0, 0), (0, 1, 0.0)) for k in range(sheets)]
    row = rows_of(np.concatenate(stack), 0.12)
    turned = row.copy()
    turned[::2, NX], turned[::2, NZ] = 0.6, 0.8
    assert share_of(turned) == pytest.approx(1 / sheets, rel=0.05)


@pytest.mark.parametrize("sides", [3, 6])
def test_a_thin_body_shows_half_of_its_sides(sides):
    """Whatever the number of its sides: each direction meets two of them, the near and the far one."""
    row = rows_of(tube(sides, 1.0, 0.03), 0.1)
    assert share_of(row) == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("count", [10, 60, 200])
def test_leaves_in_a_ball_hide_each_other_as_often_as_they_do(count):
    """Against what the same triangles cover of a grid."""
    rng, leaves = np.random.default_rng(count), []
    for _ in range(count):
        u, v, at = rng.normal(size=(3, 3))
        v -= u * (u @ v) / (u @ u)
        at *= rng.random() ** (1 / 3) / np.linalg.norm(at)
        leaves.append(quad(at, 0.3 * u / np.linalg.norm(u), 0.15 * v / np.linalg.norm(v)))
    triangles = np.concatenate(leaves)
    assert share_of(rows_of(triangles, 0.2)) == pytest.approx(covered_share(triangles), rel=0.06)


def covered_share(triangles: np.ndarray, side: int = 400) -> float:
    """What triangles cover together of three planes, by what they cover each."""
    x, y = np.stack(np.meshgrid(*[(np.arange(side) + 0.5) / side * 3 - 1.5] * 2))
    together = each = 0
    for axis in self_hiding.AXES:
        p = np.cross(axis, (0.0, 0.0, 1.0))
        p /= np.linalg.norm(p)
        times = np.zeros((side, side), int)
        for a, b, c in np.stack([triangles @ p, triangles @ np.cross(axis, p)], -1):
            double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / double
            v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / double
            times += (u >= 0) & (v >= 0) & (u + v <= 1)
        together, each = together + (times > 0).sum(), each + times.sum()
    return together / each


def test_samples_do_not_hide_each_other_and_strangers_count_for_none():
    sheets = [quad((0, 0, 0.001 * k), (1, 0, 0), (0, 1, 0.0)) for k in range(2)]
    row = rows_of(np.concatenate(sheets), 0.12)
    row[::2, NX], row[::2, NZ] = 0.6, 0.8
    half = len(row) // 2
    owner = np.repeat(np.int32([0, 2]), half)
    share = seen_share(row, row[:, AREA].copy(), owner, 3)
    assert share[0] > 0.9 and share[1] == 1.0 and share[2] > 0.9
    owner[half:] = -1
    assert seen_share(row, row[:, AREA].copy(), owner, 1)[0] > 0.9
