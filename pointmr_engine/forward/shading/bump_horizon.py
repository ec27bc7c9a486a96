"""The world's light on bumps: a normal that leans looks below the surface, too, whence nothing comes."""

from __future__ import annotations

import math

from pointmr_engine.forward.shading.world_light import world_irradiance
from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.vector import dot

LEVEL = 0.999  # cosine of a lean from which hardly anything is lost
# of what an even world sends, that the terminator's softening takes from a normal that lies flat
SOFTENED = 0.45


@device
def irradiance_of_bump(maps, normal, outward, softens):
    """Irradiance over pi (rgb) of a surface whose shading normal is bent from `outward`, unit vectors of one side.

    A lobe loses (1 - cosine) / 2 of its directions, which lie between the horizon and straight down, on the side that
    the normal leans to. softens: what comes from near the horizon is dimmed, as where lights are sampled
    (lobes.value_of); SOFTENED is by integration over a half space, within 3 % to a lean of 60 degrees.
    """
    e = world_irradiance(maps, normal[0], normal[1], normal[2])
    cosine = dot(normal, outward)
    if abs(cosine) > LEVEL:
        return e
    x = normal[0] - cosine * outward[0]
    y = normal[1] - cosine * outward[1]
    z = normal[2] - cosine * outward[2]
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length - outward[0], y / length - outward[1], z / length - outward[2]
    s = math.sqrt(0.5)
    below = world_irradiance(maps, s * x, s * y, s * z)
    lost, left = 0.5 * (1.0 - cosine), 1.0 - SOFTENED * (1.0 - cosine) if softens else 1.0
    return (
        max(e[0] - lost * below[0], 0.0) * left,
        max(e[1] - lost * below[1], 0.0) * left,
        max(e[2] - lost * below[2], 0.0) * left,
    )
