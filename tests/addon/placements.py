"""Two ways to list what a scene shows: expanded from the engine's groups, and as Blender expands it itself."""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from blender_addon import sync
from pointmr_engine.scene import group as groups


class Shown(NamedTuple):
    """One mesh in the world."""

    triangles: int
    matrix: np.ndarray  # (4, 4)
    seed: int
    visibility: int
    object_index: int
    name: str = ""


def by_blender(depsgraph) -> list[Shown]:
    """Every mesh of `depsgraph.object_instances`."""
    found = []
    for item in depsgraph.object_instances:
        ob = item.object
        if ob.type != "MESH" or not item.show_self:
            continue
        ob.data.calc_loop_triangles()
        count = len(ob.data.loop_triangles)
        if count:
            world = np.array([row[:] for row in item.matrix_world])
            seed = item.random_id & 0xFFFFFFFF if item.is_instance else None
            found.append(Shown(count, world, seed, 0, ob.pass_index, ob.name))
    return found


def by_engine(root) -> list[Shown]:
    """Every mesh under a Group, placements multiplied out. Seeds are those of one level; below others, None."""
    from pointmr_engine.scene.group import VISIBLE

    found = []

    def visit(group, world, seed, visibility, index):
        for mesh in group.meshes:
            found.append(Shown(len(mesh.triangles), world, seed, visibility, index, mesh.name))
        for inst in group.instances:
            for i in range(len(inst)):

                def value(array, default, i=i):
                    return default if array is None else array[i if len(array) > 1 else 0]

                own = int(value(inst.seed, 0))
                child = inst.groups[int(value(inst.group_index, 0))]
                matrix = world @ np.vstack([inst.transforms[i], [0, 0, 0, 1]])
                mine = own if seed == 0 else (seed if own == 0 else None)
                seen = int(value(inst.visibility, VISIBLE))
                combined = (visibility & seen & 63) | ((visibility | seen) & 64)
                visit(child, matrix, mine, combined, int(value(inst.object_index, index)))

    visit(root, np.eye(4), 0, VISIBLE, 0)
    return found


def differences(ours: list[Shown], theirs: list[Shown], tolerance: float = 2e-4) -> str:
    """What the lists do not have in common, in any order; "" if they show the same."""
    if len(ours) != len(theirs):
        return f"{len(ours)} placements instead of {len(theirs)}: {names(ours)} / {names(theirs)}"
    left = {}
    for s in ours:
        left.setdefault((s.triangles, *np.round(s.matrix[:3, 3], 1)), []).append(s)
    for s in theirs:
        scale = max(1.0, np.abs(s.matrix).max())
        place = np.round(s.matrix[:3, 3], 1)
        near = [
            (key, i)
            for d in np.ndindex(3, 3, 3)
            for key in [(s.triangles, *np.round(place + (np.array(d) - 1) * 0.1, 1))]
            for i, o in enumerate(left.get(key, ()))
            if np.abs(o.matrix - s.matrix).max() < tolerance * scale
        ]
        if not near:
            return f"'{s.name}' ({s.triangles} triangles) is missing at {s.matrix[:3].round(4).tolist()}"
        key, i = near[0]
        left[key].pop(i)
    return ""


def names(shown: list[Shown]) -> dict[str, int]:
    count: dict[str, int] = {}
    for s in shown:
        count[s.name] = count.get(s.name, 0) + 1
    return dict(sorted(count.items())[:30])


def with_depsgraph(action):
    """Call action(depsgraph) inside a render of the current scene (as render engines are called); return its result."""
    box = []

    class Probe(bpy.types.RenderEngine):
        bl_idname = "POINTMR_PROBE"
        bl_label = "Probe"

        def render(self, depsgraph):
            try:
                box.append((action(depsgraph), None))
            except BaseException as error:
                box.append((None, error))

    scene = bpy.context.scene
    keep = scene.render.engine, scene.render.resolution_x, scene.render.resolution_y, scene.camera
    bpy.utils.register_class(Probe)
    made = None
    try:
        scene.render.engine = Probe.bl_idname
        scene.render.resolution_x = scene.render.resolution_y = 8
        if scene.camera is None:
            made = bpy.data.objects.new("probe camera", bpy.data.cameras.new("probe camera"))
            scene.collection.objects.link(made)
            scene.camera = made
        bpy.ops.render.render()
    finally:
        scene.render.engine, scene.render.resolution_x, scene.render.resolution_y, scene.camera = keep
        if made is not None:
            bpy.data.objects.remove(made)
        bpy.utils.unregister_class(Probe)
    result, error = box[0]
    if error is not None:
        raise error
    return result


def export():
    """(engine scene, messages, what Blender shows)."""

    def action(depsgraph):
        said = []
        result = sync.export(depsgraph, report=lambda level, text: said.append((level, text)))
        return result, said, by_blender(depsgraph)

    return with_depsgraph(action)


def check(count: int | None = None):
    """Export, compare with Blender, and give back (engine scene, messages, what ours shows)."""
    result, said, theirs = export()
    ours = by_engine(result.root)
    assert differences(ours, theirs) == ""
    _, instanced, _ = groups.count_triangles(result.root)
    assert instanced == sum(s.triangles for s in theirs)
    if count is not None:
        assert len(ours) == count, names(ours)
    return result, said, ours


def seeds_agree(ours, theirs) -> None:
    """Every placement that Blender gives a random id has it, where one level of instancing made it."""

    def key(s):
        return (s.triangles, *np.round(s.matrix, 3).ravel())

    expected = {}
    for s in theirs:
        expected.setdefault(key(s), set()).add(s.seed)
    for s in ours:
        assert s.seed in expected[key(s)], s.name
