"""Tiles by threads and by forked processes: the same image, and nothing is lost when workers end."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from multiprocessing import active_children

import numpy as np
import pytest
from small_scenes import lit_floor

from pointmr_engine import RenderSettings, render
from pointmr_engine.image import tile_workers
from pointmr_engine.image.tile_workers import can_fork, finished_tiles, most_memory, worth_a_fork
from pointmr_engine.render import Cache, Cancelled

forks = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")
TILES = [(x, y, x + 1, y + 1) for x in range(4) for y in range(3)]


def results(work, tiles=TILES, apart=True, warnings=None):
    warnings = [] if warnings is None else warnings
    with closing(finished_tiles(work, tiles, 2, apart, warnings, threading.Event())) as finished:
        return [found for found in finished if found is not None]


@pytest.mark.parametrize("apart", [False, pytest.param(True, marks=forks)])
def test_every_tile_is_worked_on_once(apart):
    found = results(lambda bounds: (bounds, os.getpid(), threading.get_ident()), apart=apart)
    assert sorted(bounds for bounds, *_ in found) == sorted(TILES)
    assert all((pid != os.getpid()) == apart for _, pid, _ in found)
    assert not active_children()


@forks
def test_a_worker_that_is_ended_loses_no_tile():
    parent, warnings = os.getpid(), []

    def work(bounds):
        if bounds == TILES[5] and os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return bounds

    assert sorted(results(work, warnings=warnings)) == sorted(TILES)
    assert len(warnings) == 1 and "was ended" in warnings[0]


@pytest.mark.parametrize("apart", [False, pytest.param(True, marks=forks)])
def test_what_goes_wrong_in_a_tile_is_raised(apart):
    def work(bounds):
        if bounds == TILES[5]:
            raise ValueError(f"no such tile: {bounds}")
        return bounds

    with pytest.raises(ValueError, match="no such tile"):
        results(work, apart=apart)
    assert not active_children()


@forks
def test_closing_ends_workers_at_once():
    began = time.monotonic()
    with closing(
        finished_tiles(lambda bounds: time.sleep(60.0), TILES, 2, True, [], threading.Event())
    ) as finished:
        assert next(finished) is None and len(active_children()) == 2
    assert not active_children() and time.monotonic() - began < 30.0


def test_closing_lets_threads_look_at_stop():
    stop = threading.Event()
    with closing(finished_tiles(lambda bounds: stop.wait(60.0), TILES, 2, False, [], stop)) as finished:
        assert next(finished) is None
    assert stop.is_set()


@forks
def test_workers_end_with_their_parent():
    program = r"""
import os, threading, time
from pointmr_engine.image.tile_workers import finished_tiles
def work(bounds):
    os.write(1, f"{os.getpid()}\n".encode())  # whole lines
    time.sleep(600.0)
for _ in finished_tiles(work, [(0, 0, 1, 1), (1, 0, 2, 1)], 2, True, [], threading.Event()):
    pass
"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    workers = [int(parent.stdout.readline()) for _ in range(2)]
    parent.kill()
    parent.wait()
    end = time.monotonic() + 30.0
    while any(_runs(pid) for pid in workers):
        assert time.monotonic() < end, "workers outlive their parent"
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@forks
def test_few_tiles_and_single_threads_are_not_worth_a_fork():
    assert can_fork(4, 2) and not can_fork(3, 2) and not can_fork(100, 1)


@forks
@pytest.mark.parametrize("method", ["raytrace", "distributed"])
def test_processes_render_what_threads_do(method, monkeypatch):
    monkeypatch.setattr(tile_workers, "MEASURED", 0.0)
    monkeypatch.setattr(tile_workers, "WORTH", 0.0)
    scene = lit_floor()
    settings = RenderSettings(
        200, 150, method=method, samples=2, threads=2, passes=("combined", "depth", "normal")
    )
    by_threads = render(scene, settings)
    cache, told = Cache(), []
    settings.processes = True
    for _ in range(2):  # what the first image makes, and all that the second one finds
        by_processes = render(scene, settings, lambda fraction, text, tile: told.append(fraction), cache)
        for name, pixels in by_threads.passes.items():
            assert np.array_equal(pixels, by_processes.passes[name]), name
        assert by_processes.stats["counters"] == by_threads.stats["counters"]
        assert not by_processes.warnings
    assert max(told) == 1.0 and most_memory() > 0


def test_what_tiles_will_take_follows_from_those_that_are_known():
    squares, worth = [(k, 0, k + 2, 2) for k in range(6)], tile_workers.WORTH
    assert worth_a_fork(squares, {})
    assert worth_a_fork(squares, {(0, 0, 1, 1): worth / 24.0})
    assert not worth_a_fork(squares, {(0, 0, 1, 1): 0.9 * worth / 24.0})
    assert not worth_a_fork(squares, dict.fromkeys(squares, 0.9 * worth / 6.0))
    assert worth_a_fork(squares, dict.fromkeys(squares, 0.0) | {squares[3]: worth})


@forks
@pytest.mark.parametrize("method", ["raytrace", "conventional"])
def test_short_images_are_rendered_by_threads(method):
    """A second one, at least, whose kernels are there: of a first one `raytrace` does not know how short it is."""
    settings = RenderSettings(200, 150, method=method, threads=2, processes=True)
    scene, cache, first, second = lit_floor(), Cache(), [], []
    render(scene, settings, lambda *told: first.append(len(active_children())), cache)
    render(scene, settings, lambda *told: second.append(len(active_children())), cache)
    assert any(first) or method != "raytrace"
    assert second and not any(second)


def test_tiles_that_took_longest_begin_first():
    scene, cache, begun = lit_floor(), Cache(), []
    settings = RenderSettings(200, 150, method="raytrace", passes=("combined",), threads=1)

    def told(fraction, text, tile):
        if tile is not None:
            begun.append((tile.x, tile.y))

    render(scene, settings, cache=cache)
    ((fits, seconds),) = cache.find(scene, True).sampler.seconds.items()
    assert len(seconds) > 4 and min(seconds.values()) > 0.0
    for sign in (1, -1):
        places = sorted(seconds)
        cache.find(scene, True).sampler.seconds[fits] = {bounds: sign * k for k, bounds in enumerate(places)}
        begun.clear()
        render(scene, settings, told, cache)
        assert begun == [bounds[:2] for bounds in places[::-sign]]


@forks
def test_a_cancelled_image_leaves_no_process(monkeypatch):
    monkeypatch.setattr(tile_workers, "WORTH", 0.0)
    settings = RenderSettings(200, 150, method="distributed", samples=16, threads=2, processes=True)
    render(lit_floor(), settings)
    seen = []

    def cancel(fraction, text, tile):
        seen.append(len(active_children()))
        return seen[-1] > 0

    with pytest.raises(Cancelled):
        render(lit_floor(), settings, cancel)
    assert seen[-1] == 2 and not active_children()
