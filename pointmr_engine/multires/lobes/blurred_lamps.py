"""Lamps in rays behind chaotic glass: blurred, for where such a ray meets one is mere chance, and the pixel too bright.

What a ray would see is taken over all directions about it, within half an angle `blur` (mirror_chains.blur_lamps):
samples of the lamp and of these directions together (balance heuristic; Veach 1997), so that small lamps and large ones
have little noise. No light is lost, but near the blurred one's edges. Other things hide lamps as they hide the ray.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.lobes.lobe_lamps import may_show
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R2, sample_2d
from pointmr_engine.numerics.warps import uniform_cone
from pointmr_engine.raytracing.lamps import intersect_lamp, lamp_pdf_scale, sample_lamp
from pointmr_engine.shading.bsdf.vector import dot, row3

PLACES = 0x20B0  # first dimension set of places on lamps and directions about rays
LOOKS = 4  # of each kind, at each lamp
_EVERYWHERE = (0.0, 0.0, 1.0)  # within a sphere the side of a surface does not matter


@device
def _add(lamps, lamp, wo, share, out, towards, k):
    for c in range(3):
        out[k, c] += lamps.radiance[lamp, c] * share
        towards[k, c] += wo[c] * share


@device
def _look(lamps, lamp, origin, axis, nearest, reach, narrow, u, v, out, towards, k):
    """Add what LOOKS pairs of samples find of a lamp between nearest and reach; narrow: 1 - cos of half an angle."""
    x, y, z = origin
    own = 1.0 / (2.0 * math.pi * narrow)
    for _ in range(LOOKS):
        dx, dy, dz, t, pdf, scale = sample_lamp(lamps, lamp, x, y, z, *_EVERYWHERE, True, u, v)
        met = pdf > 0.0 and t > nearest and (t < reach or reach == math.inf)
        if met and 1.0 - dot(axis, (dx, dy, dz)) <= narrow:
            _add(lamps, lamp, (dx, dy, dz), scale * own / (own + pdf) / LOOKS, out, towards, k)
        u, v = (u + R2[0]) % 1.0, (v + R2[1]) % 1.0
        dx, dy, dz, _ = uniform_cone(*axis, narrow, u, v)
        t = intersect_lamp(lamps, lamp, x, y, z, dx, dy, dz)
        if t > nearest and (t < reach or reach == math.inf):
            pdf, scale = lamp_pdf_scale(lamps, lamp, x, y, z, *_EVERYWHERE, True, dx, dy, dz, t)
            _add(lamps, lamp, (dx, dy, dz), scale * own / (own + pdf) / LOOKS, out, towards, k)


@uncounted
def blurred_lamps(lamps, met, rays, reach, paths, samples, tables, bounce, blur, rows, out, towards):
    """Add to out (N, 3) float32 the radiance of lamps about the rays `rows`, within blur (N,) float32 radians of them.

    towards (N, 3) float64, added to as well: where it comes from on the whole, of no length. met (K,) int32: lamps that
    rays can meet, of which those that vary are left out. reach (N,) float64: of the rays; inf: suns as well.
    """
    for i in range(len(rows)):
        k = np.int64(rows[i])
        origin, axis, half = row3(rays.origin, k), row3(rays.direction, k), np.float64(blur[k])
        narrow, slot = 2.0 * math.sin(0.5 * half) ** 2, paths.slot[k]
        for j in range(len(met)):
            lamp = np.int64(met[j])
            if not may_show(lamps, lamp, rays.visibility[k], origin, axis, half):
                continue
            seed = np.uint32(samples.seed[slot] ^ np.uint32(k))
            places = np.uint32(PLACES + 64 * bounce + (j & 63))
            u, v = sample_2d(tables, seed, places, samples.number[slot])
            _look(lamps, lamp, origin, axis, rays.t_min[k], reach[k], narrow, u, v, out, towards, k)
