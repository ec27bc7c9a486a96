"""Parts of method "raytrace" by themselves: merging of fragments, the weights of a lobe's sub-rays."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.reconstruction.fragments import Fragments, allocate_fragments
from pointmr_engine.multires.cones.cones import allocate_cones, sub_rays
from pointmr_engine.multires.fragments.merge import merge_fragments
from pointmr_engine.multires.lobes.lobe_cones import allocate_lobe_cones
from pointmr_engine.multires.lobes.lobe_view import weigh_sub_rays
from pointmr_engine.multires.lobes.scatter import CORE, REST, WIDE, WIDEST

# Merging


def fragments(count: int, **values) -> Fragments:
    """Fragments of a plane at depth 2 that faces the camera, each of its own triangle."""
    f = allocate_fragments(count)
    for a in f:
        a[:] = 0
    f.position[:, 2] = 2.0
    f.normal[:] = f.geometric[:] = (0.0, 0.0, -1.0)
    f.triangle[:] = f.entry[:] = np.arange(count)
    for name, value in values.items():
        getattr(f, name)[:] = value
    return f


def merged(ids, f: Fragments, cell: int = 4, footprint: float = 1.0) -> tuple[int, np.ndarray]:
    """(how many are left, ids (height, width)), with the subpixels of each counted first."""
    ids = np.array(ids, np.int32)
    count = len(f.entry)
    f.count[:] = [(ids == k).sum() for k in range(count)]
    into, rank = np.empty(count, np.int32), np.empty(count, np.float32)
    height, width = (np.int64(n) for n in ids.shape)
    left = merge_fragments(
        ids, width, height, np.int64(cell), False, np.float64(footprint), f, np.int64(count), into, rank
    )
    return left, ids


HALVES = np.repeat([[0, 0, 0, 1]], 4, 0)  # 12 subpixels and 4


def test_fragments_of_a_plane_become_one_of_their_weight():
    albedo, place = ((0.0, 0.5, 1.0), (1.0, 0.5, 0.0)), ((-0.5, 0.0, 2.0), (0.5, 0.0, 2.0))
    f = fragments(2, albedo=albedo, position=place, x=(1.0, 3.0))
    count, ids = merged(HALVES, f)
    assert count == 1 and (ids == 0).all()
    assert f.count[0] == 16
    assert f.albedo[0].tolist() == [0.25, 0.5, 0.75]  # 12 to 4
    assert f.position[0].tolist() == [-0.25, 0.0, 2.0]
    assert f.x[0] == 1.5
    assert f.triangle[0] == 0  # of the larger


def test_the_larger_fragment_represents_both():
    f = fragments(2)
    assert merged(1 - HALVES[:, ::-1], f)[0] == 1  # numbered in the order of subpixels: 0 has 4
    assert f.count[0] == 16 and f.triangle[0] == 1


def test_of_small_fragments_the_middle_one_represents_all():
    """What is read at a cell's edge makes fine textures noisy."""
    y, x = np.mgrid[0:4, 0:4] + 0.5
    x[2, 1], y[2, 1] = 2.1, 1.9
    f = fragments(16, x=x.ravel(), y=y.ravel())
    assert merged(np.arange(16).reshape(4, 4), f)[0] == 1
    assert f.triangle[0] == 9


def test_many_fragments_keep_their_sum_and_mean():
    rng = np.random.default_rng(1)
    albedo = rng.random((16, 3)).astype(np.float32)
    f = fragments(16, albedo=albedo)
    count, ids = merged(np.arange(16).reshape(4, 4), f)
    assert count == 1 and f.count[0] == 16 and (ids == 0).all()
    assert f.albedo[0] == pytest.approx(albedo.mean(0), abs=1e-6)


@pytest.mark.parametrize(
    "values",
    [
        {"geometric": ((0, 0, -1), (0, -0.6, -0.8)), "normal": ((0, 0, -1), (0, -0.6, -0.8))},
        {"position": ((0, 0, 2.0), (0, 0, 2.8))},  # farther than 0.75 footprints behind
        {"part": (0, 1)},
        {"normal": ((0, 0, -1), (0, 0, -0.5))},  # a surface, a clump
    ],
)
def test_different_surfaces_stay_apart(values):
    f = fragments(2, **values)
    count, ids = merged(HALVES, f)
    assert count == 2
    assert f.count[:2].tolist() == [12, 4]
    assert (ids == HALVES).all()


def test_the_footprint_decides_what_one_surface_is():
    for footprint, expected in ((1.0, 2), (1.2, 1)):
        assert (
            merged(HALVES, fragments(2, position=((0, 0, 2.0), (0, 0, 2.8))), footprint=footprint)[0]
            == expected
        )


def test_fragments_of_two_cells_stay_apart_and_gaps_stay_empty():
    ids = np.hstack([np.zeros((4, 4), int), np.ones((4, 4), int)])
    ids[0, 0] = -1
    f = fragments(2)
    count, found = merged(ids, f)
    assert count == 2 and f.count[:2].tolist() == [15, 16]
    assert (found == ids).all()


def test_merged_normals_tell_how_they_differ():
    a = 0.15
    normals = ((math.sin(a), 0, -math.cos(a)), (-math.sin(a), 0, -math.cos(a)))
    f = fragments(2, normal=normals, geometric=normals)
    assert merged(np.repeat([[0, 0, 1, 1]], 4, 0), f)[0] == 1
    assert f.normal[0] == pytest.approx([0, 0, -math.cos(a)], abs=1e-6)  # shorter than 1
    assert f.geometric[0] == pytest.approx([0, 0, -math.cos(a)], abs=1e-6)


# Weights of a lobe's sub-rays


def lobe(alpha: float, angle: float):
    """Core and rest of a GGX lobe about z for a viewer `angle` from it, as scatter.scatter_lobes opens them."""
    lobes = allocate_lobe_cones(2, allocate_cones(2))
    c, s = math.cos(angle), math.sin(angle)
    lobes.alpha[:], lobes.part[:] = alpha, (1, 2)
    lobes.normal[:], lobes.incoming[:] = (0, 0, 1), (-s, 0, c)
    lobes.cones.axes[:] = ((c, 0, -s), (0, 1, 0), (s, 0, c))
    wide = min(2 * alpha * CORE, 0.5 * WIDEST)
    for part, w in enumerate((wide, wide * REST / CORE)):
        lobes.cones.spread[part] = min(w, WIDEST), min(w * c, WIDEST)
    return lobes


def exact_lobe(lobes, n: int = 1200):
    """(share within the core, mean direction (3,)) of the lobe, by n x n microfacet normals of its distribution."""
    alpha, i = float(lobes.alpha[0]), lobes.incoming[0].astype(float)
    u, v = ((a.ravel() + 0.5) / n for a in np.indices((n, n)))
    tangent2 = alpha**2 * u / (1 - u)  # of facets, by D(h) cos(h)
    cosine = 1 / np.sqrt(1 + tangent2)
    sine, phi = np.sqrt(1 - cosine**2), 2 * math.pi * v
    h = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], 1)
    ih = h @ i
    o = 2 * ih[:, None] * h - i

    def smith(c):
        return (np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2

    z = np.maximum(o[:, 2], 1e-6)
    weight = np.where((ih > 0) & (o[:, 2] > 0), ih / cosine / (1 + smith(z) + smith(i[2])), 0.0)
    x, y, axis = lobes.cones.axes[0]
    t = o @ axis
    a, b = lobes.cones.spread[0]
    core = (t > 0) & (abs(o @ x) <= a * t) & (abs(o @ y) <= b * t)
    mean = weight @ o
    return weight[core].sum() / weight.sum(), mean / np.linalg.norm(mean)


LOBES = [(alpha, degrees) for alpha in (0.04, 0.1, 0.25) for degrees in (0, 30, 60)]


@pytest.mark.parametrize(("alpha", "degrees"), LOBES)
def test_sub_rays_weigh_what_the_lobe_sends(alpha, degrees):
    lobes = lobe(alpha, math.radians(degrees))
    weigh_sub_rays(lobes, np.int64(2))
    assert (lobes.weights >= 0).all()
    assert lobes.weights.sum() == pytest.approx(1.0, abs=1e-5)
    _, direction, _ = sub_rays(lobes.cones)
    mean = (lobes.weights[..., None] * direction).sum((0, 1))
    mean /= np.linalg.norm(mean)
    share, expected = exact_lobe(lobes)
    # what wide lobes send to the side is cut off by the widest cone
    assert lobes.weights[0].sum() == pytest.approx(share, abs=0.02 if alpha <= 0.1 else 0.05)
    assert math.acos(min(mean @ expected, 1.0)) < 0.25 * alpha


def test_a_lobe_that_is_one_cone_sums_to_one():
    lobes = lobe(0.1, 0.5)
    lobes.part[:] = 0
    lobes.cones.spread[:] = 2 * 0.1 * WIDE
    lobes.normal[1] = 0  # and one that transmits
    weigh_sub_rays(lobes, np.int64(2))
    assert lobes.weights.sum(1) == pytest.approx(1.0, abs=1e-5)
    assert np.ptp(lobes.weights, 1).min() > 0.01
    lobes.alpha[:] = 0.0
    weigh_sub_rays(lobes, np.int64(2))
    assert (lobes.weights == 1 / 64).all()


@given(st.floats(0.02, 0.3), st.floats(0.0, 1.3), st.floats(-1.5, 1.5))
def test_of_lobes_that_bumps_tilt_what_goes_below_the_surface_is_lost(alpha, angle, tilt):
    whole, cut = lobe(alpha, angle), lobe(alpha, angle)
    weigh_sub_rays(whole, np.int64(2))
    cut.side[:] = (math.sin(tilt), 0.0, math.cos(tilt))
    weigh_sub_rays(cut, np.int64(2))
    _, direction, _ = sub_rays(cut.cones)
    leaves = direction @ cut.side[0]
    clear = abs(leaves) > 1e-6
    expected = np.where(leaves > 0, whole.weights, 0.0)
    np.testing.assert_allclose(cut.weights[clear], expected[clear], rtol=1e-6)


def test_the_rest_leaves_the_core_out():
    """The core covers 0.8 x 0.8 of the four middle cells of the rest: what is left of them is dimmer than the core."""
    lobes = lobe(0.1, 0.0)
    weigh_sub_rays(lobes, np.int64(2))
    rest = lobes.weights[1].reshape(8, 8)
    whole = lobe(0.1, 0.0)
    whole.part[:] = 0
    weigh_sub_rays(whole, np.int64(2))
    middle, all_of_it = rest[3:5, 3:5].sum(), whole.weights[1].reshape(8, 8)[3:5, 3:5].sum()
    assert 0.0 < middle < 0.1 * all_of_it
    assert rest.sum() > middle
