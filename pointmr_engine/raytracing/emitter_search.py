"""Emissive triangles are found: what shines, through nested instances, and how strongly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry, slot_materials, triangle_materials
from pointmr_engine.hierarchy.placements import Placements, placements, times_placed
from pointmr_engine.raytracing.emitters import BACK, FRONT, Emitters, pack_emitters
from pointmr_engine.raytracing.surface import emitting_points
from pointmr_engine.scene.graph import Graph, Link
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.scene.material import Material

MOST_EMITTERS = 1 << 20
MOST_LEFT = 1 << 14  # triangles that are left to chance and may be sampled nevertheless: lamps, and not haze
_WEAK = 0.5  # emission below this is left to chance, as in Cycles: not worth a light sample
_FAINT = 0.1  # and below this always: a glow, whose samples near it would be missing where they bring light
_DARK = 0.05  # and below this by no rays of its own: candle wax, beside its flame
_MOST_PROBED = 1 << 16  # triangles whose varying emission is estimated by evaluating it
_SIDES = {"FRONT": FRONT, "BACK": BACK, "FRONT_BACK": FRONT | BACK, "NONE": 0}

# points of a triangle where varying emission is probed: centroids of its four quarters and the corners' neighbourhoods
_PROBES = np.array(
    [[1 / 3, 1 / 3], [1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3], [0.45, 0.1], [0.1, 0.45], [0.45, 0.45]],
    np.float32,
)


def estimate_emission(graph: Graph) -> float:
    """The largest channel of what a surface emits, as its graph's constants tell; what is linked counts as 1."""

    def constant(node, name: str, default):
        value = node.inputs.get(name, default)
        return (
            np.ones(3) if isinstance(value, Link) else np.asarray(value, np.float64).ravel()[:3] * np.ones(3)
        )

    def below(link, depth: int) -> np.ndarray:
        node = graph.nodes.get(link.node) if isinstance(link, Link) else None
        if node is None or depth > 64:
            return np.zeros(3)
        if node.kind == "principled":
            return constant(node, "emission_color", 1.0) * constant(node, "emission_strength", 0.0)
        if node.kind == "emission":
            return constant(node, "color", 1.0) * constant(node, "strength", 1.0)
        if node.kind in ("mix_shader", "add_shader"):
            first, second = (below(node.inputs.get(name), depth + 1) for name in ("shader", "shader_b"))
            if node.kind == "add_shader":
                return first + second
            share = node.inputs.get("fac", 0.5)
            share = 0.5 if isinstance(share, Link) else min(max(float(np.mean(share)), 0.0), 1.0)
            return first * (1.0 - share) + second * share
        return np.zeros(3)

    return float(np.abs(below(graph.surface, 0)).max())


def sampled_sides(material: Material | None, program, every: bool = False) -> int:
    """Which sides of a material's surfaces are sampled as lights: FRONT and BACK bits; `every`: both, if not faint."""
    strength = _strength(material, program)
    if strength == 0.0:
        return 0
    if every and strength > _FAINT:
        return FRONT | BACK
    if material.emission_sampling == "AUTO":
        return FRONT | BACK if strength > _WEAK else 0
    return _SIDES.get(material.emission_sampling, FRONT | BACK)


def _strength(material: Material | None, program) -> float:
    """The largest channel of what a material emits, about."""
    if material is None or not program.emissive:
        return 0.0
    constant = program.constant_emission
    return estimate_emission(material.graph) if constant is None else float(np.abs(constant).max())


def find_emitters(
    geometry: Geometry, programs: list, every: bool = False
) -> tuple[Emitters, np.ndarray, Placements | None, list[str]]:
    """All emissive triangles worth sampling, through every instance, at most MOST_EMITTERS.

    Returns them, the material of each (E,) int32, where they were found, and warnings.
    programs: one Program per geometry.materials. Beyond the limit emission is still seen by rays that meet it.
    every: all that shines, not only what its material wants sampled, but for parts with too many triangles (MOST_LEFT).
    """
    wanted = _sides(geometry, programs, False)
    all_ = _sides(geometry, programs, True) if every else wanted
    local = {}
    if all_.any():
        few = _few_left(geometry, all_ != wanted)
        for part in range(len(geometry.parts)):
            found = _part_emitters(geometry, part, all_ if few[part] else wanted)
            if found is not None:
                local[part] = found
    if not local:
        return *pack_emitters([], np.zeros(0, np.bool_)), None, []
    emitting = np.zeros(len(geometry.parts), np.bool_)
    emitting[list(local)] = True
    places = placements(geometry, emitting, MOST_EMITTERS)
    counts = np.zeros(len(geometry.parts), np.int64)
    for part, found in local.items():
        counts[part] = len(found.triangle)
    lit = (places.visibility & (DIFFUSE | GLOSSY | TRANSMISSION)) != 0
    within = np.cumsum(np.where(lit, counts[places.part], 0)) <= MOST_EMITTERS
    warnings = []
    if len(places.part) >= MOST_EMITTERS or not within[lit].all():
        warnings.append(
            f"more than {MOST_EMITTERS} emissive triangles: the rest light only what rays happen to meet"
        )
    blocks = []
    for part, found in local.items():
        chosen = np.flatnonzero(lit & within & (places.part == part))
        if len(chosen):
            radiance = _mean_radiance(geometry, programs, found, places, chosen)
            blocks.append(_placed(found, radiance, places, chosen))
    varying = np.array([p.constant_emission is None for p in programs], np.bool_)
    return *pack_emitters(blocks, varying), places, warnings


def leaves_haze(geometry: Geometry, programs: list) -> bool:
    """Whether `find_emitters` of `every` leaves to chance what lights others: glows, or what has too many triangles."""
    sampled = _sides(geometry, programs, True)
    pairs = zip(sampled, geometry.materials, programs, strict=True)
    if any(not sides and _strength(material, program) > _DARK for sides, material, program in pairs):
        return True
    left = sampled != _sides(geometry, programs, False)
    return bool(left.any()) and not _few_left(geometry, left).all()


def _sides(geometry: Geometry, programs: list, every: bool) -> np.ndarray:
    """(materials,) uint8: FRONT and BACK bits of each material that are sampled."""
    materials = zip(geometry.materials, programs, strict=True)
    return np.array([sampled_sides(m, p, every) for m, p in materials], np.uint8)


def _few_left(geometry: Geometry, left: np.ndarray) -> np.ndarray:
    """(parts,) bool: those whose triangles of materials `left` (materials,) bool are few enough through all instances.

    Together they are no more than MOST_LEFT; the fewest come first, so that a panel is a lamp beside glowing leaves.
    """
    counts = np.zeros(len(geometry.parts), np.int64)
    if not left.any():
        return counts == 0
    for part in range(len(geometry.parts)):
        if left[slot_materials(geometry, part)].any():
            counts[part] = left[triangle_materials(geometry, part)].sum()
    placed = counts * times_placed(geometry)
    order = np.argsort(placed, kind="stable")
    few = np.zeros(len(placed), np.bool_)
    few[order] = np.cumsum(placed[order]) <= MOST_LEFT
    return few


class _PartEmitters(NamedTuple):
    """Emissive triangles of one part, in its own space."""

    triangle: np.ndarray  # (n,) int32 scene-wide
    vertices: np.ndarray  # (n, 3, 3) float64
    sides: np.ndarray  # (n,) uint8
    material: np.ndarray  # (n,) int32
    outside: float


def _part_emitters(geometry: Geometry, part: int, sides: np.ndarray) -> _PartEmitters | None:
    if not sides[slot_materials(geometry, part)].any():
        return None
    shape, material = geometry.shapes[int(geometry.tables.shape[part])], triangle_materials(geometry, part)
    chosen = np.flatnonzero(sides[material] > 0)
    vertices = shape.positions[shape.triangles[chosen]].astype(np.float64) + shape.center
    cross = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.linalg.norm(cross, axis=1)
    good = np.isfinite(size) & (size > 0.0)
    chosen, vertices = chosen[good], vertices[good]
    if not len(chosen):
        return None
    outside = _outside(shape.positions, shape.triangles)
    triangles = (chosen + shape.first_triangle).astype(np.int32)
    return _PartEmitters(triangles, vertices, sides[material[chosen]], material[chosen], outside)


def _outside(positions: np.ndarray, triangles: np.ndarray) -> float:
    """1 or -1 for a closed mesh (the sign of its volume), 0 for an open one. Corners at one place are one vertex."""
    if len(triangles) < 4 or not np.isfinite(positions).all():
        return 0.0
    _, vertex = np.unique(positions, axis=0, return_inverse=True)
    t = vertex.reshape(-1)[triangles].astype(np.int64)
    t = t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]
    a, b = t.ravel(), t[:, [1, 2, 0]].ravel()
    n = np.int64(len(positions))
    if not np.array_equal(np.sort(a * n + b), np.sort(b * n + a)):
        return 0.0
    p = positions[triangles].astype(np.float64)
    return float(np.sign(np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum()))


def _mean_radiance(
    geometry: Geometry, programs: list, found: _PartEmitters, places: Placements, chosen: np.ndarray
) -> np.ndarray:
    """(1 or k, n, 3) radiance of a part's emissive triangles at its placements `chosen`: constant, or probed, at one
    of them for all where it does not go by the placement. Where there are too many, each has the mean of a few.
    """
    radiance = np.ones((1, len(found.triangle), 3))
    for m in np.unique(found.material):
        rows = np.flatnonzero(found.material == m)
        constant = programs[m].constant_emission
        if constant is not None:
            radiance[:, rows] = constant
        elif len(rows) > _MOST_PROBED:
            radiance[:, rows] = estimate_emission(geometry.materials[m].graph)
        else:
            probed = chosen if programs[m].emission_placed else chosen[:1]
            most = max(_MOST_PROBED // len(rows), 1)
            some = probed[np.linspace(0, len(probed) - 1, min(most, len(probed))).astype(np.int64)]
            own = _probed(geometry, m, programs[m], found.triangle[rows], places, some)
            if len(some) < len(probed):
                own = own.mean(0, keepdims=True)
            if len(own) > len(radiance):
                radiance = np.repeat(radiance, len(own), 0)
            radiance[:, rows] = own
    return radiance


def _probed(
    geometry: Geometry, material: int, program, triangle: np.ndarray, places: Placements, chosen: np.ndarray
) -> np.ndarray:
    """(k, n, 3) mean emission of triangles (n,) at placements `chosen` over a few points; none so dark that it could
    never be chosen."""
    k, n, probes = len(chosen), len(triangle), len(_PROBES)
    u, v = np.tile(_PROBES, (k * n, 1)).T
    points = emitting_points(
        geometry, places, np.repeat(chosen, n * probes), np.tile(np.repeat(triangle, probes), k), u, v,
        program.emission_needs, scattered=not sampled_sides(geometry.materials[material], program),
    )  # fmt: skip
    emission = np.nan_to_num(np.asarray(program.emission(points), np.float64), posinf=0.0)
    mean = np.broadcast_to(emission, (points.count, 3)).reshape(k, n, probes, 3).mean(2)
    return np.maximum(mean, max(0.01 * float(np.abs(mean).mean()), 1e-6))


def _placed(found: _PartEmitters, radiance: np.ndarray, places: Placements, chosen: np.ndarray) -> tuple:
    """One part's emitters at the placements `chosen`: the columns of `pack_emitters`, placement by placement.

    radiance (1 or k, n, 3): of all placements, or of each.
    """
    m = places.world_from_part[chosen]
    vertices = np.einsum("kij,nvj->knvi", m[:, :, :3], found.vertices) + m[:, None, None, :, 3]
    mirrored = np.linalg.det(m[:, :, :3]) < 0.0
    # mirroring turns the winding round, but not the modelled front
    turned = ((found.sides & FRONT) << 1) | ((found.sides & BACK) >> 1)
    sides = np.where(mirrored[:, None], turned, found.sides)
    k, n = sides.shape
    return (
        vertices.reshape(-1, 3, 3),
        sides.astype(np.uint8).ravel(),
        np.broadcast_to(radiance, (k, n, 3)).reshape(-1, 3),
        np.tile(found.material, k),
        np.repeat(places.visibility[chosen], n),
        np.tile(found.triangle, k),
        np.repeat(places.path[chosen], n),
        np.repeat(chosen.astype(np.int32), n),
        np.repeat(np.where(mirrored, -found.outside, found.outside), n),
    )
