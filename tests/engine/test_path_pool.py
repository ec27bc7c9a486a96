"""Paths that wait for those of other batches: none is lost, none is changed, whatever the batches are."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.closed_forms import curved_mirror
from benchmarks.closed_forms.stage import mirror
from pointmr_engine import RenderSettings, Scene, principled, render
from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.lobes.lobe_cones import allocate_lobe_cones
from pointmr_engine.multires.paths import cone_paths, fragment_paths
from pointmr_engine.multires.paths.path_pool import PathPool
from pointmr_engine.raytracing.path_arrays import allocate_paths
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.small_scenes import lit_floor

N = 20


def numbered(n: int, first: int):
    """Paths and cones whose every column says which path it belongs to."""
    paths, cones = allocate_paths(n), allocate_lobe_cones(n, allocate_cones(n))
    state = paths.state._replace(camera_from_world=np.zeros((0,)))
    for column in (*paths.rays, *state, *paths[2:], *cones.cones, *cones._replace(cones=np.zeros(0))):
        rows = np.arange(first, first + len(column)) % 100
        column[...] = rows.reshape(-1, *(1,) * (column.ndim - 1)).astype(column.dtype)
    return paths, cones


def test_what_is_taken_is_given_back_in_order():
    pool = PathPool(3 * N, cones=True)
    for first in (0, N):
        pool.take(*numbered(N, first), N, 1 + first)
    paths, cones = numbered(3 * N, 70)
    assert pool.give(paths, cones) == (2 * N, 1 + N)
    assert pool.count == 0
    expected, its_cones = numbered(3 * N, 0)
    for got, want in zip(
        (paths.slot, paths.throughput, paths.rays.direction, paths.state.depth, cones.alpha, cones.cones.axes),
        (expected.slot, expected.throughput, expected.rays.direction, expected.state.depth, its_cones.alpha,
         its_cones.cones.axes),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_array_equal(got[: 2 * N], want[: 2 * N])
    assert paths.slot[2 * N] == (70 + 2 * N) % 100  # rows behind are not touched


def test_parts_are_given_from_the_end():
    pool = PathPool(2 * N, cones=False)
    pool.take(numbered(2 * N, 0)[0], None, 2 * N, 1)
    paths, _ = numbered(2 * N, 50)
    assert pool.give(paths, None, N // 2) == (N // 2, 1)
    np.testing.assert_array_equal(paths.slot[: N // 2], np.arange(2 * N - N // 2, 2 * N))
    assert pool.give(paths, None, 3 * N) == (2 * N - N // 2, 1)
    np.testing.assert_array_equal(paths.slot[: 2 * N - N // 2], np.arange(2 * N - N // 2))
    assert pool.count == 0


def test_a_core_and_what_lies_around_it_stay_together():
    pool = PathPool(N, cones=True)
    paths, cones = numbered(N, 0)
    cones.part[:N] = np.arange(N) % 2 + 1
    pool.take(paths, cones, N, 1)
    assert pool.give(paths, cones, 3) == (4, 1)
    np.testing.assert_array_equal(paths.slot[:4], np.arange(N - 4, N))
    assert pool.count == N - 4


def mirrors() -> Scene:
    """Two balls that mirror each other over a floor, under a point: next to nothing in the image is left to chance."""
    ball = curved_mirror.sphere(32)
    balls = [
        replace(
            ball, positions=(0.5 * ball.positions + (x, 0, 0.5)).astype(np.float32), materials=(mirror(),)
        )
        for x in (-0.55, 0.55)
    ]
    return lit_floor(*balls, radius=0.0)


@pytest.mark.parametrize("secondary", ["cones", "rays"])
def test_the_batches_do_not_show(monkeypatch, secondary):
    settings = RenderSettings(
        48, 36, method="raytrace", threads=1, raytrace=RaytraceSettings(secondary=secondary)
    )
    whole = render(mirrors(), settings)
    monkeypatch.setattr(fragment_paths, "BATCH", 256)
    for name, value in (("PARTS", 200), ("FEW", 40), ("MANY", 100)):
        monkeypatch.setattr(fragment_paths, name, value)
    parts = render(mirrors(), settings)
    shaded = whole.stats["counters"]["shaded_points"]
    # curved mirrors leave something to chance, whose numbers count the bounces and the rows of a batch
    assert parts.stats["counters"]["shaded_points"] == pytest.approx(shaded, rel=0.003)
    assert shaded > 48 * 36
    parts, whole = (f.passes["combined"][..., :3].astype(float) for f in (parts, whole))
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.005)
    assert np.sqrt(((parts - whole) ** 2).mean()) < 0.05 * whole.mean()


def test_in_a_crowd_each_point_sends_one_path(monkeypatch):
    """Where lobes find no room, each point sends one path and no more, or rows would be written that are not there."""
    glossy = replace(curved_mirror.sphere(32), materials=(principled("gold", metallic=1.0, roughness=0.3),))
    scene = lit_floor(replace(glossy, positions=glossy.positions + np.float32((0, 0, 1))), radius=0.0)
    settings = RenderSettings(48, 36, method="raytrace", threads=1)
    whole = render(scene, settings).passes["combined"][..., :3]
    scatter, sent = cone_paths.scatter_lobes, []

    def crowded(*a):
        bounce, room, out = a[8], 11, a[12]
        m = scatter(*a[:room], np.int64(0) if bounce == 0 else a[room], *a[room + 1 :])
        if bounce == 0:
            sent.append(out.slot[:m].copy())
        return m

    monkeypatch.setattr(cone_paths, "scatter_lobes", crowded)
    parts = render(scene, settings).passes["combined"][..., :3]
    slots = np.concatenate(sent)
    assert len(slots) > 1000
    assert len(np.unique(slots)) == len(slots)
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.01)
