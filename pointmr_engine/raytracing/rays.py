"""Rays and hits: the queues that pass between the stages of a tile, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Rays(NamedTuple):
    """N rays in world space. `skip_*` name the triangle that a ray starts on (-1: none), which it may not hit again."""

    origin: np.ndarray  # (N, 3) float64
    direction: np.ndarray  # (N, 3) float64, unit length
    t_min: np.ndarray  # (N,) float64
    t_max: np.ndarray  # (N,) float64
    visibility: np.ndarray  # (N,) uint8, a bit of scene.group: only instances that have it are hit
    skip_triangle: np.ndarray  # (N,) int32, index into the concatenated triangles
    skip_path: np.ndarray  # (N,) uint64, the instance path's hash


class Hits(NamedTuple):
    """What N rays hit. Everything but `t` and `triangle` is undefined where nothing was hit."""

    t: np.ndarray  # (N,) float64, distance along the ray; inf: nothing
    triangle: np.ndarray  # (N,) int32, index into the scene's concatenated triangles; -1: nothing
    u: np.ndarray  # (N,) float32, barycentric weight of vertex 1
    v: np.ndarray  # (N,) float32, barycentric weight of vertex 2
    part: np.ndarray  # (N,) int32, index of the mesh part (a Mesh with its materials)
    path: np.ndarray  # (N,) uint64, hash of the chain of instances; equal paths are equal placements
    world_from_part: np.ndarray  # (N, 3, 4) float64, composed transform
    object_index: np.ndarray  # (N,) int32, pass index of the object, 0 if nobody set one
    seed: np.ndarray  # (N,) uint32, combined along the path; Object Info random = seed / 2**32
    # (N,) int32, record of the innermost instance (that has attributes, if any); -1: none
    instance: np.ndarray
    color: np.ndarray  # (N, 4) float32, Object Info colour
    holdout: np.ndarray  # (N,) bool


def allocate_rays(n: int) -> Rays:
    """Room for n rays, values undefined but for `skip_triangle` (-1) and `t_min` (0)."""
    return Rays(
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.zeros(n),
        np.full(n, np.inf),
        np.full(n, 255, np.uint8),
        np.full(n, -1, np.int32),
        np.zeros(n, np.uint64),
    )


def allocate_hits(n: int) -> Hits:
    """Room for n hits, all of them misses."""
    return Hits(
        np.full(n, np.inf),
        np.full(n, -1, np.int32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.int32),
        np.zeros(n, np.uint64),
        np.empty((n, 3, 4)),
        np.zeros(n, np.int32),
        np.zeros(n, np.uint32),
        np.full(n, -1, np.int32),
        np.ones((n, 4), np.float32),
        np.zeros(n, np.bool_),
    )
