"""Looking up a mip pyramid: nearest, bilinear or bicubic within a level, linear between levels."""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import prefetch_row

REPEAT, EXTEND, CLIP, MIRROR = range(4)
# bits of `flags`
CLOSEST, SRGB, UNASSOCIATE, CUBIC = 1, 2, 4, 8
AHEAD = 4  # points: so long before one's texels are read they are asked for
ALONG = 8  # looks that stand for a long stretch of texels


@uncounted
def wrap_texel(i, n, extension):
    """Index of texel i in 0..n-1, or -1 outside a clipped image."""
    if 0 <= i < n:
        return i
    if extension == REPEAT:
        return i % n
    if extension == EXTEND:
        return 0 if i < 0 else n - 1
    if extension == MIRROR:
        m = (i if i >= 0 else -i - 1) % (2 * n)
        return 2 * n - m - 1 if m >= n else m
    return -1


@uncounted
def add_texel(texels, offset, width, height, x, y, extension, weight, out):
    """Add weight times texel (x, y) of the level at `offset` to out (4,)."""
    x = wrap_texel(x, width, extension)
    y = wrap_texel(y, height, extension)
    if x >= 0 and y >= 0 and weight != 0.0:
        k = offset + 4 * (y * width + x)
        for c in range(4):
            out[c] += weight * texels[k + c]


@uncounted
def srgb_to_linear(x):
    """The sRGB decoding curve, to single precision: its power is the cheaper one."""
    if x < 0.04045:
        return max(x, 0.0) / 12.92
    return float(np.float32((x + 0.055) / 1.055) ** np.float32(2.4))


# what bytes of sRGB decode to
_OF_BYTES = np.array([srgb_to_linear.py_func(c) for c in np.arange(256) / 255])


@uncounted
def add_decoded(texels, offset, width, height, x, y, extension, flags, scale, weight, out):
    """Add weight times the decoded texel (x, y) of an sRGB level to out (4,), times its alpha with UNASSOCIATE."""
    x = wrap_texel(x, width, extension)
    y = wrap_texel(y, height, extension)
    if x < 0 or y < 0:
        return
    k = offset + 4 * (y * width + x)
    alpha = texels[k + 3] * scale
    straight = (flags & UNASSOCIATE) != 0 and alpha > 0.0 and alpha < 1.0
    for c in range(3):
        if straight:
            out[c] += weight * alpha * srgb_to_linear(texels[k + c] * scale / alpha)
        elif scale < 1.0:
            out[c] += weight * _OF_BYTES[int(texels[k + c])]
        else:
            out[c] += weight * srgb_to_linear(texels[k + c])
    out[3] += weight * alpha


@uncounted
def lookup_mean(texels, levels, level, u, v, extension, flags, scale, out):
    """As `lookup_level`, of a coarser level than the first of an sRGB image: means of light are taken of light."""
    offset, width, height = levels[level, 0], levels[level, 1], levels[level, 2]
    for c in range(4):
        out[c] = 0.0
    x, y = u * width, v * height
    x0, y0 = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    fx, fy = x - 0.5 - x0, y - 0.5 - y0
    for j in range(2):
        for i in range(2):
            weight = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
            add_decoded(texels, offset, width, height, x0 + i, y0 + j, extension, flags, scale, weight, out)
    if flags & UNASSOCIATE and out[3] > 0.0:
        for c in range(3):
            out[c] /= out[3]


@uncounted
def b_spline(f, k):
    """Weight of the k-th (0..3) of four texels for a point at fraction f between the second and the third."""
    if k == 0:
        return (1.0 - f) ** 3 / 6.0
    if k == 1:
        return (f * f * (3.0 * f - 6.0) + 4.0) / 6.0
    if k == 2:
        g = 1.0 - f
        return (g * g * (3.0 * g - 6.0) + 4.0) / 6.0
    return f**3 / 6.0


@uncounted
def add_cubic(texels, offset, width, height, x, y, extension, out):
    """Add the uniform cubic B-spline over 4 x 4 texels at (x, y), in texels, to out (4,)."""
    x0, y0 = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    fx, fy = x - 0.5 - x0, y - 0.5 - y0
    for j in range(4):
        wy = b_spline(fy, j)
        for i in range(4):
            add_texel(
                texels, offset, width, height, x0 + i - 1, y0 + j - 1, extension, wy * b_spline(fx, i), out
            )


@uncounted
def lookup_level(texels, levels, level, u, v, extension, flags, scale, out):
    """Premultiplied scene-linear RGBA of one level at (u, v), into out (4,)."""
    if level > 0 and flags & SRGB and not flags & CLOSEST:
        lookup_mean(texels, levels, level, u, v, extension, flags, scale, out)
        return
    offset, width, height = levels[level, 0], levels[level, 1], levels[level, 2]
    for c in range(4):
        out[c] = 0.0
    x, y = u * width, v * height
    if flags & CLOSEST:
        add_texel(texels, offset, width, height, int(np.floor(x)), int(np.floor(y)), extension, 1.0, out)
    elif flags & CUBIC and level == 0:  # coarser levels are smooth enough
        add_cubic(texels, offset, width, height, x, y, extension, out)
    else:
        x0, y0 = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
        fx, fy = x - 0.5 - x0, y - 0.5 - y0
        add_texel(texels, offset, width, height, x0, y0, extension, (1.0 - fx) * (1.0 - fy), out)
        add_texel(texels, offset, width, height, x0 + 1, y0, extension, fx * (1.0 - fy), out)
        add_texel(texels, offset, width, height, x0, y0 + 1, extension, (1.0 - fx) * fy, out)
        add_texel(texels, offset, width, height, x0 + 1, y0 + 1, extension, fx * fy, out)
    for c in range(4):
        out[c] *= scale
    if flags & UNASSOCIATE and out[3] != 0.0 and out[3] != 1.0:
        for c in range(3):
            out[c] /= out[3]
    if flags & SRGB:
        for c in range(3):
            out[c] = srgb_to_linear(out[c])


@device
def _ask_for(texels, levels, width, u, v):
    """Begin to fetch the texels about (u, v) of the levels that a filter of `width` texels takes, repeated."""
    level = np.int64(0)
    while width >= 2.0 and level + 1 < levels.shape[0]:
        width *= 0.5
        level += 1
    for k in range(level, min(level + (2 if width > 1.0 else 1), levels.shape[0])):
        across, rows = levels[k, 1], levels[k, 2]
        x = min(np.int64((u - np.floor(u)) * across), across - 1)
        y = np.int64((v - np.floor(v)) * rows - 0.5)
        for j in range(y, y + 2):
            prefetch_row(texels, levels[k, 0] + 4 * (min(max(j, 0), rows - 1) * across + max(x, 0)))


@uncounted
def lookup_filtered(texels, levels, width, u, v, extension, flags, scale, coarse, out):
    """RGBA at (u, v), averaged over a square of `width` texels of the finest level, into out (4,); coarse: scratch."""
    last = levels.shape[0] - 1
    level = min(np.log2(width) if width > 1.0 else 0.0, float(last))
    base = int(level)
    lookup_level(texels, levels, base, u, v, extension, flags, scale, out)
    f = level - base
    if f > 0.0 and base < last:
        lookup_level(texels, levels, base + 1, u, v, extension, flags, scale, coarse)
        share = f
        if flags & UNASSOCIATE:  # colours count by their alpha: where there is none, there is no colour
            total = (1.0 - f) * out[3] + f * coarse[3]
            share = f * coarse[3] / total if total > 0.0 else f
        for c in range(3):
            out[c] += share * (coarse[c] - out[c])
        out[3] += f * (coarse[3] - out[3])


@uncounted
def parts_of(x, side):
    """Shares of an interval of length `side` about x that lie below 0 and in 0..1; the latter's middle and length."""
    low, high = x - 0.5 * side, x + 0.5 * side
    first, final = max(low, 0.0), min(high, 1.0)
    within = max(final - first, 0.0)
    before = max(min(high, 0.0) - low, 0.0)
    return before / side, within / side, 0.5 * (first + final), within


@uncounted
def lookup_bounded(texels, levels, side, u, v, extension, flags, scale, coarse, found, out):
    """As `lookup_filtered` over a square of `side` (in units of uv), of an image that is not repeated.

    Coarse levels know what lies within the image: beyond it there is nothing, or the finest level's edge. coarse,
    found: scratch.
    """
    before_u, within_u, middle_u, side_u = parts_of(u, side)
    before_v, within_v, middle_v, side_v = parts_of(v, side)
    texels_across = np.sqrt(float(levels[0, 1]) * float(levels[0, 2]))
    for c in range(4):
        out[c] = 0.0
    for i in range(3):
        share_u = before_u if i == 0 else (within_u if i == 1 else 1.0 - before_u - within_u)
        for j in range(3):
            share = share_u * (before_v if j == 0 else (within_v if j == 1 else 1.0 - before_v - within_v))
            inside = i == 1 and j == 1
            if share < 1e-6 or (extension == CLIP and not inside):
                continue
            wide, along_u, along_v = 0.0, ALONG, ALONG  # the finest level, along an edge
            if inside:  # squares in a row
                along_u = min(int(np.ceil(side_u / side_v)), ALONG) if side_v > 0.0 else ALONG
                along_v = min(int(np.ceil(side_v / side_u)), ALONG) if side_u > 0.0 else ALONG
                wide = max(side_u / along_u, side_v / along_v) * texels_across
            along_u, along_v = along_u if i == 1 else 1, along_v if j == 1 else 1
            weight = share / (along_u * along_v)
            for k in range(along_u * along_v):
                x = middle_u + ((k % along_u + 0.5) / along_u - 0.5) * side_u if i == 1 else 0.5 * i
                y = middle_v + ((k // along_u + 0.5) / along_v - 0.5) * side_v if j == 1 else 0.5 * j
                lookup_filtered(texels, levels, wide, x, y, EXTEND, flags, scale, coarse, found)
                for c in range(3):
                    out[c] += weight * (found[c] * found[3] if flags & UNASSOCIATE else found[c])
                out[3] += weight * found[3]
    if flags & UNASSOCIATE and out[3] > 0.0:
        for c in range(3):
            out[c] /= out[3]


@njit(cache=True, nogil=True, error_model="numpy")
def lookup(texels, levels, uv, footprint, extension, flags, scale, out):
    """RGBA at uv (n, 2) float32 into out (n, 4) float32.

    texels: flat float32 or uint8, all levels; levels (k, 3) int64: offset, width, height of each, finest first.
    footprint (n or 1,) float32: width of the filter in units of uv; 0 takes the finest level. scale brings texels to
    0..1. The finest level is decoded and, with UNASSOCIATE, divided by alpha after its interpolation, as in Cycles.
    """
    n = uv.shape[0]
    texels_across = np.sqrt(float(levels[0, 1]) * float(levels[0, 2]))
    bounded = extension == EXTEND or extension == CLIP
    found = np.empty(4)
    coarse = np.empty(4)
    part = np.empty(4)
    for i in range(n):
        if i + AHEAD < n:
            j = i + AHEAD
            width = footprint[j if footprint.shape[0] > 1 else 0] * texels_across
            _ask_for(texels, levels, width, float(uv[j, 0]), float(uv[j, 1]))
        u, v = float(uv[i, 0]), float(uv[i, 1])
        if not (abs(u) < 1e9 and abs(v) < 1e9):
            for c in range(4):
                out[i, c] = 0.0
            continue
        side = float(footprint[i if footprint.shape[0] > 1 else 0])
        width = side * texels_across
        if bounded and width > 1.0:
            lookup_bounded(texels, levels, side, u, v, extension, flags, scale, coarse, part, found)
        else:
            lookup_filtered(texels, levels, width, u, v, extension, flags, scale, coarse, found)
        for c in range(4):
            out[i, c] = found[c]
