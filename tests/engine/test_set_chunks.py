"""Chunks of sample sets: their order, and balls that contain what they stand for."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.hierarchy.set_chunks import BALL_REACH, CHUNK_OF, bound_chunks, in_space_order
from pointmr_engine.hierarchy.surfels import COLUMNS, XX, YY, ZZ, X, Z


def surfels(count: int, seed: int, spread: float = 1.0) -> np.ndarray:
    """(count, 16) float32 at random, with random covariances."""
    rng = np.random.default_rng(seed)
    row = np.zeros((count, COLUMNS), np.float32)
    row[:, X : Z + 1] = rng.normal(0, spread, (count, 3))
    row[:, [XX, YY, ZZ]] = rng.uniform(0, 0.01, (count, 3))
    return row


@settings(max_examples=30)
@given(st.integers(1, 60), st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_a_ball_contains_its_surfels_as_far_as_they_reach(count, seed, spread):
    row = surfels(count, seed, spread)
    chunks = np.zeros((count // CHUNK_OF + 2, COLUMNS), np.float32)
    begun = min(count, 5)  # as when sets are appended one after the other
    bound_chunks(row, np.int64(0), np.int64(begun), chunks)
    bound_chunks(row, np.int64(begun), np.int64(count), chunks)
    ball = chunks[np.arange(count) // CHUNK_OF].astype(np.float64)
    reach = BALL_REACH * np.sqrt(row[:, [XX, YY, ZZ]].sum(1, dtype=np.float64))
    distance = np.linalg.norm(row[:, X : Z + 1] - ball[:, X : Z + 1], axis=1)
    radius = BALL_REACH * np.sqrt(ball[:, XX])
    assert (distance + reach <= radius * (1 + 1e-6)).all()
    assert (radius <= 2.0 * (distance + reach).max() + 1e-6).all()


def test_the_order_keeps_nodes_together_and_neighbours_near():
    row = surfels(4000, 1)
    home = np.random.default_rng(2).integers(0, 5, 4000).astype(np.int32)
    chosen = np.arange(4000)
    order = in_space_order(row, chosen, home, 0.1)
    assert sorted(order) == chosen.tolist()
    assert (np.diff(home[order]) >= 0).all()

    def chunk_size(order):
        return np.ptp(row[order, X : Z + 1].reshape(-1, CHUNK_OF, 3), axis=1).max(1).mean()

    by_node = np.argsort(home, kind="stable")
    assert chunk_size(order) < 0.5 * chunk_size(by_node)
