"""Camera rays: against their own definition, and against what Cycles sees through the same camera."""

import math

import numpy as np
import pytest

from pointmr_engine.image.filters import TABLE_SIZE
from pointmr_engine.numerics.rng import sobol_tables
from pointmr_engine.raytracing.camera import (
    compile_camera,
    generate_rays,
    sample_rays,
    view_depth,
    window_coordinates,
)
from pointmr_engine.raytracing.rays import allocate_rays
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.settings import RenderSettings


def look(location, angles) -> np.ndarray:
    """world_from_camera for a location and Blender's XYZ Euler angles in degrees."""
    x, y, z = np.radians(angles)
    rx = np.array([[1, 0, 0], [0, math.cos(x), -math.sin(x)], [0, math.sin(x), math.cos(x)]])
    ry = np.array([[math.cos(y), 0, math.sin(y)], [0, 1, 0], [-math.sin(y), 0, math.cos(y)]])
    rz = np.array([[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]])
    m = np.eye(4)
    m[:3, :3] = rz @ ry @ rx
    m[:3, 3] = location
    return m


def rays_of(camera: Camera, settings: RenderSettings, x, y, u=None):
    compiled = compile_camera(camera, settings)
    n = len(x)
    rays, width, spread = allocate_rays(n), np.empty(n, np.float32), np.empty(n, np.float32)
    u = np.full((n, 4), 0.5) if u is None else u
    generate_rays(compiled, np.asarray(x, np.int32), np.asarray(y, np.int32), u, rays, width, spread, 0, n)
    return compiled, rays, width, spread


SETTINGS = RenderSettings(width=16, height=12, pixel_filter="box")
CAMERAS = {
    "plain": dict(),
    "long lens": dict(focal_length=135.0, shift_x=0.2, shift_y=-0.1),
    "vertical fit": dict(sensor_fit="VERTICAL", sensor_height=20.0, shift_x=0.1),
    "horizontal fit": dict(sensor_fit="HORIZONTAL", sensor_width=20.0, shift_y=0.15),
    "mirrored and scaled": dict(mirror=(-2.0, 1.0, 1.5)),
    "orthographic": dict(kind="ORTHOGRAPHIC", ortho_scale=4.0, shift_x=0.1, shift_y=0.05),
    "orthographic, vertical fit": dict(kind="ORTHOGRAPHIC", ortho_scale=4.0, sensor_fit="VERTICAL"),
}
IMAGES = {
    "wide": (16, 12, 1.0),
    "tall": (10, 14, 1.0),
    "wide pixels": (10, 14, 2.0),
    "high pixels": (16, 12, 0.5),
}


def make_camera(values: dict) -> Camera:
    values = dict(values)
    m = look((1.0, -6.0, 2.5), (72.0, 3.0, 11.0))
    m[:3, :3] = m[:3, :3] @ np.diag(values.pop("mirror", (1.0, 1.0, 1.0)))
    return Camera(world_from_camera=m, **values)


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("kind", CAMERAS)
def test_rays_pass_through_their_pixels(kind, image):
    """A point anywhere on a pixel's ray has that pixel's window coordinates; the depth grows as the ray's z does."""
    width, height, aspect = IMAGES[image]
    settings = RenderSettings(width=width, height=height, pixel_aspect=aspect, pixel_filter="box")
    x, y = (a.ravel() for a in np.meshgrid(np.arange(width), np.arange(height)))
    compiled, rays, _, _ = rays_of(make_camera(CAMERAS[kind]), settings, x, y)
    assert np.allclose(np.linalg.norm(rays.direction, axis=1), 1.0)
    for t in (0.0, 3.0, 500.0):
        window = window_coordinates(compiled, rays.origin + t * rays.direction)
        assert np.allclose(window * (width, height), np.stack([x + 0.5, y + 0.5], 1), atol=1e-4)
    assert np.allclose([view_depth(compiled, p) for p in rays.origin], 0.1)
    ends = rays.origin + rays.t_max[:, None] * rays.direction
    assert np.allclose([view_depth(compiled, p) for p in ends], 1000.0)


def test_footprint_covers_one_pixel():
    """Width and spread give the pixel's area across the ray, from the centre to the corner of a wide view."""
    settings = RenderSettings(width=64, height=48, pixel_filter="box")
    x, y = np.array([31, 0, 63, 63, 40]), np.array([23, 0, 47, 10, 2])
    compiled, rays, width, spread = rays_of(Camera(focal_length=18.0), settings, x, y)
    d = 1e-3
    u_step = (d * (TABLE_SIZE - 1)) / (TABLE_SIZE - 1)  # a box filter: u is the position in the pixel
    u = np.full((5, 4), 0.5)
    u[:, 0] += u_step
    _, right, _, _ = rays_of(Camera(focal_length=18.0), settings, x, y, u)
    u = np.full((5, 4), 0.5)
    u[:, 1] += u_step
    _, up, _, _ = rays_of(Camera(focal_length=18.0), settings, x, y, u)
    area = (
        np.linalg.norm(np.cross(right.direction - rays.direction, up.direction - rays.direction), axis=1)
        / d**2
    )
    assert np.allclose(spread, np.sqrt(area), rtol=2e-3)
    start = np.linalg.norm(rays.origin, axis=1)
    assert np.allclose(width, start * spread, rtol=1e-5)


def test_lens_keeps_the_focus_plane_sharp():
    camera = Camera(fstop=1.4, focus_distance=3.0, blades=6, blade_rotation=0.3, aperture_ratio=2.0)
    n = 4096
    rng = np.random.default_rng(0)
    u = np.concatenate([np.full((n, 2), 0.5), rng.random((n, 2))], 1)
    x, y = np.full(n, 3), np.full(n, 9)
    compiled, rays, _, _ = rays_of(camera, SETTINGS, x, y, u)
    t = (3.0 - 0.1) / -rays.direction[:, 2]
    start_depth = -rays.origin[:, 2]
    t = (3.0 - start_depth) / -rays.direction[:, 2]
    focus = rays.origin + t[:, None] * rays.direction
    assert np.ptp(focus, axis=0).max() < 1e-9
    lens = rays.origin + (start_depth / rays.direction[:, 2])[:, None] * rays.direction
    radius = 0.05 / 2.8
    assert np.ptp(lens[:, 1]) > 1.6 * radius and np.abs(lens[:, 1]).max() <= radius * (1 + 1e-9)
    assert np.abs(lens[:, 0]).max() <= 0.5 * radius * (1 + 1e-9)  # the ratio squeezes x
    # uniform over the hexagon: mean of the squared distance of a regular polygon, after undoing the squeeze
    px, py = 2.0 * lens[:, 0] / radius, lens[:, 1] / radius
    expected = (2.0 + math.cos(2 * math.pi / 6)) / 6.0
    assert np.isclose(np.mean(px**2 + py**2), expected, rtol=0.03)
    closed = compile_camera(camera, RenderSettings(width=16, height=12, method="conventional"))
    assert closed.lens[0] == 0.0


def test_sample_zero_is_the_centre_and_seeds_differ():
    compiled = compile_camera(Camera(), RenderSettings(width=16, height=12, filter_width=1.5))
    n = 512
    rays, width, spread = allocate_rays(n), np.empty(n, np.float32), np.empty(n, np.float32)
    seeds = np.zeros(n, np.uint32)
    x, y, sample = np.full(n, 5, np.int32), np.full(n, 7, np.int32), np.arange(n, dtype=np.int32)
    sample_rays(compiled, sobol_tables(), 3, x, y, sample, rays, seeds, width, spread, 0, n)
    window = window_coordinates(compiled, rays.origin + 5.0 * rays.direction) * (16, 12)
    assert np.allclose(window[0], (5.5, 7.5), atol=1e-4)
    offset = window[1:] - (5.5, 7.5)
    assert np.abs(offset).max() <= 1.5 + 1e-4 and np.abs(offset.mean(0)).max() < 0.02
    first = rays.direction.copy()
    sample_rays(compiled, sobol_tables(), 4, x, y, sample, rays, seeds, width, spread, 0, n)
    assert not np.allclose(first[1:], rays.direction[1:])


@pytest.mark.parametrize(
    "values, word",
    [
        (dict(kind="PANORAMIC"), "PANORAMIC"),
        (dict(focal_length=0.0), "focal_length"),
        (dict(clip_start=5.0, clip_end=1.0), "clip range"),
        (dict(world_from_camera=np.zeros((4, 4))), "singular"),
        (dict(world_from_camera=np.full((4, 4), np.nan)), "finite"),
        (dict(fstop=2.0, focus_distance=0.0), "focus distance"),
    ],
)
def test_bad_cameras_are_named(values, word):
    with pytest.raises(SceneError, match=word) as error:
        compile_camera(Camera(name="Shot 7", **values), SETTINGS)
    assert "Shot 7" in str(error.value)


# --- against Cycles -------------------------------------------------------------------------------------------------


def cycles_scene(bpy, camera: Camera, width: int, height: int, aspect: float, samples: int = 1):
    """An empty Blender scene with the same camera, for Cycles with a box filter."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = (
        samples,
        False,
        False,
    )
    scene.cycles.pixel_filter_type = "BOX"
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = max(aspect, 1.0), max(1.0 / aspect, 1.0)
    data = bpy.data.cameras.new("Camera")
    data.type = {"PERSPECTIVE": "PERSP", "ORTHOGRAPHIC": "ORTHO"}[camera.kind]
    data.lens, data.sensor_width, data.sensor_height = (
        camera.focal_length,
        camera.sensor_width,
        camera.sensor_height,
    )
    data.sensor_fit, data.ortho_scale = camera.sensor_fit, camera.ortho_scale
    data.shift_x, data.shift_y = camera.shift_x, camera.shift_y
    data.clip_start, data.clip_end = camera.clip_start, camera.clip_end
    if camera.fstop > 0.0:
        dof = data.dof
        dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, camera.fstop, camera.focus_distance
        dof.aperture_blades, dof.aperture_rotation = camera.blades, camera.blade_rotation
        dof.aperture_ratio = camera.aperture_ratio
    ob = bpy.data.objects.new("Camera", data)
    from mathutils import Matrix

    ob.matrix_world = Matrix(camera.world_from_camera.tolist())
    scene.collection.objects.link(ob)
    scene.camera = ob
    return scene


def render_passes(bpy, tmp_path, names) -> dict[str, np.ndarray]:
    """Render with Cycles and read passes (height, width, channels), bottom row first."""
    import OpenEXR

    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_position = True
    image = bpy.context.scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.use_exr_interleave = "OPEN_EXR_MULTILAYER", "32", True
    bpy.context.scene.render.filepath = str(tmp_path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(tmp_path / "cycles.exr"), separate_channels=True) as file:
        channels = {k: c.pixels for part in file.parts for k, c in part.channels.items()}
    return {
        name: np.stack([channels[f"ViewLayer.{name}.{c}"] for c in letters], -1)[::-1]
        for name, letters in names.items()
    }


def add_mesh(bpy, positions, faces):
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata([tuple(map(float, p)) for p in positions], [], faces)
    ob = bpy.data.objects.new("mesh", mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


@pytest.mark.parametrize("kind", CAMERAS)
def test_cycles_sees_the_same_pixels(kind, tmp_path):
    """Cycles' position pass, projected by our camera, lies in the pixel's centre, and its depth is ours."""
    bpy = pytest.importorskip("bpy")
    camera = make_camera(CAMERAS[kind])
    for width, height, aspect in IMAGES.values():
        cycles_scene(bpy, camera, width, height, aspect)
        add_mesh(bpy, [(-90, 30, -90), (90, 45, -90), (80, 60, 90), (-90, 25, 90)], [(0, 1, 2, 3)])
        passes = render_passes(bpy, tmp_path, {"Depth": "Z", "Position": "XYZ"})
        compiled = compile_camera(camera, RenderSettings(width=width, height=height, pixel_aspect=aspect))
        depth, position = passes["Depth"][..., 0].ravel(), passes["Position"].reshape(-1, 3)
        assert (depth < 1e9).all()
        x, y = (a.ravel() for a in np.meshgrid(np.arange(width), np.arange(height)))
        window = window_coordinates(compiled, position) * (width, height)
        assert np.abs(window - np.stack([x + 0.5, y + 0.5], 1)).max() < 5e-3
        assert np.allclose([view_depth(compiled, p) for p in position.astype(np.float64)], depth, rtol=1e-4)


@pytest.mark.parametrize("kind", ["plain", "orthographic"])
def test_cycles_clips_where_we_do(kind, tmp_path):
    """Of walls at many depths, Cycles shows the first behind the near plane, and none behind the far one."""
    bpy = pytest.importorskip("bpy")
    camera = make_camera({**CAMERAS[kind], "clip_start": 2.0, "clip_end": 7.0})
    cycles_scene(bpy, camera, 16, 12, 1.0)
    m = camera.world_from_camera
    depths = np.array([0.5, 1.9, 2.1, 3.9, 4.1, 6.9])
    for d in depths:
        corners = np.array([(-50, -50, -d, 1), (50, -50, -d, 1), (50, 50, -d, 1), (-50, 50, -d, 1)]) @ m.T
        add_mesh(bpy, corners[:, :3], [(0, 1, 2, 3)])
    depth = render_passes(bpy, tmp_path, {"Depth": "Z"})["Depth"]
    assert np.allclose(depth, 2.1, atol=1e-3)
    for ob in [o for o in bpy.data.objects if o.type == "MESH"][2:]:
        bpy.data.objects.remove(ob)
    corners = np.array([(-50, -50, -7.1, 1), (50, -50, -7.1, 1), (50, 50, -7.1, 1), (-50, 50, -7.1, 1)]) @ m.T
    add_mesh(bpy, corners[:, :3], [(0, 1, 2, 3)])
    depth = render_passes(bpy, tmp_path, {"Depth": "Z"})["Depth"]
    assert (depth == np.float32(1e10)).all()


@pytest.mark.parametrize(
    "values",
    [
        dict(fstop=0.25, focus_distance=2.0, blades=5, blade_rotation=0.35, aperture_ratio=1.6),
        dict(fstop=0.1, focus_distance=8.0, blades=0, aperture_ratio=0.7),
        dict(
            fstop=0.2, focus_distance=3.0, blades=3, blade_rotation=-0.2, kind="ORTHOGRAPHIC", ortho_scale=4.0
        ),
    ],
    ids=["near focus, five blades", "far focus, round", "orthographic, three blades"],
)
def test_bokeh_is_cycles(values, tmp_path):
    """A small bright square out of focus draws the same blur disc, in size, shape, place and brightness."""
    bpy = pytest.importorskip("bpy")
    camera = make_camera({"focal_length": 80.0, **values})
    n, side, depth = 32, 0.15, 4.0
    scene = cycles_scene(bpy, camera, n, n, 1.0, samples=1024)
    m = camera.world_from_camera
    corners = np.array(
        [
            (-side, -side, -depth, 1),
            (side, -side, -depth, 1),
            (side, side, -depth, 1),
            (-side, side, -depth, 1),
        ]
    )
    ob = add_mesh(bpy, (corners @ m.T)[:, :3], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("light")
    if not material.node_tree:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(emission.outputs[0], output.inputs[0])
    ob.data.materials.append(material)
    scene.world = None
    theirs = render_passes(bpy, tmp_path, {"Combined": "RGBA"})["Combined"][..., 0].astype(np.float64)

    compiled = compile_camera(camera, RenderSettings(width=n, height=n, pixel_filter="box"))
    samples = 1024
    ours = np.zeros((n, n))
    x, sample = (
        np.repeat(np.arange(n, dtype=np.int32), samples),
        np.tile(np.arange(samples, dtype=np.int32), n),
    )
    rays, width, spread = allocate_rays(len(x)), np.empty(len(x), np.float32), np.empty(len(x), np.float32)
    seeds = np.zeros(len(x), np.uint32)
    for y in range(n):
        sample_rays(
            compiled, sobol_tables(), 0, x, np.full_like(x, y), sample, rays, seeds, width, spread, 0, len(x)
        )
        local = rays.origin @ compiled.camera_from_world[:, :3].T + compiled.camera_from_world[:, 3]
        direction = rays.direction @ compiled.camera_from_world[:, :3].T
        hit = local + ((depth - local[:, 2]) / direction[:, 2])[:, None] * direction
        ours[y] = (np.abs(hit[:, :2]) <= side).all(1).reshape(n, samples).mean(1)
    assert theirs.max() > 0 and (theirs > 0).sum() > 20
    assert np.isclose(ours.sum(), theirs.sum(), rtol=3.0 / np.sqrt(theirs.sum() * samples))
    noise = np.sqrt(np.maximum(theirs, ours) * (1 - np.minimum(theirs, ours)) * 2 / samples)
    assert (np.abs(ours - theirs) <= 4.5 * noise + 2.0 / samples).all()
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.995
