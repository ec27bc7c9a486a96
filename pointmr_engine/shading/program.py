"""Node graphs compiled to short numpy programs over batches of surface points.

`compile_graph` removes what nothing reads, folds constants, flattens mix and add shaders into leaves with weights,
and says what the program needs of a point. `Program.evaluate` then runs every remaining node once per batch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointmr_engine.scene.graph import Graph
from pointmr_engine.shading.compiler import Constant, Slot, Source, Step
from pointmr_engine.shading.differentials import axes_at, moved_points
from pointmr_engine.shading.flatten import Flat, flatten
from pointmr_engine.shading.footprint_mean import NEEDS
from pointmr_engine.shading.leaf_plan import LeafPlan
from pointmr_engine.shading.leaves import COLUMNS, GLASS, GLOSSY, METALLIC, PRINCIPLED, REFRACTION, Leaf
from pointmr_engine.shading.nodes.registry import Call
from pointmr_engine.shading.points import RAY_CAMERA, SurfacePoints, add_missing_layers, names_of
from pointmr_engine.shading.values import normalize

PLACES = frozenset({"position", "local", "generated", "uv", "attribute", "window"})
# what a camera's ray tells that its direction alone does not
UNFORESEEN = frozenset({"ray_length", "transparent_depth", "camera_from_world", "window"})
OF_INSTANCE = frozenset(
    {"object_location", "object_color", "object_index", "object_random", "instance_attribute"}
)
# what the place tells that a part is put to, and, where nothing is read of the ray that normals turn with
OF_PLACEMENT = OF_INSTANCE | {"position", "world_from_part"}
OF_ROTATION = frozenset({"normal", "smooth_normal", "geometric_normal"})
_NORMALS = frozenset({"normal", "smooth_normal"})
BLUNT = 0.45  # roughness from which lobes are wider than what most bumps would make of them


class Plan:
    """The steps that some sources depend on, with the outputs wanted of each, and what they read from the points."""

    def __init__(self, steps: list[Step], sources: list[Source]) -> None:
        wanted: dict[int, set[str]] = {}
        self.sub: dict[tuple[int, str], Plan] = {}
        needs: set[str] = set()
        for s in sources:
            if isinstance(s, Slot):
                wanted.setdefault(s.step, set()).add(s.output)
        for index in range(max(wanted, default=-1), -1, -1):
            if index not in wanted:
                continue
            step = steps[index]
            ignored = step.type.ignores(step.params, frozenset(wanted[index]))
            for name, source in step.inputs.items():
                if isinstance(source, Slot) and name not in ignored:
                    wanted.setdefault(source.step, set()).add(source.output)
            needs.update(step.type.reads(step.params, frozenset(wanted[index])))
            for name in step.type.differenced:
                if isinstance(step.inputs[name], Slot):
                    self.sub[index, name] = sub = Plan(steps, [step.inputs[name]])
                    needs |= sub.needs
        self.steps = [(i, steps[i], frozenset(wanted[i])) for i in sorted(wanted)]
        self.needs = frozenset(needs)
        self._needs_moved = frozenset().union(*(sub.needs for sub in self.sub.values()))

    def run(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """Values of all wanted outputs, each node evaluated once."""
        memo: dict[tuple[int, str], np.ndarray] = {}
        displaced: dict[tuple[int, float, bool, bool], SurfacePoints] = {}
        for index, step, wanted in self.steps:
            ignored = step.type.ignores(step.params, wanted)
            inputs = {name: read(s, memo) for name, s in step.inputs.items() if name not in ignored}
            moved = self._mover(index, step, points, displaced) if step.type.differenced else None
            values = step.type.evaluate(Call(inputs, step.params, points, wanted, moved))
            for name in wanted:
                memo[index, name] = np.asarray(values[name], np.float32)
        return memo

    def _mover(self, index: int, step: Step, points: SurfacePoints, displaced: dict):
        def moved(name: str, axis: int, width: float, one_normal: bool = False) -> np.ndarray:
            source = step.inputs[name]
            if (index, name) not in self.sub:
                return read(source, {})
            key = axis, width, not step.params.get("raised", False), one_normal
            if key not in displaced:
                offset = axes_at(points)[axis] * (points.footprint * width)[:, None]
                needs = self._needs_moved - _NORMALS if one_normal else self._needs_moved
                displaced[key] = there = moved_points(points, offset, needs, bump=key[2])
                if one_normal:
                    there.normal, there.smooth_normal = points.normal, points.smooth_normal
            return read(source, self.sub[index, name].run(displaced[key]))

        return moved


def _decided(steps: list[Step], own: list[bool], through: bool = False) -> list[bool]:
    """Which steps are named by their `own`, or depend on one that is; through: what is differenced, too."""
    found: list[bool] = []
    for step, named in zip(steps, own, strict=True):
        below = any(found[s.step] for s in step.inputs.values() if isinstance(s, Slot))
        found.append(named or (below and (through or not step.type.differenced)))
    return found


def _columns(leaves: list[LeafPlan], decided: list[bool]) -> list[Slot]:
    """The sources of columns that are decided."""
    columns = [s for leaf in leaves for _, _, s in leaf.columns]
    return [s for s in columns if isinstance(s, Slot) and decided[s.step]]


def _is_image(step: Step) -> bool:
    return step.type.footprint is not None


def _decided_by_images(steps: list[Step], through: bool = False) -> list[bool]:
    """`_decided`, by image textures."""
    return _decided(steps, [_is_image(step) for step in steps], through)


def _is_place(step: Step, even: frozenset[str]) -> bool:
    """Whether it reads what differs from place to place of a footprint; even: attributes that do not."""
    return any(
        need.partition(":")[0] in PLACES and need not in even
        for need in step.type.reads(step.params, frozenset(step.type.outputs))
    )


def _is_stepped(step: Step) -> bool:
    return step.type.stepped is not None and step.type.stepped(step.params)


def fine_slots(
    steps: list[Step], leaves: list[LeafPlan], opaque: bool, even: frozenset[str]
) -> tuple[list[Slot], list[Slot]]:
    """The sources of columns that fine nodes decide, and of normals that fine nodes or images do.

    A column that is differenced takes the footprint into account itself; normals that bumps bend differ within it,
    which is worth telling from their mean where lobes may be sharp. Wide ones have one place's of what is fine; a
    pyramid would give them the mean of slopes, however steep, so that what images bend is told of them, too. Steps that
    coordinates are cut into are fine, and images that jump, of `opaque` materials: beside a hole, means would show what
    is not there. What reads nothing but what is `even` on triangles, a leaf's random number, say, is not.
    """
    placed = _decided(steps, [_is_place(step, even) for step in steps], through=True)
    fine = [
        at and (step.type.fine or (_is_stepped(step) and (opaque or not _is_image(step))))
        for step, at in zip(steps, placed, strict=True)
    ]
    bends = [(at and step.type.fine) or _is_image(step) for step, at in zip(steps, placed, strict=True)]
    bent = _decided(steps, bends, through=True)
    by_images = _decided_by_images(steps, through=True)
    normals = []
    for leaf in leaves:
        told = bent if _may_be_sharp(leaf) else by_images
        # the surface's own is that of leaves, too, which have none
        found = (s for name, s in leaf.normals.items() if name in ("normal", "coat_normal"))
        normals += [s for s in found if isinstance(s, Slot) and told[s.step]]
    return _columns(leaves, _decided(steps, fine)), normals


def image_slots(steps: list[Step], leaves: list[LeafPlan]) -> list[Slot]:
    """The sources of columns that images decide, filtered over footprints."""
    return _columns(leaves, _decided_by_images(steps))


def _may_be_sharp(leaf: LeafPlan) -> bool:
    """Whether a leaf's microfacets may be smoother than BLUNT, as far as its constants tell."""
    names = COLUMNS[leaf.kind]
    if leaf.kind not in (PRINCIPLED, GLOSSY, GLASS, REFRACTION, METALLIC):
        return False
    linked = {first for first, _, source in leaf.columns if isinstance(source, Slot)}

    def least(name: str) -> float:
        at = names.index(name)
        return 0.0 if at in linked else float(leaf.template[0, at])

    if leaf.distribution == "sharp" or least("roughness") < BLUNT:
        return True
    if leaf.kind != PRINCIPLED:
        return False
    coated = names.index("coat_weight") in linked or least("coat_weight") > 0.0
    return coated and least("coat_roughness") < BLUNT


def read(source: Source, memo: dict[tuple[int, str], np.ndarray]) -> np.ndarray:
    """A source's value."""
    return source.value if isinstance(source, Constant) else memo[source.step, source.output]


class Program:
    """A compiled graph. It holds no state between calls: threads may share it.

    needs: what `evaluate` reads of SurfacePoints: field names, "uv:NAME" ("uv:" is the active layer),
        "uv_footprint:NAME", "tangent:NAME", "attribute:NAME", "instance_attribute:NAME", "moved".
    transparency_needs, emission_needs, passed_needs: the same for `transparency`, `emission` and `passed_and_shown`.
        fine_reads: for `fine_values`, of which rough_names are roughnesses; fine_needs: what shading.footprint_mean
        wants besides; all are empty where nothing is fine.
        normal_reads, normal_needs, rough_reads...: the same for `normal_values`, `rough_values` and `image_values`.
    varying_with: subset of {"surface", "view", "ray", "instance"}; surface_only: nothing beyond "surface".
    leaves: tuple of LeafPlan (kind and what each column varies with).
    masked: colours of its images count by their alpha, so that holes in them have none, and do not say what passes.
    opaque: light never passes straight through; turns: how much of it does depends on where it is seen from (`faces`;
    and not only on which side: `turns_with_view`), on the ray's way there (`unforeseen`), or on where the part is
    placed (`placed`), or more may be sent besides than what does not pass (`adds`).
    emissive: it can emit; emission_placed: what does depends on where the part is placed; constant_emission: rgb,
    (0, 0, 0) if it never emits, None where emission varies.
    max_lobes: upper bound of BSDF lobes at a point. warnings: unsupported nodes, each named once.
    """

    def __init__(
        self,
        kind: str,
        flat: Flat,
        filtered: bool = False,
        unfiltered: Flat | None = None,
        even: frozenset[str] = frozenset(),
    ) -> None:
        """unfiltered: `flat` without footprints, where it has them; even: see compile_graph."""
        steps, leaves, transparency, emission, _, warnings = flat
        unfiltered = unfiltered or flat
        self.kind = kind
        self.leaves = tuple(leaves)
        self.warnings = warnings
        sources = [s for leaf in leaves for _, _, s in leaf.columns]
        sources += [s for leaf in leaves for s in leaf.normals.values()]
        self._plan = Plan(steps, sources)
        self._transparency, self._shown = unfiltered.transparency, unfiltered.shown if transparency else []
        self._emission = emission
        self._transparency_plan = Plan(unfiltered.steps, self._transparency)
        self._passed_plan = Plan(unfiltered.steps, [*self._transparency, *self._shown])
        self._emission_plan = Plan(steps, emission)
        columns, normals = (
            fine_slots(steps, leaves, not transparency, even) if filtered and kind == "surface" else ([], [])
        )
        self._fine_plan = Plan(steps, columns)
        self._fine_names = {(s.step, s.output) for s in columns}
        rough = [leaf.roughness for leaf in leaves if leaf.roughness in columns]
        self.rough_names = frozenset((s.step, s.output) for s in rough)
        self._normal_plan = Plan(steps, normals)
        self._normal_names = {(s.step, s.output) for s in normals}
        by_images = _decided_by_images(steps, through=True)
        self.normals_by_images: bool = any(by_images[s.step] for s in normals)
        images = image_slots(steps, leaves) if filtered and kind == "surface" else []
        images = [s for s in images if s not in columns]
        self._image_plan = Plan(steps, images)
        self._image_names = {(s.step, s.output) for s in images}
        of_images = [leaf.roughness for leaf in leaves if leaf.roughness in images]
        self._rough_plan = Plan(steps, of_images)
        self._of_images = {(s.step, s.output) for s in of_images}
        self.rough_reads: frozenset[str] = self._rough_plan.needs
        self.rough_needs: frozenset[str] = self.rough_reads | NEEDS if of_images else frozenset()
        self.image_reads: frozenset[str] = self._image_plan.needs
        self.image_needs: frozenset[str] = self.image_reads | NEEDS if images else frozenset()
        self.needs: frozenset[str] = self._plan.needs
        self.fine_reads: frozenset[str] = self._fine_plan.needs
        self.fine_needs: frozenset[str] = self.fine_reads | NEEDS if columns else frozenset()
        self.normal_reads: frozenset[str] = self._normal_plan.needs
        self.normal_needs: frozenset[str] = self.normal_reads | NEEDS if normals else frozenset()
        self.transparency_needs: frozenset[str] = self._transparency_plan.needs
        self.passed_needs: frozenset[str] = self._passed_plan.needs
        self.emission_needs: frozenset[str] = self._emission_plan.needs
        self.emission_placed: bool = bool(names_of(self.emission_needs) & OF_PLACEMENT)
        self.varying_with: frozenset[str] = frozenset().union(*(leaf.varying_with for leaf in leaves))
        self.surface_only: bool = self.varying_with <= {"surface"}
        self.opaque: bool = not transparency
        self.unforeseen: bool = bool(self.transparency_needs & UNFORESEEN)
        read = names_of(self.passed_needs)
        self.adds: bool = bool(self._shown)
        self.placed: bool = bool(read & (OF_PLACEMENT if "incoming" in read else OF_PLACEMENT | OF_ROTATION))
        self.turns_with_view: bool = "incoming" in read
        self.faces: bool = self.turns_with_view or "backfacing" in read
        self.turns: bool = self.faces or self.unforeseen or self.placed or self.adds
        self.masked: bool = _masked(self._plan.steps) and not _colours(self._transparency_plan.steps)
        self.emissive: bool = bool(emission)
        self.constant_emission: tuple[float, float, float] | None = None
        if all(isinstance(s, Constant) for s in emission):
            self.constant_emission = tuple(float(v) for v in self.emission(SurfacePoints(1))[0])
        # a lobe whose roughness differs within footprints may become two; a Principled leaf has room for that
        self.max_lobes: int = sum(leaf.max_lobes for leaf in leaves) + len(rough) + len(of_images)

    def evaluate(self, points: SurfacePoints, means: Sequence[tuple[np.ndarray, dict]] = ()) -> list[Leaf]:
        """Leaves of the N points; a leaf's block has N rows, or 1 where nothing in it varies. Blocks are read-only.

        means: rows (n,) of the points and what takes the place of `fine_values`, `normal_values` or `image_values`
        there, where that was averaged.
        """
        return self.fill_leaves(self.values(points), means)

    def values(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """What `fill_leaves` takes."""
        with np.errstate(all="ignore"):
            return self._plan.run(points)

    def fill_leaves(self, values: dict, means: Sequence[tuple[np.ndarray, dict]] = ()) -> list[Leaf]:
        """`evaluate`, of the values at the points."""
        memo = dict(values)
        for rows, others in means:
            for name, value in others.items():
                if len(memo[name]) <= rows.max(initial=0):
                    continue  # one value, which is its own mean
                memo[name] = memo[name].copy()
                memo[name][rows] = normalize(value) if name in self._normal_names else value
        return [_fill(leaf, memo) for leaf in self.leaves]

    def fine_values(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """What fine textures decide (shading.footprint_mean), by names of its own; reads `fine_reads`."""
        with np.errstate(all="ignore"):
            memo = self._fine_plan.run(points)
        return {name: memo[name] for name in self._fine_names}

    def rough_values(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """Roughnesses that images decide and nothing fine does; reads `rough_reads`."""
        with np.errstate(all="ignore"):
            memo = self._rough_plan.run(points)
        return {name: memo[name] for name in self._of_images}

    def normal_values(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """Normals that images bend, and fine textures where lobes may be sharp; reads `normal_reads`."""
        with np.errstate(all="ignore"):
            memo = self._normal_plan.run(points)
        return {name: memo[name] for name in self._normal_names}

    def image_values(self, points: SurfacePoints) -> dict[tuple[int, str], np.ndarray]:
        """What images decide and nothing fine does, by names of its own; reads `image_reads`."""
        with np.errstate(all="ignore"):
            memo = self._image_plan.run(points)
        return {name: memo[name] for name in self._image_names}

    def transparency(self, points: SurfacePoints) -> np.ndarray:
        """(N, 3) float32 share of light that passes straight through at the points themselves, for shadow rays: what
        materials make of a mean of their images is not the mean of what they let through.
        """
        return _sums(self._transparency_plan, points, self._transparency)[0]

    def passed_and_shown(self, points: SurfacePoints) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) float32 each: `transparency`; what is emitted, and the weights of all lobes, of a program that `adds`.
        Reads `passed_needs`.
        """
        passed, shown = _sums(self._passed_plan, points, self._transparency, self._shown)
        return passed, shown

    def emission(self, points: SurfacePoints) -> np.ndarray:
        """(N, 3) float32 emitted radiance (background radiance for a world), without a coat's or sheen's shading."""
        return _sums(self._emission_plan, points, self._emission)[0]


def _sums(plan: Plan, points: SurfacePoints, *sums: list[Source]) -> list[np.ndarray]:
    """(N, 3) float32 of what `plan` makes of the terms of each of `sums` at the points, of which there may be none."""
    totals = [np.zeros((points.count, 3), np.float32) for _ in sums]
    if not points.count:
        return totals
    with np.errstate(all="ignore"):
        memo = plan.run(points)
    for total, terms in zip(totals, sums, strict=True):
        for term in terms:
            value = read(term, memo)
            total += value if value.ndim == 2 else value[:, None]
        if not np.isfinite(total.sum()):
            np.nan_to_num(total, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return totals


def _fill(leaf: LeafPlan, memo: dict[tuple[int, str], np.ndarray]) -> Leaf:
    normals = {name: read(s, memo) for name, s in leaf.normals.items()}
    columns = [(c, w, read(s, memo)) for c, w, s in leaf.columns if isinstance(s, Slot)]
    block = leaf.template
    if columns:
        block = np.repeat(block, max(len(v) for _, _, v in columns), axis=0)
        for first, width, value in columns:
            block[:, first : first + width] = value if value.ndim == 2 else value[:, None]
        if not np.isfinite(block.sum()):
            np.nan_to_num(block, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    return Leaf(leaf.kind, block, distribution=leaf.distribution, **normals)


def compile_graph(
    graph: Graph, kind: str = "surface", filtered: bool = True, even: frozenset[str] = frozenset()
) -> Program:
    """Compile a material ("surface"), world ("background") or lamp ("light") graph. Never raises for odd nodes.

    filtered: images are averaged over the ray's footprint. Without, they are read at the point: right where many rays
    share a pixel, whose mean is then the filter, after shading instead of before. even: of what it needs, what has one
    value all over each triangle (hierarchy.layers.even_layers): textures of that alone are not averaged.
    """
    flat = flatten(graph, kind, filtered)
    unfiltered = flatten(graph, kind, False) if filtered and flat.transparency else None
    return Program(kind, flat, filtered, unfiltered, even)


def evaluate_background(
    program: Program,
    directions: np.ndarray,
    ray_kind: int = RAY_CAMERA,
    camera_from_world: np.ndarray | None = None,
    window: np.ndarray | None = None,
    ray_depth: int = 0,
) -> np.ndarray:
    """Radiance (N, 3) float32 of a world program seen in unit world directions (N, 3), pointing away from the viewer.

    ray_kind: bits RAY_* of shading.points, what the Light Path node sees (a camera ray by default). camera_from_world
    (3, 4) and window (N, 2) matter only to graphs that ask for them.
    """
    n = len(directions)
    if not program._emission_plan.needs:
        return program.emission(SurfacePoints(n))
    d = np.ascontiguousarray(directions, np.float32)
    depth = np.full(n, ray_depth, np.int32)
    zero = np.zeros(n, np.int32)
    camera = None
    if camera_from_world is not None:
        camera = np.array(camera_from_world, np.float64)[:3]
        camera[:, 3] = 0  # the background is infinitely far: only the camera's rotation counts
    points = SurfacePoints(
        n,
        position=np.asarray(directions, np.float64),
        normal=-d,
        geometric_normal=-d,
        smooth_normal=-d,
        incoming=-d,
        backfacing=np.zeros(n, np.bool_),
        generated=d,
        local=d,
        ray_kind=np.full(n, ray_kind, np.uint8),
        ray_length=np.full(n, np.finfo(np.float32).max, np.float32),
        ray_depth=depth,
        diffuse_depth=zero,
        glossy_depth=zero,
        transmission_depth=zero,
        transparent_depth=zero,
        footprint=np.zeros(n, np.float32),
        barycentric=np.zeros((n, 2), np.float32),
        object_location=np.zeros((n, 3), np.float32),
        object_color=np.zeros((n, 4), np.float32),
        object_index=zero,
        object_random=np.zeros(n, np.float32),
        camera_from_world=camera if camera is not None else np.eye(4)[:3],
        window=window if window is not None else np.zeros((n, 2), np.float32),
    )
    add_missing_layers(points, program._emission_plan.needs)
    return program.emission(points)


def _masked(steps) -> bool:
    """Program.masked, of the steps of its Plan."""
    return all(
        params.get("unassociate", True) and params.get("texture") is not None and params["texture"].associated
        for params in _colours(steps)
    )


def _colours(steps) -> list[dict]:
    """Parameters of the images of whose colours steps of a Plan make use."""
    return [s.params for _, s, wanted in steps if s.type.kind == "image_texture" and "color" in wanted]
