"""All that lights a scene - lamps, emissive triangles, the world - chosen, sampled and weighed as one.

A surface point asks `sample` for one light; a ray that went on by itself asks what it met (`seen_lamps`,
`emitter_weight`, `world_weight`), each already weighed against `sample` by the power heuristic, so that the two
together count every light once.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.placements import Placements
from pointmr_engine.raytracing import light_sampling as kernels
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.emitter_search import find_emitters, leaves_haze, sampled_sides
from pointmr_engine.raytracing.environment import ABOVE, UNIFORM, Environment
from pointmr_engine.raytracing.lamp_nodes import LampNodes, lamp_nodes
from pointmr_engine.raytracing.lamps import DISTANT, POINT, Lamps
from pointmr_engine.raytracing.light_sampling import (
    LAMP,
    NONE,
    TRIANGLE,
    WORLD,
    LightArrays,
    LightSamples,
    allocate_light_samples,
    power_heuristic,
)
from pointmr_engine.raytracing.light_tree_build import build_light_tree
from pointmr_engine.raytracing.surface import emitting_points
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.scene import Scene

__all__ = [
    "LAMP",
    "NONE",
    "TRIANGLE",
    "WORLD",
    "LightArrays",
    "LightSamples",
    "Lights",
    "allocate_light_samples",
    "build_lights",
    "power_heuristic",
]


EACH = 8  # lamps and worlds that can each have a sample of their own at every point


class Lights:
    """The compiled lights of a scene: `arrays` for kernels, programs for what varies. Threads may share it.

    Wherever a ray's origin is asked for: position (N, 3) float64; normal (N, 3) float32, the shading normal on the side
    of the viewer; transmissive (N,) bool, whether light from behind counts; bsdf_pdf (N,) float64, with which the BSDF
    chose the ray, inf where lights were not sampled at all (camera rays, mirrors): then the weight is 1.

    warnings: what was left out, by name. empty: nothing is ever sampled. only_met: something shines that is not sampled
    (weak or excluded emission, a world left to chance), so only rays that a BSDF chose can find it. haze: with `every`
    (build_lights), too, something is left to chance, as it has too many triangles. lamps: what
    `arrays.lamps.source` numbers; nodes: of those of `arrays.lamps` that vary. turns: what
    `sample` is asked for in turn at every point, so that together they find all lights: here None alone, see `apart`.
    """

    def __init__(
        self,
        arrays: LightArrays,
        environment: Environment,
        geometry: Geometry | None,
        placements: Placements | None,
        programs: list,
        materials: np.ndarray,
        scattered: np.ndarray,
        lamps: list[Light],
        nodes: dict[int, LampNodes],
        only_met: bool,
        haze: bool,
        warnings: list[str],
    ):
        self.arrays = arrays
        self.lamps = lamps
        self.nodes = nodes
        self.environment = environment
        self.warnings = warnings
        self.only_met = only_met
        self.haze = haze
        self.empty = len(arrays.tree.tops) == 0
        self.turns: list[tuple[int, int] | None] = [None]
        self._geometry = geometry
        self._placements = placements
        self._programs = programs
        self._materials = materials  # (E,) int32: material of each emitter
        self._scattered = scattered  # (E,) bool: Cycles does not sample it

    @cached_property
    def apart(self) -> Lights:
        """The same lights, where each lamp and the world has a turn of its own if they are few.

        For images of one ray a pixel, which cannot average over a choice among them.
        """
        a = self.arrays
        turns: list = [(LAMP, k) for k in range(len(a.lamps.shape))]
        if a.tree.leaf_of_world != -1:
            turns.append((WORLD, 0))
        if not turns or len(turns) > EACH:
            return self
        if len(a.emitters.path):
            turns.append(None)
        if len(turns) == 1:
            return self
        return self.asked(turns)

    @cached_property
    def above(self) -> Lights:
        """The same lights; what a world of one radiance sends through surfaces is left to rays that BSDFs choose.

        Rough refraction is brighter where it is evaluated than where it is sampled (bsdf.microfacet.evaluate). Cycles
        does not sample such a world as a light.
        """
        a = self.arrays
        if a.world.mode != UNIFORM:
            return self
        return self._with(a._replace(world=a.world._replace(mode=ABOVE)), self.turns)

    def shining(self, materials: int) -> np.ndarray:
        """(materials,) bool: which of the materials 0.. are sampled as lights."""
        return np.isin(np.arange(materials), self._materials)

    def parts_of(self, emitters: np.ndarray) -> np.ndarray:
        """(n,) int32: the parts that emitters (n,) belong to."""
        return self._placements.part[self.arrays.emitters.placement[emitters]]

    @property
    def even_world(self) -> bool:
        """Whether the world has one radiance, and is sampled."""
        return self.arrays.world.mode in (UNIFORM, ABOVE)

    def asked(self, turns: list[tuple[int, int] | None], lamps_apart: bool = True) -> Lights:
        """The same lights with these turns: (LAMP, k), (WORLD, 0), or None for one of the emissive triangles, and of
        the lamps unless they are apart.
        """
        a = self.arrays
        tree = build_light_tree(a.lamps, a.emitters, self.environment.map, lamps_apart, world_apart=True)
        return self._with(a._replace(tree=tree), turns)

    def _with(self, arrays: LightArrays, turns: list) -> Lights:
        parts = (self.environment, self._geometry, self._placements, self._programs)
        parts += (self._materials, self._scattered)
        result = Lights(arrays, *parts, self.lamps, self.nodes, self.only_met, self.haze, self.warnings)
        result.turns, result.empty = turns, result.empty if arrays is self.arrays else not turns
        return result

    def sample(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        transmissive: np.ndarray,
        u: np.ndarray,
        out: LightSamples,
        turn: tuple[int, int] | None = None,
    ) -> None:
        """Choose a light and a direction to it for each point; u (N, 3) float64 in [0, 1): selection, then 2D.

        `out` may be longer than N. Rows flagged `pending` have no radiance yet: see `emission_at`.
        turn: (kind, index) of the light that all points sample; None: each chooses one of those in the tree.
        """
        a, kind = self.arrays, None if turn is None else turn[0]
        if turn is None:
            weights = np.empty(len(a.tree.tops))
            kernels.choose_lights(a.tree, position, normal, transmissive, u, weights, out)
        else:
            for column, value in (
                (out.kind, kind), (out.index, turn[1]), (out.pdf, 1.0), (out.pending, kind == WORLD), (out.triangle, -1)
            ):  # fmt: skip
                column[: len(position)] = value
        if len(a.lamps.shape) and kind in (None, LAMP):
            kernels.sample_lamps(a.lamps, position, normal, transmissive, u, out)
        if len(a.emitters.path) and kind is None:
            kernels.sample_emitters(a.emitters, position, u, out)
        if a.tree.leaf_of_world != -1 and kind in (None, WORLD):
            kernels.sample_worlds(a.world, a.world_visibility, normal, transmissive, u, out)
        n = len(position)
        out.scattered[:n] = (out.kind[:n] == WORLD) & self.even_world
        if len(a.emitters.path) and kind is None:
            rows = np.flatnonzero(out.kind[:n] == TRIANGLE)
            out.scattered[rows] = self._scattered[out.index[rows]]

    def emission_at(self, samples: LightSamples, position: np.ndarray) -> None:
        """Fill in `radiance` of the samples whose emission varies; clears `pending`.

        position (N, 3) float64: the points that they were chosen for.
        """
        rows = np.flatnonzero(samples.pending)
        if not len(rows):
            return
        for k, own in self.nodes.items():
            some = rows[(samples.kind[rows] == LAMP) & (samples.index[rows] == k)]
            if len(some):
                direction, distance = samples.direction[some], samples.distance[some]
                samples.radiance[some] *= own.emission(position[some], direction, distance)
                samples.pending[some] = False
        worlds = rows[samples.kind[rows] == WORLD]
        if len(worlds):
            samples.radiance[worlds] = self.environment.radiance(samples.direction[worlds])
        rows = rows[samples.kind[rows] == TRIANGLE]
        material = self._materials[samples.index[rows]]
        for m in np.unique(material):
            chosen = rows[material == m]
            place = self.arrays.emitters.placement[samples.index[chosen]]
            scattered = samples.scattered[chosen]
            points = emitting_points(
                self._geometry,
                self._placements,
                place,
                samples.triangle[chosen],
                samples.u[chosen],
                samples.v[chosen],
                self._programs[m].emission_needs,
                position[chosen],
                scattered,
            )
            emission = self._programs[m].emission(points)
            samples.radiance[chosen] = np.nan_to_num(emission, posinf=0.0, neginf=0.0)
        samples.pending[rows] = False
        samples.pending[worlds] = False

    def seen_lamps(
        self,
        position: np.ndarray,
        direction: np.ndarray,
        t_min: np.ndarray,
        t_hit: np.ndarray,
        visibility: np.ndarray,
        normal: np.ndarray,
        transmissive: np.ndarray,
        bsdf_pdf: np.ndarray,
        out: np.ndarray,
    ) -> None:
        """Add to out (N, 3) float32 the weighted radiance of lamps that the rays pass between t_min and t_hit.

        t_min, t_hit (N,) float64, along the rays: behind a transparent surface a ray keeps its origin; where t_hit is
        inf suns are met as well. Lamps do not stop rays. visibility (N,) uint8: the ray's own bit (CAMERA, ...).
        """
        a = self.arrays
        if not len(a.met_lamps):
            return
        rays = (position, direction, t_min, t_hit, visibility, normal, transmissive, bsdf_pdf)
        kernels.add_seen_lamps(a.lamps, a.tree, a.met_lamps, a.met_suns, *rays, out)
        for k, own in self.nodes.items():
            if k not in a.met_lamps:
                continue
            lamps, met, suns = self.as_if_even(k)
            seen = np.zeros_like(out)
            kernels.add_seen_lamps(lamps, a.tree, met, suns, *rays, seen)
            rows = np.flatnonzero(seen.any(1))
            if len(rows):
                out[rows] += seen[rows] * own.met(position[rows], direction[rows])

    def as_if_even(self, k: int) -> tuple[Lamps, np.ndarray, int]:
        """(lamps, met lamps, how many of these are suns): lamp k alone, as if its nodes gave 1."""
        lamps = self.arrays.lamps
        even = lamps._replace(varying=np.zeros_like(lamps.varying))
        return even, np.array([k], np.int32), int(lamps.shape[k] > DISTANT)

    def emitter_pdf(self, path, triangle, position, normal, transmissive, direction, distance) -> np.ndarray:
        """(N,) float64: density per solid angle with which `sample` chooses the point met on a triangle; 0 if never.

        path (N,) uint64, triangle (N,) int32 of the hit; distance (N,) float64 from position to the hit.
        """
        out = np.zeros(len(path))
        a = self.arrays
        if len(a.emitters.path):
            leaf = np.empty(len(path), np.int32)
            kernels.emitter_densities(
                a.emitters, a.tree.leaf_of_emitter, path, triangle, position, distance, leaf, out
            )
            kernels.selection_pdf(a.tree, leaf, position, normal, transmissive, out)
        return out

    def emitter_weight(
        self, path, triangle, position, normal, transmissive, direction, distance, bsdf_pdf
    ) -> np.ndarray:
        """(N,) float32: weight of the emission met on triangles, as for `emitter_pdf`."""
        pdf = self.emitter_pdf(path, triangle, position, normal, transmissive, direction, distance)
        return power_heuristic(bsdf_pdf, pdf)

    def world_radiance(self, direction: np.ndarray, visibility: int) -> np.ndarray:
        """(N, 3) float32 radiance of the world in directions (N, 3) for rays of one visibility bit; 0 if hidden."""
        return self.environment.radiance(direction, visibility)

    def world_pdf(self, position, normal, transmissive, direction) -> np.ndarray:
        """(N,) float64: density per solid angle with which `sample` chooses the world in that direction."""
        out = np.zeros(len(direction))
        a = self.arrays
        if a.tree.leaf_of_world != -1:
            kernels.world_densities(a.world, normal, transmissive, direction, out)
            leaf = np.full(len(direction), a.tree.leaf_of_world, np.int32)
            kernels.selection_pdf(a.tree, leaf, position, normal, transmissive, out)
        return out

    def world_weight(self, position, normal, transmissive, direction, bsdf_pdf) -> np.ndarray:
        """(N,) float32: weight of the world's radiance that the rays met."""
        return power_heuristic(bsdf_pdf, self.world_pdf(position, normal, transmissive, direction))


def build_lights(
    scene: Scene,
    geometry: Geometry,
    programs: list,
    environment: Environment | None = None,
    every: bool = False,
) -> Lights:
    """Compile the lights of `scene`.

    geometry: hierarchy.geometry.Geometry; programs: the materials' Programs in the order of geometry.materials.
    environment: Environment(scene.world), where it is at hand.
    every: for methods whose diffuse surfaces send no rays that could meet a light by chance: what is left to chance is
    sampled, too, a world, backs of surfaces, weak emission, but for glows and haze (find_emitters); and the
    world's sun is a lamp.
    """
    if environment is None or (every and environment.unsampled):
        environment = Environment(scene.world, every)
    sources = list(scene.lights)
    if every and environment.sun is not None:
        sources.append(environment.sun.light)
        environment = environment.without_sun()
    lamps, warnings = compile_lamps(sources)
    nodes = lamp_nodes(sources, lamps)
    for k, own in nodes.items():
        lamps.factor[k] = own.estimate()
        warnings += [w for w in own.warnings if w not in warnings]
    emitters, material, places, more = find_emitters(geometry, programs, every)
    warnings = warnings + more + environment.warnings
    extended = (lamps.shape != POINT) & (lamps.shape != DISTANT)
    suns = np.flatnonzero(extended & (lamps.shape > DISTANT))
    local = np.flatnonzero(extended & (lamps.shape < DISTANT))
    tree = build_light_tree(lamps, emitters, environment.map)
    arrays = LightArrays(
        lamps,
        emitters,
        environment.map,
        tree,
        int(scene.world.visibility),
        len(suns),
        np.concatenate([suns, local]).astype(np.int32),
    )
    pairs = list(zip(geometry.materials, programs, strict=True))
    dark = any(m is not None and p.emissive and not sampled_sides(m, p, every) for m, p in pairs)
    scattered = np.array([not sampled_sides(m, p) for m, p in pairs], np.bool_)
    haze = every and leaves_haze(geometry, programs)
    only_met = dark or bool(more) or environment.unsampled
    own = geometry, places, programs, material, scattered[material]
    return Lights(arrays, environment, *own, sources, nodes, only_met, haze, warnings)
