"""Vector box and triangle tests against plain formulas, and rays brought into local single precision spaces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from pointmr_engine.hierarchy.acceleration import aligned_empty
from pointmr_engine.numerics.intersect import PAD, localize, shear_of
from pointmr_engine.numerics.pointers import address_of, load_f32, load_i32, pointer_f64, store_f32
from pointmr_engine.numerics.simd import slab_test, trailing_zeros, triangle_test
from pointmr_engine.numerics.transforms import append_transform, cofactors, is_singular, ray_into

seeds = st.integers(0, 2**32 - 1)


@njit(nogil=True, error_model="numpy")
def _boxes(boxes, o, d, radius, t_min, t_max, entry):
    length, shift, pad, _, _, near, scale, first, last = localize(o[0], o[1], o[2], d[0], d[1], d[2], radius)
    low, high = np.float32(t_min * length - shift - pad), np.float32(t_max * length - shift + pad)
    return slab_test(boxes, np.int64(1), near, scale, first, last, low, high, entry)


@njit(nogil=True, error_model="numpy")
def _triangles(blocks, o, d, radius, result):
    length, shift, _, origin, direction, _, scale, _, _ = localize(o[0], o[1], o[2], d[0], d[1], d[2], radius)
    axes, sheared, shear = shear_of(origin, direction, scale)
    zero, far = np.float32(-shift), np.float32(1e30)
    return triangle_test(blocks, np.int64(1), axes, sheared, shear, zero, far, result), shift, length


@settings(max_examples=200)
@given(seeds, st.sampled_from([0.3, 3.0, 1e6]), st.integers(0, 3))
def test_boxes_that_are_met_are_never_missed(seed, distance, flat_axes):
    rng = np.random.default_rng(seed)
    node = aligned_empty((2, 48), np.float32)
    center, half = rng.uniform(-1, 1, (8, 3)), rng.uniform(0, 0.3, (8, 3))
    lower, upper = (center - half).astype(np.float32), (center + half).astype(np.float32)
    node[1].reshape(2, 3, 8)[:] = lower.T, upper.T
    direction = rng.normal(size=3)
    direction[rng.permutation(3)[: min(flat_axes, 2)]] = 0
    # aim at a point on a box, corners among them: rounding must never lose it
    target = (
        np.where(rng.random(3) < 0.5, lower[3], upper[3]) if seed % 2 else rng.uniform(lower[3], upper[3])
    )
    origin = target - direction * distance
    entry = np.empty(8, np.float32)
    mask = _boxes(address_of(node), origin, direction, 1.4, 0.0, np.inf, address_of(entry))
    assert mask >> 3 & 1
    with np.errstate(all="ignore"):
        t0, t1 = (lower - origin) / direction, (upper - origin) / direction
        enter = np.fmax.reduce(np.fmin(t0, t1), axis=1)
        leave = np.fmin.reduce(np.fmax(t0, t1), axis=1)
    clearly_missed = (leave < -1e-3 * (1 + 1e-3 * distance)) | (enter - leave > 1e-3 * (1 + 1e-3 * distance))
    clearly_missed[3] = False  # where 0 / 0 may have appeared
    assert not any(mask >> i & 1 for i in np.flatnonzero(clearly_missed))
    behind = _boxes(address_of(node), origin, -direction, 1.4, 0.0, np.inf, address_of(entry))
    outside = ((origin < lower - 1e-3) | (origin > upper + 1e-3)).any(1)
    assert not (behind >> 3 & 1 and outside[3] and distance == 1e6)


@settings(max_examples=200)
@given(seeds, st.sampled_from([0.5, 1e4]), st.booleans())
def test_triangles_against_exact_weights(seed, distance, axis_aligned):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (8, 3, 3)).astype(np.float32)
    corners[6:] = np.nan  # unused lanes
    block = aligned_empty((2, 72), np.float32)
    block[1].reshape(3, 3, 8)[:] = corners.transpose(1, 2, 0)
    weights = rng.dirichlet(np.ones(3))
    target = weights @ corners[0].astype(float)
    direction = np.eye(3)[seed % 3] * (1 if seed % 2 else -1) if axis_aligned else rng.normal(size=3)
    origin = target - direction * distance
    result = np.empty(24, np.float32)
    mask, shift, length = _triangles(address_of(block), origin, direction, 1.0, address_of(result))
    assert not mask & 0b11000000
    a = corners[:6, 0].astype(float)
    e1, e2 = corners[:6, 1] - a, corners[:6, 2] - a
    p = np.cross(direction, e2)
    det = (e1 * p).sum(1)
    u = ((origin - a) * p).sum(1) / det
    q = np.cross(origin - a, e1)
    v, t = q @ direction / det, (e2 * q).sum(1) / det
    steep = np.abs(det) / np.linalg.norm(direction) > 0.05
    inside = np.minimum(np.minimum(u, v), 1 - u - v)
    for i in np.flatnonzero(steep & (t > 1e-3)):
        if inside[i] > 1e-3:
            assert mask >> i & 1
            assert abs(result[8 + i] - u[i]) < 1e-4 and abs(result[16 + i] - v[i]) < 1e-4
            assert abs((result[i] + shift) / length - t[i]) < 1e-4 / length
        elif inside[i] < -1e-3:
            assert not mask >> i & 1


def test_padding_exceeds_the_rounding_it_stands_for():
    assert PAD > 12 * 2.0**-24


@njit(nogil=True)
def _first_bit(mask):
    return trailing_zeros(mask)


@njit(nogil=True)
def _copied(source, target, n):
    for i in range(n):
        store_f32(target, i, load_f32(source, i) * np.float32(2) + np.float32(load_i32(source, i) * 0))


def test_bits_and_addresses():
    assert [_first_bit(m) for m in (1, 2, 128, 0b10100)] == [0, 1, 7, 2]
    a, b = np.arange(5, dtype=np.float32), np.zeros(5, np.float32)
    _copied(address_of(a), address_of(b), 5)
    np.testing.assert_array_equal(b, 2 * a)
    assert address_of(None) == 0 and address_of(np.zeros(0)) == 0


@njit(nogil=True)
def _into(address, ray):
    return ray_into(pointer_f64(address), 12, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5])


@njit(nogil=True)
def _appended(out, address):
    append_transform(out, pointer_f64(address), 12)


@njit(nogil=True)
def _singular(address, i):
    return is_singular(pointer_f64(address), 12 * i)


@settings(max_examples=50)
@given(seeds)
def test_transforms(seed):
    rng = np.random.default_rng(seed)
    m = rng.normal(size=(2, 3, 4))
    ray = rng.normal(size=6)
    inverse = np.linalg.inv(m[1, :, :3])
    expected = np.r_[inverse @ (ray[:3] - m[1, :, 3]), inverse @ ray[3:]]
    condition = np.linalg.cond(m[1, :, :3])
    np.testing.assert_allclose(
        _into(address_of(m), ray), expected, rtol=0, atol=1e-13 * condition * np.abs(expected).max()
    )
    out = m[0].copy()
    _appended(out, address_of(m))
    full = [np.vstack([x, [0, 0, 0, 1]]) for x in m]
    np.testing.assert_allclose(out, (full[0] @ full[1])[:3], atol=1e-12)
    q = np.empty((3, 3))
    cofactors(m[0], q)
    det = np.linalg.det(m[0, :, :3])
    np.testing.assert_allclose(q, abs(det) * np.linalg.inv(m[0, :, :3]).T, atol=1e-10)


def test_singular_transforms_are_told_from_small_ones():
    m = np.zeros((6, 3, 4))
    m[0, :, :3] = np.eye(3) * 1e-8  # tiny, yet fine
    m[1, :, :3] = np.diag([1, 1, 0])
    m[2, :, :3] = np.ones((3, 3))
    m[3, :, :3] = np.diag([1, np.nan, 1])
    m[4, :, :3], m[4, :, 3] = np.eye(3), [0, np.inf, 0]
    m[5, :, :3] = np.diag([1, 1e-6, -1e5])
    assert [bool(_singular(address_of(m), i)) for i in range(6)] == [False, True, True, True, True, False]
