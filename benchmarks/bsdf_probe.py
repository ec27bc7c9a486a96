"""BSDF values from Cycles without noise: a grid of faces, one to a pixel, lit by a sun without extent.

Every face has its own shading normal and shader inputs; one sample a pixel gives BSDF * |cos| for each of them.
"""

from __future__ import annotations

import math
import os
import tempfile

import numpy as np

IRRADIANCE = 1.0


def socket_name(name: str) -> str:
    """Blender's socket name of a snake_case input."""
    special = {"ior": "IOR", "specular_ior_level": "Specular IOR Level", "coat_ior": "Coat IOR"}
    special["thin_film_ior"] = "Thin Film IOR"
    return special.get(name, name.replace("_", " ").title())


def _grid(side: int, normals: np.ndarray, attributes: dict[str, np.ndarray]):
    """A mesh of side^2 unit faces with a shading normal each, and face attributes."""
    import bpy

    x, y = np.meshgrid(np.arange(side), np.arange(side))
    corner = np.stack([x, y], -1).reshape(-1, 1, 2) + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    vertices = np.concatenate([corner.reshape(-1, 2), np.zeros((4 * side * side, 1))], axis=1)
    mesh = bpy.data.meshes.new("grid")
    mesh.from_pydata(vertices.tolist(), [], np.arange(4 * side * side).reshape(-1, 4).tolist())
    mesh.normals_split_custom_set(np.repeat(normals, 4, axis=0).tolist())
    for name, values in attributes.items():
        kind = "FLOAT" if values.ndim == 1 else "FLOAT_VECTOR"
        field = "value" if values.ndim == 1 else "vector"
        layer = mesh.attributes.new("probe_" + name, kind, "FACE")
        layer.data.foreach_set(field, np.ascontiguousarray(values, np.float32).ravel())
    return mesh


def _material(node_type: str, inputs: dict, attributes: dict, properties: dict, correction: bool):
    """A material of one shader node whose inputs are constants or face attributes."""
    import bpy

    material = bpy.data.materials.new("probe")
    material.use_nodes = True
    material.cycles.use_bump_map_correction = correction
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new(node_type)
    for name, value in properties.items():
        setattr(shader, name, value)
    for name, value in inputs.items():
        socket = shader.inputs[socket_name(name)]
        socket.default_value = (*value, 1.0) if np.ndim(value) and len(socket.default_value) == 4 else value
    for name, values in attributes.items():
        node = tree.nodes.new("ShaderNodeAttribute")
        node.attribute_name = "probe_" + name
        tree.links.new(
            node.outputs["Fac" if values.ndim == 1 else "Vector"], shader.inputs[socket_name(name)]
        )
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def probe(
    node_type: str,
    normals: np.ndarray,
    light: np.ndarray | None,
    inputs: dict | None = None,
    attributes: dict | None = None,
    properties: dict | None = None,
    correction: bool = True,
    world: float = 0.0,
    samples: int = 1,
    layer: str = "Combined",
) -> np.ndarray:
    """Radiance (n, 3) of n = side^2 faces seen from straight above, whose plane is z = 0.

    light: unit direction toward a sun of irradiance 1 on a facing surface, or None. world: uniform radiance, seen by
    scattered rays only. layer: "Combined", "Diffuse Color", "Glossy Color" or "Transmission Color".
    """
    import bpy
    import OpenEXR

    side = math.isqrt(len(normals))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mesh = _grid(side, normals, attributes or {})
    mesh.materials.append(_material(node_type, inputs or {}, attributes or {}, properties or {}, correction))
    scene.collection.objects.link(bpy.data.objects.new("grid", mesh))

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = side
    camera.location = (side / 2, side / 2, 5.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    if light is not None:
        from mathutils import Vector

        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.angle = 0.0
        sun.data.energy = IRRADIANCE
        sun.rotation_mode = "QUATERNION"
        sun.rotation_quaternion = Vector(light).to_track_quat("Z", "Y")
        scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    background = scene.world.node_tree.nodes.get("Background")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = world

    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = 1 if world else 0
    cycles.diffuse_bounces = 0
    scene.render.resolution_x = scene.render.resolution_y = side
    scene.render.resolution_percentage = 100
    view_layer = scene.view_layers[0]
    view_layer.use_pass_diffuse_color = view_layer.use_pass_glossy_color = True
    view_layer.use_pass_transmission_color = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = os.path.join(folder, "probe")
        scene.render.use_file_extension = True
        bpy.ops.render.render(write_still=True)
        file = OpenEXR.File(os.path.join(folder, "probe.exr"), separate_channels=True)
        channels = {name: c for part in file.parts for name, c in part.channels.items()}
        prefix = f"ViewLayer.{layer}."
        image = np.stack([np.array(channels[prefix + c].pixels) for c in "RGB"], axis=-1)
    return image[::-1].reshape(-1, 3).astype(np.float64)
