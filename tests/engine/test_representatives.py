"""Fragments that borrow their light: nobody counts twice, nobody is left out, and the choice has no bias."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine import Camera, Group, Light, Material, Mesh, RenderSettings, Scene, render, uniform_world
from pointmr_engine.forward.reconstruction.fragments import allocate_fragments
from pointmr_engine.multires.fragments.representatives import (
    RUN,
    bring_forward,
    choose_representatives,
    lend_light,
)
from pointmr_engine.scene.graph import Graph, Link, Node

CELL, SHAPE = 4, (6, 6)


def some_fragments(rng, n: int):
    """n fragments in the order of the cells of a tile, of one to four subpixels, each with a number of its own."""
    f = allocate_fragments(n)
    cell = np.sort(rng.integers(0, SHAPE[0] * SHAPE[1], n))
    f.x[:] = CELL * (cell % SHAPE[1] + rng.random(n))
    f.y[:] = CELL * (cell // SHAPE[1] + rng.random(n))
    f.count[:] = rng.integers(1, 5, n)
    for column in f:
        if column is not f.x and column is not f.y and column is not f.count:
            column[:] = np.arange(n).reshape(-1, *[1] * (column.ndim - 1))
    return f, cell


def chosen(f, shining, seed: int) -> np.ndarray:
    stands = np.empty(len(f.x), np.int32)
    choose_representatives(
        f,
        np.int64(len(f.x)),
        shining,
        np.int64(CELL),
        SHAPE,
        np.int64(64),
        np.int64(32),
        np.int64(seed),
        stands,
    )
    return stands


@given(st.integers(1, 200), st.integers(0, 1 << 30))
def test_small_fragments_of_a_cell_stand_for_each_other(n, seed):
    rng = np.random.default_rng(seed)
    f, cell = some_fragments(rng, n)
    count, shining = f.count.copy(), rng.random(n) < 0.1
    stands = chosen(f, shining, seed)
    assert (stands[stands] == stands).all()
    assert (cell[stands] == cell).all()
    own = (count >= RUN) | shining
    assert (stands[own] == np.flatnonzero(own)).all() and (f.count[own] == count[own]).all()
    # as often seen as all that it stands for
    np.testing.assert_array_equal(f.count[np.unique(stands)], np.bincount(stands, count)[np.unique(stands)])
    # runs are no longer than their last member makes them
    assert (np.bincount(stands, count)[np.unique(stands[~own])] <= 2 * (RUN - 1)).all()


def test_the_choice_is_in_proportion_to_what_is_seen():
    n, times = 60, 4000
    sums = np.zeros(n)
    for seed in range(times):
        f, _ = some_fragments(np.random.default_rng(3), n)
        count = f.count.copy()
        stands = chosen(f, np.zeros(n, np.bool_), seed)
        sums += np.where(stands == np.arange(n), f.count, 0)
    np.testing.assert_allclose(sums / times, count, atol=5.0 * np.sqrt(2.0 / times))


@given(st.integers(1, 200), st.integers(0, 1 << 30))
def test_those_that_are_shaded_come_first_and_lend_their_light(n, seed):
    rng = np.random.default_rng(seed)
    f, _ = some_fragments(rng, n)
    stands = chosen(f, np.zeros(n, np.bool_), seed)
    before, old = [a.copy() for a in f], stands.copy()
    into, at = np.empty(n, np.int32), np.empty(n, np.int32)
    kept = bring_forward(f, np.int64(n), stands, into, at)
    assert sorted(into) == list(range(n))
    for column, was in zip(f, before, strict=True):
        np.testing.assert_array_equal(column[into], was)
    own = np.flatnonzero(old == np.arange(n))
    np.testing.assert_array_equal(into[own], np.arange(kept))  # in their order
    np.testing.assert_array_equal(stands[into], into[old])
    light = np.zeros((n, 3), np.float32)
    light[:kept] = rng.random((kept, 3))
    lend_light(light, stands, np.int64(kept), np.int64(n))
    np.testing.assert_array_equal(light[into], light[into[old]])


def scattered_cards(materials) -> Mesh:
    """Small cards, each of a colour of its own, so far that a pixel shows many."""
    rng, n = np.random.default_rng(2), 6000
    middle = rng.uniform(-1, 1, (n, 1, 3)) * (2.0, 2.0, 0.2)
    corners = middle + 0.012 * rng.normal(0, 1, (n, 3, 3))
    return Mesh(
        "cards",
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * n, dtype=np.int32).reshape(-1, 3),
        material_index=rng.integers(0, len(materials), n).astype(np.int32),
        materials=materials,
    )


def test_light_is_that_of_the_exact_image_and_passes_are_their_own():
    """A red card that stands for a green one lends it its light, and not its place or its normal."""
    materials = tuple(
        Material(name, Graph({"d": Node("diffuse", {"color": color})}, surface=Link("d", "bsdf")))
        for name, color in (
            ("red", (0.8, 0.1, 0.1)),
            ("green", (0.1, 0.8, 0.1)),
            ("dark", (0.05, 0.05, 0.05)),
        )
    )
    camera = np.eye(4)
    camera[2, 3] = 12.0
    sun = Light("SUN", np.eye(4), power=3.0, angle=0.0)
    scene = Scene(
        Group("root", [scattered_cards(materials)]), Camera(camera), [sun], uniform_world((0.2, 0.2, 0.2))
    )
    size = (40, 30)
    exact = render(scene, RenderSettings(*size, method="distributed", samples=64))
    frames = [
        render(scene, RenderSettings(*size, method="raytrace", seed=s, passes=("combined", "normal")))
        for s in range(4)
    ]
    ours = np.mean([f.passes["combined"][..., :3] for f in frames], 0)
    for c in range(3):
        assert ours[..., c].mean() == pytest.approx(exact.passes["combined"][..., c].mean(), rel=0.02)
    counters = frames[0].stats["counters"]
    assert counters["fragments"] > 0
    # what is lent changes with the seed, what is seen does not
    assert not np.array_equal(frames[0].passes["combined"], frames[1].passes["combined"])
    np.testing.assert_array_equal(frames[0].passes["normal"], frames[1].passes["normal"])
