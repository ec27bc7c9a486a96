"""All that lights a scene - lamps, emissive triangles, the world - chosen, sampled and weighed as one.

A surface point asks `sample` for one light; a ray that went on by itself asks what it met (`seen_lamps`, `emitter_weight`,
`world_weight`), each already weighed against `sample` by the power heuristic, so that the two together count every
light once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

NONE, LAMP, TRIANGLE, WORLD = 0, 1, 2, 3


class LightSamples(NamedTuple):
    """One chosen light for each of N points. All but `kind` is undefined where kind is NONE (nothing can light the point).

    The light adds f(wi, direction) |cos| * radiance / pdf * (mis ? power_heuristic(pdf, bsdf_pdf) : 1), where
    the lobes that `visibility` names are f. Shadow rays run from t_min to `distance` less a little.
    """

    kind: np.ndarray  # (N,) uint8: NONE, LAMP, TRIANGLE, WORLD
    index: np.ndarray  # (N,) int32: lamp, emitter, or 0
    direction: np.ndarray  # (N, 3) float64, unit, from the point to the light
    distance: np.ndarray  # (N,) float64, inf for sun and world
    radiance: np.ndarray  # (N, 3) float32; for delta lamps: radiance times solid angle
    pdf: np.ndarray  # (N,) float64 per solid angle, selection included; for delta lamps: of the selection alone
    pending: np.ndarray  # (N,) bool: `radiance` must still be filled in, by `Lights.emission_at`
    mis: np.ndarray  # (N,) bool: a ray chosen by a BSDF can meet this light too
    cast_shadow: np.ndarray  # (N,) bool
    visibility: np.ndarray  # (N,) uint8, bits DIFFUSE, GLOSSY, TRANSMISSION of scene.group: what may see the light
    triangle: np.ndarray  # (N,) int32, the emissive triangle that a shadow ray may touch, -1 if none
    path: np.ndarray  # (N,) uint64, its instance path
    u: np.ndarray  # (N,) float32, barycentric weight of vertex 1
    v: np.ndarray  # (N,) float32, barycentric weight of vertex 2


def allocate_light_samples(n: int) -> LightSamples:
    """Room for n samples, none of them valid."""
    return LightSamples(
        np.zeros(n, np.uint8),
        np.zeros(n, np.int32),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros((n, 3), np.float32),
        np.zeros(n),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.uint8),
        np.full(n, -1, np.int32),
        np.zeros(n, np.uint64),
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
    )


class Lights:
    """The compiled lights of a scene: `arrays` for kernels, programs for what varies. Threads may share it.

    Wherever a ray's origin is asked for: position (N, 3) float64; normal (N, 3) float32, the shading normal on the side of
    the viewer; transmissive (N,) bool, whether light from behind counts; bsdf_pdf (N,) float64, with which the BSDF
    chose the ray, inf where lights were not sampled at all (camera rays, mirrors): then the weight is 1.
    """

    def sample(
        self, position: np.ndarray, normal: np.ndarray, transmissive: np.ndarray, u: np.ndarray, out: LightSamples
    ) -> None:
        """Choose a light and a direction to it for each point; u (N, 3) float64 in [0, 1): selection, then 2D."""
        raise NotImplementedError

    def emission_at(self, samples: LightSamples, index: np.ndarray | None = None) -> None:
        """Fill in `radiance` of the samples (of the rows `index`, or all) whose emission varies; clears `pending`."""
        raise NotImplementedError

    def seen_lamps(
        self,
        position: np.ndarray,
        direction: np.ndarray,
        t_hit: np.ndarray,
        visibility: np.ndarray,
        normal: np.ndarray,
        transmissive: np.ndarray,
        bsdf_pdf: np.ndarray,
        out: np.ndarray,
    ) -> None:
        """Add to out (N, 3) float32 the weighted radiance of lamps that the rays pass before t_hit (inf: suns as well).

        Lamps do not stop rays. visibility (N,) uint8: the ray's own bit (CAMERA, DIFFUSE, ...).
        """
        raise NotImplementedError

    def emitter_pdf(self, path, triangle, position, normal, transmissive, direction, distance) -> np.ndarray:
        """(N,) float64: density per solid angle with which `sample` chooses the point met on a triangle; 0 if never."""
        raise NotImplementedError

    def emitter_weight(
        self, path, triangle, position, normal, transmissive, direction, distance, bsdf_pdf
    ) -> np.ndarray:
        """(N,) float32: weight of the emission met on triangles: path (N,) uint64, triangle (N,) int32, distance (N,)."""
        raise NotImplementedError

    def world_radiance(self, direction: np.ndarray, visibility: int) -> np.ndarray:
        """(N, 3) float32 radiance of the world in directions (N, 3) for rays of one visibility bit; 0 if hidden from it."""
        raise NotImplementedError

    def world_pdf(self, position, normal, transmissive, direction) -> np.ndarray:
        """(N,) float64: density per solid angle with which `sample` chooses the world in that direction."""
        raise NotImplementedError

    def world_weight(self, position, normal, transmissive, direction, bsdf_pdf) -> np.ndarray:
        """(N,) float32: weight of the world's radiance that the rays met."""
        raise NotImplementedError


def build_lights(scene, geometry, programs: list, settings=None) -> Lights:
    """Compile the lights of `scene`.

    geometry: hierarchy.geometry.Geometry; programs: the materials' Programs in the order of geometry.materials.
    """
    raise NotImplementedError
