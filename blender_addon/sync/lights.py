"""Blender's light objects to lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.scene.group import VISIBLE
from pointmr_engine.scene.light import Light

MAX_LAMPS = 10_000  # of instanced lamps; more are left out, with a warning
KINDS = {"POINT": "POINT", "SUN": "SUN", "SPOT": "SPOT", "AREA": "AREA"}


def lights(lamp_tree, root, material_sync, watch) -> list[Light]:
    """All lamps of the scene, instanced ones included (up to MAX_LAMPS), in world space."""
    found, total = lamp_tree.expand(root, MAX_LAMPS)
    if total > len(found):
        watch.warn(f"{total} lamps, counting instances: only the first {len(found)} are rendered")
    read: dict[int, Light | None] = {}
    result = []
    for ob, world, seen in found:
        watch.poll()
        key = ob.as_pointer()
        if key not in read:
            read[key] = lamp(ob, material_sync, watch)
        template = read[key]
        if template is not None:
            # scale stays in the matrix: it widens spots' cones and area lights, as in Cycles
            visibility = template.visibility & seen & VISIBLE
            result.append(replace(template, world_from_light=np.array(world), visibility=visibility))
    return result


def lamp(ob, material_sync, watch) -> Light | None:
    """A light object's lamp at the origin; None for what gives no light."""
    data = ob.data
    own = getattr(data, "cycles", None)
    if data.type == "AREA" and getattr(own, "is_portal", False):
        return None  # portals guide sampling, they do not shine
    if data.type not in KINDS:
        watch.warn(f"light '{ob.name}': type {data.type.lower()} is not supported")
        return None
    color = np.array(data.color[:3], np.float64)
    if getattr(data, "use_temperature", False):
        color *= np.array(data.temperature_color[:3])
    graph = material_sync.light_graph(data)
    tint = None if graph is None else constant_emission(graph)
    if tint is not None:
        color, graph = color * tint, None
    light = Light(
        KINDS[data.type],
        color=tuple(float(c) for c in color),
        power=float(data.energy),
        exposure=float(getattr(data, "exposure", 0.0)),
        normalize=bool(getattr(data, "normalize", True)),
        soft_falloff=bool(getattr(data, "use_soft_falloff", True)),
        cast_shadow=bool(getattr(data, "use_shadow", True)),
        use_mis=bool(getattr(own, "use_multiple_importance_sampling", True)),
        lights_catchers=bool(ob.is_shadow_catcher),
        graph=graph,
        name=ob.name,
    )
    if data.type in {"POINT", "SPOT"}:
        light.radius = float(data.shadow_soft_size)
    if data.type == "SUN":
        light.angle = float(data.angle)
    if data.type == "SPOT":
        light.spot_angle, light.spot_blend = float(data.spot_size), float(data.spot_blend)
        if data.use_square:
            watch.warn(f"light '{ob.name}': square cones are only shown in the viewport, as in Cycles")
    if data.type == "AREA":
        light.shape, light.spread = data.shape, float(data.spread)
        light.size_x = float(data.size)
        light.size_y = float(data.size_y if data.shape in {"RECTANGLE", "ELLIPSE"} else data.size)
    return light


def constant_emission(graph) -> np.ndarray | None:
    """The constant RGB radiance of an emission graph, None where it varies. An empty graph emits nothing."""
    if graph.surface is None:
        return np.zeros(3)
    from pointmr_engine.shading.program import compile_graph

    value = compile_graph(graph).constant_emission
    return None if value is None else np.asarray(value, np.float64)[:3]
