"""Samples in which a surface meets clutter become two."""

import numpy as np

from pointmr_engine.hierarchy.surface_split import split_surfaces
from pointmr_engine.hierarchy.surfels import AREA, COLUMNS, NX, NZ, XX, YY, ZZ, X, Z

SPACING = 1.0


def ground(side: int = 8) -> np.ndarray:
    """A square of SPACING's size in side x side pieces."""
    row = np.zeros((side * side, COLUMNS), np.float32)
    a = ((np.arange(side) + 0.5) / side - 0.5) * SPACING
    row[:, X], row[:, X + 1] = (c.ravel() for c in np.meshgrid(a, a))
    row[:, AREA] = (SPACING / side) ** 2
    row[:, XX] = row[:, YY] = (SPACING / side) ** 2 / 12
    row[:, NZ] = 1.0
    return row


def leaves(count: int, size: float = 0.1, seed: int = 0) -> np.ndarray:
    """Small pieces that face all directions, above the ground."""
    rng = np.random.default_rng(seed)
    row = np.zeros((count, COLUMNS), np.float32)
    row[:, X : Z + 1] = rng.uniform(-0.5, 0.5, (count, 3)) * SPACING + [0, 0, 0.6 * SPACING]
    normal = rng.normal(size=(count, 3))
    row[:, NX : NZ + 1] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    row[:, AREA] = size**2
    row[:, [XX, YY, ZZ]] = size**2 / 36
    return row


def split(row: np.ndarray, representative: int = 0):
    owner = np.zeros(len(row), np.int32)
    return split_surfaces(row, owner, np.array([representative], np.int32), SPACING)


def test_ground_and_what_stands_on_it_part():
    flat, clutter = ground(), leaves(60)
    for first in (0, len(flat)):  # whichever of the two stands for the sample
        owner, representative = split(np.concatenate([flat, clutter]), first)
        assert len(representative) == 2
        assert (owner[: len(flat)] == owner[0]).all()
        assert (owner[len(flat) :] != owner[0]).mean() > 0.95
        assert (owner[representative] == [0, 1]).all()


def test_clutter_and_bare_ground_stay_whole():
    for row in (ground(), leaves(200), leaves(8, 0.2)):
        owner, representative = split(row)
        assert len(representative) == 1 and (owner == 0).all()


def test_what_belongs_to_no_sample_stays_so():
    row = np.concatenate([ground(), leaves(60)])
    owner = np.zeros(len(row), np.int32)
    owner[5:20] = -1
    found, _ = split_surfaces(row, owner, np.zeros(1, np.int32), SPACING)
    assert (found[5:20] == -1).all() and (np.delete(found, np.arange(5, 20)) >= 0).all()
