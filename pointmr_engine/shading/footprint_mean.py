"""Means over rays' footprints of what no pyramid filters: procedural textures, sampled at places of each footprint.

A checker or a noise has no stored levels as an image has. Seen from afar, one point of it stands for nothing: what a
material takes from it is evaluated at several points of the footprint, in the plane of the surface, and averaged
before shading, as prefiltered texels are.

Pyramids of images filter squares. Where a surface is seen obliquely, its footprint is longer than wide: images are read
at places along it, as wide as it is wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.differentials import moved_points, tangent_axes
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.values import cross, dot

NEEDS = frozenset({"moved", "footprint", "geometric_normal", "incoming", "position", "camera_from_world"})
GRAZING = 0.02  # cosine below which footprints on a surface grow no further
FIRST, MORE, ALL = 4, 16, 32  # places of a footprint
ALIKE = 0.1  # of their mean: largest difference between the first places' values that needs no others
CONTRAST = 1.0  # ... between the values of more places, that needs not all
FAINT = 0.01  # added to that mean
OBLIQUE = 0.6  # cosine below which images are read at several places
FAR = 0.2  # ... and at all of them, where the first ones differ
# at which places of their footprints points see textures: as many as they need, the first ones, none but their own
EVERY, SOME, POINT = 0, 1, 2
OF_FEW = FIRST / (FIRST - 1)  # times the variance about the mean of so few

# 32 points of a lattice, the first 4 and 16 of which are lattices, too (Hickernell, Hong, L'Ecuyer and
# Lemieux 2000, "Extensible Lattice Sequences for Quasi-Monte Carlo Quadrature"): points of Sobol's sequence resonate
# with checks. The generator was chosen for checks of all sizes.
_U = np.array([int(f"{i:05b}"[::-1], 2) for i in range(ALL)]) / ALL
_LATTICE = np.stack([_U, 19.0 * _U % 1.0])


class Slopes(NamedTuple):
    """How values change across the footprints of m points: of planes that fit the values at all places best."""

    rows: np.ndarray  # (m,) int64 of the points whose footprints they are
    sides: np.ndarray  # (2, m, 3) float64 sides of the footprints, world space, metres
    along: tuple[dict, dict]  # by name, (m,) or (m, 3) float32: change from end to end of either side


def footprint_means(
    run: Callable[[SurfacePoints], dict],
    gather: Callable[[np.ndarray], SurfacePoints],
    rows: np.ndarray,
    needs: frozenset[str],
    seed: int = 0,
    few: np.ndarray | None = None,
    rough: frozenset = frozenset(),
) -> tuple[dict, dict, Slopes | None]:
    """Values by name, each (n,) or (n, 3) float32: the means over the footprints of points `rows` (n,).

    run(points): the values at points, by name; needs: what it reads. gather(rows): the points with these fields, and
    with NEEDS. seed: another one has other places. few (n,) bool: points that are not worth more than the first places.
    Also returns `two_values` (3, n) of those with names in `rough`, in parts of their mean, and the slopes where values
    differ.
    """
    found, places, sides = _at_places(run, gather, rows, needs, seed, 0, FIRST)
    mean = {name: v.mean(0) for name, v in found.items()}
    pairs = {name: two_values(found[name]) for name in rough}
    chosen, slopes = np.arange(len(rows)), None
    for begin, end, apart in ((FIRST, MORE, ALIKE), (MORE, ALL, CONTRAST)):
        differ = _differ(found, apart)
        if few is not None and begin == FIRST:
            differ &= ~few
        differ = np.flatnonzero(differ)
        if not len(differ):
            break
        chosen, places = chosen[differ], places[:, :, differ]
        others, other_places, sides = _at_places(run, gather, rows[chosen], needs, seed, begin, end)
        found = {name: np.concatenate([v[:, differ], others[name]]) for name, v in found.items()}
        places = np.concatenate([places, other_places], 1)
        for name, v in found.items():
            mean[name][chosen] = v.mean(0)
        for name in rough:
            pairs[name][:, chosen] = two_values(found[name])
        along = _planes(places, found)
        slopes = Slopes(chosen, sides, along) if slopes is None else _with(slopes, differ, along)
    return mean, pairs, slopes


def two_values(values: np.ndarray) -> np.ndarray:
    """(3, n) float32: two numbers, in parts of the mean of values (k, n), and the weight of the first; variance and
    skewness are those of the values."""
    mean = values.mean(0)
    apart = (values - mean) / np.maximum(mean, 1e-6)
    deviation = np.sqrt((apart**2).mean(0))
    skew = 0.5 * (apart**3).mean(0) / np.maximum(deviation, 1e-9) ** 3
    root = np.sqrt(1.0 + skew * skew)
    low, high = 1.0 - deviation * (root - skew), 1.0 + deviation * (root + skew)
    return np.stack([low, high, 0.5 * (1.0 + skew / root)]).astype(np.float32)


def roughness_at_places(run, gather, rows: np.ndarray, needs: frozenset[str], seed: int = 0) -> dict:
    """`two_values` by name of what images decide, at the first places of footprints, unfiltered: in their pyramids lie
    means alone. See `footprint_means`.
    """
    found = _at_places(run, gather, rows, needs, seed, 0, FIRST, 0.0)[0]
    pairs = {name: two_values(v) for name, v in found.items()}
    for of_few in pairs.values():
        of_few[:2] = 1.0 + math.sqrt(OF_FEW) * (of_few[:2] - 1.0)
    return pairs


def normals_at_places(
    run, gather, rows: np.ndarray, needs: frozenset[str], seed: int = 0, images: bool = True
) -> tuple[dict, dict]:
    """Normals (FIRST, n, 3) by name at the first places of footprints; see `footprint_means`.

    Images are filtered over the part of the footprint that a place stands for, which tells the mean best, and not at
    all, as it takes to tell how the normals differ. images: whether any bends them; else both are one.
    """
    points = gather(rows)

    def places(narrower: float) -> dict:
        return _at_places(run, lambda _: points, rows, needs, seed, 0, FIRST, narrower)[0]

    wide = places(1.0 / math.sqrt(FIRST))
    return wide, places(0.0) if images else wide


def nearer_to_mean(normals: np.ndarray, mean: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Of normals (FIRST, n, 3) of `normals_at_places` those at one place, (n, 3), so much nearer to the mean (n, 3) of
    all places that they vary by 1 - shared of what these do.

    shared (n,): the part of the variance, 0..1, that lobes about the result have besides.
    """
    return mean + np.sqrt(1.0 - shared).astype(np.float32)[:, None] * (normals[0] - mean)


def _with(slopes: Slopes, rows: np.ndarray, along: tuple[dict, dict]) -> Slopes:
    """`slopes` in which rows have these instead."""
    for old, new in zip(slopes.along, along, strict=True):
        for name, v in new.items():
            old[name][rows] = v
    return slopes


@device
def _spread_of(places, i):
    """Mean of places[:, :, i] along either axis, and the sums uu, uv, vv of products of what differs from it."""
    k = places.shape[1]
    mean_u, mean_v = 0.0, 0.0
    for j in range(k):
        mean_u, mean_v = mean_u + places[0, j, i], mean_v + places[1, j, i]
    mean_u, mean_v = mean_u / k, mean_v / k
    uu, uv, vv = 0.0, 0.0, 0.0
    for j in range(k):
        u, v = places[0, j, i] - mean_u, places[1, j, i] - mean_v
        uu, uv, vv = uu + u * u, uv + u * v, vv + v * v
    return mean_u, mean_v, uu, uv, vv


@uncounted
def _fit_planes(places, x, along):
    """along (2, m, channels) from values x (k, m, channels) at places (2, k, m): see `_planes`."""
    k = x.shape[0]
    freedom = 2.0 / (k - 3)
    for i in range(x.shape[1]):
        mean_u, mean_v, uu, uv, vv = _spread_of(places, i)
        inverse = 1.0 / (uu * vv - uv * uv)  # of stratified places: far from 0
        of_planes, whole = 0.0, 0.0
        for c in range(x.shape[2]):
            mean, ux, vx = 0.0, 0.0, 0.0
            for j in range(k):
                mean += x[j, i, c]
            mean /= k
            for j in range(k):
                w = x[j, i, c] - mean
                ux, vx = ux + (places[0, j, i] - mean_u) * w, vx + (places[1, j, i] - mean_v) * w
                whole += w * w
            a, b = (vv * ux - uv * vx) * inverse, (uu * vx - uv * ux) * inverse
            along[0, i, c], along[1, i, c] = a, b
            of_planes += uu * a * a + 2.0 * uv * a * b + vv * b * b
        chance = freedom * max(whole - of_planes, 0.0)
        part = max(1.0 - chance / max(of_planes, 1e-30), 0.0)
        for c in range(x.shape[2]):
            along[0, i, c] *= part
            along[1, i, c] *= part


def _planes(places: np.ndarray, values: dict) -> tuple[dict, dict]:
    """By name, (m, ...): by how much the plane nearest to values (k, m, ...) at places (2, k, m) rises along either
    axis, in one step of 1; less by what chance may have of it (James and Stein 1961).
    """
    along: tuple[dict, dict] = {}, {}
    for name, x in values.items():
        rises = np.empty((2, *x.shape[1:]), np.float32)
        of_channels = rises.reshape(*rises.shape[:2], -1)
        _fit_planes(places, np.ascontiguousarray(x).reshape(*x.shape[:2], -1), of_channels)
        along[0][name], along[1][name] = rises
    return along


def stretched_means(
    run: Callable[[SurfacePoints], dict],
    gather: Callable[[np.ndarray], SurfacePoints],
    rows: np.ndarray,
    needs: frozenset[str],
    cosine: np.ndarray,
) -> dict:
    """`footprint_means` of what images decide, along footprints: at each place they are filtered over a square.

    cosine (n,): to the viewers, all below OBLIQUE.
    """

    def along(index: np.ndarray, count: int) -> dict:
        points = gather(rows[index])
        _, b = _axes(points)
        steep = np.maximum(cosine[index], GRAZING).astype(np.float64)
        places = np.linspace(-0.5, 0.5, count)[:, None, None]
        # places have their own width, which is that of the whole footprint across the view
        offset = places * ((1.0 - steep)[:, None] * b)
        return _values_at(run, points, offset, needs, of_uvs=np.sqrt(steep))

    first = along(np.arange(len(rows)), FIRST)
    mean = {name: v.mean(0) for name, v in first.items()}
    more = np.flatnonzero((cosine < FAR) & _differ(first, ALIKE))
    if len(more):
        for name, v in along(more, MORE).items():
            mean[name][more] = v.mean(0)
    return mean


def _differ(values: dict, apart: float) -> np.ndarray:
    """(n,) bool: whether the values (k, n, ...) of any name are farther apart than this part of their mean.

    Or their mean is as far from that of the footprints before or after, which lie side by side as a rule: of what is
    only black and white, four places are all alike in an eighth of all footprints, however fine it is.
    """
    differ = np.zeros(next(iter(values.values())).shape[1] if values else 0, np.bool_)
    for v in values.values():
        v = v if v.ndim == 3 else v[..., None]
        mean = v.mean(0)
        room = apart * (np.abs(mean) + FAINT)
        differ |= (v.max(0) - v.min(0) > room).any(1)
        steps = np.abs(np.diff(mean, axis=0))
        differ[1:] |= (steps > room[1:]).any(1)
        differ[:-1] |= (steps > room[:-1]).any(1)
    return differ


def slope_variance(mean: np.ndarray) -> np.ndarray:
    """(n,) float32 variance of slopes along one axis, of unit normals whose mean (n, 3) of FIRST places is given
    (Toksvig 2005, "Mipmapping Normal Maps").
    """
    length = np.sqrt(dot(mean, mean))
    return np.maximum(1.0 / np.maximum(length, 0.1) - 1.0, 0.0).astype(np.float32) * np.float32(OF_FEW)


def _at_places(run, gather, rows: np.ndarray, needs, seed: int, begin: int, end: int, narrower=None):
    """Values (end - begin, n, ...) at places begin..end of the footprints of points `rows`, all in one batch; these
    places (2, end - begin, n) along the footprints' sides, from -0.5 to 0.5, and the sides (2, n, 3). narrower: over
    what part of the footprint images are filtered.
    """
    points = gather(rows)
    a, b = _turned(points, *_axes(points))
    places, offset = np.empty((2, end - begin, len(rows))), np.empty((end - begin, len(rows), 3))
    _fill_places(np.stack(turns(points.position, seed)), _LATTICE[:, begin:end], a, b, places, offset)
    if narrower is not None:
        narrower = np.full(len(rows), narrower, np.float32)
    return _values_at(run, points, offset, needs, narrower), places, np.stack([a, b])


@uncounted
def _fill_places(turns, lattice, a, b, places, offset):
    """places (2, k, n): points of lattice (2, k) turned by (2, n), from -0.5 to 0.5; offset (k, n, 3): along a, b."""
    for j in range(places.shape[1]):
        for i in range(places.shape[2]):
            for axis in range(2):
                place = turns[axis, i] + lattice[axis, j]
                places[axis, j, i] = place - (1.5 if place >= 1.0 else 0.5)
            for c in range(3):
                offset[j, i, c] = places[0, j, i] * a[i, c] + places[1, j, i] * b[i, c]


def _values_at(run, points: SurfacePoints, offset: np.ndarray, needs, narrower=None, of_uvs=None) -> dict:
    """Values (count, n, ...) at the n points moved by offset (count, n, 3), all in one batch.

    narrower (n,): over what part of the footprints images are filtered there; of_uvs (n,): of the footprints of UVs,
    which are as large as those on the oblique surface.
    """
    count, n = offset.shape[:2]
    moved = moved_points(points, offset.reshape(-1, 3), needs, narrower)
    if of_uvs is not None:
        scale = np.tile(of_uvs.astype(np.float32), count)
        moved.uv_footprints = {k: v * scale for k, v in moved.uv_footprints.items()}
    # far outside a triangle its normals go anywhere; how the surface itself bends is not a matter of textures
    for name in ("normal", "smooth_normal"):
        if getattr(moved, name) is not None:
            setattr(moved, name, np.tile(getattr(points, name), (count, 1)))
    moved.tangents = {k: np.tile(points.tangents[k], (count, 1)) for k in moved.tangents}
    values = run(moved)
    return {
        name: np.broadcast_to(x, (count * n, *x.shape[1:])).reshape(count, n, *x.shape[1:])
        for name, x in values.items()
    }


def _axes(points: SurfacePoints) -> tuple[np.ndarray, np.ndarray]:
    """Sides (n, 3) float64 of the footprints on their surfaces, world space, metres: across the view and along it."""
    n = points.geometric_normal.astype(np.float64)
    across = cross(n, points.incoming.astype(np.float64))
    length = np.sqrt(dot(across, across))
    facing = length < 1e-6
    if facing.any():
        across[facing], length[facing] = tangent_axes(n[facing])[0], 1.0
    across /= length[:, None]
    width = points.footprint.astype(np.float64)
    cosine = np.maximum(np.abs(dot(n, points.incoming)), GRAZING)
    return width[:, None] * across, (width / cosine)[:, None] * cross(across, n)


def _turned(points: SurfacePoints, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sides a, b of `_axes` turned until the image shows them along its own, as those of its cells."""
    if points.camera_from_world is None:
        return a, b
    incoming, (right, up) = points.incoming.astype(np.float64), points.camera_from_world[:2, :3]
    across = a / np.maximum(points.footprint, 1e-30)[:, None]
    along = cross(across, incoming)
    along[dot(points.geometric_normal, incoming) < 0] *= -1.0
    c, s = across @ right, along @ right
    far = c * c + s * s < 0.1  # seen in a mirror, from the side
    if far.any():
        c[far], s[far] = along[far] @ up, -across[far] @ up
    size = np.maximum(np.sqrt(c * c + s * s), 1e-9)
    c, s = (c / size)[:, None], (s / size)[:, None]
    return c * a + s * b, c * b - s * a


def turns(position: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers (n,) in 0..1 for each position (n, 3) float64, as if by chance: where the places of its footprint
    begin, or what it is of several that it may be.
    """
    h = np.full(len(position), np.uint64(0x9E3779B97F4A7C15 * (2 * seed + 1) & 0xFFFFFFFFFFFFFFFF))
    for c in range(3):
        h = (h ^ np.ascontiguousarray(position[:, c]).view(np.uint64)) * np.uint64(0xBF58476D1CE4E5B9)
        h ^= h >> np.uint64(29)
    return (h >> np.uint64(40)) / 2.0**24, (h & np.uint64(0xFFFFFF)) / 2.0**24
