"""The whole export, part by part; `blender_addon.sync.export` is its public face."""

from __future__ import annotations

from pointmr_engine.scene.scene import Scene

from . import attributes
from .camera import camera as read_camera
from .instances import InstanceSync
from .lights import lights as read_lights
from .materials import MaterialSync
from .meshes import MeshSync, SlotMaterials
from .report import Watch
from .world import world as read_world


def export_scene(
    depsgraph, *, report=None, cancel=None, progress=None, view_layer=None, camera=None
) -> Scene:
    """See `blender_addon.sync.export`."""
    watch = Watch(report, cancel, progress)
    watch.poll(0.0, "reading objects")
    scene = depsgraph.scene_eval
    layer = view_layer or depsgraph.view_layer_eval
    material_sync = MaterialSync(watch.say)
    slots = SlotMaterials(material_sync, layer.material_override)
    sync = InstanceSync(depsgraph, MeshSync(slots, watch), watch, requested_by_all(slots, depsgraph))
    root = sync.root()
    watch.poll(1.0, "reading lights")
    lamps = read_lights(sync.lamps, root, material_sync, watch)
    source = camera if camera is not None else scene.camera
    if source is not None and not source.is_evaluated:
        source = source.evaluated_get(depsgraph)
    return Scene(
        root,
        read_camera(source, depsgraph, watch),
        lamps,
        read_world(scene, layer, material_sync, watch),
    )


def requested_by_all(slots: SlotMaterials, depsgraph):
    """What any evaluated material reads of objects and instancers."""
    materials = [block for block in depsgraph.ids if block.bl_rna.identifier == "Material"]
    return slots.requests(tuple(materials)) if materials else attributes.NOTHING
