"""Mirrors that show mirrors: how footprints grow from one bent surface to the next, where rays stand for them.

A ray has no width. Behind several bent surfaces it stands for much of what is around, and where such a ray met a lamp
by chance, a pixel would be far too bright: so the last of these mirrors is as rough as its footprint is wide, and light
samples find the lamp in it (regularised paths: Kaplanyan and Dachsbacher 2013). Glass shows what is behind it as it is,
and lamps alone blurred (blurred_lamps.py).
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.fragments.curvature import bend_at
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.path_arrays import SEES_LAMPS
from pointmr_engine.shading.bsdf.layout import GLASS, KIND_MASK, REFRACTION, TRANSLUCENT
from pointmr_engine.shading.bsdf.vector import row3

WIDE = 0.05  # growth of a mirrored footprint per metre from which the mirror is as rough
ROUGHEST = 0.06  # variance of the slopes that it has then, at most: what is rougher grazes, and loses light
OF_GROWTH = 1.0 / 48.0  # that variance against a squared growth: of half of it, over a box
CHAOTIC = 1.0  # growth of a footprint per metre at glass from which its rays see lamps blurred, ...
BLUR, MOST_BLUR = 0.25, 0.35  # ... by half an angle of so much of it, and of so many radians at most
TWICE = 2.0  # roughnesses that this blur must be larger than: else light samples find lamps as well


@device
def _sees_mirrored(lobes, k):
    """(whether point k has lobes that are not diffuse, whether one of them lets light through)."""
    sees = through = False
    for j in range(np.int64(lobes.count[k])):
        kind = lobes.kind[k, j] & KIND_MASK
        sees |= kind > TRANSLUCENT
        through |= kind == REFRACTION or kind == GLASS
    return sees, through


@uncounted
def follow_footprints(
    tables, paths, hits, facing, lobes, alive, count, narrower, turned, chaos, spread, shape, q
):
    """turned (N,) float32: by how much the normal turns across the footprints of points 0..count; 0 of matt and flat.

    chaos (N,) float32, radians: half the angle over which rays of its glass see lamps blurred; 0: they see them sharp.
    spread (N,) float32: variance of the slopes by which lobes are widened; that of a WIDE footprint is added. Not at
    glass, whose lobes show more than lamps: what is behind it would blur as well.

    narrower: share of the blur, which becomes less with more cones a pixel, as the noise does.
    tables: PartTables; facing (N, 3): normals to the viewer's side; alive (N,) bool; shape (N, 6), q (3, 3) to work in.
    """
    for k in range(count):
        turned[k] = chaos[k] = 0.0
        if not alive[k]:
            continue
        sees, through = _sees_mirrored(lobes, k)
        if not sees:
            continue
        bend, _ = bend_at(tables, hits, np.int64(k), row3(facing, k), shape, q)
        wide = np.float64(paths.state.width[k]) + np.float64(paths.state.spread[k]) * hits.t[k]
        turned[k] = math.sqrt(bend) * wide
        growth = np.float64(paths.state.spread[k]) + 2.0 * np.float64(turned[k])
        if through:
            chaos[k] = narrower * min(BLUR * growth, MOST_BLUR) if growth > CHAOTIC else 0.0
        elif growth > WIDE:
            spread[k] += min(OF_GROWTH * growth * growth, ROUGHEST)


@device
def grow(out, first, end, change):
    """The footprints of paths first..end, of a mirror, grow by `change` more a metre.

    Not of what glass transmits: that may as well narrow them, and textures would blur.
    """
    for m in range(first, end):
        out.state.spread[m] += change


@device
def blurs_lamps(kind, rough, chaos):
    """Whether a lobe of this kind and roughness sees lamps by rays alone, and blurred. chaos: of its point."""
    return kind & KIND_MASK > TRANSLUCENT and chaos > TWICE * rough


@device
def blur_lamps(out, record, first, end, blur):
    """Paths first..end, of one lobe, find lamps by themselves, blurred. record: LobeCones."""
    for m in range(first, end):
        record.blur[m] = blur
        out.flags[m] |= SEES_LAMPS
        out.bsdf_pdf[m] = math.inf
