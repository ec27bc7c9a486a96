"""Fragments of lens views that merge: what represents others stands for as many, and where it was asked."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.reconstruction.pixel_filter import NO_SLOPES, allocate_slopes
from pointmr_engine.multires.lens.lens_merge import VIEW, light_where_seen, merge_views
from tests.engine.test_raytrace_parts import fragments

CELLS = 40  # of one view
EACH = 4  # fragments in each, one of every turn


def merged(count, seen, seed=0, part=None, view=1, turns=None):
    """(into, times, fragments) of CELLS cells of so many fragments, which are seen in `seen` (N,) subpixels."""
    n = CELLS * count
    f = fragments(n, **({} if part is None else {"part": part}))
    f.count[:], f.x[:] = seen, np.arange(n)
    key = (np.int64(view) << VIEW) + np.arange(n) // count
    turns = 1 << np.arange(n) % count if turns is None else turns
    into, times = np.empty(n, np.int32), np.empty(n, np.float32)
    kept, chosen = np.empty(n, np.int64), np.empty(n, np.int64)
    groups = merge_views(
        np.arange(n), key, np.full(n, 4), False, np.float64(1.0), f, np.int64(n), into, np.empty(n, np.float32), kept,
        chosen, times, turns.astype(np.uint8), np.int64(0), np.int64(0), np.int64(seed),
    )  # fmt: skip
    return into, times, f, kept[:groups], chosen[:groups]


@given(st.integers(0, 10_000), st.integers(1, EACH))
def test_who_represents_others_counts_for_all_of_them(seed, count):
    rng = np.random.default_rng(seed)
    n = CELLS * count
    seen, part = rng.integers(1, 5, n), rng.integers(0, 2, n)
    into, times, f, kept, chosen = merged(count, seen, seed, part)
    for group, k in enumerate(chosen):
        members = np.flatnonzero(into == group)
        assert k in members
        assert len(set(part[members])) == 1
        np.testing.assert_allclose(times[k] * seen[k], seen[members].sum(), rtol=1e-5)
        assert not times[members[members != k]].any()
        assert f.count[kept[group]] == seen[members].sum()
        assert f.x[kept[group]] == k  # at its own place


def test_each_is_chosen_as_often_as_it_is_seen():
    seen = np.tile([1, 1, 2], CELLS)
    turns = np.tile([1, 2, 12], CELLS)  # the last is seen at two turns
    chosen = np.concatenate([merged(3, seen, seed, turns=turns)[4] % 3 for seed in range(200)])
    share = np.bincount(chosen) / len(chosen)
    np.testing.assert_allclose(share, [0.25, 0.25, 0.5], atol=4 * 0.5 / np.sqrt(len(chosen)))


def test_where_one_is_missing_others_are_chosen_evenly():
    chosen = np.concatenate([merged(3, 1, seed)[4] % 3 for seed in range(200)])
    share = np.bincount(chosen) / len(chosen)
    np.testing.assert_allclose(share, 1 / 3, atol=4 * 0.5 / np.sqrt(len(chosen)))


def test_what_views_share_is_one_fragment_that_all_show():
    into, times, f, kept, _ = merged(EACH, 1, view=0)
    assert len(kept) == CELLS
    assert (times == 1).all()
    light = np.arange(CELLS * 3.0).reshape(CELLS, 3).astype(np.float32)
    slopes = allocate_slopes(CELLS)
    slopes.x[:], slopes.y[:] = 0.5, 0.0
    mean = type(f)(*(a[kept] for a in f))
    x = np.arange(CELLS * EACH, dtype=np.float32)
    out = np.empty((len(x), 3), np.float32)
    light_where_seen(x, x, into, times, light, mean, NO_SLOPES, out)
    np.testing.assert_array_equal(out, light[into])
    light_where_seen(x, x, into, times, light, mean, slopes, out)
    np.testing.assert_allclose(out - light[into], 0.5 * np.tile([[-1.5], [-0.5], [0.5], [1.5]], (CELLS, 3)))
