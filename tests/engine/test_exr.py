"""Image files: multilayer EXR as Blender writes and reads it, PNG, and failures that leave nothing behind."""

import numpy as np
import pytest

from pointmr_engine.image import exr, png
from pointmr_engine.image.frame import CHANNELS, NOTHING, Frame
from pointmr_engine.scene.errors import SceneError


@pytest.fixture
def frame() -> Frame:
    rng = np.random.default_rng(5)
    h, w = 6, 9
    passes = {name: rng.random((h, w, c), np.float32) for name, c in CHANNELS.items()}
    passes["depth"][2, 3] = NOTHING
    passes["combined"][0, 0, :3] = 1e6
    return Frame(w, h, passes)


def test_round_trip_is_exact(frame, tmp_path):
    exr.write(tmp_path / "a.exr", frame, pixel_aspect=2.0, metadata={"pointmr.samples": "64"})
    back = exr.read(tmp_path / "a.exr")
    assert list(back) == list(frame.passes)
    for name, pixels in frame.passes.items():
        assert back[name].dtype == np.float32 and np.array_equal(back[name], pixels), name


def test_half_rounds_colours_only(frame, tmp_path):
    exr.write(tmp_path / "a.exr", frame, half=True)
    back = exr.read(tmp_path / "a.exr")
    assert np.array_equal(back["position"], frame.passes["position"])
    assert back["combined"][0, 0, 0] == 65504.0
    assert np.allclose(back["combined"][1:], frame.passes["combined"][1:], atol=1e-3)
    assert not np.array_equal(back["combined"][1:], frame.passes["combined"][1:])


def test_region_is_set_into_the_whole_image(frame, tmp_path):
    frame.region, frame.full_width, frame.full_height = (2, 1, 11, 7), 16, 8
    exr.write(tmp_path / "a.exr", frame)
    back = exr.read(tmp_path / "a.exr")
    assert back["depth"].shape == (8, 16, 1) and back["depth"][0, 0, 0] == NOTHING
    assert np.array_equal(back["position"][1:7, 2:11], frame.passes["position"])
    assert back["combined"][7].max() == 0.0


def test_layers_keep_apart(frame, tmp_path):
    other = Frame(9, 6, {"combined": frame.passes["combined"] * 0.5})
    exr.write(tmp_path / "a.exr", {"ViewLayer": frame, "Fore.ground": other})
    back = exr.read(tmp_path / "a.exr")
    assert np.array_equal(back["Fore.ground.combined"], other.passes["combined"])
    assert np.array_equal(back["combined"], frame.passes["combined"])


def blender_passes(bpy):
    layer = bpy.context.view_layer
    for name in ("z", "position", "normal", "object_index", "material_index", "diffuse_color", "emit"):
        setattr(layer, f"use_pass_{name}", True)
    layer.cycles.pass_debug_sample_count = True


@pytest.mark.parametrize("interleave", [False, True])
def test_names_and_values_are_blenders(interleave, tmp_path):
    """A file that Blender wrote has our channels, and reads as its render result; the first row is the bottom."""
    bpy = pytest.importorskip("bpy")
    OpenEXR = pytest.importorskip("OpenEXR")
    bpy.ops.wm.read_factory_settings()
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 20, 12, 100
    bpy.data.objects["Cube"].pass_index = 7
    blender_passes(bpy)
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.use_exr_interleave = "OPEN_EXR_MULTILAYER", "32", interleave
    scene.render.filepath = str(tmp_path / "blender.exr")
    bpy.ops.render.render(write_still=True)

    theirs = exr.read(tmp_path / "blender.exr")
    assert set(theirs) == set(CHANNELS)
    depth = theirs["depth"][..., 0]
    assert (depth == np.float32(NOTHING)).any() and (depth < 20).any()
    hit = depth < 20
    assert (theirs["object_index"][..., 0][hit] == 7).all() and theirs["object_index"][..., 0][
        ~hit
    ].max() == 0
    up = theirs["position"][..., 2]
    assert up[np.nonzero(hit.any(1))[0][-1]].max() > up[np.nonzero(hit.any(1))[0][0]].max()

    exr.write(tmp_path / "ours.exr", Frame(20, 12, theirs))
    names = []
    for path in (tmp_path / "blender.exr", tmp_path / "ours.exr"):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            names.append(sorted(c for part in file.parts for c in part.channels))
    assert names[0] == names[1]


def test_blender_loads_our_layers(frame, tmp_path):
    """Blender's compositor offers every pass of our file, and reads its numbers."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    exr.write(tmp_path / "ours.exr", frame)
    scene = bpy.context.scene
    tree = bpy.data.node_groups.new("read", "CompositorNodeTree")
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(tmp_path / "ours.exr"))
    assert node.has_layers
    names = {name for name, _, _ in exr.PASSES.values()}
    assert names <= {socket.name for socket in node.outputs}
    if not hasattr(scene, "compositing_node_group"):
        pytest.skip("this Blender's compositor has no node groups")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    output = tree.nodes.new("NodeGroupOutput")
    scene.compositing_node_group = tree
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 9, 6, 100
    image = scene.render.image_settings
    image.media_type = "IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    for key in ("combined", "depth", "position", "object_index"):
        tree.links.new(node.outputs[exr.PASSES[key][0]], output.inputs[0])
        scene.render.filepath = str(tmp_path / "through_blender.exr")
        bpy.ops.render.render(write_still=True)
        back = exr.read(tmp_path / "through_blender.exr")["combined"]
        channels = min(frame.passes[key].shape[2], 3)
        assert np.array_equal(back[..., :channels], frame.passes[key][..., :channels]), key


@pytest.mark.parametrize("write", [exr.write, png.write])
def test_unwritable_paths_are_named_and_leave_nothing(write, frame, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "folder").mkdir()
    before = sorted(p.name for p in tmp_path.rglob("*"))
    for path in (tmp_path / "file" / "a.exr", tmp_path / "folder"):
        with pytest.raises(SceneError) as error:
            write(path, frame)
        assert str(path) in str(error.value)
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


@pytest.mark.parametrize("write", [exr.write, png.write])
def test_a_failure_in_mid_write_keeps_the_old_file(write, frame, tmp_path, monkeypatch):
    path = tmp_path / "a.img"
    write(path, frame)
    old = path.read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pointmr_engine.image.files.os.replace", fail)
    with pytest.raises(SceneError, match="No space left"):
        write(path, frame)
    assert path.read_bytes() == old and [p.name for p in tmp_path.iterdir()] == ["a.img"]


def test_unreadable_files_are_named(tmp_path):
    (tmp_path / "text.exr").write_text("this is no image")
    for name in ("missing.exr", "text.exr"):
        with pytest.raises(SceneError, match=name):
            exr.read(tmp_path / name)


def test_png_is_blenders_standard_view(tmp_path):
    """Bytes as Blender saves them from the same linear pixels, dithering off; alpha unassociated, top row first."""
    bpy = pytest.importorskip("bpy")
    from PIL import Image

    rng = np.random.default_rng(2)
    combined = rng.random((8, 16, 4), np.float32) ** 2
    combined[..., :3] *= combined[..., 3:]
    combined[0, 0] = (4.0, -1.0, 0.5, 1.0)
    png.write(tmp_path / "ours.png", Frame(16, 8, {"combined": combined}))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.view_settings.view_transform = "Standard"
    image = bpy.data.images.new("linear", 16, 8, alpha=True, float_buffer=True)
    image.alpha_mode = "PREMUL"
    image.pixels.foreach_set(combined.ravel())
    settings = bpy.context.scene.render.image_settings
    settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode = "PNG", "RGBA"
    image.save_render(str(tmp_path / "blender.png"))
    ours, theirs = (np.asarray(Image.open(tmp_path / n)).astype(int) for n in ("ours.png", "blender.png"))
    assert ours.shape == theirs.shape == (8, 16, 4)
    visible = theirs[..., 3] > 8
    assert np.abs(ours - theirs)[visible].max() <= 1
