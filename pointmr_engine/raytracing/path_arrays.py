"""The queue of paths that go from bounce to bounce, the samples that they belong to, and the limits that bind them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.raytracing.rays import Rays, allocate_rays
from pointmr_engine.raytracing.surface import RayState, allocate_ray_state
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.scene.settings import RenderSettings
from pointmr_engine.shading.points import RAY_CAMERA

# Paths.flags
FINAL = 1  # only emission and what is straight behind still count (a bounce limit is reached)
LAST = 2  # the next surface is the last, transparent or not
BACKDROP = 4  # nothing but transparent surfaces so far: alpha and passes see through
PASSES_DONE = 8  # the normal pass has its surface
THROUGH = 16  # some surface was passed straight
SEES_LAMPS = 32  # no light sample looked for lamps in the ray's place (multires)
NO_LAMPS = 64  # light samples looked for all lamps in the ray's place (multires)
UNSHARED = 128  # what the ray finds is its fragment's alone (multires)


class Paths(NamedTuple):
    """N paths on their way; row k of every array belongs to one path. `slot` is its row in `Samples`."""

    rays: Rays
    state: RayState
    throughput: np.ndarray  # (N, 3) float32
    bsdf_pdf: np.ndarray  # (N,) float64 of the ray's direction; inf: lights were not sampled for it
    # (N, 3) float32 shading normal where the ray starts, for light sampling densities
    origin_normal: np.ndarray
    origin_transmissive: np.ndarray  # (N,) bool
    flags: np.ndarray  # (N,) uint8
    slot: np.ndarray  # (N,) int32


class Samples(NamedTuple):
    """What becomes of N image samples."""

    pixel: np.ndarray  # (N,) int32, in the tile
    x: np.ndarray  # (N,) int32, in the whole image
    y: np.ndarray  # (N,) int32
    number: np.ndarray  # (N,) int32, of the pixel's samples
    seed: np.ndarray  # (N,) uint32
    radiance: np.ndarray  # (N, 3) float64
    transparency: np.ndarray  # (N,) float64, share that saw a transparent film or a holdout


class Scattered(NamedTuple):
    """Where N paths go from a surface."""

    direction: np.ndarray  # (N, 3) float64
    pdf: np.ndarray  # (N,) float64, inf for mirrors
    label: np.ndarray  # (N,) uint8, LABEL_* of shading.bsdf.layout
    alpha: np.ndarray  # (N,) float32, roughness of the lobe


class Limits(NamedTuple):
    """Bounces and other bounds of a render, for kernels."""

    bounces: int
    diffuse: int
    glossy: int
    transmission: int
    transparent: int
    clamp_direct: float
    clamp_indirect: float
    # points with nothing but a diffuse lobe are lit by light samples alone, and end their path
    diffuse_by_lights: bool
    lobe_spread: float  # how much of a lobe's width one of its rays stands for
    # diffuse rays go out even where they may not bounce: something shines that no light sample finds (multires)
    seeks: bool


def limits_of(settings: RenderSettings, only_met: bool = True) -> Limits:
    """The limits that a render's settings set. only_met: something shines that light samples do not find.

    Where one ray stands for a pixel, the second look at the lights that a diffuse ray gives is not worth a walk.
    """
    return Limits(
        settings.max_bounces,
        settings.diffuse_bounces,
        settings.glossy_bounces,
        settings.transmission_bounces,
        settings.transparent_max_bounces,
        float(settings.clamp_direct),
        float(settings.clamp_indirect),
        settings.method == "conventional" and settings.diffuse_bounces == 0 and not only_met,
        1.0 / math.sqrt(settings.samples),
        False,
    )


def allocate_paths(n: int, camera_from_world: np.ndarray | None = None) -> Paths:
    """Room for n paths."""
    return Paths(
        allocate_rays(n),
        allocate_ray_state(n, camera_from_world),
        np.ones((n, 3), np.float32),
        np.full(n, np.inf),
        np.zeros((n, 3), np.float32),
        np.zeros(n, np.bool_),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int32),
    )


def allocate_samples(n: int) -> Samples:
    """Room for n samples."""
    return Samples(
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.uint32),
        np.zeros((n, 3)),
        np.zeros(n),
    )


def allocate_scattered(n: int) -> Scattered:
    """Room for n directions."""
    return Scattered(np.zeros((n, 3)), np.zeros(n), np.zeros(n, np.uint8), np.zeros(n, np.float32))


def lay_out(samples: Samples, x0: int, y0: int, x1: int, y1: int, first: int, count: int) -> int:
    """Samples first..first+count of every pixel of a tile, pixel by pixel; returns how many."""
    width, pixels = x1 - x0, (x1 - x0) * (y1 - y0)
    n = pixels * count
    pixel = np.repeat(np.arange(pixels, dtype=np.int32), count)
    samples.pixel[:n] = pixel
    samples.x[:n] = pixel % width + x0
    samples.y[:n] = pixel // width + y0
    samples.number[:n] = np.tile(np.arange(first, first + count, dtype=np.int32), pixels)
    samples.radiance[:n] = 0.0
    samples.transparency[:n] = 0.0
    return n


def start_paths(paths: Paths, n: int) -> None:
    """Fresh camera paths 0..n; rays, width and spread are filled by the camera."""
    paths.throughput[:n] = 1.0
    paths.bsdf_pdf[:n] = math.inf
    paths.origin_normal[:n] = 0.0
    paths.origin_transmissive[:n] = False
    paths.flags[:n] = BACKDROP
    paths.slot[:n] = np.arange(n)
    paths.rays.visibility[:n] = CAMERA
    state = paths.state
    state.kind[:n] = RAY_CAMERA
    for values in (
        state.depth,
        state.diffuse_depth,
        state.glossy_depth,
        state.transmission_depth,
        state.transparent_depth,
        state.length,
    ):
        values[:n] = 0
    state.density[:n] = np.inf


@device
def copy_path(paths: Paths, k, weight, out: Paths, m):
    """Row m of out becomes path k with a share of its throughput; its ray is left alone."""
    a, s = paths.state, out.state
    for c in range(3):
        out.throughput[m, c] = paths.throughput[k, c] * weight
        out.origin_normal[m, c] = paths.origin_normal[k, c]
    out.bsdf_pdf[m] = paths.bsdf_pdf[k]
    out.origin_transmissive[m] = paths.origin_transmissive[k]
    out.flags[m] = paths.flags[k]
    out.slot[m] = paths.slot[k]
    s.kind[m] = a.kind[k]
    s.depth[m] = a.depth[k]
    s.diffuse_depth[m] = a.diffuse_depth[k]
    s.glossy_depth[m] = a.glossy_depth[k]
    s.transmission_depth[m] = a.transmission_depth[k]
    s.transparent_depth[m] = a.transparent_depth[k]
    s.length[m] = a.length[k]
    s.width[m] = a.width[k]
    s.spread[m] = a.spread[k]
    s.density[m] = a.density[k]


@device
def note_density(out, m, density):
    """The direction of row m of paths was drawn with this density, or stands for what a lobe sends there."""
    out.state.density[m] = min(out.state.density[m], np.float32(density))


@device
def copy_ray(rays: Rays, k, out: Rays, m):
    """Row m of out becomes ray k."""
    for c in range(3):
        out.origin[m, c] = rays.origin[k, c]
        out.direction[m, c] = rays.direction[k, c]
    out.t_min[m] = rays.t_min[k]
    out.t_max[m] = rays.t_max[k]
    out.visibility[m] = rays.visibility[k]
    out.skip_triangle[m] = rays.skip_triangle[k]
    out.skip_path[m] = rays.skip_path[k]
