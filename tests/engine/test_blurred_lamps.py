"""Lamps behind chaotic glass: as much light as rays bring that meet them by chance, without the chance."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Mesh, Scene, principled, uniform_world
from pointmr_engine.multires.lobes.blurred_lamps import blurred_lamps
from pointmr_engine.numerics.sobol import sobol_tables
from pointmr_engine.numerics.warps import uniform_cone
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.lamps_in_view import see_lamp
from pointmr_engine.raytracing.path_arrays import allocate_paths, allocate_samples
from pointmr_engine.render import Cache
from tests.engine.instanced import sphere
from tests.engine.small_scenes import quad
from tests.engine.test_mirror_chains import error
from tests.engine.test_raytrace_light import image

TOWARDS = look((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
LAMPS = {
    "bulb": Light("POINT", TOWARDS, power=100.0, radius=0.3),
    "spot": Light("SPOT", TOWARDS, power=100.0, radius=0.3, spot_angle=1.0),
    "small square": Light("AREA", TOWARDS, power=100.0, shape="SQUARE", size_x=0.05),
    "wide square": Light("AREA", TOWARDS, power=100.0, shape="SQUARE", size_x=5.0),
    "disk": Light("AREA", TOWARDS, power=100.0, shape="DISK", size_x=1.0),
    "sun": Light("SUN", TOWARDS, power=3.0, angle=0.01),
}


def seen(light: Light, direction: np.ndarray, blur: float, reach: float = math.inf) -> np.ndarray:
    """(N,) radiance about rays (N, 3) from the origin."""
    n = len(direction)
    lamps, _ = compile_lamps([light])
    tables, samples, found = sobol_tables(), allocate_samples(n), allocate_paths(n)
    found.slot[:] = np.arange(n)
    samples.number[:] = np.arange(n)
    found.rays.origin[:], found.rays.direction[:], found.rays.visibility[:] = 0.0, direction, 255
    out, towards = np.zeros((n, 3), np.float32), np.zeros((n, 3))
    blurred_lamps(
        lamps, np.zeros(1, np.int32), found.rays, np.full(n, reach), found, samples, tables, np.int64(2),
        np.full(n, blur, np.float32), np.arange(n), out, towards,
    )  # fmt: skip
    lit = out.any(1)
    assert (towards[lit] @ (0, 0, 1) > 0).all() and not towards[~lit].any()
    return out[:, 0].astype(float)


def sharp(light: Light, direction: np.ndarray) -> np.ndarray:
    """(N,) the same of what the rays themselves meet."""
    out = np.zeros((len(direction), 3), np.float32)
    see_lamp(
        compile_lamps([light])[0],
        0,
        np.zeros_like(direction),
        direction,
        np.full(len(direction), math.inf),
        out,
    )
    return out[:, 0].astype(float)


def upwards(n: int, narrow: float, seed: int) -> np.ndarray:
    """Directions evenly spread about the lamp, to 1 - cos = narrow."""
    u = np.random.default_rng(seed).random((n, 2))
    return np.array([uniform_cone(0.0, 0.0, 1.0, narrow, *p)[:3] for p in u])


@settings(max_examples=24, deadline=None)
@given(st.sampled_from(sorted(LAMPS)), st.floats(0.02, 0.35), st.integers(0, 1000))
def test_no_light_is_lost_or_won(name, blur, seed):
    """Over all directions, a blurred lamp is as bright as it is."""
    half = blur + {"wide square": 0.65, "small square": 0.01, "disk": 0.1001, "sun": 0.00501}.get(name, 0.07)
    d = upwards(6000, 2.0 * math.sin(0.5 * half) ** 2, seed)
    e = upwards(20000, 2.0 * math.sin(0.5 * half) ** 2, seed + 1)
    ours, exact = seen(LAMPS[name], d, blur), sharp(LAMPS[name], e)
    off = math.hypot(ours.std() / len(d) ** 0.5, exact.std() / len(e) ** 0.5)
    assert abs(ours.mean() - exact.mean()) < 4.5 * off
    if name != "wide square":  # without the chance that makes white pixels
        assert ours.max() < 0.6 * exact.max() or blur < 0.2


@pytest.mark.parametrize("name", ["small square", "sun"])
def test_small_lamps_are_discs_as_wide_as_the_blur(name):
    """Radiance times solid angle over that of the blur, wherever it reaches the lamp, and nothing beyond."""
    blur, lamps = 0.2, compile_lamps([LAMPS[name]])[0]
    solid = 0.05**2 / 25.0 if name == "small square" else math.pi * 0.005**2
    for angle in (0.0, 0.1, 0.18, 0.22):
        d = np.tile((math.sin(angle), 0.0, math.cos(angle)), (50, 1))
        right = lamps.radiance[0, 0] * solid / (2.0 * math.pi * (1.0 - math.cos(blur)))
        ours = seen(LAMPS[name], d, blur)
        assert np.median(ours) == pytest.approx(right if angle < blur else 0.0, rel=0.03)
        assert ours.max() < 2.0 * right


def test_what_rays_meet_before_a_lamp_hides_it():
    d = np.tile((0.0, 0.0, 1.0), (20, 1))
    assert (seen(LAMPS["disk"], d, 0.1, reach=6.0) > 0.0).all()
    assert not seen(LAMPS["disk"], d, 0.1, reach=4.0).any()
    assert not seen(LAMPS["sun"], d, 0.1, reach=4.0).any()


def bumpy(material) -> Mesh:
    """A closed lump with dents of half a pixel, smooth as meshes are."""
    positions, triangles = sphere(120, 240)
    rng = np.random.default_rng(3)
    positions = positions * (1.0 + 0.006 * rng.normal(size=(len(positions), 1)))
    a, b, c = positions[triangles].transpose(1, 0, 2)
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(positions)
    for corner in triangles.T:
        np.add.at(normals, corner, face)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arrays = positions.astype(np.float32), triangles
    return Mesh("lump", *arrays, normals=normals.astype(np.float32), materials=(material,))


def test_chaotic_glass_has_no_white_pixels():
    glass = principled("glass", roughness=0.0, transmission_weight=1.0)
    floor = quad(6.0, -1.1, principled("floor", base_color=(0.5, 0.5, 0.5), specular_ior_level=0.0), "floor")
    lights = [
        Light("AREA", look(p, (0, 0, 0)), shape="SQUARE", size_x=0.5, power=150.0)
        for p in ((3.0, 2.0, 4.0), (-3.0, 3.0, 2.0))
    ]
    camera = Camera(look((0, -5, 1.5), (0, 0, 0)))
    root, cache = Group("root", [floor, bumpy(glass)]), Cache()
    scene = Scene(root, camera, lights, uniform_world((0.2, 0.2, 0.2)))
    exact = np.mean([image(scene, cache, method="distributed", samples=512, seed=s) for s in range(4)], 0)
    ours = np.array([image(scene, cache, cones=4, seed=s) for s in range(4)])
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.03)
    assert error(exact, ours) < 0.02  # a quarter, where rays meet lamps by chance
