"""Cones behind curved mirrors and clear glass: as exact rays leave them, and as the formula has a mirrored sphere."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_footprint import Surface

from benchmarks.closed_forms import curved_mirror
from benchmarks.closed_forms.__main__ import image_of
from pointmr_engine import Group, Instances, Mesh, Scene
from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.multires.cones.cones import allocate_cones, sub_rays
from pointmr_engine.multires.fragments.curvature import spread_of_curvature
from pointmr_engine.multires.lobes.curved_mirrors import BENT, open_curved, own_variance
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.path_arrays import allocate_paths
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.raytracing.walk import intersect
from pointmr_engine.shading.bsdf.layout import GLASS, REFLECTION, TRANSLUCENT

seeds = st.integers(0, 2**32 - 1)


@uncounted
def open_one(cones, out, shape, own, normal, incoming, d, eta):
    return open_curved(cones, np.int64(0), out, shape, np.int64(0), own, normal, normal, incoming, d, eta)


@uncounted
def own_of(kind, rough, curved):
    return own_variance(kind, rough, curved)


def opened(k, angle, eta, half, slope, own=0.0):
    """The cone behind a surface at the origin that bends as test_footprint.Surface does, or None."""
    surface = Surface(k, angle)
    normal, incoming = np.array([0.0, 0.0, 1.0]), -surface.incoming
    d = surface.leave(surface.incoming, normal, eta)
    paths, cones = allocate_paths(1), allocate_cones(1)
    paths.rays.origin[0], paths.rays.t_min[0], paths.rays.t_max[0] = 0.0, 0.0, np.inf
    paths.rays.visibility[0] = 255
    paths.state.width[0], paths.state.spread[0] = 2.0 * half, 2.0 * slope
    shape = np.array([[k[0], k[1], 0.0, k[2], 0.0, 0.0]], np.float32)
    if not open_one(cones, paths, shape, own, tuple(normal), tuple(incoming), tuple(d), eta):
        return None
    return cones


def exact_rays(k, angle, eta, half, slope, distance):
    """Where exact rays, even over a footprint, pass the plane across the axis at a distance: (N, 3)."""
    surface = Surface(k, angle)
    d = surface.leave(surface.incoming, np.array([0.0, 0.0, 1.0]), eta)
    places = []
    for u, v in np.stack(np.meshgrid(*2 * [np.linspace(-0.875, 0.875, 8)]), -1).reshape(-1, 2):
        axis, across = surface.incoming, np.array([0.0, 1.0, 0.0])
        first = np.array([-axis[2], 0.0, axis[0]])
        lateral = u * first + v * across
        direction = axis + slope * lateral
        direction /= np.linalg.norm(direction)
        p, normal = surface.hit(half * lateral, direction)
        out = surface.leave(direction, normal, eta)
        places.append(p + (distance - p @ d) / (out @ d) * out)
    return np.array(places)


@settings(max_examples=60)
@given(seeds, st.sampled_from([0.0, 1 / 1.5, 1.2]))
def test_cones_cover_what_exact_rays_cover(seed, eta):
    rng = np.random.default_rng(seed)
    k, angle = tuple(rng.normal(size=3)), rng.uniform(0.05, 0.7)
    half, slope = 1e-4, rng.uniform(0.0, 1e-4)
    cones = opened(k, angle, eta, half, slope)
    assert cones is not None
    # refracted footprints about where they are matched; mirrored ones are as if they came from a point
    distance = (400.0 if eta == 0.0 else 8.0) * half / np.abs(cones.spread).max()
    exact = exact_rays(k, angle, eta, half, slope, distance)
    origin, direction, stretch = sub_rays(cones)
    places = (origin + distance * (direction * stretch[..., None]))[0]
    np.testing.assert_allclose(places.mean(0), exact.mean(0), atol=0.02 * np.ptp(exact, 0).max())
    ours, truth = np.cov(places.T), np.cov(exact.T)
    np.testing.assert_allclose(ours, truth, atol=0.12 * np.abs(truth).max())


def test_roughness_of_its_own_widens_a_cone():
    clear, rough = (opened((20.0, 0.0, 20.0), 0.3, 0.0, 0.001, 0.0, own) for own in (0.0, 1e-4))
    more = rough.spread[0] ** 2 - clear.spread[0] ** 2
    np.testing.assert_allclose(
        np.sort(more), np.sort(3.0 * 4e-4 * np.array([1.0, np.cos(0.3) ** 2])), rtol=0.02
    )


def test_too_wide_a_footprint_has_no_cone():
    assert opened((2000.0, 0.0, 2000.0), 0.3, 0.0, 0.001, 0.0) is None


def test_little_else_than_a_mirror_keeps_its_footprint():
    assert own_of(REFLECTION, 0.1, 0.005) == pytest.approx(0.0)
    assert own_of(GLASS, 0.11, 0.005) == pytest.approx(0.5 * 0.11**2 - 0.005)
    assert own_of(REFLECTION, 0.0, 1e-9) == 0.0
    for kind, rough, curved in ((REFLECTION, 0.2, 0.005), (REFLECTION, 0.0, 0.0), (TRANSLUCENT, 0.1, 0.005)):
        assert own_of(kind, rough, curved) < 0.0


def shape_of(mesh: Mesh, placed: np.ndarray, origin, target, width=0.01, mean=1.0):
    """(3, 3) shape operator and curved variance where a ray from origin to target meets the placed mesh.

    mean: length of the mean of the normals of the triangles that merged.
    """
    placements = Instances((Group("ball", [mesh]),), placed[None])
    scene = Scene(
        Group("root", [], [placements]), curved_mirror.cases()[0].view.camera(), [], curved_mirror.DARK
    )
    geometry = compile_geometry(scene)
    rays, hits = allocate_rays(1), allocate_hits(1)
    direction = np.subtract(target, origin)
    rays.origin[0], rays.direction[0] = origin, direction / np.linalg.norm(direction)
    rays.t_min[0], rays.t_max[0], rays.visibility[0] = 0.0, np.inf, 255
    intersect(build_acceleration(geometry), rays, hits)
    assert hits.triangle[0] >= 0
    out, curved = np.zeros((1, 6), np.float32), np.zeros(1, np.float32)
    spread_of_curvature(
        geometry.tables, hits, -rays.direction.astype(np.float32), rays.direction, np.full(1, width, np.float32),
        np.full(1, 4, np.int32), 4.0, -np.float32(mean) * rays.direction.astype(np.float32), np.zeros(1, np.int64),
        np.int64(1), curved, *np.zeros((2, 1), np.float32), out, np.empty((3, 3)),
    )  # fmt: skip
    a = out[0].astype(np.float64)
    return np.array([[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]]), float(curved[0])


@settings(max_examples=15)
@given(seeds)
def test_a_sphere_bends_by_its_radius(seed):
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    radius, middle = rng.uniform(0.2, 5.0), rng.normal(size=3)
    placed = np.concatenate([radius * turn, middle[:, None]], 1)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    tangent = np.eye(3) - np.outer(n, n)
    mesh = curved_mirror.sphere(60)
    # from outside it is convex, from inside concave
    outside, curved = shape_of(mesh, placed, middle + 3.0 * radius * n, middle)
    np.testing.assert_allclose(outside, tangent / radius, atol=0.12 / radius)
    assert curved == pytest.approx((0.01 / radius) ** 2 / 12.0, rel=0.02)
    inside, _ = shape_of(mesh, placed, middle, middle + n)
    np.testing.assert_allclose(inside, -tangent / radius, atol=0.12 / radius)


def test_a_stretched_sphere_bends_less_along_it():
    placed = np.diag([1.0, 1.0, 3.0])
    placed = np.concatenate([placed, np.zeros((3, 1))], 1)
    shape, _ = shape_of(curved_mirror.sphere(60), placed, (5.0, 0.013, 0.017), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(shape, np.diag([0.0, 1.0, 1.0 / 9.0]), atol=0.05)


def test_small_triangles_bend_by_what_merged_with_them():
    """A footprint of half the sphere, of triangles that turn by 3 degrees: alone, it has the variance of one."""
    placed, mesh = np.eye(3, 4), curved_mirror.sphere(60)
    whole, _ = shape_of(mesh, placed, (3.0, 0.1, 0.2), (0.0, 0.0, 0.0))
    alone, curved = shape_of(mesh, placed, (3.0, 0.1, 0.2), (0.0, 0.0, 0.0), width=1.0)
    side = math.radians(180 / 60)
    assert 0.5 * side**2 / 12.0 < curved < 2.5 * side**2 / 12.0
    np.testing.assert_allclose(alone, whole * math.sqrt(curved * 12.0), rtol=0.02, atol=1e-4)
    assert shape_of(mesh, placed, (3.0, 0.1, 0.2), (0.0, 0.0, 0.0), 1.0, 0.98)[1] == pytest.approx(
        curved + 0.5 * (1.0 - 0.98**2), rel=1e-3
    )
    assert shape_of(mesh, placed, (3.0, 0.1, 0.2), (0.0, 0.0, 0.0), 1.0, 0.8)[1] == pytest.approx(
        1 / 12, rel=0.02
    )


@pytest.mark.parametrize(("cones", "bound"), [(1, 0.012), (16, 0.005)])
def test_a_coarse_mirrored_sphere_is_the_formulas(cones, bound):
    """4,600 triangles of many pixels each. As lobes of the footprint's variance: 1.4 % at one cone, 1 % at 16."""
    case = next(c for c in curved_mirror.cases() if c.name == "mirrored sphere, middle")
    root = Group("root", [curved_mirror.sphere(48), *curved_mirror.stripes()])
    scene = Scene(root, case.view.camera(), [], curved_mirror.DARK)
    assert case.error(image_of(case, scene, f"raytrace:{cones}"), case.exact()) < bound


def test_flat_mirrors_keep_their_place():
    """Where curvature adds hardly anything, sub-rays leave from all over the footprint, as of a flat mirror."""
    cones = opened((1e-6, 0.0, 1e-6), 0.3, 0.0, 0.01, 0.002)
    np.testing.assert_allclose(cones.start[0], 0.01, rtol=1e-4)
    np.testing.assert_allclose(np.abs(cones.spread[0]), 0.002, rtol=1e-3)
    bent = opened((1.0, 0.0, 1.0), 0.3, 0.0, 0.01, 0.002)
    assert np.abs(bent.spread).max() > BENT * 0.002 and (bent.start == 0.0).all()
