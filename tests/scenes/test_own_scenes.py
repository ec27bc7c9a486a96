"""The project's own scenes: their scripts build what is committed, they hold what they promise, and they render."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pointmr_engine.image import exr

bpy = pytest.importorskip("bpy")
ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "scenes_blend"
NAMES = ("still_life", "forest_1e15", "stadium")
MOST_BYTES = 3_000_000
MOST_MEGABYTES = 1500  # of memory, for any of them


def run(*arguments) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module", params=NAMES)
def scene(request, tmp_path_factory):
    """(name, facts of the committed file, facts of what its script builds now, frame's stats, image)."""
    name = request.param
    folder = tmp_path_factory.mktemp(name)
    run(SCENES / f"build_{name}.py", folder)
    made = json.loads(run("-m", "blender_addon.cli", "info", "--json", folder / f"{name}.blend"))
    kept = json.loads(run("-m", "blender_addon.cli", "info", "--json", SCENES / f"{name}.blend"))
    out = folder / "image.exr"
    small = ("--method", "conventional", "--size", "64x48", "--stats", folder / "stats.json")
    run("-m", "blender_addon.cli", "render", SCENES / f"{name}.blend", "-o", out, *small)
    frame = json.loads((folder / "stats.json").read_text())["frames"][0]
    return name, kept, made, frame, exr.read(out)


def test_script_builds_the_file(scene):
    name, kept, made, _, _ = scene
    for key in (
        "unique_triangles",
        "instanced_triangles",
        "depth",
        "groups",
        "instances",
        "lights",
        "materials",
        "images",
    ):
        assert kept[key] == made[key], key
    assert (SCENES / f"{name}.blend").stat().st_size < MOST_BYTES


def test_camera_and_nothing_unsupported(scene):
    _, kept, _, _, _ = scene
    assert kept["camera"] == "Camera"
    assert kept["size"] == [640, 480]
    assert kept["warnings"] == []


def test_counts(scene):
    name, kept, _, frame, _ = scene
    assert frame["stats"]["triangles"] == kept["instanced_triangles"]
    if name == "forest_1e15":
        assert kept["instanced_triangles"] >= 10**15
        assert kept["depth"] >= 7
        assert kept["instances"] < 200_000  # what is stored, for all that
    elif name == "stadium":
        assert 104_500_000 < kept["instanced_triangles"] < 106_500_000
    else:
        assert kept["lights"] == {"area": 7} and len(kept["images"]) == 3


def test_renders(scene):
    """Something is seen: no black or flat image, nothing that is no number."""
    name, _, _, frame, image = scene
    color = image["combined"][..., :3]
    assert color.shape == (48, 64, 3)
    assert np.isfinite(color).all() and (color >= 0).all()
    luminance = color.mean(-1)
    assert 0.01 < luminance.mean() < 5
    assert luminance.std() > 0.15 * luminance.mean()
    assert frame["stats"]["bad_samples"] == 0


@pytest.fixture(scope="module")
def add_on():
    """The add-on, as a user of Blender has it."""
    import blender_addon

    registered = hasattr(bpy.types.Object, "pointmr")
    if not registered:
        blender_addon.register()
    yield
    if not registered:
        blender_addon.unregister()


def test_stadium_seats_every_fan():
    bpy.ops.wm.open_mainfile(filepath=str(SCENES / "stadium.blend"))
    crowd = bpy.data.objects["Crowd"]
    assert len(crowd.data.vertices) == 16_416
    sizes = [
        sum(len(p.vertices) - 2 for p in ob.data.polygons)
        for ob in bpy.data.objects
        if ob.name.startswith("Fan ")
    ]
    assert len(sizes) == 8
    assert all(6000 < n < 7200 for n in sizes)
    seats = np.array([v.co for v in crowd.data.vertices])
    cell = np.unique(np.round(seats / 0.25).astype(int), axis=0)
    assert len(cell) > 0.99 * len(seats)  # hardly two on one seat


def test_forest_hides_nothing_from_blender_but_its_instances(add_on):
    """Blender itself opens and evaluates the file without expanding what PointMR's instancers place."""
    bpy.ops.wm.open_mainfile(filepath=str(SCENES / "forest_1e15.blend"))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert sum(1 for _ in depsgraph.object_instances) < 100
    placers = [ob for ob in bpy.data.objects if ob.pointmr.instance_collection is not None]
    native = [ob for ob in bpy.data.objects if any(m.type == "NODES" for m in ob.modifiers)]
    assert len(placers) > 10 and len(native) > 4
