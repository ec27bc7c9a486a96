"""Footprint transport against the finite differences of exact rays at curved surfaces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.multires.cones import footprint

seeds = st.integers(0, 2**32 - 1)
STEP = 1e-6


class Surface:
    """z = -(k_pp x^2 + 2 k_ps x y + k_ss y^2) / 2 near the origin; rays come from above in the plane y = 0."""

    def __init__(self, k, angle):
        self.k = np.array([[k[0], k[1]], [k[1], k[2]]])
        self.incoming = np.array([np.sin(angle), 0.0, -np.cos(angle)])

    def hit(self, origin, direction):
        t = -origin[2] / direction[2]
        for _ in range(50):
            p = origin + t * direction
            height = p[2] + 0.5 * p[:2] @ self.k @ p[:2]
            t -= height / (direction[2] + p[:2] @ self.k @ direction[:2])
        p = origin + t * direction
        normal = np.array([*(self.k @ p[:2]), 1.0])
        return p, normal / np.linalg.norm(normal)

    def scatter(self, place, slope, eta):
        """Lateral place and slope, in the axes after the surface, of a ray given in those before it; eta 0: mirror."""
        axis = self.incoming
        across = np.array([0.0, 1.0, 0.0])
        first = np.array([-axis[2], 0.0, axis[0]])
        out_axis = self.leave(axis, np.array([0.0, 0.0, 1.0]), eta)
        out_first = np.array([abs(out_axis[2]), 0.0, -np.sign(out_axis[2]) * out_axis[0]])
        direction = axis + slope[0] * first + slope[1] * across
        p, normal = self.hit(place[0] * first + place[1] * across, direction / np.linalg.norm(direction))
        out = self.leave(direction / np.linalg.norm(direction), normal, eta)
        q = p - (p @ out_axis) / (out @ out_axis) * out
        return np.array([q @ out_first, q[1], out @ out_first / (out @ out_axis), out[1] / (out @ out_axis)])

    @staticmethod
    def leave(d, n, eta):
        c = -(d @ n)
        if eta == 0.0:
            return d + 2 * c * n
        return eta * d + (eta * c - np.sqrt(1 - eta**2 * (1 - c**2))) * n


def transport(surface, eta):
    """(4, 4) numerical derivative of (place, slope) after with respect to (place, slope) before."""
    rows = []
    for e in np.eye(4) * STEP:
        plus, minus = (surface.scatter(s * e[:2], s * e[2:], eta) for s in (1, -1))
        rows.append((plus - minus) / (2 * STEP))
    return np.array(rows).T


@settings(max_examples=40)
@given(seeds, st.sampled_from([0.0, 1 / 1.5, 1 / 1.33, 1.2]))
def test_mirrors_and_refractions_at_curved_surfaces(seed, eta):
    rng = np.random.default_rng(seed)
    k = tuple(rng.normal(size=3))
    angle = rng.uniform(0.0, 0.8)
    exact = transport(Surface(k, angle), eta)
    place, slope = rng.normal(size=(2, 2, 2))
    before = np.concatenate([place, slope])
    expected = exact @ before
    p, s = tuple(place.ravel()), tuple(slope.ravel())
    if eta == 0.0:
        got_place, got_slope = p, footprint.mirrored(p, s, np.cos(angle), k)
    else:
        got_place, got_slope = footprint.refracted(p, s, np.cos(angle), eta, k)
    np.testing.assert_allclose(np.reshape(got_place, (2, 2)), expected[:2], atol=2e-4)
    np.testing.assert_allclose(np.reshape(got_slope, (2, 2)), expected[2:], atol=2e-4)


@settings(max_examples=25)
@given(seeds)
def test_roughness_adds_variances_and_keeps_what_is_smooth(seed):
    rng = np.random.default_rng(seed)
    slope = rng.normal(size=(2, 2))
    same = np.reshape(footprint.roughened(tuple(slope.ravel()), 0.0, 0.0), (2, 2))
    np.testing.assert_allclose(same, slope, atol=1e-8)
    rough = np.reshape(footprint.roughened(tuple(slope.ravel()), 0.2, 0.05), (2, 2))
    np.testing.assert_allclose(rough @ rough.T / 3, slope @ slope.T / 3 + np.diag([0.2, 0.05]), atol=1e-9)
    from_none = np.reshape(footprint.roughened((0.0, 0.0, 0.0, 0.0), 0.2, 0.05), (2, 2))
    np.testing.assert_allclose(from_none, np.diag(np.sqrt([0.6, 0.15])), atol=1e-9)


@settings(max_examples=25)
@given(seeds, st.floats(0.1, 10.0))
def test_cones_have_the_footprints_variances(seed, distance):
    rng = np.random.default_rng(seed)
    place, slope = rng.normal(size=(2, 2, 2))
    c, s, *numbers = footprint.as_cone(tuple(place.ravel()), tuple(slope.ravel()), distance)
    turn = np.array([[c, s], [-s, c]])
    start, spread = np.reshape(numbers, (2, 2))
    at_end, at_start = turn @ (place + distance * slope), turn @ place
    np.testing.assert_allclose(
        at_end @ at_end.T, np.diag((start + distance * spread) ** 2), atol=1e-8 * distance**2
    )
    np.testing.assert_allclose(np.diag(at_start @ at_start.T), start**2, atol=1e-9)
