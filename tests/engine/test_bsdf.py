"""Lobes: sampling agrees with evaluation, energy is conserved, nothing breaks at the extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bsdf_cases import (
    ROUGH,
    albedo_of_phong,
    evaluate,
    even_numbers,
    make_block,
    make_lobes,
    sample,
    sphere,
    viewer,
)

from pointmr_engine.shading import leaves, lobes
from pointmr_engine.shading.bsdf import layout
from pointmr_engine.shading.leaves import Leaf

VIEWS = (0.95, 0.5, 0.2)
SCATTERED = lobes.LABEL_DIFFUSE | lobes.LABEL_GLOSSY


def refractable(lb, wi, wo):
    """Directions that some facet refracts to, or above the surface.

    Like Cycles', evaluation of rough refraction goes on where the half vector has both directions on one side, or
    is below the surface; sampling never goes there.
    """
    glass = [
        j for j in range(lb.count[0]) if lb.kind[0, j] & layout.KIND_MASK in (layout.GLASS, layout.REFRACTION)
    ]
    if not glass:
        return np.ones(len(wo), np.bool_)
    half = float(lb.data[0, glass[0], layout.IOR]) * wo + wi
    cos_i = half @ wi
    return (wo[:, 2] > 0.0) | ((cos_i * np.sum(half * wo, axis=1) < 0.0) & (cos_i * half[:, 2] > 0.0))


@pytest.mark.parametrize("cosine", VIEWS)
@pytest.mark.parametrize("name", ROUGH)
def test_samples_follow_the_density_and_integrate_the_bsdf(name, cosine):
    """Moments of sampled directions and values are the integrals of pdf and BSDF over the sphere."""
    kind, values, options = ROUGH[name]
    wi = viewer(cosine)
    lb = make_lobes(kind, wi, values, **options)
    wo, solid = sphere(400)
    field = evaluate(lb, wi, wo, 0)
    assert np.all(field >= 0.0) and np.all(np.isfinite(field))
    field[~refractable(lb, wi, wo)] = 0.0
    out, labels = sample(lb, wi, even_numbers(40_000), 0)
    scattered = (labels & SCATTERED) > 0
    clear = lb.transparency[0].mean()
    chance_clear = clear / (clear + lb.data[0, : lb.count[0], layout.SAMPLE].sum())
    assert np.mean((labels & lobes.LABEL_TRANSPARENT) > 0) == pytest.approx(chance_clear, abs=1e-3)

    total = field[:, 3].sum() * solid
    assert total <= 1.0 + 3e-3
    assert np.mean(scattered) == pytest.approx(total, abs=4e-3)
    with np.errstate(divide="ignore", invalid="ignore"):
        throughput = np.where(scattered[:, None], out[:, 3:6] / out[:, 6:7], 0.0)
    for test in (np.ones_like, lambda x: x, lambda x: x * x, lambda x: x > 0.6):
        for axis in range(3):
            expected = (field[:, 3] * test(wo[:, axis])).sum() * solid
            assert np.mean(scattered * test(out[:, axis])) == pytest.approx(expected, abs=8e-3)
            expected = (field[:, :3] * test(wo[:, axis])[:, None]).sum(axis=0) * solid
            found = (throughput * test(out[:, axis])[:, None]).mean(axis=0)
            assert found == pytest.approx(expected, abs=1e-2)


@pytest.mark.parametrize("cosine", VIEWS)
@pytest.mark.parametrize("roughness", [0.1, 0.4, 0.8])
def test_gloss_of_ashikhmin_and_shirley_knows_its_albedo(roughness, cosine):
    wi = viewer(cosine)
    lb = make_lobes(leaves.GLOSSY, wi, {"roughness": roughness}, distribution="ashikhmin_shirley")
    out, _ = sample(lb, wi, even_numbers(40_000), 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = np.where(out[:, 6] > 0.0, out[:, 3] / out[:, 6], 0.0).mean()
    found = albedo_of_phong(lb, np.asarray(wi, np.float64))
    assert found * lb.data[0, 0, layout.WEIGHT] == pytest.approx(exact, abs=0.02)


@pytest.mark.parametrize("name", ROUGH)
def test_sampled_value_and_pdf_are_those_of_evaluate(name):
    kind, values, options = ROUGH[name]
    wi = viewer(0.6)
    lb = make_lobes(kind, wi, values, **options)
    out, labels = sample(lb, wi, even_numbers(500), 0)
    scattered = (labels & SCATTERED) > 0
    field = evaluate(lb, wi, out[scattered, :3], 0)
    assert out[scattered, 3:7] == pytest.approx(field, rel=1e-9)


@pytest.mark.parametrize("roughness", (0.0, 0.005, 0.02, 0.1, 0.3, 0.7, 1.0))
@pytest.mark.parametrize("kind", (leaves.GLOSSY, leaves.GLASS))
def test_white_furnace_loses_nothing(kind, roughness):
    """With compensation, white glossy and glass surfaces return all light, at any roughness and angle."""
    for cosine in (1.0, 0.7, 0.3, 0.1):
        wi = viewer(cosine)
        lb = make_lobes(kind, wi, {"roughness": roughness, **({"ior": 1.5} if kind == leaves.GLASS else {})})
        out, labels = sample(lb, wi, even_numbers(20_000), 0)
        seen = labels != lobes.LABEL_NONE
        assert np.sum(out[seen, 3] / out[seen, 6]) / len(out) == pytest.approx(1.0, abs=8e-3)


@pytest.mark.parametrize("alpha", (2e-5, 1e-4, 1e-3, 1e-2))
@pytest.mark.parametrize("cosine", (1.0, 0.6, 0.05))
def test_density_is_normalised_at_low_roughness(alpha, cosine):
    """The half vectors' density integrates to 1 where single precision would have no digits left."""
    wi = viewer(cosine).astype(np.float64)
    normal = np.float32([0.36, 0.48, 0.8])
    tangent = np.array([0.8, -0.6, 0.0])
    frame = np.stack([tangent, np.cross(normal, tangent), normal.astype(np.float64)])
    wi = (wi @ frame).astype(np.float32)
    lb = make_lobes(
        leaves.GLOSSY, wi, {"roughness": math.sqrt(alpha)}, shading=normal[None], distribution="ggx"
    )
    lb.data[0, 0, layout.ALPHA_X : layout.ALPHA_Y + 1] = alpha
    u, v = even_numbers(20_000)[:, :2].T
    slope = alpha * np.sqrt(u / (1.0 - u))
    density = 1.0 / (math.pi * alpha**2 * (1.0 + (slope / alpha) ** 2) ** 2)
    half = np.stack(
        [slope * np.cos(2 * math.pi * v), slope * np.sin(2 * math.pi * v), np.ones_like(u)], axis=1
    )
    length = np.linalg.norm(half, axis=1)
    half = half / length[:, None] @ frame
    view = wi.astype(np.float64)
    cos_h = half @ view
    wo = 2.0 * cos_h[:, None] * half - view
    pdf = evaluate(lb, wi, wo, 0)[:, 3]
    # d(wo) = 4 cos d(half), d(half) = cos(theta)^3 d(slope)
    estimate = np.mean(np.where(cos_h > 0.0, pdf * 4.0 * cos_h / length**3 / density, 0.0))
    # the tail beyond the horizon is lost; it is alpha's order at grazing view
    assert estimate == pytest.approx(1.0, abs=2e-3 + 2.0 * alpha / cosine)


@pytest.mark.parametrize("name", ("lambert", "oren-nayar", "glossy ggx", "glossy anisotropic", "metallic"))
def test_reciprocity(name):
    """f(a, b) = f(b, a) for models that promise it (compensation of energy and layering do not)."""
    cases = {
        **ROUGH,
        "glossy ggx": (leaves.GLOSSY, {"roughness": 0.5}, {"distribution": "ggx"}),
        "glossy anisotropic": (
            leaves.GLOSSY,
            {"roughness": 0.5, "anisotropy": 0.5},
            {"distribution": "ggx", "tangent": np.float32([[1.0, 0.2, 0.0]])},
        ),
        "metallic": (
            leaves.METALLIC,
            {"base_color": 0.7, "edge_tint": 0.5, "roughness": 0.6},
            {"distribution": "ggx"},
        ),
    }
    kind, values, options = cases[name]
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(2, 200, 3))
    directions[..., 2] = np.abs(directions[..., 2]) + 0.05
    a, b = (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).astype(np.float32)
    there = evaluate(make_lobes(kind, a, values, **options), a, b)[:, :3] / b[:, 2:]
    back = evaluate(make_lobes(kind, b, values, **options), b, a)[:, :3] / a[:, 2:]
    assert there == pytest.approx(back, rel=2e-5)


@pytest.mark.parametrize("roughness, sigma", ((0.0, 0.01), (0.3, 0.3), (1.0, 1.0), (2.0, 1.0)))
def test_velvet_seen_from_above(roughness, sigma):
    """Along the normal half vectors lie halfway to the light, and Ashikhmin's formula is one of its angle alone."""
    wi = np.array([0.0, 0.0, 1.0])
    lb = make_lobes(leaves.SHEEN, wi, {"roughness": roughness}, distribution="ashikhmin")
    theta = np.linspace(0.02, 1.55, 64)
    wo = np.stack([np.sin(theta), np.zeros(64), np.cos(theta)], axis=1)
    half = np.sin(0.5 * theta) ** 2
    facets = np.exp((1.0 - 1.0 / half) / sigma**2) / (math.pi * sigma**2 * half**2)
    expected = 0.25 * facets * np.minimum(1.0, 2.0 * np.cos(theta))
    field = evaluate(lb, wi, wo, 0)
    assert field[:, :3] == pytest.approx(np.tile(expected[:, None], 3), rel=2e-4 if sigma < 0.1 else 1e-5)
    assert field[:, 3] == pytest.approx(np.full(64, 0.5 / math.pi))
    assert np.all(evaluate(lb, wi, wo * [1.0, 1.0, -1.0], 0) == 0.0)
    assert make_lobes(leaves.SHEEN, -wi, {"roughness": 0.5}, distribution="ashikhmin").count[0] == 0


def test_mirror_and_smooth_glass_are_exact():
    wi = viewer(0.6).astype(np.float64)
    lb = make_lobes(leaves.GLOSSY, wi, {"roughness": 0.0})
    out, labels = sample(lb, wi, even_numbers(8), 0)
    assert np.all(labels == (lobes.LABEL_SINGULAR | lobes.LABEL_REFLECT))
    assert out[:, :3] == pytest.approx(np.tile([-wi[0], -wi[1], wi[2]], (8, 1)), abs=1e-6)
    assert out[:, 3] / out[:, 6] == pytest.approx(np.ones(8), abs=1e-5)
    assert np.all(evaluate(lb, wi, out[:, :3], 0) == 0.0)
    assert not lb.flags[0] & lobes.HAS_EVALUATION and lb.flags[0] & lobes.HAS_SINGULAR

    ior = 1.45
    lb = make_lobes(leaves.GLASS, wi, {"roughness": 0.0, "ior": ior})
    out, labels = sample(lb, wi, even_numbers(20_000), 0)
    through = (labels & lobes.LABEL_TRANSMIT) > 0
    cos_t = math.sqrt(1.0 - (1.0 - wi[2] ** 2) / ior**2)
    rs = ((wi[2] - ior * cos_t) / (wi[2] + ior * cos_t)) ** 2
    rp = ((ior * wi[2] - cos_t) / (ior * wi[2] + cos_t)) ** 2
    assert np.mean(~through) == pytest.approx(0.5 * (rs + rp), abs=1e-3)
    assert out[through, 2] == pytest.approx(np.full(through.sum(), -cos_t), abs=1e-6)
    assert out[through, 0] == pytest.approx(np.full(through.sum(), -wi[0] / ior), abs=1e-6)
    assert np.all(out[through, 8] == np.float32(ior)) and np.all(out[~through, 8] == 1.0)


def test_total_reflection_inside_glass():
    wi = viewer(0.3)
    lb = make_lobes(leaves.GLASS, wi, {"roughness": 0.0, "ior": 1.5}, backfacing=True)
    out, labels = sample(lb, wi, even_numbers(64), 0)
    assert np.all(labels == (lobes.LABEL_SINGULAR | lobes.LABEL_REFLECT))
    assert out[:, 3] / out[:, 6] == pytest.approx(np.ones(64), abs=1e-5)
    lb = make_lobes(leaves.REFRACTION, wi, {"roughness": 0.0, "ior": 1.5}, backfacing=True)
    assert np.all(sample(lb, wi, even_numbers(64), 0)[1] == lobes.LABEL_NONE)


def test_matched_index_goes_straight_on():
    wi = viewer(0.5)
    for roughness in (0.0, 0.5):
        lb = make_lobes(leaves.GLASS, wi, {"roughness": roughness, "ior": 1.0})
        out, labels = sample(lb, wi, even_numbers(64), 0)
        assert np.all(labels == (lobes.LABEL_SINGULAR | lobes.LABEL_TRANSMIT))
        assert out[:, :3] == pytest.approx(np.tile(-wi, (64, 1)), abs=1e-6)


def test_sums_of_leaves():
    """Transparency, emission, holdout and the diffuse colour add up over leaves and parts of Principled."""
    wi = viewer(0.7)[None]
    normal = np.float32([[0.0, 0.0, 1.0]])
    view = lobes.View(wi, normal, normal, np.zeros(1, np.bool_), np.zeros(1, np.bool_))
    lb = lobes.allocate(1, 8)
    lobes.reset(lb, view)
    rows = np.arange(1)
    for kind, weight in ((leaves.TRANSPARENT, 0.25), (leaves.EMISSION, 3.0), (leaves.HOLDOUT, 0.5)):
        block = np.full((1, 3), weight, np.float32)
        lobes.append(lb, Leaf(kind, block), rows, view, lobes.load_tables())
    block = make_block(
        leaves.PRINCIPLED, 1, {"weight": 0.5, "alpha": 0.5, "emission": (1.0, 2.0, 4.0), "base_color": 0.6}
    )
    lobes.append(lb, Leaf(leaves.PRINCIPLED, block), rows, view, lobes.load_tables())
    assert lb.transparency[0] == pytest.approx([0.5] * 3)
    assert lb.emission[0] == pytest.approx([3.25, 3.5, 4.0])
    assert lb.holdout[0] == pytest.approx(0.5)
    assert np.all(lb.diffuse_color[0] < 0.15) and np.all(lb.diffuse_color[0] > 0.13)
    assert lb.count[0] == 2 and lb.flags[0] & lobes.HAS_DIFFUSE
    lobes.reset(lb, view)
    assert lb.count[0] == 0 and not lb.emission.any() and not lb.transparency.any() and not lb.holdout.any()
    out, labels = sample(lb, wi, np.full((1, 3), 0.5))
    assert labels[0] == lobes.LABEL_NONE and out[0, 6] == 0.0


def test_caustics_switches_apply_to_diffuse_rays_only():
    wi = np.tile(viewer(0.7), (2, 1))
    normal = np.tile(np.float32([0.0, 0.0, 1.0]), (2, 1))
    view = lobes.View(wi, normal, normal, np.zeros(2, np.bool_), np.array([False, True]))
    tables = lobes.load_tables()
    for kind, reflective, refractive, expected in (
        (leaves.GLOSSY, False, True, [1, 0]),
        (leaves.GLASS, False, False, [1, 0]),
        (leaves.REFRACTION, True, False, [1, 0]),
        (leaves.PRINCIPLED, False, True, [2, 1]),
    ):
        lb = lobes.allocate(2, 7)
        lobes.reset(lb, view)
        leaf = Leaf(
            kind, make_block(kind, 1, {"roughness": 0.3, "ior": 1.4} if kind != leaves.GLOSSY else {})
        )
        lobes.append(lb, leaf, np.arange(2), view, tables, reflective, refractive)
        assert list(lb.count) == expected


def test_displaced_surfaces_have_no_bumped_terminator():
    """Displacement shown as bump is the surface's own normal: nothing leaks through or softens that is not below it."""
    wi = viewer(0.7)[None]
    tilted = np.float32([[0.6, 0.0, 0.8]])
    wo = np.float64([[0.99, 0.0, 0.141], [0.995, 0.0, -0.0999]])
    bumped, displaced = (
        evaluate(make_lobes(leaves.DIFFUSE, wi, {}, normal=tilted, surface_normal=surface), wi, wo, 0)[:, 0]
        for surface in (None, tilted)
    )
    assert displaced == pytest.approx(wo @ tilted[0] / np.pi, rel=1e-4)
    assert bumped[0] < 0.7 * displaced[0] and bumped[1] == 0


def test_a_full_point_keeps_what_it_has():
    wi = viewer(0.7)[None]
    normal = np.float32([[0.0, 0.0, 1.0]])
    view = lobes.View(wi, normal, normal, np.zeros(1, np.bool_), np.zeros(1, np.bool_))
    lb = lobes.allocate(1, 1)
    lobes.reset(lb, view)
    for _ in range(3):
        lobes.append(
            lb,
            Leaf(leaves.DIFFUSE, make_block(leaves.DIFFUSE, 1, {})),
            np.arange(1),
            view,
            lobes.load_tables(),
        )
    assert lb.count[0] == 1


def test_bumped_diffuse_does_not_leak_through_the_surface():
    """A tilted shading normal lights nothing behind the smooth surface, and fades toward its horizon."""
    wi = viewer(1.0)[None]
    tilted = np.float32([[math.sin(0.9), 0.0, math.cos(0.9)]])
    lb = make_lobes(leaves.DIFFUSE, wi, {}, normal=tilted)
    angle = np.linspace(0.0, math.pi, 181)
    wo = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    value = evaluate(lb, wi, wo, 0)[:, 0]
    plain = np.maximum(wo @ tilted[0], 0.0) / math.pi
    assert np.all(value[wo[:, 2] < -1e-9] == 0.0)
    assert np.all(value <= plain + 1e-7) and value[0] == pytest.approx(plain[0], rel=1e-6)
    assert value[88] < 0.2 * plain[88]


@pytest.mark.parametrize("seed", range(3))
def test_extremes_stay_finite(seed):
    """Any input within reach of a shader: no NaN, infinity or negative value, unit directions, positive densities."""
    rng = np.random.default_rng(seed)
    n = 20_000

    def mixed(low, high, *edges, shape=()):
        x = rng.uniform(low, high, (n, *shape))
        edges = np.array([low, high, *edges])
        return np.where(rng.random((n, *shape)) < 0.4, edges[rng.integers(len(edges), size=(n, *shape))], x)

    values = {
        "base_color": mixed(0.0, 1.0, 5.0, shape=(3,)),
        "metallic": mixed(0.0, 1.0),
        "roughness": mixed(0.0, 1.0, 1e-5, 3.8e-3, 1e-2),
        "ior": mixed(0.2, 5.0, 1.0, 1.0001, 0.9999),
        "alpha": mixed(0.0, 1.0),
        "diffuse_roughness": mixed(0.0, 1.0),
        "subsurface_weight": mixed(0.0, 1.0),
        "specular_ior_level": mixed(0.0, 2.0, 0.5),
        "specular_tint": mixed(0.0, 2.0, shape=(3,)),
        "anisotropic": mixed(0.0, 1.0),
        "anisotropic_rotation": mixed(0.0, 1.0),
        "transmission_weight": mixed(0.0, 1.0),
        "coat_weight": mixed(0.0, 2.0),
        "coat_roughness": mixed(0.0, 1.0),
        "coat_ior": mixed(0.5, 4.0, 1.0),
        "coat_tint": mixed(0.0, 1.0, shape=(3,)),
        "sheen_weight": mixed(0.0, 1.0),
        "sheen_roughness": mixed(0.0, 1.0),
        "sheen_tint": mixed(0.0, 1.0, shape=(3,)),
        "thin_film_thickness": mixed(0.0, 2000.0, 0.5),
        "thin_film_ior": mixed(0.5, 3.0, 1.0),
    }

    def directions(least):
        d = rng.normal(size=(n, 3))
        d[:, 2] = np.abs(d[:, 2]) * 10.0 ** rng.uniform(least, 0.0, n)
        return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)

    wi, normal, smooth = directions(-6), directions(-3), directions(-1)
    smooth = np.where(rng.random((n, 1)) < 0.5, np.float32([0.0, 0.0, 1.0]), smooth)
    geometric = np.tile(np.float32([0.0, 0.0, 1.0]), (n, 1))
    normal = np.where(rng.random((n, 1)) < 0.3, np.float32(0.0), normal)
    values["roughness"] = np.where(rng.random(n) < 0.01, np.nan, values["roughness"])
    lb = make_lobes(
        leaves.PRINCIPLED,
        wi,
        values,
        normal=normal,
        shading=smooth,
        geometric=geometric,
        backfacing=rng.random(n) < 0.5,
        tangent=rng.normal(size=(n, 3)).astype(np.float32),
    )
    assert np.all(np.isfinite(lb.data)) and np.all(np.isfinite(lb.emission)) and np.all(lb.diffuse_color >= 0)
    out, labels = sample(lb, wi, rng.random((n, 3)))
    used = labels != lobes.LABEL_NONE
    assert used.mean() > 0.6
    assert np.all(np.isfinite(out)) and np.all(out[:, 3:7] >= 0.0)
    assert np.all(out[used, 6] > 0.0)
    assert np.linalg.norm(out[used, :3], axis=1) == pytest.approx(np.ones(used.sum()), abs=1e-6)
    wo = rng.normal(size=(n, 3))
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    field = np.concatenate([evaluate(lb, wi, wo), evaluate(lb, wi, out[:, :3])])
    assert np.all(np.isfinite(field)) and np.all(field >= 0.0)


def test_raised_normals_reflect_above_the_surface():
    """Glossy lobes of steeply bumped normals mirror the viewer to above the geometric surface."""
    rng = np.random.default_rng(0)
    n = 2000
    wi = rng.normal(size=(n, 3))
    wi[:, 2] = np.abs(wi[:, 2]) * 0.3 + 0.01
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    normal = rng.normal(size=(n, 3))
    normal[:, 2] = np.abs(normal[:, 2]) + 0.2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    up = np.tile(np.float32([0.0, 0.0, 1.0]), (n, 1))
    lb = make_lobes(leaves.GLOSSY, wi, {"roughness": 0.0}, normal=normal.astype(np.float32), geometric=up)
    lifted = lb.data[:, 0, layout.NORMAL : layout.NORMAL + 3].astype(np.float64)
    mirrored = 2.0 * np.sum(lifted * wi, axis=1, keepdims=True) * lifted - wi
    assert np.all(mirrored[:, 2] > np.minimum(0.9 * wi[:, 2], 0.01) - 1e-5)
    _, labels = sample(lb, wi, rng.random((n, 3)))
    facing = np.sum(lifted * wi, axis=1) > 1e-6
    assert np.all(labels[facing] == (lobes.LABEL_SINGULAR | lobes.LABEL_REFLECT))
