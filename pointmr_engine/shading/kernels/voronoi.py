"""Voronoi textures in one to four dimensions."""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.shading.kernels.hashes import hash_words, pcg2d, pcg3d, pcg4d, unit_float

F1, F2, SMOOTH_F1, DISTANCE_TO_EDGE, N_SPHERE_RADIUS = range(5)
EUCLIDEAN, MANHATTAN, CHEBYCHEV, MINKOWSKI = range(4)
# columns of `parameters`
DETAIL, ROUGHNESS, LACUNARITY, SMOOTHNESS, EXPONENT, RANDOMNESS, SCALE = range(7)
_UNIT = 1.0 / 2147483647.0


@njit(cache=True, nogil=True, error_model="numpy")
def float_bits(x):
    """The bits of a float32, as a word."""
    return np.float32(x).view(np.uint32)


@njit(cache=True, nogil=True, error_model="numpy")
def feature_point(dimensions, x, y, z, w):
    """Where the point of cell (x, y, z, w) lies in it, 0..1 each way."""
    if dimensions == 1:
        return unit_float(hash_words(1, float_bits(x), 0, 0, 0)), 0.0, 0.0, 0.0
    if dimensions == 2:
        a, b = pcg2d(x, y)
        return a * _UNIT, b * _UNIT, 0.0, 0.0
    if dimensions == 3:
        a, b, c = pcg3d(x, y, z)
        return a * _UNIT, b * _UNIT, c * _UNIT, 0.0
    a, b, c, d = pcg4d(x, y, z, w)
    return a * _UNIT, b * _UNIT, c * _UNIT, d * _UNIT


@njit(cache=True, nogil=True, error_model="numpy")
def cell_color(dimensions, x, y, z, w):
    """The colour of a cell."""
    if dimensions == 1:
        b = float_bits(x)
        return (
            unit_float(hash_words(1, b, 0, 0, 0)),
            unit_float(hash_words(2, b, float_bits(1.0), 0, 0)),
            unit_float(hash_words(2, b, float_bits(2.0), 0, 0)),
        )
    if dimensions == 4:
        r, g, b, _ = pcg4d(x, y, z, w)
    else:
        r, g, b = pcg3d(x, y, z * (dimensions == 3))
    return np.float32(r * _UNIT), np.float32(g * _UNIT), np.float32(b * _UNIT)


@njit(cache=True, nogil=True, error_model="numpy")
def distance(metric, exponent, x, y, z, w):
    """Length of a vector."""
    if metric == EUCLIDEAN:
        return np.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = abs(x), abs(y), abs(z), abs(w)
    if metric == MANHATTAN:
        return x + y + z + w
    if metric == CHEBYCHEV:
        return max(max(x, y), max(z, w))
    return (x**exponent + y**exponent + z**exponent + w**exponent) ** (1.0 / exponent)


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(dimensions, reach, second, metric, exponent, randomness, cell, local, best):
    """The nearest feature point, or the second nearest, to `local` in the cells around `cell`.

    best (2, 9) gets, of the nearest (and with `second` of the second nearest): distance, position in the cell's
    frame (4), offset of its cell (4).
    """
    ky, kz = reach if dimensions > 1 else 0, reach if dimensions > 2 else 0
    kw = reach if dimensions > 3 else 0
    best[0, 0] = best[1, 0] = np.inf
    for w in range(-kw, kw + 1):
        for z in range(-kz, kz + 1):
            for y in range(-ky, ky + 1):
                for x in range(-reach, reach + 1):
                    a, b, c, d = feature_point(dimensions, cell[0] + x, cell[1] + y, cell[2] + z, cell[3] + w)
                    a, b, c, d = (
                        x + a * randomness,
                        y + b * randomness,
                        z + c * randomness,
                        w + d * randomness,
                    )
                    r = distance(metric, exponent, a - local[0], b - local[1], c - local[2], d - local[3])
                    rank = 0 if r < best[0, 0] else 1
                    if rank == 1 and not (second and r < best[1, 0]):
                        continue
                    if rank == 0 and second:
                        best[1, :] = best[0, :]
                    best[rank, 0] = r
                    best[rank, 1], best[rank, 2], best[rank, 3], best[rank, 4] = a, b, c, d
                    best[rank, 5], best[rank, 6], best[rank, 7], best[rank, 8] = x, y, z, w


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_nearest(dimensions, metric, exponent, smoothness, randomness, cell, local, octave):
    """A smooth minimum over the cells around; octave (8,): distance, colour (3), position (4)."""
    ky, kz = 2 if dimensions > 1 else 0, 2 if dimensions > 2 else 0
    kw = 2 if dimensions > 3 else 0
    h = -1.0
    octave[:] = 0.0
    for w in range(-kw, kw + 1):
        for z in range(-kz, kz + 1):
            for y in range(-ky, ky + 1):
                for x in range(-2, 3):
                    i, j, k, m = cell[0] + x, cell[1] + y, cell[2] + z, cell[3] + w
                    a, b, c, d = feature_point(dimensions, i, j, k, m)
                    a, b, c, d = (
                        x + a * randomness,
                        y + b * randomness,
                        z + c * randomness,
                        w + d * randomness,
                    )
                    r = distance(metric, exponent, a - local[0], b - local[1], c - local[2], d - local[3])
                    if h == -1.0:
                        h = 1.0
                    else:
                        t = min(max(0.5 + 0.5 * (octave[0] - r) / smoothness, 0.0), 1.0)
                        if t == 0.0:  # too far to count
                            continue
                        h = t * t * (3.0 - 2.0 * t)
                    correction = smoothness * h * (1.0 - h)
                    octave[0] += h * (r - octave[0]) - correction
                    correction /= 1.0 + 3.0 * smoothness
                    red, green, blue = cell_color(dimensions, i, j, k, m)
                    octave[1] += h * (red - octave[1]) - correction
                    octave[2] += h * (green - octave[2]) - correction
                    octave[3] += h * (blue - octave[3]) - correction
                    octave[4] += h * (a - octave[4]) - correction
                    octave[5] += h * (b - octave[5]) - correction
                    octave[6] += h * (c - octave[6]) - correction
                    octave[7] += h * (d - octave[7]) - correction


@njit(cache=True, nogil=True, error_model="numpy")
def edge_distance(dimensions, randomness, cell, local, best):
    """Distance to the nearest border between cells (Quilez); best (2, 9): scratch."""
    if dimensions == 1:
        mid = feature_point(dimensions, cell[0], cell[1], cell[2], cell[3])[0] * randomness
        left = -1.0 + feature_point(dimensions, cell[0] - 1, cell[1], cell[2], cell[3])[0] * randomness
        right = 1.0 + feature_point(dimensions, cell[0] + 1, cell[1], cell[2], cell[3])[0] * randomness
        return min(abs((mid + left) / 2 - local[0]), abs((mid + right) / 2 - local[0]))
    nearest(dimensions, 1, False, EUCLIDEAN, 1.0, randomness, cell, local, best)
    px, py = best[0, 1] - local[0], best[0, 2] - local[1]
    pz, pw = best[0, 3] - local[2], best[0, 4] - local[3]
    kz, kw = 1 if dimensions > 2 else 0, 1 if dimensions > 3 else 0
    result = np.inf
    for w in range(-kw, kw + 1):
        for z in range(-kz, kz + 1):
            for y in range(-1, 2):
                for x in range(-1, 2):
                    a, b, c, d = feature_point(dimensions, cell[0] + x, cell[1] + y, cell[2] + z, cell[3] + w)
                    a = x + a * randomness - local[0]
                    b = y + b * randomness - local[1]
                    c = z + c * randomness - local[2]
                    d = w + d * randomness - local[3]
                    ex, ey, ez, ew = a - px, b - py, c - pz, d - pw
                    size = ex * ex + ey * ey + ez * ez + ew * ew
                    if size > 0.0001:
                        across = (px + a) * ex + (py + b) * ey + (pz + c) * ez + (pw + d) * ew
                        result = min(result, 0.5 * across / np.sqrt(size))
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def sphere_radius(dimensions, randomness, cell, local, best):
    """Half the distance between the nearest point and its own nearest one; cell and local are changed."""
    nearest(dimensions, 1, False, EUCLIDEAN, 1.0, randomness, cell, local, best)
    for k in range(4):
        cell[k] += np.int64(best[0, 5 + k])
        local[k] = best[0, 1 + k] - best[0, 5 + k]
    # the nearest to a point is the point itself, at distance 0; the next is what is asked for
    nearest(dimensions, 1, True, EUCLIDEAN, 1.0, randomness, cell, local, best)
    return best[1, 0] / 2


@njit(cache=True, nogil=True, error_model="numpy")
def split_cell(dimensions, p, scale, cell, local):
    """The cell (integers) and the place in it of p * scale."""
    for k in range(4):
        c = np.float32(p[k] * np.float32(scale)) if k < dimensions else np.float32(0.0)
        cell[k] = np.int64(np.floor(c))
        local[k] = c - cell[k]


@njit(cache=True, nogil=True, error_model="numpy")
def add_octave(k, detail, amplitude, scale, octave, total):
    """Add octave number k of a fractal to the total; what of its amplitude counted."""
    share = 1.0 if k <= detail else detail - np.floor(detail)
    for c in range(4):
        total[c] += share * amplitude * octave[c]
    for c in range(4, 8):
        total[c] += share * amplitude * (octave[c] / scale - total[c])
    return share * amplitude


@njit(cache=True, nogil=True, error_model="numpy")
def write_texture(i, total, most, far, scale, normalize, out):
    """Row i of out: distance, colour and position of a finished fractal."""
    if normalize:
        total[0] /= most * far
        for c in range(1, 4):
            total[c] /= most
    for c in range(4):
        out[i, c] = total[c]
        out[i, 4 + c] = total[4 + c] / scale if scale != 0.0 else 0.0


# One kernel per group of features, so that a scene compiles only what it shows. All have the same arguments:
# points (n, 4) float32, already scaled, the first `dimensions` used; parameters (n or 1, 7) float32; far (n or 1,)
# float32: the distance that normalises; out (n, 8) float32: distance or radius, colour (3), position (4: x, y, z, w).


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_texture(points, parameters, far, dimensions, feature, metric, normalize, out):
    """F1 and F2."""
    cell, local, best = np.empty(4, np.int64), np.empty(4), np.empty((2, 9))
    octave, total = np.empty(8), np.empty(8)
    for i in range(points.shape[0]):
        row = parameters[i if parameters.shape[0] > 1 else 0]
        single = row[DETAIL] == 0.0 or row[ROUGHNESS] == 0.0
        detail = 0.0 if single else row[DETAIL]
        amplitude, most, scale = 1.0, 0.0, 1.0
        total[:] = 0.0
        for k in range(int(np.ceil(detail)) + 1):
            split_cell(dimensions, points[i], scale, cell, local)
            nearest(dimensions, 1, feature == F2, metric, row[EXPONENT], row[RANDOMNESS], cell, local, best)
            b = best[1 if feature == F2 else 0]
            octave[0] = b[0]
            octave[1], octave[2], octave[3] = cell_color(
                dimensions,
                cell[0] + np.int64(b[5]),
                cell[1] + np.int64(b[6]),
                cell[2] + np.int64(b[7]),
                cell[3] + np.int64(b[8]),
            )
            for c in range(4):
                octave[4 + c] = b[1 + c] + cell[c] if c < dimensions else 0.0
            most += add_octave(k, detail, amplitude, scale, octave, total)
            scale *= row[LACUNARITY]
            amplitude *= row[ROUGHNESS]
        write_texture(i, total, most, far[i if far.shape[0] > 1 else 0], row[SCALE], normalize, out)


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_texture(points, parameters, far, dimensions, feature, metric, normalize, out):
    """Smooth F1, its smoothness above 0."""
    cell, local = np.empty(4, np.int64), np.empty(4)
    octave, total = np.empty(8), np.empty(8)
    for i in range(points.shape[0]):
        row = parameters[i if parameters.shape[0] > 1 else 0]
        single = row[DETAIL] == 0.0 or row[ROUGHNESS] == 0.0
        detail = 0.0 if single else row[DETAIL]
        amplitude, most, scale = 1.0, 0.0, 1.0
        total[:] = 0.0
        smoothness = max(row[SMOOTHNESS], np.float32(1e-6))
        for k in range(int(np.ceil(detail)) + 1):
            split_cell(dimensions, points[i], scale, cell, local)
            smooth_nearest(
                dimensions, metric, row[EXPONENT], smoothness, row[RANDOMNESS], cell, local, octave
            )
            for c in range(4):
                octave[4 + c] = octave[4 + c] + cell[c] if c < dimensions else 0.0
            most += add_octave(k, detail, amplitude, scale, octave, total)
            scale *= row[LACUNARITY]
            amplitude *= row[ROUGHNESS]
        write_texture(i, total, most, far[i if far.shape[0] > 1 else 0], row[SCALE], normalize, out)


@njit(cache=True, nogil=True, error_model="numpy")
def edge_texture(points, parameters, far, dimensions, feature, metric, normalize, out):
    """Distance to edge: over octaves, each finer one pulling the result nearer."""
    cell, local, best = np.empty(4, np.int64), np.empty(4), np.empty((2, 9))
    for i in range(points.shape[0]):
        row = parameters[i if parameters.shape[0] > 1 else 0]
        most = float(far[i if far.shape[0] > 1 else 0])
        detail, roughness, longest = row[DETAIL], row[ROUGHNESS], most
        amplitude, scale, result = 1.0, 1.0, 8.0
        for k in range(int(np.ceil(detail)) + 1):
            split_cell(dimensions, points[i], scale, cell, local)
            d = edge_distance(dimensions, row[RANDOMNESS], cell, local, best)
            if detail == 0.0 or roughness == 0.0:
                result = d
                break
            nearer = result + amplitude * (min(result, d / scale) - result)
            farther = most + amplitude * (longest / scale - most)
            if k <= detail:
                most, result = farther, nearer
                scale *= row[LACUNARITY]
                amplitude *= roughness
            else:
                rest = detail - np.floor(detail)
                most += rest * (farther - most)
                result += rest * (min(result, nearer) - result)
        out[i, :] = 0.0
        out[i, 0] = result / most if normalize else result


@njit(cache=True, nogil=True, error_model="numpy")
def radius_texture(points, parameters, far, dimensions, feature, metric, normalize, out):
    """Radius of the spheres around the feature points that touch one another."""
    cell, local, best = np.empty(4, np.int64), np.empty(4), np.empty((2, 9))
    for i in range(points.shape[0]):
        row = parameters[i if parameters.shape[0] > 1 else 0]
        split_cell(dimensions, points[i], 1.0, cell, local)
        out[i, :] = 0.0
        out[i, 0] = sphere_radius(dimensions, row[RANDOMNESS], cell, local, best)
