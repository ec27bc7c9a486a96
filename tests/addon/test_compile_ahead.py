"""Compiling ahead: nothing starts where nobody waits, the process ends with Blender, and what it leaves is enough."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from blender_addon import ahead, kernel_cache

ROOT = Path(ahead.__file__).parents[1]


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    """kernel_cache for an empty folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernel_cache.folder.cache_clear()
    yield tmp_path
    kernel_cache.folder.cache_clear()


def test_in_the_background_nothing_starts():
    ahead.begin()
    assert not ahead.wanted() and ahead._running == []


def test_the_process_ends_when_it_is_told(monkeypatch, own_cache):
    monkeypatch.setattr(ahead, "wanted", lambda: True)
    ahead.begin()
    ahead.begin()  # one is enough
    (process,) = ahead._running
    assert process.poll() is None
    ahead.stop()
    assert process.poll() is not None and ahead._running == []


def test_a_note_says_that_all_is_there_until_it_is_cleared(own_cache):
    note = kernel_cache.note()
    assert note.parent == own_cache and not note.exists()
    note.touch()
    assert note.exists()
    kernel_cache.clear()
    assert not note.exists()


LATER = """
import sys
sys.path[:0] = {path!r}
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, e): pass
    def on_end(self, e): compiled.append(e.data["dispatcher"].py_func.__name__)
event.register("numba:compile", Listener())
from pointmr_engine import RenderSettings, render
from tests.engine.test_raytrace import balls, trees
for scene in (balls(), trees()):
    for method in ("raytrace", "forward", "distributed"):
        render(scene, RenderSettings(24, 18, method=method, samples=1))
print(len(compiled), *compiled)
"""


@pytest.mark.slow
def test_other_scenes_compile_next_to_nothing_later(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pointmr_engine.ahead", "--note", str(tmp_path / "ahead.py3")]
    subprocess.run(command, env=environment, check=True)
    assert list(tmp_path.glob("ahead.py*"))
    code = LATER.format(path=[str(ROOT)])
    out = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    count, *names = out.stdout.split()
    assert int(count) <= 3, names
