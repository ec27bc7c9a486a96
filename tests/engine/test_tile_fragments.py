"""A tile's fragments before they are shaded: their numbers along a curve, and what is left of them in its margin."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.forward.fragments import allocate_fragments
from pointmr_engine.multires.fragment_paths import begin_numbers, number_samples
from pointmr_engine.multires.merge import thin_margin
from pointmr_engine.numerics.rng import sample_2d
from pointmr_engine.numerics.sobol import sobol_tables
from pointmr_engine.raytracing.paths import allocate_samples

SUBPIXELS = 8


def numbers(x, y, shape, batch=None):
    """Samples of fragments at x, y (F,), numbered `batch` at a time."""
    n = len(x)
    f, samples, used = allocate_fragments(n), allocate_samples(n), np.empty(shape, np.int32)
    f.x[:], f.y[:] = x, y
    pixel, side = np.empty(n, np.int64), np.int64(SUBPIXELS)
    begin_numbers(f, side, np.int64(n), used)
    for first in range(0, n, batch or n):
        count = min(batch or n, n - first)
        part = type(samples)(*(a[first:] for a in samples))
        number_samples(
            f, np.int64(-8), np.int64(16), side, np.int64(first), np.int64(count), part, np.int64(3), used,
            pixel[first:],
        )  # fmt: skip
    return samples, pixel


@settings(deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 300), st.integers(1, 50))
def test_every_fragment_has_a_number_of_its_own_and_pixels_have_runs_of_them(seed, n, batch):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 12, 2))
    y, x = (rng.uniform(-SUBPIXELS, (s + 1) * SUBPIXELS, n).astype(np.float32) for s in shape)
    samples, pixel = numbers(x, y, shape, batch)
    assert len(np.unique(samples.number[:n])) == n
    assert len(np.unique(samples.seed[:n])) == 1
    for p in np.unique(pixel):
        own = np.sort(samples.number[:n][pixel == p])
        np.testing.assert_array_equal(own, np.arange(own[0], own[0] + len(own)))
        assert own[0] % 2 ** int(np.ceil(np.log2(len(own)))) == 0


def test_samples_of_neighbours_are_stratified_together():
    """Each 4 x 4 pixels with one fragment each have one sample in each sixteenth of either dimension."""
    side = 32
    y, x = (SUBPIXELS * (a.ravel() + 0.5) for a in np.mgrid[:side, :side])
    samples, _ = numbers(x, y, (side, side))
    tables = sobol_tables()
    u = np.array(
        [sample_2d(tables, samples.seed[k], np.uint32(7), samples.number[k]) for k in range(side**2)]
    )
    blocks = u.reshape(side // 4, 4, side // 4, 4, 2).transpose(0, 2, 1, 3, 4).reshape(-1, 16, 2)
    strata = np.sort(np.floor(16 * blocks).astype(int), axis=1)
    assert (strata == np.arange(16)[:, None]).all()


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
@settings(deadline=None, max_examples=30)
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
