"""Perlin noise in one to four dimensions and the fractals built of it."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.shading.kernels.hashes import hash_words
from pointmr_engine.shading.kernels.solid_noise import add_solid, fade, perlin_solid

FBM, MULTIFRACTAL, HYBRID_MULTIFRACTAL, RIDGED_MULTIFRACTAL, HETERO_TERRAIN = range(5)
# columns of `parameters`
DETAIL, ROUGHNESS, LACUNARITY, OFFSET, GAIN, DISTORTION = range(6)


@uncounted
def gradient(dimensions, h, x, y, z, w):
    """Dot product of (x, y, z, w) with the gradient that hash h chooses, in any dimensions but three."""
    if dimensions == 1:
        g = 1.0 + (h & 7)
        return -g * x if h & 8 else g * x
    third = 0.0
    if dimensions == 2:
        h &= 7
        a = x if h < 4 else y
        b = 2.0 * (y if h < 4 else x)
    else:
        a = x if h < 24 else y
        b = y if h < 16 else z
        third = z if h < 8 else w
    return (-a if h & 1 else a) + (-b if h & 2 else b) + (-third if h & 4 else third)


@uncounted
def perlin(dimensions, x, y, z, w):
    """Gradient noise, unscaled: the corners of the cell blended. In three dimensions `perlin_solid` is faster."""
    cx, cy, cz, cw = np.floor(x), np.floor(y), np.floor(z), np.floor(w)
    x, y, z, w = x - cx, y - cy, z - cz, w - cw
    ix, iy, iz, iw = np.int64(cx), np.int64(cy), np.int64(cz), np.int64(cw)
    u, v, s, t = fade(x), fade(y), fade(z), fade(w)
    total = 0.0
    for corner in range(1 << dimensions):
        bx, by, bz, bw = corner & 1, (corner >> 1) & 1, (corner >> 2) & 1, corner >> 3
        weight = u if bx else 1.0 - u
        if dimensions > 1:
            weight *= v if by else 1.0 - v
        if dimensions > 2:
            weight *= s if bz else 1.0 - s
            weight *= t if bw else 1.0 - t
        if weight != 0.0:
            h = np.int64(hash_words(dimensions, ix + bx, iy + by, iz + bz, iw + bw) & np.uint32(31))
            total += weight * gradient(dimensions, h, x - bx, y - by, z - bz, w - bw)
    return total


@uncounted
def wrap_far(p):
    """Coordinates repeat every 100000, where floats would run out of bits."""
    far = 0.5 if abs(p) >= 1e6 else 0.0
    return np.fmod(p, 100000.0) + far


@uncounted
def signed_noise(dimensions, x, y, z, w):
    """Perlin noise in -1..1."""
    if dimensions == 3:
        return 0.9820 * perlin_solid(wrap_far(x), wrap_far(y), wrap_far(z))
    value = perlin(dimensions, wrap_far(x), wrap_far(y), wrap_far(z), wrap_far(w))
    if dimensions == 1:
        return 0.25 * value
    if dimensions == 2:
        return 0.6616 * value
    return 0.8344 * value


@uncounted
def fractal_sum(dimensions, x, y, z, w, detail, roughness, lacunarity, normalize):
    """Fractal Brownian motion; 0..1 where normalised."""
    scale, amplitude, most, total = 1.0, 1.0, 0.0, 0.0
    for _ in range(int(detail) + 1):
        total += amplitude * signed_noise(dimensions, scale * x, scale * y, scale * z, scale * w)
        most += amplitude
        amplitude *= roughness
        scale *= lacunarity
    rest = detail - np.floor(detail)
    if rest != 0.0:
        more = total + amplitude * signed_noise(dimensions, scale * x, scale * y, scale * z, scale * w)
        if normalize:
            low, high = 0.5 * total / most + 0.5, 0.5 * more / (most + amplitude) + 0.5
            return low + rest * (high - low)
        return total + rest * (more - total)
    return 0.5 * total / most + 0.5 if normalize else total


@uncounted
def multifractal(kind, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain):
    """Musgrave's fractals, by kind."""
    octaves = int(detail)
    rest = detail - np.floor(detail)
    power, value, weight, signal = 1.0, 1.0, 1.0, 0.0
    if kind == HYBRID_MULTIFRACTAL:
        value = 0.0
    for i in range(octaves + 2):
        share = 1.0
        if i > octaves:
            # the last octave counts by the fraction of the detail
            if rest == 0.0 or kind == RIDGED_MULTIFRACTAL:
                break
            share = rest
        if kind == HYBRID_MULTIFRACTAL and weight <= 0.001:
            break
        n = signed_noise(dimensions, x, y, z, w)
        x, y, z, w = x * lacunarity, y * lacunarity, z * lacunarity, w * lacunarity
        if kind == MULTIFRACTAL:
            value *= share * power * n + 1.0
        elif kind == HETERO_TERRAIN:
            value = offset + n if i == 0 else value + share * (n + offset) * power * value
        elif kind == HYBRID_MULTIFRACTAL:
            weight = min(weight, 1.0)
            signal = (n + offset) * power
            value += share * weight * signal
            weight *= gain * signal
        else:
            weight = 1.0 if i == 0 else min(max(signal * gain, 0.0), 1.0)
            signal = (offset - abs(n)) ** 2 * weight
            value = signal if i == 0 else value + signal * power
        power *= roughness
    return value


@uncounted
def fractal(kind, dimensions, x, y, z, w, parameters, normalize):
    """One value of any fractal type; parameters: one row."""
    detail, roughness, lacunarity = parameters[DETAIL], parameters[ROUGHNESS], parameters[LACUNARITY]
    if kind == FBM:
        return fractal_sum(dimensions, x, y, z, w, detail, roughness, lacunarity, normalize)
    return multifractal(
        kind, dimensions, x, y, z, w, detail, roughness, lacunarity, parameters[OFFSET], parameters[GAIN]
    )


@uncounted
def noise_texture(points, parameters, offsets, dimensions, kind, normalize, channels, out):
    """out (n, 3) float32: the texture's value, and with channels 3 its colour (whose red is the value).

    points (n, 4) float32, the first `dimensions` used; parameters (n or 1, 6) float32; offsets (6, 4) float32: shifts
    that stand for seeds.
    """
    for i in range(points.shape[0]):
        row = parameters[i if parameters.shape[0] > 1 else 0]
        x, y = float(points[i, 0]), float(points[i, 1])
        z, w = float(points[i, 2]), float(points[i, 3])
        distortion = row[DISTORTION]
        if distortion != 0.0:
            o = offsets
            dx = signed_noise(dimensions, x + o[0, 0], y + o[0, 1], z + o[0, 2], w + o[0, 3])
            dy, dz, dw = 0.0, 0.0, 0.0
            if dimensions > 1:
                dy = signed_noise(dimensions, x + o[1, 0], y + o[1, 1], z + o[1, 2], w + o[1, 3])
            if dimensions > 2:
                dz = signed_noise(dimensions, x + o[2, 0], y + o[2, 1], z + o[2, 2], w + o[2, 3])
            if dimensions > 3:
                dw = signed_noise(dimensions, x + o[3, 0], y + o[3, 1], z + o[3, 2], w + o[3, 3])
            x, y, z, w = x + dx * distortion, y + dy * distortion, z + dz * distortion, w + dw * distortion
        out[i, 0] = fractal(kind, dimensions, x, y, z, w, row, normalize)
        for c in range(1, channels):
            s = offsets[dimensions + c - 1]
            out[i, c] = fractal(kind, dimensions, x + s[0], y + s[1], z + s[2], w + s[3], row, normalize)


@uncounted
def _add_octave(scratch, scale, amplitude, total, n):
    """Add amplitude times the noise at scale times the places in rows 0 to 2 to total (n,)."""
    first, near = 0, True
    for i in range(n):
        most = max(abs(scale * scratch[0, i]), abs(scale * scratch[1, i]), abs(scale * scratch[2, i]))
        near &= most < 100000.0
    if not near:
        for axis in range(3):
            for i in range(n):
                scratch[8 + axis, i] = wrap_far(scale * scratch[axis, i])
        first, scale = 8, 1.0
    add_solid(scratch[first], scratch[first + 1], scratch[first + 2], scale, amplitude, total, n)


@uncounted
def solid_texture(points, row, offsets, normalize, channels, scratch, out):
    """`noise_texture` in three dimensions, of kind FBM and with one row (6,) of parameters for all points: the same
    values, octave by octave over blocks of points. scratch: (11, block) float64.
    """
    detail, distortion = row[DETAIL], row[DISTORTION]
    whole, rest = int(detail), detail - np.floor(detail)
    total, before = scratch[6], scratch[7]
    for start in range(0, points.shape[0], scratch.shape[1]):
        n = min(scratch.shape[1], points.shape[0] - start)
        for axis in range(3):
            for i in range(n):
                scratch[3 + axis, i] = points[start + i, axis]
        # distortions of the three axes, then the channels
        for stage in range(0 if distortion == 0.0 else -3, channels):
            octaves = 0 if stage < 0 else (whole if rest == 0.0 else whole + 1)
            for axis in range(3):
                shift = offsets[3 + stage if stage < 0 else 2 + stage, axis] if stage else np.float32(0.0)
                for i in range(n):
                    place = points[start + i, axis] + shift  # the distortion's in single precision
                    scratch[axis, i] = place if stage < 0 else scratch[3 + axis, i] + shift
            for i in range(n):
                total[i] = 0.0
            scale, amplitude, most, most_before = 1.0, 1.0, 0.0, 0.0
            for octave in range(octaves + 1):
                if octave > whole:
                    most_before = most
                    for i in range(n):
                        before[i] = total[i]
                _add_octave(scratch, scale, amplitude, total, n)
                most += amplitude
                amplitude *= row[ROUGHNESS]
                scale *= row[LACUNARITY]
            if stage < 0:
                for i in range(n):
                    scratch[6 + stage, i] += total[i] * distortion
                continue
            for i in range(n):
                value = 0.5 * total[i] / most + 0.5 if normalize else total[i]
                if octaves > whole:
                    first = 0.5 * before[i] / most_before + 0.5 if normalize else before[i]
                    value = first + rest * (value - first)
                out[start + i, stage] = value
