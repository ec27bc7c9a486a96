"""Light sampling: closed forms, densities that match, and three estimators that agree."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.numerics import warps
from pointmr_engine.raytracing.lights import (
    LAMP,
    NONE,
    TRIANGLE,
    WORLD,
    Lights,
    allocate_light_samples,
    build_lights,
    power_heuristic,
)
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY, VISIBLE, Group, instance
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.material import Material, emission
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.texture import Image
from pointmr_engine.scene.world import World, uniform_world
from pointmr_engine.shading.program import compile_graph

UP = (0.0, 0.0, 1.0)
N = 1 << 14


def placed(location=(0.0, 0.0, 0.0), down=True, scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    """A transform at a location; a lamp there shines down, or up."""
    m = np.eye(4)
    m[:3, :3] = np.diag(scale) if down else np.diag([1.0, -1.0, -1.0]) * scale
    m[:3, 3] = location
    return m


def lights_of(lamps=(), world=None, meshes=(), instances=(), **options) -> Lights:
    scene = Scene(Group("root", list(meshes), list(instances)), lights=list(lamps), world=world or World())
    geometry = compile_geometry(scene)
    programs = [compile_graph(m.graph if m else Graph()) for m in geometry.materials]
    return build_lights(scene, geometry, programs, **options)


def points(position, normal=UP, n=N, transmissive=False):
    p = np.broadcast_to(np.asarray(position, np.float64), (n, 3)).copy()
    nor = np.broadcast_to(np.asarray(normal, np.float32), (n, 3)).copy()
    return p, nor, np.full(n, transmissive)


def uniforms(n=N, dimensions=3, seed=0) -> np.ndarray:
    """Well-spread points of the unit cube, randomly shifted (Kronecker sequence)."""
    phi = 1.22074408460575947536 if dimensions == 3 else 1.32471795724474602596
    steps = phi ** -np.arange(1.0, dimensions + 1.0)
    return (np.arange(n)[:, None] * steps + np.random.default_rng(seed).random(dimensions)) % 1.0


def sampled(lights, position, normal=UP, n=N, transmissive=False, seed=0):
    out = allocate_light_samples(n)
    p, nor, trans = points(position, normal, n, transmissive)
    lights.sample(p, nor, trans, uniforms(n, seed=seed), out)
    lights.emission_at(out)
    assert not out.pending.any()
    return out


def meets(lights, position, direction):
    """(emitter or -1, distance) of the nearest emissive triangle along each ray, by brute force."""
    v = lights.arrays.emitters.vertices
    nearest, index = np.full(len(direction), np.inf), np.full(len(direction), -1)
    for e in range(len(v)):
        edge1, edge2 = v[e, 1] - v[e, 0], v[e, 2] - v[e, 0]
        h = np.cross(direction, edge2)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = h @ edge1
            s = position - v[e, 0]
            a = np.einsum("ij,ij->i", s, h) / det
            q = np.cross(s, edge1)
            b = np.einsum("ij,ij->i", direction, q) / det
            t = q @ edge2 / det
            hit = (a >= 0.0) & (b >= 0.0) & (a + b <= 1.0) & (t > 1e-9) & (t < nearest)
        nearest[hit], index[hit] = t[hit], e
    return index, nearest


def by_lights(lights, position, normal=UP, n=N, mis=False, seed=0):
    """Irradiance by light samples, weighted against cosine-distributed rays if mis; blocked by nearer emitters."""
    out = sampled(lights, position, normal, n, seed=seed)
    p, nor, _ = points(position, normal, n)
    cosine = np.einsum("ij,ij->i", out.direction, nor.astype(np.float64))
    ok = (out.kind != NONE) & (cosine > 0.0)
    _, t = meets(lights, p, out.direction)
    ok &= t >= out.distance * (1.0 - 1e-6)
    value = np.zeros((n, 3))
    value[ok] = out.radiance[ok] * (cosine[ok] / out.pdf[ok])[:, None]
    if mis:
        weight = power_heuristic(out.pdf, np.maximum(cosine, 0.0) / math.pi)
        value *= np.where(out.mis, weight, 1.0)[:, None]
    return value


def by_rays(lights, position, normal=UP, n=N, mis=False, seed=1):
    """Irradiance by cosine-distributed rays that meet lights, weighted against light samples if mis."""
    axis = np.asarray(normal, np.float64)
    d = np.array([warps.cosine_hemisphere(*axis, *u) for u in uniforms(n, 2, seed)])
    p, nor, trans = points(position, normal, n)
    d, pdf = np.ascontiguousarray(d[:, :3]), d[:, 3] / math.pi
    bsdf_pdf = pdf if mis else np.full(n, np.inf)
    index, t = meets(lights, p, d)
    value = np.zeros((n, 3), np.float32)
    lights.seen_lamps(p, d, t, np.full(n, DIFFUSE, np.uint8), nor, trans, bsdf_pdf, value)
    hit = index >= 0
    emitters = lights.arrays.emitters
    if hit.any():
        e = index[hit]
        weight = lights.emitter_weight(
            emitters.path[e],
            emitters.triangle[e],
            p[hit],
            nor[hit],
            trans[hit],
            d[hit],
            t[hit],
            bsdf_pdf[hit],
        )
        value[hit] += emitters.radiance[e] * weight[:, None]
    miss = ~hit
    world = lights.world_radiance(d[miss], DIFFUSE)
    value[miss] += (
        world * lights.world_weight(p[miss], nor[miss], trans[miss], d[miss], bsdf_pdf[miss])[:, None]
    )
    return value.astype(np.float64) * math.pi


def all_agree(lights, position, normal=UP, expected=None, rel=0.02, n=N):
    """Light samples alone, rays alone and both weighted have one mean, which is `expected` if given."""
    alone = by_lights(lights, position, normal, n).mean(0)
    both = by_lights(lights, position, normal, n, mis=True).mean(0) + by_rays(
        lights, position, normal, n, True
    ).mean(0)
    rays = by_rays(lights, position, normal, n).mean(0)
    if expected is not None:
        assert alone == pytest.approx(np.full(3, expected), rel=rel)
    assert both == pytest.approx(alone, rel=rel)
    assert rays == pytest.approx(alone, rel=3.0 * rel)


def quad(name="quad", size=1.0, height=0.0, radiance=1.0, material=None, facing_down=True) -> Mesh:
    s = 0.5 * size
    p = np.array([[-s, -s, height], [s, -s, height], [s, s, height], [-s, s, height]], np.float32)
    t = np.array([[0, 2, 1], [0, 3, 2]] if facing_down else [[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(name, p, t, materials=(material or emission(strength=radiance),))


def cube(material) -> Mesh:
    p = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    t = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh("cube", p, t, materials=(material,))


def form_factor_square(half: float, height: float) -> float:
    """Of a small surface to a parallel square of sides 2 * half centred above it."""
    x = half / height
    root = math.sqrt(1.0 + x * x)
    return 4.0 / math.pi * x / root * math.atan(x / root)


# closed forms


@pytest.mark.parametrize("soft", [False, True])
def test_point_light_falls_off_with_the_square(soft):
    lights = lights_of([Light("POINT", placed((0.0, 0.0, 2.0)), power=10.0, soft_falloff=soft)])
    out = sampled(lights, (1.5, 0.0, 0.0), n=16)
    d2 = 1.5**2 + 2.0**2
    assert out.radiance[:, 0] / out.pdf == pytest.approx(10.0 / (4.0 * math.pi * d2), rel=1e-6)
    assert out.distance == pytest.approx(math.sqrt(d2))
    assert not out.mis.any()


def test_sphere_above_the_horizon():
    r, d = 0.5, np.array([1.0, 0.0, 2.0])
    radiance = 7.0 / (4.0 * math.pi**2 * r * r)
    light = Light("POINT", placed(d), power=7.0, radius=r, soft_falloff=False)
    expected = math.pi * radiance * r * r / (d @ d) * d[2] / np.linalg.norm(d)
    all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


def test_inside_a_sphere():
    light = Light("POINT", placed((0.1, 0.0, 0.2)), power=7.0, radius=2.0, soft_falloff=False)
    expected = math.pi * 7.0 / (4.0 * math.pi**2 * 4.0)
    all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


def test_disc_on_its_axis():
    r, h = 1.0, 0.7
    light = Light("AREA", placed((0.0, 0.0, h)), power=5.0, shape="DISK", size_x=2.0 * r)
    radiance = 5.0 / (math.pi * math.pi * r * r)
    all_agree(lights_of([light]), (0, 0, 0), expected=math.pi * radiance * r * r / (r * r + h * h), rel=0.01)


@pytest.mark.parametrize("height", [0.1, 1.0, 20.0])
def test_square_over_its_centre(height):
    light = Light("AREA", placed((0.0, 0.0, height)), power=5.0, size_x=2.0)
    expected = 5.0 / (math.pi * 4.0) * math.pi * form_factor_square(1.0, height)
    alone = by_lights(lights_of([light]), (0.0, 0.0, 0.0)).mean(0)
    assert alone == pytest.approx(np.full(3, expected), rel=0.003)
    if height < 10.0:
        all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.01, 1.0])
def test_sun_gives_its_irradiance(angle):
    lights = lights_of([Light("SUN", placed(), power=3.0, angle=angle)])
    assert by_lights(lights, (5.0, 6.0, 7.0)).mean(0) == pytest.approx(np.full(3, 3.0), rel=1e-3)
    if angle == 1.0:
        all_agree(lights, (0.0, 0.0, 0.0), (0.6, 0.0, 0.8), 3.0 * 0.8, rel=0.01)


def test_spot_is_dark_outside_its_cone():
    light = Light("SPOT", placed((0.0, 0.0, 1.0)), power=10.0, spot_angle=math.pi / 2, spot_blend=0.0)
    lights = lights_of([light])
    inside, outside = sampled(lights, (0.99, 0.0, 0.0), n=8), sampled(lights, (1.01, 0.0, 0.0), n=8)
    assert (inside.kind == LAMP).all() and (outside.kind == NONE).all()
    assert inside.radiance[0, 0] == pytest.approx(10.0 / (4.0 * math.pi * (0.99**2 + 1.0)), rel=1e-6)


@pytest.mark.parametrize(
    "light",
    [
        Light(
            "SPOT", placed((0.3, 0.0, 1.0)), radius=0.4, spot_angle=1.4, spot_blend=0.5, soft_falloff=False
        ),
        Light(
            "SPOT", placed((0.3, 0.0, 0.6)), radius=0.5, spot_angle=0.6, spot_blend=0.5, soft_falloff=False
        ),
        Light("SPOT", placed((0.3, 0.0, 1.0)), radius=0.4, spot_angle=1.4, spot_blend=0.5, soft_falloff=True),
        Light("SPOT", placed((0.1, 0.0, 0.2)), radius=0.6, spot_angle=1.4, soft_falloff=False),
        Light("POINT", placed((0.3, 0.0, 0.2)), radius=0.5, soft_falloff=True),
        Light("POINT", placed((0.3, 0.0, 0.2)), radius=0.36, soft_falloff=False),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="RECTANGLE", size_x=1.0, size_y=2.0, spread=1.0),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="DISK", size_x=2.0, spread=1.2),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="ELLIPSE", size_x=2.0, size_y=1.0),
        Light("AREA", placed((0.5, 0.3, 0.5), scale=(2.0, 1.0, 1.0)), size_x=1.0, color=(1.0, 0.5, 0.2)),
        Light("SUN", placed(), angle=2.0),
    ],
    ids=lambda light: f"{light.kind}-{light.shape}-{light.radius}-{light.spread:.1f}",
)
def test_lamps_by_samples_and_by_rays(light):
    lights = lights_of([light])
    for normal in (UP, (0.6, 0.0, 0.8), (-0.8, 0.6, 0.0)):
        alone = by_lights(lights, (0.0, 0.0, 0.0), normal).mean(0)
        rays = by_rays(lights, (0.0, 0.0, 0.0), normal).mean(0)
        both = by_lights(lights, (0, 0, 0), normal, mis=True) + by_rays(lights, (0, 0, 0), normal, mis=True)
        close = 0.03 * alone.max() + 1e-3
        assert rays == pytest.approx(alone, abs=close)
        assert both.mean(0) == pytest.approx(alone, abs=close)


def test_area_light_shines_to_its_front_only():
    up = lights_of([Light("AREA", placed((0.0, 0.0, 1.0), down=False))])
    assert (sampled(up, (0.0, 0.0, 0.0), n=16).kind == NONE).all()
    assert by_rays(up, (0.0, 0.0, 0.0), n=256).max() == 0.0


# the world


def test_uniform_world():
    lights = lights_of(world=uniform_world((0.5, 0.25, 0.125), 2.0))
    value = by_lights(lights, (1.0, 2.0, 3.0))
    assert value.mean(0) == pytest.approx(math.pi * np.array([1.0, 0.5, 0.25]), rel=1e-5)
    assert value.std(0).max() < 1e-3  # chosen by the cosine: no noise at all
    all_agree(lights, (0.0, 0.0, 0.0))
    all_agree(lights.above, (0.0, 0.0, 0.0))
    chance = lights_of(world=replace(uniform_world((0.5, 0.5, 0.5), 2.0), sampling="NONE"))
    assert chance.empty and chance.only_met
    assert by_rays(chance, (0.0, 0.0, 0.0)).mean(0) == pytest.approx(np.full(3, math.pi), rel=1e-5)


def image_world(pixels, **options) -> World:
    image = Image("sky", np.asarray(pixels, np.float32), colorspace="Linear")
    nodes = {
        "sky": Node("environment_texture", params={"image": image}),
        "background": Node("background", {"color": Link("sky", "color"), "strength": 1.0}),
    }
    return World(Graph(nodes, surface=Link("background", "background")), **options)


def test_image_world_by_samples_and_by_rays():
    rng = np.random.default_rng(3)
    pixels = np.ones((32, 64, 4), np.float32)
    pixels[..., :3] = rng.random((32, 64, 3))
    pixels[25, 40, :3] = 200.0  # a small sun
    lights = lights_of(world=image_world(pixels))
    for normal in (UP, (0.0, 0.8, -0.6)):
        alone = by_lights(lights, (0.0, 0.0, 0.0), normal)
        rays = by_rays(lights, (0.0, 0.0, 0.0), normal, n=1 << 16)
        both = by_lights(lights, (0, 0, 0), normal, mis=True) + by_rays(lights, (0, 0, 0), normal, mis=True)
        assert rays.mean(0) == pytest.approx(alone.mean(0), rel=0.05)
        assert both.mean(0) == pytest.approx(alone.mean(0), rel=0.02)
    assert (sampled(lights, (0.0, 0.0, 0.0), n=64).kind == WORLD).all()


def test_world_density_integrates_to_one_and_matches_samples():
    rng = np.random.default_rng(3)
    pixels = rng.random((16, 32, 4)) ** 8
    lights = lights_of(world=image_world(pixels, sampling="MANUAL", map_resolution=128))
    z = (np.arange(512) + 0.5) / 256 - 1.0
    phi = (np.arange(1024) + 0.5) / 1024 * 2.0 * math.pi
    r = np.sqrt(1.0 - z * z)
    d = np.stack([r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], 1024, 1)], -1)
    p, nor, trans = points((0.0, 0.0, 0.0), n=d[..., 0].size)
    assert lights.world_pdf(p, nor, trans, d.reshape(-1, 3)).mean() * 4.0 * math.pi == pytest.approx(
        1.0, abs=0.005
    )
    out = sampled(lights, (0.0, 0.0, 0.0), n=4096)
    again = lights.world_pdf(*points((0.0, 0.0, 0.0), n=4096), out.direction)
    assert (np.abs(again / out.pdf - 1.0) < 1e-5).mean() > 0.998  # but for texel borders


def test_sun_of_a_sky_is_sampled_by_itself():
    sky = {"sun_disc": True, "sun_elevation": 0.7, "sun_rotation": 2.0, "sun_size": 0.009512}
    nodes = {
        "sky": Node("sky_texture", params=sky),
        "background": Node("background", {"color": Link("sky", "color"), "strength": 1.0}),
    }
    lights = lights_of(world=World(Graph(nodes, surface=Link("background", "background"))))
    value = by_lights(lights, (0.0, 0.0, 0.0))
    sun = lights.arrays.world.sun
    assert sun[4] > 0.0 and value[:, 1].std() < 1.5 * value[:, 1].mean()
    # just within the disc is far brighter than just outside, all around
    side = np.array(warps.orthonormal_basis(*sun[:3])).reshape(2, 3)
    turn = np.arange(8)[:, None] * math.pi / 4
    rim = np.cos(turn) * side[0] + np.sin(turn) * side[1]
    angle = 0.5 * sky["sun_size"]
    inside = lights.world_radiance(sun[:3] + 0.9 * angle * rim, DIFFUSE)
    outside = lights.world_radiance(sun[:3] + 1.1 * angle * rim, DIFFUSE)
    assert inside.min() > 100.0 * outside.max()
    # light of the disc and of the rest, by quadrature
    z = (np.arange(256) + 0.5) / 128 - 1.0
    phi = (np.arange(512) + 0.5) / 512 * 2.0 * math.pi
    r = np.sqrt(1.0 - z * z)
    d = np.stack(
        [r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], 512, 1)], -1
    ).reshape(-1, 3)
    away = d @ sun[:3] < math.cos(angle)
    rest = (
        (lights.world_radiance(d, DIFFUSE) * (np.maximum(d[:, 2:], 0.0) * away[:, None])).mean(0)
        * 4.0
        * math.pi
    )
    n = 4096
    disc = np.array([warps.uniform_cone(*sun[:3], sun[3], *u) for u in uniforms(n, 2)])[:, :3]
    solid_angle = 2.0 * math.pi * sun[3]
    disc = (lights.world_radiance(disc, DIFFUSE) * disc[:, 2:]).mean(0) * solid_angle
    assert value.mean(0) == pytest.approx(rest + disc, rel=0.02)


def test_world_and_lamps_hide_from_what_may_not_see_them():
    world = uniform_world()
    world.visibility = VISIBLE & ~CAMERA
    light = Light(
        "POINT", placed((0.0, 0.0, 2.0)), radius=0.5, soft_falloff=False, visibility=VISIBLE & ~GLOSSY
    )
    lights = lights_of([light], world)
    up = np.array([[0.0, 0.0, 1.0]])
    assert lights.world_radiance(up, CAMERA).max() == 0.0 and lights.world_radiance(up, DIFFUSE).min() > 0.0
    p, nor, trans = points((0.0, 0.0, 0.0), n=1)
    for bit, seen in ((CAMERA, True), (GLOSSY, False), (DIFFUSE, True)):
        out = np.zeros((1, 3), np.float32)
        lights.seen_lamps(
            p, up, np.array([9.0]), np.array([bit], np.uint8), nor, trans, np.array([np.inf]), out
        )
        assert (out[0, 0] > 0.0) == seen
    out = np.zeros((1, 3), np.float32)
    lights.seen_lamps(
        p, up, np.array([1.4]), np.array([CAMERA], np.uint8), nor, trans, np.array([np.inf]), out
    )
    assert out.max() == 0.0  # something stands before it
    sample = sampled(lights, (0.0, 0.0, 0.0), n=256)
    assert set(np.unique(sample.visibility[sample.kind == LAMP])) == {VISIBLE & ~GLOSSY}


# emissive triangles


@pytest.mark.parametrize("height", [0.05, 1.0, 30.0])
def test_emissive_square_over_its_centre(height):
    lights = lights_of(meshes=[quad(size=2.0, height=height, radiance=3.0)])
    expected = 3.0 * math.pi * form_factor_square(1.0, height)
    alone = by_lights(lights, (0.0, 0.0, 0.0)).mean(0)
    assert alone == pytest.approx(np.full(3, expected), rel=0.01)
    if height < 10.0:
        all_agree(lights, (0.0, 0.0, 0.0), expected=expected, rel=0.02)


def test_closed_emissive_mesh_hardly_samples_its_inside():
    lights = lights_of(
        instances=[instance(Group("cube", [cube(emission(strength=2.0))]), placed((0.2, 0.1, 2.0)))]
    )
    out = sampled(lights, (0.0, 0.0, 0.0), n=4096)
    v = lights.arrays.emitters.vertices[out.index]
    outward = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    assert (np.einsum("ij,ij->i", outward, out.direction) > 0.0).mean() < 0.2
    all_agree(lights, (0.0, 0.0, 0.0))
    all_agree(lights, (0.2, 0.1, 2.1), expected=2.0 * math.pi)  # within it


@pytest.mark.parametrize(
    "mode, front, back", [("AUTO", 1, 1), ("FRONT", 1, 0), ("BACK", 0, 1), ("NONE", 0, 0)]
)
@pytest.mark.parametrize("mirrored", [False, True])
def test_emission_sampling_sides(mode, front, back, mirrored):
    material = emission(strength=2.0)
    material.emission_sampling = mode
    m = placed((0.0, 0.0, 1.0), scale=(-1.0 if mirrored else 1.0, 1.0, 1.0))
    lights = lights_of(instances=[instance(Group("g", [quad(material=material)]), m)])
    below, above = (
        sampled(lights, (0.1, 0.0, 0.0), n=64),
        sampled(lights, (0.1, 0.0, 2.0), (0.0, 0.0, -1.0), n=64),
    )
    assert (below.kind == TRIANGLE).any() == bool(front)
    assert (above.kind == TRIANGLE).any() == bool(back)
    if mode == "NONE":
        assert lights.only_met and lights.empty
    # what is not sampled is met by rays, with their whole weight
    both = by_lights(lights, (0.1, 0, 0), mis=True).mean(0) + by_rays(lights, (0.1, 0, 0), mis=True).mean(0)
    if mode != "NONE":
        assert both == pytest.approx(by_rays(lights, (0.1, 0.0, 0.0)).mean(0), rel=0.03)


def test_weak_emission_is_left_to_chance():
    lights = lights_of(meshes=[quad(radiance=0.3, height=1.0)])
    assert lights.empty and lights.only_met
    assert not lights_of(meshes=[quad(radiance=0.7, height=1.0)]).empty


def test_emitters_of_nested_instances_are_found_by_path():
    leaf = Group("leaf", [quad(size=0.2, radiance=5.0)])
    pair = Group("pair", instances=[instance(leaf, placed((x, 0.0, 0.0))) for x in (-0.3, 0.3)])
    root = [instance(pair, placed((0.0, y, 1.0), scale=(1.0, 1.0, 2.0))) for y in (-0.4, 0.0, 0.4)]
    lights = lights_of(instances=root)
    emitters = lights.arrays.emitters
    assert len(emitters.path) == 12 and len(np.unique(emitters.path)) == 6
    centres = np.round(emitters.vertices.mean(1), 1)
    assert {tuple(c) for c in np.round(emitters.vertices.reshape(6, 6, 3).mean(1), 6) + 0.0} >= {
        (0.3, 0.4, 1.0)
    }
    assert centres[:, 2] == pytest.approx(1.0)
    all_agree(lights, (0.0, 0.0, 0.0))


def test_textured_emission_is_evaluated_where_it_is_sampled():
    pixels = np.zeros((8, 8, 4), np.float32)
    pixels[:, 4:, 0], pixels[:, :4, 1], pixels[..., 3] = 4.0, 2.0, 1.0
    image = Image("glow", pixels, colorspace="Linear")
    nodes = {
        "image": Node("image_texture", params={"image": image, "interpolation": "Closest"}),
        "emission": Node("emission", {"color": Link("image", "color"), "strength": 1.0}),
    }
    mesh = quad(
        size=2.0, height=1.0, material=Material("glow", Graph(nodes, surface=Link("emission", "emission")))
    )
    mesh.uvs["uv"] = (mesh.positions[mesh.triangles][..., :2] * 0.5 + 0.5).astype(np.float32)
    mesh.active_uv = "uv"
    lights = lights_of(meshes=[mesh])
    out = sampled(lights, (0.0, 0.0, 0.0), n=1024)
    x = out.direction[:, 0] * out.distance
    clear = np.abs(x) > 0.02
    assert out.radiance[clear & (x > 0.0)] == pytest.approx(
        np.array([[4.0, 0.0, 0.0]]).repeat((clear & (x > 0)).sum(), 0)
    )
    assert out.radiance[clear & (x < 0.0)] == pytest.approx(
        np.array([[0.0, 2.0, 0.0]]).repeat((clear & (x < 0)).sum(), 0)
    )


# choosing among many


def many_lights(n: int, seed=5) -> Lights:
    """n emissive triangles and lamps of every kind, around the origin."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n, 1, 3)) * 3.0 + rng.normal(size=(n, 3, 3)) * 0.3
    materials = tuple(emission(strength=s) for s in (1.0, 5.0, 20.0))
    mesh = Mesh(
        "shards",
        t.reshape(-1, 3).astype(np.float32),
        np.arange(3 * n, dtype=np.int32).reshape(n, 3),
        material_index=rng.integers(0, 3, n).astype(np.int32),
        materials=materials,
    )
    lamps = [
        Light("POINT", placed((1.0, 2.0, 1.0)), power=30.0),
        Light("POINT", placed((-2.0, 1.0, 2.0)), power=30.0, radius=0.4, soft_falloff=False),
        Light("SPOT", placed((0.0, 0.5, 3.0)), power=90.0, radius=0.1, spot_angle=1.2),
        Light("AREA", placed((2.0, -1.0, 2.0)), power=40.0),
        Light("AREA", placed((-2.0, -1.0, 2.0)), power=40.0, shape="DISK", spread=1.0),
        Light("SUN", placed(), power=1.0, angle=0.1),
    ]
    return lights_of(lamps, uniform_world((0.3, 0.3, 0.3)), [mesh])


@pytest.mark.parametrize("n", [4, 300])
def test_probabilities_of_all_lights_sum_to_one(n):
    from pointmr_engine.raytracing import light_tree

    lights = many_lights(n)
    tree = lights.arrays.tree
    assert (len(tree.tops) <= 16 + 2) and len(tree.leaf_of_emitter) == n
    rng = np.random.default_rng(0)
    for transmissive in (True, False):
        for _ in range(6):
            p, normal = rng.normal(size=3) * 3.0, rng.normal(size=3)
            args = (*p, *normal / np.linalg.norm(normal), transmissive)
            leaves = [*tree.leaf_of_emitter, *tree.leaf_of_lamp, tree.leaf_of_world]
            q = np.array([light_tree.light_probability(tree, k, *args) for k in leaves])
            # where a cluster seems possible but none of its lights is, a choice fails: that share is missing
            assert q.sum() < 1.0 + 1e-9 and q.sum() > (1.0 - 1e-9 if n == 4 else 0.6)
            chosen = [
                light_tree.choose_light(tree, *args, u, np.empty(len(tree.tops)))
                for u in (np.arange(400) + 0.5) / 400
            ]
            assert np.mean([node >= 0 for node, _ in chosen]) == pytest.approx(q.sum(), abs=0.02)
            nodes = np.array([node for node, _ in chosen])
            if n == 4:  # each light has one interval of u
                assert (np.diff(nodes) != 0).sum() == len(np.unique(nodes)) - 1
            lookup = dict(zip(leaves, q, strict=True))
            for node, probability in chosen:
                assert node < 0 or lookup[node] == pytest.approx(probability, rel=1e-9)


def test_bright_lamps_are_weighed_beside_a_cluster_of_faint_ones():
    mesh = quad(radiance=1e-6)
    lamps = [Light("AREA", placed((float(x), 0.0, 2.0)), power=40.0) for x in range(6)]
    lamps += [Light("POINT", placed((0.01 * k, 5.0, 0.0)), power=1e-3, radius=0.01) for k in range(100)]
    tree = lights_of(lamps, meshes=[mesh]).arrays.tree
    assert (tree.top[tree.leaf_of_lamp[:6]] >= 0).all()
    assert (tree.top[tree.leaf_of_lamp[6:]] < 0).all() and (tree.top[tree.leaf_of_emitter] < 0).all()
    assert len(tree.tops) < 10  # nothing that is faint is opened


def test_tree_is_unbiased():
    lights = many_lights(200)
    p, normal = np.array([0.2, 0.1, -0.5]), np.array([0.0, 0.6, 0.8])
    e = lights.arrays.emitters
    # every triangle by itself, seen from both sides, without shadows: the exact polygon formula, clipped by sampling
    v = e.vertices - p
    total = np.zeros(3)
    rng = np.random.default_rng(2)
    b = rng.random((4000, 2))
    b = np.where(b.sum(1, keepdims=True) > 1.0, 1.0 - b, b)
    for k in range(len(v)):
        x = v[k, 0] + b[:, :1] * (v[k, 1] - v[k, 0]) + b[:, 1:] * (v[k, 2] - v[k, 0])
        cross = np.cross(v[k, 1] - v[k, 0], v[k, 2] - v[k, 0])
        r2 = (x * x).sum(1)
        total += e.radiance[k] * (np.maximum(x @ normal, 0.0) * np.abs(x @ cross) * 0.5 / r2**2).mean()
    out = sampled(lights, p, normal, n=1 << 16)
    ok = out.kind == TRIANGLE
    cosine = np.maximum(out.direction[ok] @ normal, 0.0)
    value = (out.radiance[ok] * (cosine / out.pdf[ok])[:, None]).sum(0) / len(out.kind)
    assert value == pytest.approx(total, rel=0.01)


def test_densities_of_rays_equal_those_of_samples():
    lights = many_lights(200)
    out = sampled(lights, (0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=4096)
    ok = np.flatnonzero(out.kind == TRIANGLE)
    p, nor, trans = points((0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=len(ok))
    again = lights.emitter_pdf(
        out.path[ok], out.triangle[ok], p, nor, trans, out.direction[ok], out.distance[ok]
    )
    assert again == pytest.approx(out.pdf[ok], rel=1e-6)
    assert (
        lights.emitter_pdf(
            out.path[ok] + np.uint64(1), out.triangle[ok], p, nor, trans, None, out.distance[ok]
        ).max()
        == 0
    )


def test_many_lights_with_little_noise():
    lights = many_lights(200)
    value = by_lights(lights, (0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=1 << 14)[:, 0]
    assert value.std() < 2.5 * value.mean()


# odd input


def test_nothing_to_sample():
    lights = lights_of()
    assert lights.empty and not lights.only_met
    assert (sampled(lights, (0.0, 0.0, 0.0), n=4).kind == NONE).all()
    assert by_rays(lights, (0.0, 0.0, 0.0), n=64).max() == 0.0


def test_black_lights_are_left_out():
    lights = lights_of(
        [Light("POINT", power=0.0), Light("AREA", color=(0.0, 0.0, 0.0))], meshes=[quad(radiance=0.0)]
    )
    assert lights.empty and not lights.warnings


def test_lights_that_cannot_shine_are_named():
    bad = [
        Light("AREA", size_x=0.0, name="flat"),
        Light("POINT", placed((math.nan, 0.0, 0.0)), name="lost"),
        Light("SPOT", placed(scale=(0.0, 0.0, 0.0)), name="crushed"),
        Light("AREA", power=math.inf, name="endless"),
        Light("LASER", name="laser"),
    ]
    lights = lights_of([*bad, Light("POINT", placed((0.0, 0.0, 1.0)))])
    for light in bad:
        assert any(light.name in w for w in lights.warnings)
    assert (sampled(lights, (0.0, 0.0, 0.0), n=4).kind == LAMP).all()


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "AREA"])
def test_lights_behind_the_surface(kind):
    lights = lights_of([Light(kind, placed((0.0, 0.0, -1.0), down=False), radius=0.1, spot_angle=2.0)])
    assert (sampled(lights, (0.0, 0.0, 0.0), n=16).kind == NONE).all()
    assert (sampled(lights, (0.0, 0.0, 0.0), n=16, transmissive=True).kind == LAMP).all()


@pytest.mark.parametrize("distance", [1e-6, 1e6])
def test_extreme_distances(distance):
    lamps = [Light("AREA", placed((0.0, 0.0, distance)), power=distance**2, size_x=1.0)]
    lamps += [
        Light("POINT", placed((0.0, 0.0, distance)), power=distance**2, radius=0.5, soft_falloff=s)
        for s in (0, 1)
    ]
    far = Group("far", [quad(radiance=max(1.0, distance**2))])
    lights = lights_of(lamps, instances=[instance(far, placed((0.0, 0.0, distance)))])
    out = sampled(lights, (0.0, 0.0, 0.0), n=1024)
    ok = out.kind != NONE
    assert ok.any() and np.isfinite(out.radiance[ok]).all() and np.isfinite(out.pdf[ok]).all()
    assert np.linalg.norm(out.direction[ok], axis=1) == pytest.approx(1.0)
    if distance > 1.0:
        each = [out.radiance[out.index == i, 0].mean() for i in range(1)]
        area = (out.radiance[:, 0] / out.pdf)[(out.kind == LAMP) & (out.index == 0)]
        assert np.isfinite(each).all() and area.std() < 1e-3 * area.mean()


def test_degenerate_triangles_do_not_shine():
    p = np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1], [0, 1, 1], [np.nan, 0, 1]], np.float32)
    t = np.array([[0, 1, 2], [0, 1, 1], [0, 4, 1], [0, 1, 3]], np.int32)
    lights = lights_of(meshes=[Mesh("odd", p, t, materials=(emission(strength=2.0),))])
    assert len(lights.arrays.emitters.path) == 1
    all_agree(lights, (0.0, 0.0, 0.0))


def test_more_emitters_than_the_limit(monkeypatch):
    from pointmr_engine.raytracing import emitters

    monkeypatch.setattr(emitters, "MOST_EMITTERS", 10)
    lights = lights_of(
        instances=[instance(Group("g", [quad(radiance=2.0)]), placed((k, 0.0, 1.0))) for k in range(9)]
    )
    assert len(lights.arrays.emitters.path) <= 10 and lights.only_met
    assert any("10" in w for w in lights.warnings)
