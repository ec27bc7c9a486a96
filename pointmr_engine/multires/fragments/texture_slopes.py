"""Slopes of textures in the image: how the light of a fragment changes from subpixel to subpixel with its material."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import Fragments
from pointmr_engine.forward.reconstruction.pixel_filter import Slopes
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.footprint_slopes import TextureSlopes

WHOLE = 0.5  # of a cell: what a footprint must cover of it, beyond which nothing is known
MOST = 3.0  # of a fragment's light: greatest difference at the corners of its footprint


@device
def _in_image(view, camera_from_world, f: Fragments, k, side):
    """How far a step of a world vector moves fragment k in the image, subpixels."""
    x = (
        camera_from_world[0, 0] * side[0]
        + camera_from_world[0, 1] * side[1]
        + camera_from_world[0, 2] * side[2]
    )
    y = (
        camera_from_world[1, 0] * side[0]
        + camera_from_world[1, 1] * side[1]
        + camera_from_world[1, 2] * side[2]
    )
    if not view.perspective:
        return view.scale_x * x, view.scale_y * y
    z = (
        camera_from_world[2, 0] * side[0]
        + camera_from_world[2, 1] * side[1]
        + camera_from_world[2, 2] * side[2]
    )
    depth = f.position[k, 2]
    x -= f.position[k, 0] / depth * z
    y -= f.position[k, 1] / depth * z
    return view.scale_x * x / depth, view.scale_y * y / depth


@uncounted
def slopes_in_image(
    view, camera_from_world, fragments: Fragments, first, textures: TextureSlopes, cell, count, out: Slopes
):
    """Slopes of fragments first..first + count, in parts of their light and per subpixel: NaN where none are known.

    cell: subpixels per side of a fragment's part of the image.
    """
    f = fragments
    for n in range(count):
        k = first + n
        if not textures.known[n]:
            out.x[k, 0] = np.nan
            continue
        ax, ay = _in_image(view, camera_from_world, f, k, textures.sides[0, n])
        bx, by = _in_image(view, camera_from_world, f, k, textures.sides[1, n])
        det = ax * by - ay * bx
        if not abs(det) > WHOLE * cell * cell:
            out.x[k, 0] = np.nan
            continue
        for c in range(3):
            u, v = np.float64(textures.change[0, n, c]), np.float64(textures.change[1, n, c])
            corner = 0.5 * (abs(u) + abs(v))
            scale = (MOST / corner if corner > MOST else 1.0) / det
            out.x[k, c], out.y[k, c] = scale * (by * u - ay * v), scale * (ax * v - bx * u)


@uncounted
def take_texture_slopes(textures: Slopes, light, count, out: Slopes):
    """Slopes of the light (F, 3) of fragments 0..count, where those of their textures are known."""
    for k in range(count):
        if not np.isnan(textures.x[k, 0]):
            for c in range(3):
                out.x[k, c], out.y[k, c] = light[k, c] * textures.x[k, c], light[k, c] * textures.y[k, c]
