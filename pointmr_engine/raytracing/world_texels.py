"""Texels of a world's maps: rows of equal angle from straight down, columns of equal azimuth from -pi."""

from __future__ import annotations

import math

import numpy as np


def row_borders(height: int) -> np.ndarray:
    """(height + 1,) heights z of the borders of rows."""
    return -np.cos(np.linspace(0.0, math.pi, height + 1))


def solid_angles(height: int, width: int) -> np.ndarray:
    """(height,) of a texel of each row."""
    return np.diff(row_borders(height)) * (2.0 * math.pi / width)


def directions(row: np.ndarray, column: np.ndarray, height: int, width: int) -> np.ndarray:
    """(N, 3) unit directions of places in a map: of a texel's middle by its row and column, of others between these."""
    angle, azimuth = (row + 0.5) * (math.pi / height), (column + 0.5) * (2.0 * math.pi / width) - math.pi
    flat = np.sin(angle)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), -np.cos(angle)], 1)
