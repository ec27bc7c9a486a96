"""First use: the second process compiles exactly what the renderer would, and nothing depends on it."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_scenes import lit_floor

from pointmr_engine import RenderSettings, render, warm

ROOT = Path(warm.__file__).parents[1]

# Compile for a scene ahead of its render, and say which kernels the render compiled nevertheless.
AHEAD = """
import json, sys
sys.path[:0] = {path!r}
from numba.core import event
from pointmr_engine import RenderSettings, emission, render, warm
from pointmr_engine.shading.program import compile_graph
from small_scenes import lit_floor, quad

compiled = []
class Listener(event.Listener):
    def on_start(self, e): pass
    def on_end(self, e):
        f = e.data["dispatcher"].py_func
        compiled.append(f.__module__ + "." + f.__name__)
event.register("numba:compile", Listener())

lamp = quad(1.0, 1.0, emission("lamp", strength=3.0), "lamp")
quick = dict(method="distributed", samples=4, threads=1, passes=("combined",))
scene, settings = lit_floor(lamp), RenderSettings(8, 8, **quick)
materials = [m for mesh in scene.root.meshes for m in mesh.materials]
wanted = warm.describe(scene, [compile_graph(m.graph) for m in materials], settings)
warm.Helper.start = lambda self, python=None: None
warm.compile_all(wanted)
ahead = len(compiled)
render(scene, settings)
print(json.dumps([compiled[:ahead], compiled[ahead:]]))
"""


def test_what_is_compiled_ahead_is_what_the_renderer_calls(tmp_path):
    code = AHEAD.format(path=[str(ROOT), str(Path(__file__).parent)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    out = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert out.returncode == 0, out.stderr
    ahead, later = json.loads(out.stdout)
    stages = {"paths.scatter", "paths.move", "direct_light.connect", "camera.sample_rays", "frames.frames_of"}
    assert {f"pointmr_engine.raytracing.{s}" for s in stages} <= set(ahead)
    own = {name for name in later if name.startswith("pointmr_engine.")}
    left_to_the_renderer = ("hierarchy.", "raytracing.walk", "numerics.")
    assert [n for n in sorted(own) if not n.split(".", 1)[1].startswith(left_to_the_renderer)] == []
    assert own & set(ahead) == set()  # nothing compiled twice, for other types


@pytest.mark.parametrize("python", ["/nowhere/python3", "/usr/bin/blender", "", None])
def test_a_helper_that_cannot_start_is_harmless(python, monkeypatch):
    monkeypatch.setattr(warm, "is_cold", lambda: True)
    monkeypatch.setattr(sys, "executable", python)
    frame = render(lit_floor(), RenderSettings(4, 4, method="distributed", samples=1))
    assert np.isfinite(frame.passes["combined"]).all()


def test_interpreters_are_known_by_their_names():
    assert all(warm.is_python(n) for n in ("python", "/x/bin/python3.11", r"C:\blender\python.exe"[-10:]))
    assert not any(warm.is_python(n) for n in ("blender", "/opt/blender-5.0/blender", "pythonista", "", None))


def test_the_helper_ends_with_its_parent(monkeypatch, tmp_path):
    monkeypatch.setattr(warm, "is_cold", lambda: True)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    helper = warm.Helper()
    helper.start()
    process = helper._process
    assert process is not None and process.poll() is None
    helper.begin({"leaves": [], "max_lobes": 1, "transparent": False, "emissive": False, "lamps": [],
                  "several_bounces": True, "passes": ["combined"]})  # fmt: skip
    start = time.monotonic()
    helper.stop()
    assert process.poll() is not None
    assert time.monotonic() - start < 10.0


def test_two_writers_of_one_function_do_not_mix_their_kernels(tmp_path):
    """The second process' files have numbers of their own, and what another has noted in the index stays."""
    code = """
import sys, threading
sys.path.insert(0, {root!r})
from numba.core.caching import IndexDataCacheFile
numba_save = IndexDataCacheFile.save
from pointmr_engine import warm
warm.save_beside(threading.Lock())
first, second = (IndexDataCacheFile({folder!r}, "kernel", ("stamp", 1)) for _ in range(2))
numba_save(first, "a", "from the renderer")
second.save("b", "from the second process")
second.save("a", "never written")
numba_save(first, "c", "from the renderer, too")
print([second.load(k) for k in "abc"], len(set(first._load_index().values())))
"""
    code = code.format(root=str(ROOT), folder=str(tmp_path))
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    values = ["from the renderer", "from the second process", "from the renderer, too"]
    assert out.stdout.strip() == f"{values} 3"
