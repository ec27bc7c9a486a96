"""The add-on as a Blender extension: what the zip holds, Blender's own validation, and running under another name."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest

from blender_addon import build_extension, kernel_cache


@pytest.fixture(scope="module")
def extension(tmp_path_factory) -> Path:
    """The extension's zip, without the downloaded wheels."""
    return build_extension.build(tmp_path_factory.mktemp("dist"), ["linux-x64"], fetch=False)


def test_blender_finds_the_extension_valid(extension):
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    done = subprocess.run(
        [sys.executable, str(tool), "validate", str(extension)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_zip_holds_addon_manifest_and_engine(extension):
    with zipfile.ZipFile(extension) as archive:
        names = archive.namelist()
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        wheel = next(n for n in names if n.startswith("wheels/pointmr_engine-"))
        with zipfile.ZipFile(archive.open(wheel)) as engine:
            packed = engine.namelist()
    project = tomllib.loads((build_extension.PROJECT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"]
    assert manifest["wheels"] == [f"./{wheel}"]
    assert {"__init__.py", "engine.py", "sync/__init__.py", "ui/__init__.py"} <= set(names)
    assert not any("__pycache__" in n or n.endswith(".nbi") for n in names + packed)
    assert "pointmr_engine/scene/scene.py" in packed
    data = [p for p in (build_extension.PROJECT / "pointmr_engine").rglob("*.npz")]
    assert all(p.relative_to(build_extension.PROJECT).as_posix() in packed for p in data)


def test_wheels_needed_are_the_engines_but_not_numpy():
    needed = sorted(d.split(">")[0] for d in build_extension.dependencies())
    assert needed == ["OpenEXR", "numba", "threadpoolctl"]


def test_works_under_an_extensions_name(extension, tmp_path):
    """Blender calls the package bl_ext.user_default.pointmr and puts the engine's wheel on the path."""
    package = tmp_path / "elsewhere" / "user_default" / "pointmr"
    with zipfile.ZipFile(extension) as archive:
        archive.extractall(package)
    for folder in (package.parent, package.parent.parent):
        (folder / "__init__.py").touch()
    site = tmp_path / "site"
    with zipfile.ZipFile(next((package / "wheels").glob("pointmr_engine-*.whl"))) as wheel:
        wheel.extractall(site)
    code = f"""
import sys
sys.path[:0] = [{str(site)!r}, {str(tmp_path)!r}]
import bpy
from elsewhere.user_default import pointmr
import pointmr_engine
assert pointmr_engine.__path__[0].startswith({str(site)!r}), pointmr_engine.__path__
pointmr.register()

# The engine is the same package under every name of the add-on: no need to compile its kernels here.
import importlib
import numpy as np
from pointmr_engine import Frame
from pointmr_engine.scene.group import count_triangles

def render(scene, settings, progress=None, cache=None):
    assert count_triangles(scene.root)[1] == 12
    pixels = np.full((settings.height, settings.width, 4), 0.5, np.float32)
    return Frame(settings.width, settings.height, {{"combined": pixels}})

importlib.import_module("pointmr_engine.render").render = render
scene = bpy.context.scene
scene.render.engine = "POINTMR"
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 24, 100
scene.render.filepath = {str(tmp_path / "out.png")!r}
bpy.ops.render.render(write_still=True)
assert "blender_addon" not in sys.modules, "something imports the add-on by its name in the checkout"
pointmr.unregister()
"""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=tmp_path,
        env=environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "out.png").stat().st_size > 100


@pytest.fixture
def fresh_cache(monkeypatch):
    """kernel_cache as in a new process without settings."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    kernel_cache.folder.cache_clear()
    yield monkeypatch
    kernel_cache.folder.cache_clear()


def test_checkout_keeps_kernels_beside_the_sources(fresh_cache):
    assert kernel_cache.folder() == kernel_cache.engine_folder()


def test_kernels_go_to_the_users_cache_where_the_engine_cannot_be_written(fresh_cache, tmp_path):
    engine = kernel_cache.engine_folder()
    writable = kernel_cache.writable
    fresh_cache.setattr(kernel_cache, "writable", lambda f: f != engine and writable(f))
    fresh_cache.setenv("XDG_CACHE_HOME", str(tmp_path))
    fresh_cache.setattr(sys, "platform", "linux")
    assert kernel_cache.folder() == tmp_path / "pointmr" / kernel_cache.source_hash(engine)
    assert kernel_cache.is_cold()


def test_no_writable_folder_is_said_with_the_way_out(fresh_cache):
    fresh_cache.setattr(kernel_cache, "writable", lambda f: False)
    with pytest.raises(OSError, match="set NUMBA_CACHE_DIR"):
        kernel_cache.folder()


def test_changed_sources_get_another_folder(tmp_path):
    (tmp_path / "a.py").write_text("x = 1\n")
    before = kernel_cache.source_hash(tmp_path)
    (tmp_path / "a.py").write_text("x = 2\n")
    assert kernel_cache.source_hash(tmp_path) != before
