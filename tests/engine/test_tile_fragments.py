"""A tile's fragments before they are shaded: their samples along a curve, and what is left of them in its margin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.forward.reconstruction.fragments import allocate_fragments
from pointmr_engine.multires.fragments.merge import thin_margin
from pointmr_engine.multires.paths.fragment_paths import TOGETHER, count_in_pixels, number_samples
from pointmr_engine.numerics.rng import sample_2d
from pointmr_engine.numerics.sobol import sobol_tables
from pointmr_engine.raytracing.path_arrays import allocate_samples

SUBPIXELS = 8


def numbers(x, y, shape, left=0, low=0, batch=None):
    """Samples of fragments at x, y (F,) subpixels of a tile, numbered `batch` at a time, and pixels' numbers."""
    n = len(x)
    f, samples, used = allocate_fragments(n), allocate_samples(n), np.zeros(shape, np.int32)
    own, f.x[:], f.y[:] = np.empty_like(used), x, y
    pixel, side = np.empty(n, np.int64), np.int64(SUBPIXELS)
    count_in_pixels(f, side, np.int64(n), own)
    for first in range(0, n, batch or n):
        part = type(samples)(*(a[first:] for a in samples))
        number_samples(
            f, np.int64(SUBPIXELS * left), np.int64(SUBPIXELS * low), side, np.int64(TOGETHER),
            np.int64(first),
            np.int64(min(batch or n, n - first)), part, np.int64(3), own, used, pixel[first:],
        )  # fmt: skip
    return samples, pixel


@given(st.integers(0, 10**6), st.integers(1, 300), st.integers(1, 50))
def test_every_fragment_has_samples_of_its_own_whatever_the_tile(seed, n, batch):
    rng = np.random.default_rng(seed)
    shape, left, low = tuple(rng.integers(1, 12, 2)), *rng.integers(-5, 4000, 2)
    y, x = (rng.uniform(0, s * SUBPIXELS, n).astype(np.float32) for s in shape)
    samples, pixel = numbers(x, y, shape, left, low, batch)
    assert len({*zip(samples.seed.tolist(), samples.number.tolist(), strict=True)}) == n
    # another tile that begins two pixels to the left has the same fragments
    wider = shape[0], shape[1] + 2
    again, _ = numbers(x + 2 * SUBPIXELS, y, wider, left - 2, low)
    np.testing.assert_array_equal(again.number, samples.number)
    np.testing.assert_array_equal(again.seed, samples.seed)
    assert (samples.x == left + pixel % shape[1]).all() and (samples.y == low + pixel // shape[1]).all()


@pytest.mark.parametrize(("count", "run"), [(1, 1), (4, 4), (5, 1), (6, 2), (8, 8), (24, 8), (15, 4)])
def test_samples_of_neighbours_are_stratified_together(count, run):
    """Squares of pixels with `count` fragments each: the samples of a run have one in each stratum of a dimension."""
    side, tables = 16, sobol_tables()
    y, x = (SUBPIXELS * (a.ravel() + 0.5) for a in np.mgrid[:side, :side])
    samples, _ = numbers(np.tile(x, count), np.tile(y, count), (side, side))
    own = np.arange(count * side**2).reshape(count, side, side)
    begin = sum(size for size in (8, 4, 2, 1) if size > run and count & size) if run < 8 else count - run
    rows, wide = own[begin : begin + run], 4 if run == 1 else 2
    u = np.array(
        [sample_2d(tables, samples.seed[k], np.uint32(7), samples.number[k]) for k in rows.ravel()]
    ).reshape(run, side // wide, wide, side // wide, wide, 2)
    total = run * wide**2
    strata = np.floor(total * u.transpose(1, 3, 0, 2, 4, 5).reshape(-1, total, 2)).astype(int)
    assert (np.sort(strata, axis=1) == np.arange(total)[:, None]).all()


# The margin

SIDE, MARGIN, CONE = 8, 2, 8  # cones, cones, subpixels


def tile(rng):
    """ids (subpixels squared) of fragments four a cone with gaps, and the fragments, each known by its entry."""
    wide, cells = SIDE * CONE, SIDE * CONE // 4
    ids = np.arange(cells * cells).reshape(cells, cells).repeat(4, 0).repeat(4, 1).astype(np.int32)
    ids[rng.random((wide, wide)) < 0.3] = -1
    shown, ids_of = np.unique(ids[ids >= 0], return_inverse=True)
    ids[ids >= 0] = ids_of
    f = allocate_fragments(len(shown))
    for column in f:
        column[:] = 0
    f.entry[:], f.count[:] = np.arange(len(shown)), np.bincount(ids[ids >= 0])
    return ids, f


@given(st.integers(0, 10**6))
@settings(max_examples=30)
def test_a_margin_keeps_one_fragment_of_each_cone_and_all_within_stay(seed):
    ids, f = tile(np.random.default_rng(seed))
    before, count = ids.copy(), f.count.copy()
    work = np.empty((2, len(f.entry)), np.int32)
    wide = np.int64(SIDE * CONE)
    left = thin_margin(
        ids, wide, wide, np.int64(MARGIN * CONE), np.int64(CONE), f, np.int64(len(f.entry)), *work
    )
    np.testing.assert_array_equal(ids < 0, before < 0)
    entry = np.where(ids >= 0, f.entry[ids], -1)
    inner = np.s_[MARGIN * CONE : -MARGIN * CONE, MARGIN * CONE : -MARGIN * CONE]
    np.testing.assert_array_equal(entry[inner], before[inner])
    assert sorted(np.unique(ids[ids >= 0])) == list(range(left))
    for j in range(SIDE):
        for i in range(SIDE):
            cone = np.s_[j * CONE : (j + 1) * CONE, i * CONE : (i + 1) * CONE]
            if MARGIN <= min(i, j) and max(i, j) < SIDE - MARGIN:
                continue
            shown, were = np.unique(entry[cone][ids[cone] >= 0]), np.unique(before[cone][before[cone] >= 0])
            assert len(shown) == 1 and count[shown[0]] == count[were].max()
