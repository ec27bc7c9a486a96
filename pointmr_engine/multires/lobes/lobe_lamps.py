"""Lamps in the cones of strong lobes: each sub-ray that meets a lamp before anything else brings its radiance.

The lobe weighs the sub-rays, so that highlights of lamps have little noise, however narrow they are: light samples of a
lamp hardly ever fall into a narrow lobe. What they find better, in the lobe's tails, is theirs (power heuristic; Veach
1997): lobe_shares.share_with_lobes has the other half. Cones of mirrors and clear glass have them all: of one ray for
each, lamps about as thin as a footprint would be too bright or too dark by how they lie in the image.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones.cones import direction_of, origin_of
from pointmr_engine.multires.lobes.lobe_cones import (
    LobeCones,
    finds_lights,
    looks_within,
    slopes_of,
)
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lamps import (
    ELLIPSE,
    HALF_U,
    HALF_V,
    PX,
    PY,
    PZ,
    RADIUS,
    RECTANGLE,
    SUN,
    intersect_lamp,
    lamp_pdf_scale,
)
from pointmr_engine.raytracing.light_tree import light_probability
from pointmr_engine.raytracing.path_arrays import NO_LAMPS, Paths
from pointmr_engine.shading.bsdf.vector import row3


@device
def _is_sharp(paths: Paths, lobes: LobeCones, m):
    """Whether cone m is a mirror's, or clear glass's, that shows lamps by itself."""
    return lobes.alpha[m] == 0.0 and paths.bsdf_pdf[m] == math.inf and not paths.flags[m] & NO_LAMPS


@device
def may_show(lamps, lamp, visibility, origin, axis, half):
    """Whether a cone of half an angle `half` about a unit axis may show a lamp: by the balls about both.

    Not one that varies, nor one that rays of this visibility do not meet.
    """
    if not lamps.mis[lamp] or lamps.varying[lamp] or not lamps.visibility[lamp] & visibility:
        return False
    row, shape = lamps.values[lamp], lamps.shape[lamp]
    if shape == SUN:
        return True
    x, y, z = row[PX] - origin[0], row[PY] - origin[1], row[PZ] - origin[2]
    wide = row[RADIUS]
    if shape == RECTANGLE or shape == ELLIPSE:
        wide = math.sqrt(row[HALF_U] * row[HALF_U] + row[HALF_V] * row[HALF_V])
    far = math.sqrt(x * x + y * y + z * z)
    if not far > wide:
        return True
    along = (x * axis[0] + y * axis[1] + z * axis[2]) / far
    return math.acos(min(max(along, -1.0), 1.0)) <= 1.001 * (half + math.asin(wide / far))


@uncounted
def first_fragments(fragments, count, begin):
    """begin (N + 1,) int64: the first of the fragments 0..count of each cone, which are in the order of the cones."""
    begin[:] = 0
    for r in range(count):
        begin[fragments.cone[r] + 1] += 1
    for k in range(len(begin) - 1):
        begin[k + 1] += begin[k]


@device
def _stopped(fragments, first, end, b):
    """Where, along the cone's axis, sub-ray b meets one of the fragments first..end."""
    for r in range(first, end):
        if (fragments.mask[r] >> np.uint64(b)) & np.uint64(1):
            return 0.5 * (fragments.depth[r, 0] + fragments.depth[r, 1])
    return math.inf


@device
def _slopes(lobes, k, b):
    """Slopes of sub-ray b of cone k; what is left of a cell whose middle the lobe's core covers is met beside it."""
    wide, high = np.float64(lobes.cones.spread[k, 0]), np.float64(lobes.cones.spread[k, 1])
    u, v = slopes_of(lobes.cones, k, b)
    if lobes.part[k] == 2:
        core_u, core_v = np.float64(lobes.cones.spread[k - 1, 0]), np.float64(lobes.cones.spread[k - 1, 1])
        if abs(u) < core_u and abs(v) < core_v:
            if (b ^ (b >> 3) ^ k) & 1:
                u = math.copysign(0.5 * (abs(u) + 0.125 * wide + core_u), u)
            else:
                v = math.copysign(0.5 * (abs(v) + 0.125 * high + core_v), v)
    return u, v


@device
def _add_sub_ray(lamps, tree, near, count, lobes, k, b, stop, transmissive, out, towards):
    """Add to row k of out what sub-ray b of cone k brings of lamps near[:count] that it meets within `stop`.

    Its direction, by the weight of that, is added to row k of towards.
    """
    c = lobes.cones
    u, v = _slopes(lobes, k, b)
    dx, dy, dz = direction_of(c, k, u, v)
    stretch = math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / stretch, dy / stretch, dz / stretch
    # beside others, where the cone is a footprint
    x, y = (0.25 * (b & 7) - 0.875) * c.start[k, 0], (0.25 * (b >> 3) - 0.875) * c.start[k, 1]
    x, y, z = origin_of(c, k, x, y)
    nx, ny, nz = row3(lobes.normal, k)
    for i in range(count):
        lamp = np.int64(near[i])
        t = intersect_lamp(lamps, lamp, x, y, z, dx, dy, dz)
        if not t > 0.0 or (t >= stop * stretch and stop < math.inf):
            continue
        pdf, scale = lamp_pdf_scale(lamps, lamp, x, y, z, nx, ny, nz, transmissive, dx, dy, dz, t)
        pdf *= light_probability(tree, tree.leaf_of_lamp[lamp], x, y, z, nx, ny, nz, transmissive)
        own = looks_within(lobes, k, (dx, dy, dz))
        if not own > 0.0:
            continue
        ratio = pdf / own
        scale *= lobes.weights[k, b] / (1.0 + ratio * ratio)
        for a in range(3):
            out[k, a] += lamps.radiance[lamp, a] * scale
        towards[k, 0] += dx * scale
        towards[k, 1] += dy * scale
        towards[k, 2] += dz * scale


@uncounted
def lamps_in_cones(
    lamps, tree, met, paths: Paths, lobes: LobeCones, fragments, begin, n, sharp, rough, near, out, towards
):  # fmt: skip
    """Add to out (N, 3) float32 the radiance of lamps that the cones 0..n see, where they are to find it.

    sharp, rough: whether cones of mirrors and clear glass are, whose paths see no lamps then, and those of lobes.

    towards (N, 3) float64, added to as well: where they see it on the whole, of no length.

    tree: LightTree; met (K,) int32: lamps that rays can meet, of which those that vary are left out; fragments: what
    the cones meet; begin: see first_fragments; near (K,) int32 to work in.
    """
    for k in range(n):
        by_itself = sharp and _is_sharp(paths, lobes, np.int64(k))
        if not (by_itself or rough and finds_lights(paths, lobes, np.int64(k))):
            continue
        c, count = lobes.cones, np.int64(0)
        origin, axis = row3(c.origin, k), row3(c.axes[k], 2)
        half = math.atan(math.sqrt(c.spread[k, 0] ** 2 + c.spread[k, 1] ** 2))
        for i in range(len(met)):
            lamp = np.int64(met[i])
            if may_show(lamps, lamp, c.visibility[k], origin, axis, half):
                near[count] = lamp
                count += 1
        if count == 0:
            continue
        if by_itself:
            paths.flags[k] |= NO_LAMPS
        for b in range(64):
            if lobes.weights[k, b] > 0:
                stop = _stopped(fragments, begin[k], begin[k + 1], b)
                _add_sub_ray(
                    lamps,
                    tree,
                    near,
                    count,
                    lobes,
                    np.int64(k),
                    np.int64(b),
                    stop,
                    paths.origin_transmissive[k],
                    out,
                    towards,
                )
