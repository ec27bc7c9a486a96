"""Blender's camera to the engine's."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.camera import Camera

from .transforms import matrix

KINDS = {"PERSP": "PERSPECTIVE", "ORTHO": "ORTHOGRAPHIC"}


def camera(ob, depsgraph, watch) -> Camera | None:
    """The engine's camera for an evaluated object; None, and an error, where it cannot be rendered from.

    Any object may be looked through, as in Blender: along its -z axis, with a camera's defaults.
    """
    if ob is None:
        watch.error("the scene has no camera")
        return None
    world = unscaled(matrix(ob.matrix_world))
    if ob.type != "CAMERA":
        return Camera(world, name=ob.name)
    data = ob.data
    if data.type not in KINDS:
        what = "panoramic" if data.type == "PANO" else data.type.lower()
        watch.error(f"camera '{ob.name}': {what} cameras are not supported")
        return None
    result = Camera(
        world,
        KINDS[data.type],
        focal_length=data.lens,
        sensor_width=data.sensor_width,
        sensor_height=data.sensor_height,
        sensor_fit=data.sensor_fit,
        ortho_scale=data.ortho_scale,
        shift_x=data.shift_x,
        shift_y=data.shift_y,
        clip_start=data.clip_start,
        clip_end=data.clip_end,
        name=ob.name,
    )
    dof = data.dof
    if dof.use_dof:
        result.fstop = max(dof.aperture_fstop, 1e-5)
        result.focus_distance = focus_distance(dof, world, depsgraph)
        result.blades = dof.aperture_blades
        result.blade_rotation = dof.aperture_rotation
        result.aperture_ratio = dof.aperture_ratio
    return result


def unscaled(world: np.ndarray) -> np.ndarray:
    """The same matrix with columns of length 1."""
    size = np.sqrt((world[:3, :3] ** 2).sum(0))
    world = world.copy()
    world[:3, :3] /= np.where(size > 0, size, 1)
    return world


def focus_distance(dof, world: np.ndarray, depsgraph) -> float:
    """Distance of the plane of focus along the view axis: to the focus object (or its bone), else as set."""
    target = dof.focus_object
    if target is None:
        return max(dof.focus_distance, 1e-5)
    target = target if target.is_evaluated else target.evaluated_get(depsgraph)
    place = matrix(target.matrix_world)
    bone = target.pose.bones.get(dof.focus_subtarget) if target.type == "ARMATURE" and target.pose else None
    if bone is not None:
        place = place @ matrix(bone.matrix)
    to_target = place[:3, 3] - world[:3, 3]
    return max(abs(float(to_target @ world[:3, 2])), 1e-5)
