"""Surface attributes at hits: frames under any transform, layers, tangents, footprints, and only what is asked for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from instanced import accelerate, cast, nest, random_mesh, random_transforms, sphere

from pointmr_engine.hierarchy.placements import placements, times_placed
from pointmr_engine.raytracing import surface
from pointmr_engine.raytracing.frames import veil_frames
from pointmr_engine.scene.group import CAMERA, Group, Instances, instance
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Attribute, Mesh
from pointmr_engine.shading.points import SurfacePoints

seeds = st.integers(0, 2**32 - 1)


def seen(root: Group, origin, direction, **values):
    """(geometry, rays, hits, frames) of rays into a scene."""
    geometry, acceleration = accelerate(root)
    rays, hits = cast(acceleration, origin, direction, **values)
    frames = surface.allocate_frames(len(rays.origin))
    surface.frames(geometry, rays, hits, frames)
    return geometry, rays, hits, frames


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.0, 1e6]))
def test_frames_under_any_transform(seed, offset):
    rng = np.random.default_rng(seed)
    p, t = sphere(24, 32)
    m = np.eye(4)
    m[:3] = random_transforms(rng, 1, (0.1, 10.0))[0]
    m[:3, 3] = rng.normal(size=3) + offset
    mesh = Mesh("ball", p, t, normals=p)
    inside = m[:3, 3] + 1e-3 * rng.normal(size=3)
    outward = rng.normal(size=(200, 3))
    _, rays, hits, frames = seen(Group("root", [], [instance(Group("g", [mesh]), m)]), inside, outward)
    assert (hits.triangle >= 0).all()
    scale = np.abs(m[:3, :3]).max()
    np.testing.assert_allclose(
        frames.position, rays.origin + rays.direction * hits.t[:, None], atol=1e-5 * scale
    )
    inverse = np.linalg.inv(m[:3, :3])
    corners = p[t[hits.triangle]].astype(np.float64)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ inverse
    np.testing.assert_allclose(frames.geometric_normal, unit(flat), atol=1e-5)
    # outward normals stay outward, mirrored or not, and the smooth ones are those of the ellipsoid
    local = (frames.position - m[:3, 3]) @ inverse.T
    smooth = unit(local @ inverse)
    assert np.abs(frames.smooth_normal - smooth).max() < 0.1
    assert ((frames.geometric_normal * smooth).sum(1) > 0.9).all()
    assert frames.backfacing.all()  # seen from inside
    assert (frames.offset > 0).all() and (frames.offset < 1e-9 * (scale + abs(offset))).all()
    # positions are exact: on the triangle's plane to double precision
    height = ((frames.position - m[:3, 3]) @ inverse.T - corners[:, 0]) * unit(flat @ m[:3, :3])
    assert np.abs(height.sum(1)).max() < 1e-7 if offset else 1e-12


def test_materials_by_slot():
    a, b = Material("a", pass_index=3), Material("b")
    p = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    p = np.concatenate([p + [2 * i, 0, 0] for i in range(4)]).astype(np.float32)
    t = np.arange(12, dtype=np.int32).reshape(4, 3)
    mesh = Mesh("m", p, t, materials=(a, b, None), material_index=np.array([1, 0, 2, 99], np.int32))
    bare = Mesh("bare", p + np.float32([0, 5, 0]), t)
    origin = [[2 * i + 0.2, y + 0.2, 1] for y in (0, 5) for i in range(4)] + [[50, 0, 1]]
    geometry, rays, hits, frames = seen(Group("root", [mesh, bare]), origin, [0, 0, -1])
    found = [geometry.materials[i] if i >= 0 else "miss" for i in frames.material]
    assert found == [b, a, None, None, None, None, None, None, "miss"]


def quad(**values) -> Mesh:
    p = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], np.float32)
    t = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = (p[t][..., :2] * [0.5, 3]).astype(np.float32)
    return Mesh("quad", p, t, uvs={"Map": uv}, active_uv="Map", **values)


ALL = (
    "position normal smooth_normal geometric_normal incoming backfacing generated local barycentric footprint "
    "object_location object_color object_index object_random ray_kind ray_length ray_depth diffuse_depth glossy_depth "
    "transmission_depth transparent_depth window world_from_part camera_from_world moved uv: uv:Map uv:Other "
    "uv_footprint:Map tangent:Map attribute:weight attribute:colour attribute:none instance_attribute:tint"
).split()


def test_only_what_is_asked_for_is_filled():
    geometry, rays, hits, frames = seen(Group("root", [quad()]), [0.5, 0.25, 1], [0, 0, -1])
    state = surface.allocate_ray_state(1)
    index = np.arange(1)
    everything = surface.gather(geometry, rays, hits, frames, index, frozenset(ALL), state)
    blank = SurfacePoints(count=1)
    for need in ALL:
        points = surface.gather(geometry, rays, hits, frames, index, frozenset([need]), state)
        filled = [n for n in vars(blank) if not _same(getattr(points, n), getattr(blank, n))]
        assert len(filled) == 1, (need, filled)
        field, name = filled[0], need.partition(":")[2]
        value, whole = getattr(points, field), getattr(everything, field)
        if isinstance(value, dict):
            value, whole = value[name], whole[name]
        if field != "moved":
            np.testing.assert_array_equal(value, whole)
            assert len(value) == (3 if field == "camera_from_world" else 1)
    with pytest.raises(KeyError, match="nonsense"):
        surface.gather(geometry, rays, hits, frames, index, frozenset(["nonsense"]), state)


def test_what_hits_tell_takes_neither_rays_nor_frames():
    geometry, rays, hits, frames = seen(Group("root", [quad()]), [0.5, 0.25, 1], [0, 0, -1])
    state, index = surface.allocate_ray_state(1), np.arange(1)
    told = frozenset(need for need in ALL if surface.told_by_hits(frozenset([need])))
    assert {"uv:", "attribute:weight", "generated", "object_random", "world_from_part"} <= told
    assert not {"position", "incoming", "uv_footprint:Map", "moved", "ray_kind", "ray_length"} & told
    whole = surface.gather(geometry, rays, hits, frames, index, told, state)
    nothing = surface.Frames(*(None for _ in frames))
    alone = surface.gather(geometry, None, hits, nothing, index, told)
    for name, value in vars(whole).items():
        np.testing.assert_equal(getattr(alone, name), value)


@settings(max_examples=20)
@given(seeds)
def test_veils_have_the_offsets_and_materials_of_frames(seed):
    rng = np.random.default_rng(seed)
    materials = tuple(Material(f"m{k}") for k in range(3))
    mesh = random_mesh(
        rng, 60, 2.0, materials=materials, material_index=rng.integers(0, 3, 60).astype(np.int32)
    )
    root = nest(rng, 2, Group("leaf", [mesh]))
    geometry, _, hits, frames = seen(root, np.zeros(3), rng.normal(size=(300, 3)))
    rows = np.flatnonzero(hits.triangle >= 0)
    veils = surface.allocate_frames(len(rows))
    met = hits._replace(**{name: column[rows] for name, column in zip(hits._fields, hits, strict=True)})
    veil_frames(geometry, met, len(rows), veils)
    np.testing.assert_array_equal(veils.offset, frames.offset[rows])
    np.testing.assert_array_equal(veils.material, frames.material[rows])


def _same(a, b) -> bool:
    return a is b or (isinstance(a, dict | int) and a == b)


def test_layers_of_every_domain():
    attributes = {
        "vertex": Attribute(np.array([[0], [2], [2], [0]], np.float32), "vertex"),
        "face": Attribute(np.array([[1, 2, 3], [4, 5, 6]], np.float32), "face"),
        "constant": Attribute(np.array([[0.1, 0.2]], np.float32), "constant"),
        "corner": Attribute(np.arange(24, dtype=np.float32).reshape(6, 4), "corner"),
    }
    mesh, other = quad(attributes=attributes), sphere()
    root = Group("root", [mesh, Mesh("far", other[0] + np.float32([0, 0, -50]), other[1])])
    geometry, rays, hits, frames = seen(
        root, [[1.5, 0.25, 1], [0.5, 0.75, 1], [0.1, -9.8, 1]], [[0, 0, -1], [0, 0, -1], [0, 0.2, -1]]
    )
    needs = frozenset(["uv:Map", "attribute:Map", *(f"attribute:{n}" for n in [*attributes, "none", ""])])
    points = surface.gather(geometry, rays, hits, frames, np.arange(3), needs)
    xy = frames.position[:2, :2]
    np.testing.assert_allclose(points.uvs["Map"][:2], xy * [0.5, 3], atol=1e-6)
    np.testing.assert_allclose(points.attributes["Map"][:2], np.c_[xy * [0.5, 3], [0, 0], [1, 1]], atol=1e-6)
    np.testing.assert_allclose(points.attributes["vertex"][:2], np.c_[xy[:, [0, 0, 0]], [1, 1]], atol=1e-6)
    assert points.attributes["face"].tolist()[:2] == [[1, 2, 3, 1], [4, 5, 6, 1]]
    np.testing.assert_allclose(points.attributes["constant"][0], [0.1, 0.2, 0, 1])
    w = np.array([1 - hits.u[0] - hits.v[0], hits.u[0], hits.v[0]])
    corners = attributes["corner"].values.reshape(2, 3, 4)
    np.testing.assert_allclose(points.attributes["corner"][0], w @ corners[0], rtol=1e-5)
    np.testing.assert_array_equal(points.attributes[""], points.attributes["corner"])  # the active colours
    assert not points.attributes["none"].any()
    assert hits.part[2] == 1 and not points.uvs["Map"][2].any() and not points.attributes["corner"][2].any()


def test_object_and_ray_values():
    m = np.eye(4)
    m[:3, 3] = 5, 0, 0
    given_color = np.array([0.1, 0.2, 0.3, 0.4], np.float32)
    tint = {"tint": np.array([[0.5, 0.6, 0.7]], np.float32)}
    leaf = Group("leaf", [], [instance(Group("inner", [quad()]), np.diag([1, 1, 1, 1]))])
    batch = instance(leaf, m, color=given_color, object_index=8, seed=2**31, attributes=tint)
    geometry, rays, hits, frames = seen(Group("root", [], [batch]), [5.5, 0.25, -2], [0, 0, 1])
    state = surface.allocate_ray_state(1, np.eye(4) * 2)
    state.length[:], state.width[:], state.spread[:], state.window[:], state.glossy_depth[:] = (
        10,
        0.5,
        0.25,
        0.3,
        4,
    )
    points = surface.gather(geometry, rays, hits, frames, np.array([0]), frozenset(ALL), state)
    np.testing.assert_allclose(points.object_location, [[5, 0, 0]])
    np.testing.assert_array_equal(points.object_color[0], given_color)
    assert points.object_index[0] == 8 and points.object_random[0] == 0.5
    # an attribute of an outer placement is found through inner ones without any
    np.testing.assert_allclose(points.instance_attributes["tint"], [[0.5, 0.6, 0.7, 1]])
    assert points.ray_length[0] == 12 and points.footprint[0] == 1.0 and points.glossy_depth[0] == 4
    np.testing.assert_allclose(points.local, [[0.5, 0.25, 0]])
    np.testing.assert_allclose(points.generated, [[0.25, 0.25, 0]])
    np.testing.assert_array_equal(points.camera_from_world, np.eye(4)[:3] * 2)
    assert points.backfacing[0] and frames.backfacing[0]
    np.testing.assert_array_equal(points.incoming, [[0, 0, -1]])
    np.testing.assert_array_equal(points.normal, [[0, 0, -1]])
    np.testing.assert_array_equal(points.smooth_normal, [[0, 0, 1]])
    np.testing.assert_array_equal(points.geometric_normal, [[0, 0, -1]])
    # the quad spans 2 x 1 metres and 1 x 3 in UV: sqrt(3/2) per metre
    assert points.uv_footprints["Map"][0] == pytest.approx(np.sqrt(1.5), rel=1e-5)


@pytest.mark.parametrize("mirror", [False, True])
def test_tangents_follow_u_and_mirror(mirror):
    m = np.eye(4)
    m[:3] = random_transforms(np.random.default_rng(2), 1, (1.0, 1.0))[0]
    q, _ = np.linalg.qr(m[:3, :3])
    m[:3, :3] = q * np.linalg.det(q) * 2.0
    if mirror:
        m[:3, 0] *= -1
    eye = m @ [0.5, 0.25, 1, 1]
    geometry, rays, hits, frames = seen(
        Group("root", [], [instance(Group("g", [quad()]), m)]), eye[:3], -m[:3, 2]
    )
    points = surface.gather(
        geometry,
        rays,
        hits,
        frames,
        np.array([0]),
        frozenset(["tangent:Map", "tangent:none", "smooth_normal"]),
    )
    tangent = points.tangents["Map"][0]
    np.testing.assert_allclose(tangent[:3], m[:3, 0] / 2, atol=1e-6)
    across = np.cross(points.smooth_normal[0], tangent[:3]) * tangent[3]
    np.testing.assert_allclose(across, m[:3, 1] / 2, atol=1e-6)
    assert not points.tangents["none"][0, :3].any()


def test_tangents_are_smooth_where_normals_are_and_break_at_seams():
    p, t = sphere(20, 24)
    polar = np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi) % 1
    uv = np.stack([polar, np.arccos(np.clip(p[:, 2], -1, 1)) / np.pi], 1)[t].astype(np.float32)
    wide = np.ptp(uv[..., 0], axis=1) > 0.5  # the seam
    uv[..., 0] = np.where(wide[:, None] & (uv[..., 0] < 0.5), uv[..., 0] + 1, uv[..., 0])
    mesh = Mesh("ball", p, t, normals=p, uvs={"Map": uv})
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(500, 3))
    direction[:, 2] *= 0.3
    geometry, rays, hits, frames = seen(Group("root", [mesh]), 3 * unit(direction), -direction)
    points = surface.gather(
        geometry, rays, hits, frames, np.arange(500), frozenset(["tangent:Map", "normal"])
    )
    east = unit(np.cross([0, 0, 1], points.normal))
    assert ((points.tangents["Map"][:, :3] * east).sum(1) > 0.99).all()
    np.testing.assert_allclose(np.linalg.norm(points.tangents["Map"][:, :3], axis=1), 1, atol=1e-5)


@settings(max_examples=10)
@given(seeds)
def test_moved_points_stay_in_the_plane_and_move_everything(seed):
    rng = np.random.default_rng(seed)
    m = np.eye(4)
    m[:3] = random_transforms(rng, 1, (0.5, 2.0))[0]
    target = (m @ [0.7, 0.4, 0, 1])[:3]
    geometry, rays, hits, frames = seen(
        Group("root", [], [instance(Group("g", [quad()]), m)]),
        target + rng.normal(size=3) + m[:3, 2],
        [0, 0, 1],
    )
    geometry, rays, hits, frames = seen(
        Group("root", [], [instance(Group("g", [quad()]), m)]), rays.origin, target - rays.origin
    )
    state = surface.allocate_ray_state(1)
    points = surface.gather(geometry, rays, hits, frames, np.array([0]), frozenset(ALL), state)
    step = m[:3, 0] * 0.01 + m[:3, 1] * 0.02
    there = points.moved(step[None])
    np.testing.assert_allclose(there.position - points.position, step[None], atol=1e-9)
    np.testing.assert_allclose(there.uvs["Map"] - points.uvs["Map"], [[0.005, 0.06]], atol=1e-6)
    np.testing.assert_allclose(there.local - points.local, [[0.01, 0.02, 0]], atol=1e-6)
    np.testing.assert_allclose(there.generated - points.generated, [[0.005, 0.02, 0]], atol=1e-6)
    np.testing.assert_array_equal(there.geometric_normal, points.geometric_normal)
    assert there.object_index is points.object_index and there.ray_length is points.ray_length
    np.testing.assert_array_equal(points.moved(np.zeros((1, 3))).position, points.position)
    np.testing.assert_allclose(there.moved(step[None]).position - there.position, step[None], atol=1e-9)


@pytest.mark.parametrize("behind", [False, True])
def test_bumps_move_all_that_textures_lie_by(behind):
    """Seen from behind, what is stored with the mesh goes the other way, and nothing that is asked for gets lost."""
    side = -1.0 if behind else 1.0
    geometry, rays, hits, frames = seen(Group("root", [quad()]), [0.7, 0.4, side], [0, 0, -side])
    points = surface.gather(
        geometry, rays, hits, frames, np.array([0]), frozenset(ALL), surface.allocate_ray_state(1)
    )
    assert points.backfacing[0] == behind
    there = points.moved(
        np.array([[0.01, 0.02, 0.0]]), frozenset({"local", "generated", "uv:Map"}), bump=True
    )
    np.testing.assert_allclose(there.local - points.local, [[0.01, 0.02, 0]], atol=1e-6)
    np.testing.assert_allclose(
        there.generated - points.generated, [[side * 0.005, side * 0.02, 0]], atol=1e-6
    )
    np.testing.assert_allclose(there.uvs["Map"] - points.uvs["Map"], [[side * 0.005, side * 0.06]], atol=1e-6)


@settings(max_examples=10)
@given(seeds)
@example(446173644)  # a point 0.01 from the viewer, in a mesh of 16
def test_points_anywhere_are_those_of_hits(seed):
    rng = np.random.default_rng(seed)
    mesh = random_mesh(rng, 40)
    mesh.uvs["Map"] = rng.random((40, 3, 2)).astype(np.float32)
    mesh.normals = unit(rng.normal(size=(40, 3, 3))).astype(np.float32)
    root = nest(rng, 2, Group("leaf", [mesh]))
    origin = rng.normal(size=(300, 3)) * 8
    geometry, rays, hits, frames = seen(root, origin, rng.normal(size=(300, 3)) * 2 - origin)
    k = np.flatnonzero(hits.triangle >= 0)
    needs = frozenset(ALL) - {"moved"}
    points = surface.gather(geometry, rays, hits, frames, k, needs, surface.allocate_ray_state(300))
    free = surface.points_at(
        geometry,
        hits.part[k],
        hits.triangle[k],
        hits.u[k],
        hits.v[k],
        hits.world_from_part[k],
        needs,
        rays.origin[k],
    )
    np.testing.assert_array_equal(free.position, points.position)
    np.testing.assert_array_equal(free.backfacing, points.backfacing)
    np.testing.assert_array_equal(free.normal, points.normal)
    np.testing.assert_array_equal(free.uvs["Map"], points.uvs["Map"])
    # weights in float32 place a point as well as its triangle is large: seen from near by, directions differ by more
    length, large = points.ray_length[:, None].astype(float), np.abs(points.position).max()
    np.testing.assert_allclose(free.incoming * length, points.incoming * length, atol=1e-6 * large, rtol=0)
    np.testing.assert_allclose(free.ray_length, points.ray_length, rtol=1e-4)
    for name, value in vars(points).items():
        assert (value is None) == (getattr(free, name) is None), name
    alone = surface.points_at(
        geometry,
        hits.part[k],
        hits.triangle[k],
        hits.u[k],
        hits.v[k],
        hits.world_from_part[k],
        frozenset(["backfacing"]),
    )
    assert not alone.backfacing.any()


def test_degenerate_attributes_never_give_nan():
    p = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    t = np.array([[0, 1, 2]], np.int32)
    mesh = Mesh("m", p, t, normals=np.zeros((3, 3), np.float32), uvs={"Map": np.zeros((1, 3, 2), np.float32)})
    geometry, rays, hits, frames = seen(Group("root", [mesh]), [0.2, 0.2, 1], [0, 0, -1])
    np.testing.assert_array_equal(frames.smooth_normal, frames.geometric_normal)
    points = surface.gather(
        geometry, rays, hits, frames, np.array([0]), frozenset(ALL), surface.allocate_ray_state(1)
    )
    for name, value in vars(points).items():
        for array in value.values() if isinstance(value, dict) else [value]:
            if isinstance(array, np.ndarray) and array.dtype.kind == "f":
                assert np.isfinite(array).all(), name


def test_placements_are_what_rays_find():
    rng = np.random.default_rng(8)
    lit, dark = random_mesh(rng, 10), random_mesh(rng, 10)
    leaf = Group("leaf", [lit, dark])
    batch = Instances(
        (leaf, Group("unlit", [dark])),
        random_transforms(rng, 6),
        group_index=np.array([0, 1, 0, 0, 1, 0], np.int32),
        object_index=np.array([1, 2, -1, 4, 5, 6], np.int32),
        seed=rng.integers(0, 9, 6).astype(np.uint32),
        color=rng.random((6, 4)).astype(np.float32),
        visibility=np.array([63, 63, 0, CAMERA, 63, 63], np.uint8),
    )
    middle = Group("middle", [], [batch])
    flat = random_transforms(rng, 3)
    flat[1, :, 0] = 0  # singular
    root = Group("root", [], [Instances((middle,), flat, object_index=np.array([7, 8, 9], np.int32))])
    geometry, acceleration = accelerate(root)
    found = placements(geometry, np.array([mesh is lit for mesh in geometry.parts]))
    assert len(found.part) == 2 * 3  # 2 of 3 outer, 3 of 6 inner: lit, visible
    assert list(times_placed(geometry)) == [3 * 4 if mesh is lit else 3 * 6 for mesh in geometry.parts]
    assert len(placements(geometry, np.ones(2, np.bool_), limit=4).part) == 4
    assert not len(placements(geometry, np.zeros(2, np.bool_)).part)
    by_path = {int(path): i for i, path in enumerate(found.path)}
    corners = lit.positions[lit.triangles].mean(1)
    for i in range(len(found.part)):
        target = corners @ found.world_from_part[i][:, :3].T + found.world_from_part[i][:, 3]
        away = target + rng.normal(size=target.shape) * 1e-3
        _, hits = cast(acceleration, away, target - away)
        for k in np.flatnonzero((hits.triangle >= 0) & (hits.part == found.part[i])):
            j = by_path[int(hits.path[k])]
            np.testing.assert_allclose(hits.world_from_part[k], found.world_from_part[j], rtol=1e-12)
            assert hits.object_index[k] == found.object_index[j] and hits.seed[k] == found.seed[j]
            assert hits.instance[k] == found.instance[j]
            np.testing.assert_array_equal(hits.color[k], found.color[j])
