"""Transparency of fragments: coverage has accounted for it, and for the holes of what they are part of."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.part_opacity import BRIGHTENS
from pointmr_engine.forward.shading.lobe_light import ADDED
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf.layout import SAMPLE, WEIGHT
from pointmr_engine.shading.bsdf.vector import combine, load3, mean

TINGE = 0.02  # of light in a channel: what coloured transparency lets through, below which it is not followed
FAINTEST = 0.05  # opaque share of a footprint below which its lobes say too little
UNKNOWN = -1.0  # instead of what a place lets through: of footprints that hold no holes


@device
def _share_sent(lobes, k, j):
    """What lobe j of point k sends on of its weight: that of a clear coat is one, and it reflects a few per cent."""
    weight = mean(load3(lobes.data, k, j, WEIGHT))
    return min(np.float64(lobes.data[k, j, SAMPLE]) / weight, 1.0) if weight > 0.0 else 0.0


@device
def _leave_holes(lobes, through, k):
    """Point k, averaged over a footprint with holes, lets through what its opaque part does; returns by how much the
    lobes of that are stronger.

    through (N, 3) float32: what the place lets through by itself. What the footprint lets through besides are holes,
    or less than none: where places differ that are all half clear, the means of what they give are those of the lobes.
    """
    holes, opaque = 0.0, 1.0
    for c in range(3):
        own = min(max(np.float64(through[k, c]), 0.0), 1.0)
        holes += (min(max(np.float64(lobes.transparency[k, c]), 0.0), 1.0) - own) / 3.0
        opaque -= own / 3.0
        lobes.transparency[k, c] = through[k, c]
    if opaque < FAINTEST:
        return 1.0
    return opaque / max(opaque - holes, FAINTEST * opaque)


@uncounted
def close_transparency(lobes, throughput, coloured, by_view, passed, through, count):
    """Take the transparency of points 0..count out, as far as coverage accounts for it, and scale up what is left.

    coloured (N,) bool: covered by what the densest channel blocks; what the others let through besides stays. Elsewhere
    coverage is by mean opacity, and nothing stays. by_view (N,) bool: covered by the most that anybody sees of them:
    what passes besides stays, as it does where it is brighter behind a surface than before it. passed (N,) float32: the
    share that coverage lets through there. Of lobes that were added to what passes (Add Shader), no more is taken: they
    do not fade with what they hide, and a surface that lets nearly all through would shine. through (N, 3) float32: see
    _leave_holes, or UNKNOWN.
    """
    for k in range(count):
        sent = (0.0, 0.0, 0.0)
        for j in range(np.int64(lobes.count[k])):
            weight = load3(lobes.data, np.int64(k), np.int64(j), WEIGHT)
            sent = combine(1.0, sent, _share_sent(lobes, np.int64(k), np.int64(j)), weight)
        most = max(sent[0], sent[1], sent[2])
        scale = _leave_holes(lobes, through, k) if through[k, 0] >= 0.0 else 1.0
        average, least, brightest = 0.0, 1.0, 0.0
        for c in range(3):
            passes = np.float64(lobes.transparency[k, c])
            brightest = max(brightest, passes)
            clear = min(max(passes, 0.0), 1.0)
            average += clear / 3.0
            least = min(least, clear)
        taken = min(least if coloured[k] else average, 0.999)
        if by_view[k] or brightest > BRIGHTENS:
            taken = min(taken, np.float64(passed[k]))
        if scale * most > ADDED * (1.0 - taken):
            taken = min(taken, np.float64(passed[k]))
        whole = scale / (1.0 - taken)
        for c in range(3):
            left = 0.0
            if coloured[k]:
                # what the lobes' scale takes is given back to what passes
                clear = np.float64(lobes.transparency[k, c])
                left = min(max(clear - taken, 0.0), max(clear, 1.0) * (1.0 - taken))
            lobes.transparency[k, c] = left / scale if left > TINGE else 0.0
            throughput[k, c] *= whole
