"""The `pointmr` command: what it writes, what it says, and what it leaves behind when something goes wrong."""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from blender_addon import batch
from blender_addon.cli import FORWARD, RAYTRACE, build_parser, main
from blender_addon.command.report import Report
from blender_addon.headless import Options, output_path
from pointmr_engine import ForwardSettings, Frame, RaytraceSettings
from pointmr_engine.image import exr

bpy = pytest.importorskip("bpy")
ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--size", "24x16", "--method", "conventional"]


@pytest.fixture(scope="module")
def blend(tmp_path_factory) -> Path:
    """A cube that moves with the frames, instanced three times, two cameras, a lamp, and a script that wants to run."""
    folder = tmp_path_factory.mktemp("scenes")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 4
    mesh = bpy.data.meshes.new("cube")
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh.from_pydata(corners, [], faces)
    mesh.materials.append(bpy.data.materials.new("grey"))
    ob = bpy.data.objects.new("cube", mesh)
    ob.pass_index = 5
    for frame in (1, 4):
        ob.location.x = 0.4 * frame
        ob.keyframe_insert("location", frame=frame)
    scene.collection.objects.link(ob)
    part = bpy.data.collections.new("part")
    part.objects.link(bpy.data.objects.new("part", mesh))
    for i in range(3):
        empty = bpy.data.objects.new(f"place {i}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", part
        empty.location = (3.0 * (i - 1), 6.0, 0.0)
        scene.collection.objects.link(empty)
    for name, x in (("Left", -3.0), ("Right", 3.0)):
        camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        camera.location, camera.rotation_euler = (x, -12.0, 0.0), (np.pi / 2, 0.0, 0.0)
        scene.collection.objects.link(camera)
    scene.camera = bpy.data.objects["Left"]
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.use_pass_object_index = bpy.context.view_layer.use_pass_z = True
    text = bpy.data.texts.new("startup.py")
    text.use_module = True
    text.write(f"open({str(folder / 'script ran')!r}, 'w').close()\n")
    path = folder / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    scene.camera = None
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "blind.blend"))
    return path


def files_in(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.rglob("*") if p.is_file())


def test_frame_lists():
    assert batch.parse_frames("3") == [3]
    assert batch.parse_frames("1,3,5-9") == [1, 3, 5, 6, 7, 8, 9]
    assert batch.parse_frames("1-21/10, 2") == [1, 2, 11, 21]
    for bad in ("", "a", "5-1", "1-", "-3", "1-9/0", "1;2"):
        with pytest.raises(ValueError):
            batch.parse_frames(bad)
    frames = list(range(1, 11))
    assert (
        sorted(batch.share(frames, "1/3") + batch.share(frames, "2/3") + batch.share(frames, "3/3")) == frames
    )
    for bad in ("0/2", "3/2", "x", "1"):
        with pytest.raises(ValueError):
            batch.share(frames, bad)


def test_output_names():
    assert output_path("out/a_####.exr", 7, False) == Path("out/a_0007.exr")
    assert output_path("out/a.exr", 7, False) == Path("out/a.exr")
    assert output_path("out/a.png", 7, True) == Path("out/a_0007.png")
    assert output_path("out/a_##.v2", 123, True) == Path("out/a_123.v2.exr")
    assert output_path("out/a#b##.exr", 3, True) == Path("out/a#b03.exr")


@pytest.mark.filterwarnings("error")
def test_a_bar_of_many_frames_ends_where_it_ends(capfd):
    """Sums of fractions were a rounding more than the number of frames, of which the bar warned."""
    rng = np.random.default_rng(0)
    for frames in range(1, 9):
        report = Report(Options(Path("shot.blend"), ""), True, frames)
        for frame in range(frames):
            for fraction in [*np.sort(rng.random(50)), 1.0]:
                report.progress(frame, float(fraction), "rendering")
            str(report._bar)
        assert report._bar.n == frames
        report.close()


def test_help_needs_neither_blender_nor_numba():
    code = (
        "import sys\nfrom blender_addon.cli import main\n"
        "try:\n    main(['render', '--help'])\nexcept SystemExit:\n    pass\n"
        "assert not {'bpy', 'numba', 'numpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, timeout=60)


def test_render_writes_what_it_says(blend, tmp_path, capfd):
    """One frame: every pass in the EXR, a PNG, times, memory and counts; nothing else, and no script has run."""
    output = tmp_path / "new folder" / "image.exr"
    stats = tmp_path / "stats.json"
    code = main(
        [
            "render",
            str(blend),
            "-o",
            str(output),
            "--png",
            "--stats",
            str(stats),
            "--seed",
            "7",
            "--samples",
            "2",
        ]
        + ["--size", "40x30", "--method", "distributed", "--camera", "Right", "--threads", "1"]
    )
    out, err = capfd.readouterr()
    assert code == 0, err
    assert files_in(tmp_path) == ["image.exr", "image.png", "stats.json"]
    passes = exr.read(output)
    assert set(passes) >= {"combined", "depth", "object_index"}
    assert passes["combined"].shape == (30, 40, 4) and all(np.isfinite(p).all() for p in passes.values())
    assert set(np.unique(passes["object_index"])) == {0.0, 5.0}
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["frame"] == 1 and {"open", "sync", "render", "write"} <= set(frame["seconds"])
    settings = frame["stats"]["settings"]
    assert (settings["width"], settings["height"], settings["samples"], settings["seed"]) == (40, 30, 2, 7)
    assert settings["method"] == "distributed" and settings["threads"] == 1
    assert frame["stats"]["unique_triangles"] == 12 and frame["stats"]["triangles"] == 48
    assert frame["peak_memory"] > 2**24
    for text in (
        "12 unique, 48 instanced",
        "peak memory",
        "together",
        str(output),
        str(output.with_suffix(".png")),
    ):
        assert text in out
    assert "Saved" not in out and "Traceback" not in err
    assert not (blend.parent / "script ran").exists()


@pytest.fixture
def asked(monkeypatch) -> list:
    """The settings of every render since, which the engine does not do: images are white."""
    asked = []

    def render(scene, settings, progress=None, **_):
        asked.append(settings)
        pixels = np.ones((settings.height, settings.width, 4), np.float32)
        stats = {
            "counters": {"points": 12345},
            "needs": {
                "shadows": np.bool_(True),
                "reflections": False,
                "sets": 3,
                "lens": 0,
                "passes": ("depth",),
            },
        }
        return Frame(settings.width, settings.height, {"combined": pixels}, stats)

    monkeypatch.setattr(importlib.import_module("pointmr_engine.render"), "render", render)
    return asked


def test_options_of_raytracing_reach_the_engine(blend, tmp_path, asked, capfd):
    """Every property but the viewport's has its option; the summary says what was asked for and what was needed."""
    start = ["render", str(blend), "-o", str(tmp_path / "a.exr"), "--size", "24x16", "--method", "raytrace"]
    stats = tmp_path / "stats.json"
    typed = [
        "--cones",
        "16",
        "--footprint",
        "0.5",
        "--secondary",
        "rays",
        "--visibility",
        "alpha",
        "--keep-sets",
    ]
    assert main([*start, *typed, "--stats", str(stats)]) == 0
    out, _ = capfd.readouterr()
    assert asked[0].method == "raytrace" and asked[0].raytrace.cache_folder
    assert replace(asked[0].raytrace, cache_folder=None) == RaytraceSettings(16, 0.5, "rays", "alpha")
    assert "24x16, raytrace, 16 cones per pixel, footprint 0.5, visibility alpha, secondary rays" in out
    assert "  needed: shadows, sets 3, passes (depth)\n  not needed: reflections, lens\n" in out
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["stats"]["needs"] == {
        "shadows": True,
        "reflections": False,
        "sets": 3,
        "lens": 0,
        "passes": ["depth"],
    }
    names = {n for n in bpy.context.scene.pointmr.bl_rna.properties.keys() if n.startswith("raytrace_")}
    assert names - set(RAYTRACE) == {"raytrace_preview_cones"}
    assert main(start) == 0
    assert asked[1].raytrace == RaytraceSettings()
    assert "24x16, raytrace, 1 cone per pixel\n" in capfd.readouterr()[0]


def test_options_of_forward_mapping_reach_the_engine(blend, tmp_path, asked):
    """Every property has its option, and what is typed is what the engine is asked for."""
    typed = [
        "--forward-sampling",
        "dynamic",
        "--forward-samples-per-pixel",
        "0.05",
        "--forward-draws",
        "random",
    ]
    typed += ["--forward-epsilon", "0.25", "--forward-failure", "0.0001", "--forward-strategy", "random"]
    typed += [
        "--forward-reconstruction",
        "gaussian",
        "--forward-subpixels",
        "8",
        "--forward-shading",
        "simple",
    ]
    typed += ["--no-forward-shadows", "--forward-backface-culling", "--no-forward-occlusion-culling"]
    typed += ["--forward-keep-sets"]
    start = ["render", str(blend), "-o", str(tmp_path / "a.exr"), "--size", "24x16", "--method", "forward"]
    stats = tmp_path / "stats.json"
    assert main([*start, *typed, "--stats", str(stats)]) == 0
    forward = asked[0].forward
    assert asked[0].method == "forward" and forward.cache_folder
    expected = ForwardSettings(
        "dynamic", 0.05, 0.25, 1e-4, "random", "random", "gaussian", 8, "simple", False, True, False
    )
    assert astuple(forward)[:-1] == pytest.approx(astuple(expected)[:-1])
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["stats"]["settings"]["forward"]["draws"] == "random"
    assert frame["stats"]["counters"] == {"points": 12345}
    assert set(FORWARD) == {n for n in bpy.context.scene.pointmr.bl_rna.properties.keys() if "forward_" in n}
    assert main([*start, "--samples", "4"]) == 0
    assert asked[1].forward == replace(
        ForwardSettings(failure=asked[1].forward.failure), samples_per_pixel=4.0
    )


def test_what_cycles_would_do_is_asked_of_the_engine(blend, tmp_path, asked):
    """--as-cycles takes the file's bounces; a seed that is typed counts, too."""
    start = ["render", str(blend), "-o", str(tmp_path / "a.exr"), "--size", "24x16"]
    assert main(start) == main([*start, "--as-cycles", "--seed", "3"]) == 0
    plain, taken = asked
    assert (plain.diffuse_bounces, taken.diffuse_bounces) == (0, bpy.context.scene.cycles.diffuse_bounces)
    assert taken.diffuse_bounces > 0 and taken.seed == 3
    assert taken.clamp_indirect == bpy.context.scene.cycles.sample_clamp_indirect > 0


def test_a_batchs_processes_get_all_options(blend, tmp_path, monkeypatch):
    commands = []
    monkeypatch.setattr(
        batch, "render_frames", lambda command, frames, *_: commands.append(command) or (frames, [])
    )
    typed = ["--forward-sampling", "dynamic", "--no-forward-shadows", "--forward-backface-culling"]
    start = ["render", str(blend), "-o", str(tmp_path / "a.exr"), "--method", "forward", "-f", "1-2"]
    assert main([*start, *typed, "--as-cycles", "--jobs", "2"]) == 0
    [command] = commands
    worker = build_parser().parse_args(command[command.index("render") :])
    given = {name: value for name, value in vars(worker).items() if "forward_" in name and value is not None}
    assert worker.as_cycles and given == {
        "forward_sampling": "dynamic",
        "forward_shadows": False,
        "forward_backface_culling": True,
    }
    commands.clear()
    typed = [
        "--cones",
        "4",
        "--footprint",
        "2",
        "--secondary",
        "rays",
        "--visibility",
        "alpha",
        "--no-keep-sets",
    ]
    start[start.index("forward")] = "raytrace"
    assert main([*start, *typed, "--jobs", "2"]) == 0
    worker = build_parser().parse_args(commands[0][commands[0].index("render") :])
    given = {name: value for name, value in vars(worker).items() if "raytrace_" in name}
    assert worker.method == "raytrace" and given == {
        "raytrace_cones": "4",
        "raytrace_footprint": "2",
        "raytrace_secondary": "rays",
        "raytrace_visibility": "alpha",
        "raytrace_keep_sets": False,
    }


def test_options_change_the_image(blend, tmp_path):
    """Camera and frame are those asked for: the depth of what is seen moves to the side."""

    def seen(*options):
        assert main(["render", str(blend), "-o", str(tmp_path / "a.exr"), *SMALL, *options]) == 0
        return exr.read(tmp_path / "a.exr")["object_index"][..., 0] == 5.0

    left, right, later = seen(), seen("--camera", "Right"), seen("-f", "4")
    column = np.arange(24)
    assert (left * column).sum() / left.sum() > (right * column).sum() / right.sum() + 2
    assert (later * column).sum() / later.sum() > (left * column).sum() / left.sum()


def test_scripts_run_only_when_asked_for(blend, tmp_path):
    marker = blend.parent / "script ran"
    assert main(["render", str(blend), "-o", str(tmp_path / "a.exr"), *SMALL, "--scripts"]) == 0
    assert marker.exists()
    marker.unlink()
    assert main(["info", str(blend)]) == 0
    assert not marker.exists()


def test_existing_frames_are_kept(blend, tmp_path, capfd):
    pattern = str(tmp_path / "f_####.exr")
    assert main(["render", str(blend), "-o", pattern, *SMALL, "-f", "2"]) == 0
    kept = (tmp_path / "f_0002.exr").stat().st_mtime_ns
    capfd.readouterr()
    assert main(["render", str(blend), "-o", pattern, *SMALL, "-f", "1-3", "--keep-existing"]) == 0
    out, _ = capfd.readouterr()
    assert files_in(tmp_path) == ["f_0001.exr", "f_0002.exr", "f_0003.exr"]
    assert (tmp_path / "f_0002.exr").stat().st_mtime_ns == kept
    assert "kept 1 frame" in out and "frame 1:" in out and "frame 3:" in out and "frame 2:" not in out
    assert main(["render", str(blend), "-o", pattern, *SMALL, "-f", "1-3", "--keep-existing"]) == 0
    assert "kept 3 frames" in capfd.readouterr()[0]


def test_processes_render_the_same_images(blend, tmp_path):
    """Two processes, each with a frame: files as from one process, bit for bit."""
    options = ["--size", "24x16", "--method", "distributed", "--samples", "4", "-f", "1,3"]
    assert main(["render", str(blend), "-o", str(tmp_path / "one.exr"), *options]) == 0
    stats = tmp_path / "stats.json"
    command = [
        "render",
        str(blend),
        "-o",
        str(tmp_path / "two.exr"),
        *options,
        "--jobs",
        "2",
        "--stats",
        str(stats),
    ]
    assert main(command) == 0
    for frame in ("0001", "0003"):
        one, two = exr.read(tmp_path / f"one_{frame}.exr"), exr.read(tmp_path / f"two_{frame}.exr")
        assert set(one) == set(two) and all(np.array_equal(one[k], two[k]) for k in one)
    assert [f["frame"] for f in json.loads(stats.read_text())["frames"]] == [1, 3]


@pytest.mark.parametrize(
    "arguments, code, words",
    [
        (["render", "missing.blend"], 2, "no such file: missing.blend"),
        (["render", __file__], 2, "not a .blend file"),
        (["info", "missing.blend"], 2, "no such file: missing.blend"),
        (["render", "BLEND", "--camera", "Nobody"], 2, "no camera 'Nobody'; there are: Left, Right"),
        (
            ["render", "BLEND", "--method", "forward", "--forward-strategy", "grid"],
            2,
            "no forward-strategy 'grid'; there are: random, jittered_grid, quantised_grid, neighbourhood",
        ),
        (
            ["render", "BLEND", "--method", "forward", "--forward-samples-per-pixel", "65"],
            2,
            "--forward-samples-per-pixel: 65 is outside 0.05 to 64",
        ),
        (["render", "BLEND", "--method", "forward", "--forward-epsilon", "x"], 2, "'x' is not a number"),
        (["render", "BLEND", "--method", "forward", "--forward-failure", "nan"], 2, "nan is outside"),
        (["render", "BLEND", "--method", "forward", "--samples", "100"], 2, "--samples: 100 is outside 0.05"),
        (
            ["render", "BLEND", "--method", "conventional", "--no-forward-shadows"],
            2,
            "--forward-shadows is of method forward, not conventional",
        ),
        (
            ["render", "BLEND", "--method", "magic"],
            2,
            "no method 'magic'; there are: raytrace, conventional, distributed",
        ),
        (
            ["render", "BLEND", "--method", "raytrace", "--cones", "3"],
            2,
            "no cones '3'; there are: 1, 4, 16, 64",
        ),
        (
            ["render", "BLEND", "--method", "raytrace", "--footprint", "5"],
            2,
            "--footprint: 5 is outside 0.25 to 4",
        ),
        (["render", "BLEND", "--method", "raytrace", "--footprint", "nan"], 2, "--footprint: nan is outside"),
        (
            ["render", "BLEND", "--method", "raytrace", "--footprint", "x"],
            2,
            "--footprint: 'x' is not a number",
        ),
        (
            ["render", "BLEND", "--method", "raytrace", "--secondary", "beams"],
            2,
            "no secondary 'beams'; there are: cones, rays",
        ),
        (
            ["render", "BLEND", "--method", "forward", "--cones", "4"],
            2,
            "--cones is of method raytrace, not forward",
        ),
        (["render", "BLEND", "--method", "raytrace", "--samples", "64"], 2, "which takes --cones"),
        (["render", "BLIND"], 2, "has no camera; choose one with --camera: Left, Right"),
        (["render", "BLEND", "-o", "TMP/file/a.exr"], 3, "file/a.exr"),
        (["render", "BLEND", "--stats", "TMP/file/a.json"], 3, "file/a.json"),
        (["render", "BLEND", "-f", "1-4", "--part", "5/4"], 2, "K/N"),
        (["render", "TMP/broken.blend"], 2, "Blender cannot open"),
        (["render", "BLIND", "-f", "1-4", "--jobs", "2"], 1, "has no camera"),
    ],
)
def test_errors_are_named_and_nothing_is_left(arguments, code, words, blend, tmp_path, capfd):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "broken.blend").write_bytes(blend.read_bytes()[:2000])
    before = files_in(tmp_path)
    paths = {"BLEND": str(blend), "BLIND": str(blend.with_name("blind.blend"))}
    arguments = [paths.get(a, a).replace("TMP", str(tmp_path)) for a in arguments]
    if "-o" not in arguments and arguments[0] == "render":
        arguments += ["-o", str(tmp_path / "a.exr")]
    assert main(arguments) == code
    err = capfd.readouterr()[1]
    assert words in err and "Traceback" not in err
    assert files_in(tmp_path) == before


@pytest.mark.parametrize(
    "arguments", [["--size", "10"], ["--samples", "0"], ["-f", "9-1"], ["--threads", "-1"], []]
)
def test_the_grammar_refuses(arguments, blend):
    with pytest.raises(SystemExit) as error:
        main(["render", str(blend), *arguments] if arguments else [])
    assert error.value.code == 2


def test_ctrl_c_leaves_nothing(blend, tmp_path):
    """Interrupted in mid-render: at once, exit code 130, no file."""
    command = [sys.executable, "-m", "blender_addon.cli", "render", str(blend), "-o", str(tmp_path / "a.exr")]
    command += ["--size", "1600x1200", "--method", "distributed", "--samples", "16000"]
    process = subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, bufsize=0
    )
    try:
        os.set_blocking(process.stderr.fileno(), False)
        end = time.monotonic() + 120
        told = b""
        while b"scene" not in told and time.monotonic() < end and process.poll() is None:
            told += process.stderr.read() or b""
            time.sleep(0.05)
        assert process.poll() is None, told.decode()
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
    finally:
        process.kill()
    assert files_in(tmp_path) == []


def test_a_dead_worker_takes_only_its_frame(tmp_path):
    """Workers that crash are replaced; what was not JSON is ignored; an error that stops one frame stops no other."""
    script = tmp_path / "worker.py"
    script.write_text(
        "import sys, os, json\n"
        "for line in sys.stdin:\n"
        "    f = int(line)\n"
        "    if f in (2, 5): os._exit(9)\n"
        "    print('noise', flush=True)\n"
        "    kind = 'failed' if f == 3 else 'done'\n"
        "    print(json.dumps({'event': kind, 'frame': f, 'error': 'bad mesh'}), flush=True)\n"
    )
    events = []
    done, failed = batch.render_frames([sys.executable, str(script)], range(1, 8), 2, events.append)
    assert done == [1, 4, 6, 7] and failed == [2, 3, 5]
    reasons = {e["frame"]: e["error"] for e in events if e["event"] == "failed"}
    assert "code 9" in reasons[2] and "code 9" in reasons[5] and reasons[3] == "bad mesh"


def test_info_counts(blend, capfd):
    assert main(["info", str(blend)]) == 0
    out = capfd.readouterr()[0]
    assert "12 unique, 48 instanced" in out and "camera: Left" in out and "1 sun" in out and "grey" in out
    assert main(["info", str(blend.with_name("blind.blend")), "--json"]) == 0
    facts = json.loads(capfd.readouterr()[0])
    assert facts["camera"] is None and facts["unique_triangles"] == 12 and facts["instanced_triangles"] == 48
    assert facts["lights"] == {"sun": 1} and facts["materials"] == ["grey"]
