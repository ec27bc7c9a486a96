"""The film: averages, exposure, alpha, unfiltered passes, what is not finite, and the pixel filter as Cycles has it."""

import numpy as np
import pytest

from pointmr_engine.image.film import Film, add_averages, add_light, clamp_light, write_first, write_nothing
from pointmr_engine.image.frame import NOTHING
from pointmr_engine.scene.settings import PASSES, RenderSettings


def settings(**values) -> RenderSettings:
    return RenderSettings(**{"width": 7, "height": 5, "passes": PASSES, **values})


def test_averages_exposure_and_alpha():
    film = Film(settings(film_exposure=2.0))
    tile = film.tile((0, 0, 7, 5))
    pixel = np.array([0, 0, 0, 0, 34], np.int32)
    radiance = np.array([(1, 2, 3), (3, 2, 1), (0, 0, 0), (0, 0, 0), (5, 5, 5)], np.float32)
    transparency = np.array([0, 0.5, 1, 1, 0], np.float32)
    add_light(tile, pixel, radiance, transparency, 0, 5)
    add_averages(tile.emission, pixel, radiance, 0, 5)
    add_averages(tile.diffuse_color, pixel, radiance, 0, 5)
    add_averages(tile.normal, pixel[:2], np.array([(0, 0, 1), (0, 0.6, 0.8)]), 0, 2)
    film.finish_tile(tile)
    frame = film.result()
    assert np.allclose(frame.passes["combined"][0, 0], (2, 2, 2, 0.375))  # exposure leaves alpha alone
    assert np.allclose(frame.passes["combined"][4, 6], (10, 10, 10, 1))
    assert np.allclose(frame.passes["emission"][0, 0], (2, 2, 2))
    assert np.allclose(frame.passes["diffuse_color"][0, 0], (1, 1, 1))  # no exposure on data
    assert np.allclose(frame.passes["normal"][0, 0], (0, 0.15, 0.45))  # of four samples, two saw nothing
    assert frame.passes["sample_count"][0, 0, 0] == 4 and frame.passes["sample_count"][2, 2, 0] == 0
    assert (frame.passes["depth"] == np.float32(NOTHING)).all()
    assert (frame.width, frame.height) == (7, 5) and frame.stats["bad_samples"] == 0 and not frame.warnings


def test_unfiltered_passes_take_the_last_word_of_sample_zero():
    film = Film(settings())
    tile = film.tile((0, 0, 7, 5))
    pixel = np.array([0, 1, 2], np.int32)
    depth, position = np.array([1.0, 2.0, 3.0]), np.arange(9.0).reshape(3, 3)
    index = np.array([7, 8, 9], np.int32)
    write_first(tile, pixel, depth, position, index, index + 10, 0, 3)
    # seen through a transparent surface
    write_first(tile, pixel, depth + 1, position + 1, index, index + 10, 1, 2)
    write_nothing(tile, pixel, 2, 3)  # the background, seen through one
    add_light(tile, pixel, np.zeros((3, 3)), np.zeros(3), 0, 3)
    film.finish_tile(tile)
    passes = film.result().passes
    assert passes["depth"][0, :3, 0].tolist() == [1.0, 3.0, np.float32(NOTHING)]
    assert passes["object_index"][0, :3, 0].tolist() == [7.0, 8.0, 0.0]
    assert passes["material_index"][0, :3, 0].tolist() == [17.0, 18.0, 0.0]
    assert passes["position"][0, :3].tolist() == [[0, 1, 2], [4, 5, 6], [0, 0, 0]]


def test_nothing_that_is_not_finite_reaches_the_image():
    film = Film(settings())
    tile = film.tile((0, 0, 7, 5))
    pixel = np.zeros(5, np.int32)
    radiance = np.array([(1, 1, 1), (np.nan, 0, 0), (0, np.inf, 0), (3, 3, 3), (1, 1, 1)])
    add_light(tile, pixel, radiance, np.array([0, 0, 0, 0, np.nan]), 0, 5)
    add_averages(tile.normal, pixel, radiance, 0, 5)
    add_light(tile, np.array([1], np.int32), np.array([(1e300, 0, 0)]), np.zeros(1), 0, 1)
    write_first(tile, pixel, radiance[:, 0], radiance, pixel, pixel, 1, 2)
    film.finish_tile(tile)
    frame = film.result()
    for name, pixels in frame.passes.items():
        assert np.isfinite(pixels).all(), name
    assert np.allclose(frame.passes["combined"][0, 0], (0.8, 0.8, 0.8, 0.4))
    assert frame.stats["bad_samples"] == 3 and "3 samples" in frame.warnings[0]


@pytest.mark.parametrize("region", [None, (2, 1, 6, 5)])
def test_tiles_cover_the_region_once_in_any_order(region):
    film = Film(settings(region=region, passes=("combined", "depth")))
    x0, y0, x1, y1 = region or (0, 0, 7, 5)
    tiles = film.tiles(3)
    seen = np.zeros((5, 7), int)
    for bounds in reversed(tiles):
        left, low, right, high = bounds
        assert 0 < right - left <= 3 and 0 < high - low <= 3
        seen[low:high, left:right] += 1
        tile = film.tile(bounds)
        assert len(tile.normal) == 0 and len(tile.position) == 0  # not asked for, not stored
        y, x = np.mgrid[low:high, left:right]
        n = x.size
        value = np.stack([x.ravel(), y.ravel(), np.ones(n)], 1).astype(np.float64)
        add_light(tile, np.arange(n, dtype=np.int32), value, np.zeros(n), 0, n)
        add_averages(tile.normal, np.arange(n, dtype=np.int32), value, 0, n)
        film.finish_tile(tile)
    assert (seen[y0:y1, x0:x1] == 1).all() and seen.sum() == (x1 - x0) * (y1 - y0)
    frame = film.result()
    assert (frame.width, frame.height) == (x1 - x0, y1 - y0)
    assert np.array_equal(frame.passes["combined"][..., 0], np.tile(np.arange(x0, x1), (y1 - y0, 1)))
    whole = frame.whole().passes
    assert whole["combined"].shape == (5, 7, 4)
    assert np.array_equal(
        whole["combined"][y0:y1, x0:x1, 1], np.tile(np.arange(y0, y1)[:, None], (1, x1 - x0))
    )
    assert tiles[0][3] == y1  # the top of the image comes first


def test_clamp():
    assert clamp_light(3.0, 0.0, 0.0, 0.0) == (3.0, 0.0, 0.0)
    assert clamp_light(1.0, 1.0, 1.0, 1.0) == (1.0, 1.0, 1.0)
    assert np.allclose(clamp_light(6.0, 3.0, 3.0, 1.0), (1.5, 0.75, 0.75))


@pytest.mark.parametrize("kind, width", [("box", 3.0), ("gaussian", 2.0), ("blackman_harris", 1.5)])
def test_pixel_filter_is_cycles(kind, width, tmp_path):
    """A bright strip a fraction of a pixel wide spreads over its neighbours as it does in Cycles."""
    bpy = pytest.importorskip("bpy")
    from pointmr_engine.image import exr
    from pointmr_engine.image.filters import filter_offset, filter_table

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = 4096, False, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = kind.upper(), width
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 11, 3, 100
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 11.0
    camera.location = (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    mesh = bpy.data.meshes.new("strip")
    left, right = 0.2, 0.45  # metres are pixels; the image's centre is the middle of pixel 5
    mesh.from_pydata([(left, -9, 0), (right, -9, 0), (right, 9, 0), (left, 9, 0)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("light")
    if not material.node_tree:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    light, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(light.outputs[0], output.inputs[0])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("strip", mesh))
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.filepath = str(tmp_path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    theirs = exr.read(tmp_path / "cycles.exr")["combined"][..., 0].mean(0)

    table = filter_table(kind, width)
    offsets = np.array([filter_offset(table, (i + 0.5) / 20000) for i in range(20000)])
    ours = [np.mean((offsets + x - 5 >= left) & (offsets + x - 5 < right)) for x in range(11)]
    assert theirs.max() > 0.1
    assert np.abs(np.array(ours) - theirs).max() < 4e-3
