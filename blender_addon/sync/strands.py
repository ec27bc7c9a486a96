"""Strands of hair as triangles: open tubes along smooth curves, as wide as Cycles' ribbons are from everywhere."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.mesh import GENERATED, Attribute, Mesh

from .attributes import Requests
from .derived import STRAND
from .seeds import hash_pair

# sides of a tube, by points of all strands up to which they have so many
SIDES = ((50_000, 8), (300_000, 6), (math.inf, 4))
BENT = 0.25  # radii by which a piece may miss the middle of its curve before it is halved
MOST = 4  # pieces of a segment: those of Cycles' ribbons, at its default


class Strands(NamedTuple):
    """S strands of P points, in the object's space.

    Strand s holds counts[s] points from starts[s] on. of_points (P, channels), of_strands (S, channels) float32: what
    materials may ask for, by name. uv (S, 2) float32 of the surface that they grow on, or None.
    """

    points: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    starts: np.ndarray  # (S,) int64
    counts: np.ndarray  # (S,) int64
    of_points: dict[str, np.ndarray]
    of_strands: dict[str, np.ndarray]
    uv: np.ndarray | None
    generated: np.ndarray | None = None  # (S, 3) of all of a strand, instead of its coordinates


def tubes(name: str, strands: Strands, wanted: Requests) -> Mesh | None:
    """Strands as tubes with what materials want of them; None if none has two points."""
    own = _long(strands)
    if not len(own.starts):
        return None
    strand = np.repeat(np.arange(len(own.counts)), own.counts)
    key, u = _pieces(own, strand)
    points, strand = _smooth(own, strand, key, u), strand[key]
    counts = np.bincount(strand, minlength=len(own.counts))
    sides = next(n for most, n in SIDES if len(points) <= most)
    radius = _between(own.radius[:, None], key, u)[:, 0]
    # a flat-sided tube is as wide on the mean as a round one
    positions, normals = _rings(points[:, :3], points[:, 3] * _wider(sides), strand, counts, sides)
    rings = np.flatnonzero(np.diff(strand, append=-1) == 0)  # all but the last of each strand
    mesh = Mesh(name, positions, _walls(rings, sides), normals, displaceable=False)
    mesh.generated = np.array([np.zeros(3), np.ones(3)])  # as in Cycles: the object's own coordinates
    _add_attributes(mesh, own, wanted, key, u, strand, radius, sides)
    if own.uv is not None:
        corner = (mesh.triangles // sides).astype(np.int64)
        mesh.uvs["surface"] = np.ascontiguousarray(own.uv[strand[corner]], np.float32)
        mesh.active_uv = "surface"
    return mesh


def _long(strands: Strands) -> Strands:
    """The strands of two points or more, one after the other."""
    long = strands.counts > 1
    starts, counts = strands.starts[long].astype(np.int64), strands.counts[long].astype(np.int64)
    first = np.cumsum(counts) - counts
    total = int(counts.sum())
    pick = np.arange(total) + np.repeat(starts - first, counts)
    return Strands(
        strands.points[pick].astype(np.float64),
        strands.radius[pick].astype(np.float64),
        first,
        counts,
        {name: values[pick] for name, values in strands.of_points.items()},
        {name: values[long] for name, values in strands.of_strands.items()}
        | {STRAND["Random"]: hash_pair(np.flatnonzero(long), 0)[:, None].astype(np.float64) / 2.0**32},
        None if strands.uv is None else strands.uv[long],
        None if strands.generated is None else strands.generated[long],
    )


def _neighbours(own: Strands, strand: np.ndarray) -> list[np.ndarray]:
    """Rows of four points about each point's segment: before it, its ends, behind it; ends stand for what is not."""
    row, first = np.arange(len(strand)), own.starts[strand]
    last = first + own.counts[strand] - 1
    return [np.maximum(row - 1, first), row, np.minimum(row + 1, last), np.minimum(row + 2, last)]


def _pieces(own: Strands, strand: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(points before, share of the way to the next) of the points of pieces, more where a strand bends more."""
    a, b, c, d = (own.points[rows] for rows in _neighbours(own, strand))
    off, way = (b + c - a - d) / 16.0, unit(c - b)
    off -= (off * way).sum(1, keepdims=True) * way
    bend = np.linalg.norm(off, axis=1) / np.maximum(BENT * own.radius, 1e-30)
    count = np.ones(len(strand), np.int64)
    count[bend > 1.0] = 2
    count[bend > 4.0] = MOST
    count[own.starts + own.counts - 1] = 1
    key = np.repeat(np.arange(len(strand)), count)
    u = (np.arange(len(key)) - np.repeat(np.cumsum(count) - count, count)) / count[key]
    return key, u


def _smooth(own: Strands, strand: np.ndarray, key: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(N, 4) points and radii of Catmull-Rom curves through the strands' points."""
    through = np.concatenate([own.points, own.radius[:, None]], 1)
    a, b, c, d = (through[rows[key]] for rows in _neighbours(own, strand))
    t = u[:, None]
    points = 0.5 * (((3.0 * (b - c) + d - a) * t + 2.0 * a - 5.0 * b + 4.0 * c - d) * t + c - a) * t + b
    points[:, 3] = np.maximum(points[:, 3], 0.0)
    return points


def _between(values: np.ndarray, key: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Values (P, channels) of points, linear from one to the next; the last of a strand has u = 0."""
    return values[key] + (values[np.minimum(key + 1, len(values) - 1)] - values[key]) * u[:, None]


def _wider(sides: int) -> float:
    """Of a regular polygon about a circle's centre, the radius of corners at which its mean width is the circle's."""
    return (math.pi / sides) / math.sin(math.pi / sides)


def _rings(
    points: np.ndarray, radius: np.ndarray, strand: np.ndarray, counts: np.ndarray, sides: int
) -> tuple[np.ndarray, np.ndarray]:
    """(positions, normals) (N sides, 3) float32 of tubes' corners about their points (N, 3)."""
    first = np.cumsum(counts) - counts
    last = first + counts - 1
    row = np.arange(len(points))
    ahead, behind = row + 1, row - 1
    ahead[last], behind[first] = last, first
    tangent = unit(points[ahead] - points[behind])
    # one reference axis per strand, the one it runs along least: the tube does not twist
    run = np.abs(points[last] - points[first])
    reference = np.eye(3)[np.argmin(run, 1)][strand]
    side = unit(np.cross(tangent, reference))
    up = np.cross(tangent, side)
    angle = 2 * np.pi * np.arange(sides) / sides
    normal = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    positions = (points[:, None] + normal * radius[:, None, None]).reshape(-1, 3)
    return positions.astype(np.float32), normal.reshape(-1, 3).astype(np.float32)


def _walls(rings: np.ndarray, sides: int) -> np.ndarray:
    """(T, 3) int32: triangles between the rings numbered and the next ones."""
    lower = rings[:, None] * sides + np.arange(sides)
    right = rings[:, None] * sides + (np.arange(sides) + 1) % sides
    triangles = np.stack([lower, right, right + sides, lower, right + sides, lower + sides], 2)
    return triangles.reshape(-1, 3).astype(np.int32)


def _add_attributes(mesh: Mesh, own: Strands, wanted: Requests, key, u, strand, radius, sides: int) -> None:
    """What materials want of strands, at the corners of their tubes."""
    step = np.linalg.norm(np.diff(own.points, axis=0, prepend=own.points[:1]), axis=1)
    step[own.starts] = 0.0
    way = np.cumsum(step)
    way -= np.repeat(way[own.starts], own.counts)
    length = way[own.starts + own.counts - 1]
    share = way / np.maximum(np.repeat(length, own.counts), 1e-30)
    found = {
        STRAND["Is Strand"]: lambda: np.ones((len(key), 1)),
        STRAND["Intercept"]: lambda: _between(share[:, None], key, u),
        STRAND["Length"]: lambda: length[strand][:, None],
        STRAND["Thickness"]: lambda: 2.0 * radius[:, None],
    }
    for name, values in own.of_points.items():
        found[name] = lambda values=values: _between(values, key, u)
    for name, values in own.of_strands.items():
        found[name] = lambda values=values: values[strand]
    if wanted.generated and own.generated is not None:
        mesh.attributes[GENERATED] = Attribute(
            np.repeat(own.generated[strand], sides, 0).astype(np.float32), "vertex"
        )
    for name in wanted.geometry & found.keys():
        mesh.attributes[name] = Attribute(np.repeat(found[name](), sides, 0).astype(np.float32), "vertex")


def unit(v: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) at length 1, x where they have none."""
    length = np.sqrt((v * v).sum(1, keepdims=True))
    return np.where(length > 0, v / np.where(length > 0, length, 1), [1.0, 0.0, 0.0])
