"""What lobes and light samples leave each other: of light that both find, and of lobes that only cones can follow."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.lobes.lobe_cones import (
    inverse_ior,
    lobe_pdf,
    looks_of,
    refracted_pdf,
    refraction,
)
from pointmr_engine.multires.lobes.mirror_chains import blurs_lamps
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lights import LAMP, TRIANGLE
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    BECKMANN,
    GLASS,
    HAS_EVALUATION,
    KIND_MASK,
    MIRROR,
    NORMAL,
    REFLECTION,
    REFRACTION,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.vector import dot, load3, row3

BENT = 4.0  # squared roughnesses in the variance of normals up to which a lobe is a mirror that bends


@uncounted
def look_where_lobes_do(lobes, rows, count, diffuse, normal, transmissive):
    """Let light samples of points rows[0..count] look where their diffuse lobes do, if all have one normal, however
    bumps bend it.

    diffuse: no others receive these samples' light; else, points that have others look as they did. normal (N, 3),
    transmissive (N,): what they look along, and whether behind it, too; where nothing is reflected, behind it alone.
    """
    for i in range(count):
        k, first, before, behind, alike = np.int64(rows[i]), np.int64(-1), False, False, True
        for j in range(np.int64(lobes.count[k])):
            base = lobes.kind[k, j] & KIND_MASK
            if base > TRANSLUCENT:
                alike = alike and diffuse
                continue
            if first < 0:
                first = np.int64(j)
            before, behind = before or base != TRANSLUCENT, behind or base == TRANSLUCENT
            for a in range(3):
                alike = alike and lobes.data[k, j, NORMAL + a] == lobes.data[k, first, NORMAL + a]
        if alike and first >= 0:
            side = 1.0 if before else -1.0
            for a in range(3):
                normal[i, a] = side * lobes.data[k, first, NORMAL + a]
            transmissive[i] = before and behind


@device
def mean_roughness(lobes, k, j):
    """Mean roughness of lobe j of point k."""
    return math.sqrt(np.float64(lobes.data[k, j, ALPHA_X]) * np.float64(lobes.data[k, j, ALPHA_Y]))


@device
def _is_shared(samples, i, glints):
    """Whether lobes look for what light sample i found, or some do not know of it: mirrors of lamps that are points."""
    return samples.kind[i] == TRIANGLE or (samples.kind[i] == LAMP and (glints or not samples.mis[i]))


@uncounted
def share_with_lobes(
    lobes, incoming, rows, samples, pdf, mis_of_lamp, glints, behind, cone_of, record, count, kept
):
    """Leave light samples 0..count at points `rows` the part of each lobe's light that the lobe itself does not find.

    Lobes look for what shines on surfaces: both are weighted by the power heuristic (Veach 1997), pdf (N,) float64 of
    the sample against the lobe's own (lobe_cones.lobe_pdf, refracted_pdf), or against how close together its cones
    look, the first of which cone_of (N, L) tells, of `record` (LobeCones): see scatter_lobes. With `glints`, they look
    for lamps that rays can meet, too (SEES_LAMPS), where they reflect, and where they refract `behind` first surfaces;
    what shines in first refractions lies within their cones. kept (N, L, 3): the lobes' weights, for `restore_lobes`.
    """
    for i in range(count):
        if not _is_shared(samples, i, glints):
            continue
        k = np.int64(rows[i])
        w, wi = row3(samples.direction, i), row3(incoming, k)
        for j in range(np.int64(lobes.count[k])):
            share = 1.0
            base = lobes.kind[k, j] & KIND_MASK
            if base > TRANSLUCENT:
                lamp = samples.kind[i] == LAMP
                normal = load3(lobes.data, k, j, NORMAL)
                if lamp and not mis_of_lamp[samples.index[i]]:
                    share = 0.0 if lobes.kind[k, j] & MIRROR else 1.0
                elif base == REFRACTION or base == GLASS and dot(normal, w) <= 0.0:
                    share = 1.0 if lamp and not behind else 0.0
                    if behind and pdf[i] > 0.0:
                        rough = mean_roughness(lobes, k, np.int64(j))
                        axis, bend, _ = refraction(normal, wi, inverse_ior(lobes, k, np.int64(j)), rough)
                        ratio = refracted_pdf(bend * bend, axis, w) / pdf[i]
                        share = 1.0 / (1.0 + ratio * ratio)
                elif cone_of[k, j] >= 0:
                    ratio = looks_of(record, np.int64(cone_of[k, j]), w) / max(pdf[i], 1e-30)
                    share = 1.0 / (1.0 + ratio * ratio)
                elif pdf[i] > 0.0:
                    rough = mean_roughness(lobes, k, np.int64(j))
                    ratio = lobe_pdf(rough * rough, normal, wi, w) / pdf[i]
                    share = 1.0 / (1.0 + ratio * ratio)
            for c in range(3):
                kept[i, j, c] = lobes.data[k, j, WEIGHT + c]
                lobes.data[k, j, WEIGHT + c] *= share


@uncounted
def restore_lobes(lobes, rows, samples, glints, count, kept):
    """Undo `share_with_lobes`."""
    for i in range(count):
        if _is_shared(samples, i, glints):
            k = np.int64(rows[i])
            for j in range(np.int64(lobes.count[k])):
                for c in range(3):
                    lobes.data[k, j, WEIGHT + c] = kept[i, j, c]


@uncounted
def sample_widened(lobes, count):
    """Let light samples look for what shines in the mirrors of points 0..count that are seen as narrow lobes.

    What shines in narrow refractions is left to rays that meet it.
    """
    for k in range(count):
        for j in range(np.int64(lobes.count[k])):
            kind = lobes.kind[k, j]
            base = kind & KIND_MASK
            if base > TRANSLUCENT and base != REFRACTION and base != GLASS and not kind & SINGULAR_LOBE:
                lobes.flags[k] |= HAS_EVALUATION


@uncounted
def bend_mirrors(lobes, variance, alpha, count):
    """Let light samples look for lamps in mirrors that bend, of points 0..count.

    variance (N,) float32 of the normals' slopes in a footprint, where a mirror shows a lamp in one footprint and not in
    the next; 0: flat. alpha (N, L, 2): of these mirrors it becomes that of a lobe as wide. Lobes that are little else
    have no tails, which would be a glow about every lamp.
    """
    for k in range(count):
        for j in range(np.int64(lobes.count[k])):
            kind = lobes.kind[k, j]
            glass = kind & KIND_MASK == GLASS  # that hardly bends is left to its cones
            if kind & KIND_MASK != REFLECTION and not glass:
                continue
            if kind & SINGULAR_LOBE:
                if glass or not variance[k] > 0.0:
                    continue
                alpha[k, j, 0] = alpha[k, j, 1] = math.sqrt(2.0 * np.float64(variance[k]))
            if np.float64(alpha[k, j, 0]) * np.float64(alpha[k, j, 1]) < BENT * np.float64(variance[k]):
                lobes.kind[k, j] |= BECKMANN
            lobes.flags[k] |= HAS_EVALUATION


@uncounted
def keep_lobes(lobes, alpha, chaos, cone_of, count):
    """Drop the lobes of points 0..count that only cones can follow: perfect mirrors, clear glass, and chaotic glass.

    chaos (N,): as of mirror_chains.follow_footprints.
    alpha (N, L, 2): their roughness as lobe_light.widen_by_normals and `bend_mirrors` left it; cone_of (N, L): see
    scatter_lobes.
    """
    for k in range(count):
        kept = np.int64(0)
        for j in range(np.int64(lobes.count[k])):
            kind = lobes.kind[k, j]
            rough = np.float64(alpha[k, j, 0]) * np.float64(alpha[k, j, 1])
            if kind & SINGULAR_LOBE and rough <= SINGULAR_ALPHA_SQUARED:
                continue
            if blurs_lamps(kind, math.sqrt(rough), np.float64(chaos[k])):
                continue
            if kept != j:
                lobes.kind[k, kept] = kind
                cone_of[k, kept] = cone_of[k, j]
                alpha[k, kept, 0], alpha[k, kept, 1] = alpha[k, j, 0], alpha[k, j, 1]
                for c in range(lobes.data.shape[2]):
                    lobes.data[k, kept, c] = lobes.data[k, j, c]
            kept += 1
        lobes.count[k] = kept
        if kept == 0:
            lobes.flags[k] = 0
