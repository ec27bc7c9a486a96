"""`pointmr info`: what a .blend file holds, as the renderer sees it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..headless import (
    BAD_INPUT,
    CommandError,
    FrameObserver,
    interruptible,
    open_blend,
    run_render,
)
from .report import plain


def command_info(a: argparse.Namespace) -> int:
    """`pointmr info`: exports the scene as for a render, and counts."""
    scene = open_blend(a.file, a.scripts)
    facts = scene_facts(scene, a.file)
    if a.json:
        print(json.dumps(facts, indent=1, default=plain))
        return 0
    print(f"{facts['file']}: scene '{facts['scene']}', frames {facts['frames'][0]} to {facts['frames'][1]}")
    print(f"  size: {facts['size'][0]}x{facts['size'][1]}; camera: {facts['camera'] or 'none'}")
    print(f"  triangles: {facts['unique_triangles']:,} unique, {facts['instanced_triangles']:,} instanced")
    print(
        f"  groups: {facts['groups']:,}, nested {facts['depth']} deep; instances stored: {facts['instances']:,}"
    )
    lights = ", ".join(f"{n} {kind}" for kind, n in facts["lights"].items()) or "none"
    print(f"  lights: {lights}")
    print(f"  materials: {len(facts['materials'])}; images: {len(facts['images'])}")
    for name in facts["materials"]:
        print(f"    {name}")
    print(f"  unsupported: {'' if facts['warnings'] else 'nothing'}")
    for text in facts["warnings"]:
        print(f"    {text}")
    return 0


def scene_facts(scene, file: Path) -> dict:
    """What the engine would render of the open file, as JSON-ready facts."""
    import bpy

    from pointmr_engine.scene.group import count_triangles, unique_groups

    scene.render.engine = "POINTMR"
    scene.render.use_sequencer = scene.render.use_compositing = False
    camera = scene.camera
    if camera is None:  # Blender asks for one before it evaluates anything
        scene.camera = bpy.data.objects.new("pointmr info", bpy.data.cameras.new("pointmr info"))
        scene.collection.objects.link(scene.camera)
    observer = FrameObserver(export_only=True)
    with interruptible(observer):
        run_render(observer)
    exported = next(iter(observer.scenes.values()), None)
    if exported is None:
        raise CommandError(
            "; ".join(observer.errors) or "nothing to render: no view layer is enabled", BAD_INPUT
        )
    unique, instanced, depth = count_triangles(exported.root)
    groups = unique_groups(exported.root)
    materials = {m.name: m for g in groups for mesh in g.meshes for m in mesh.materials if m is not None}
    images = {}
    for material in materials.values():
        for node in material.graph.nodes.values():
            for value in node.params.values():
                if hasattr(value, "pixels"):
                    images[value.name] = value
    lights: dict[str, int] = {}
    for light in exported.lights:
        lights[light.kind.lower()] = lights.get(light.kind.lower(), 0) + 1
    settings = observer.settings
    return {
        "file": str(file),
        "scene": scene.name,
        "frames": [scene.frame_start, scene.frame_end],
        "size": [settings.width, settings.height],
        "camera": camera.name if camera else None,
        "unique_triangles": unique,
        "instanced_triangles": instanced,
        "depth": depth,
        "groups": len(groups),
        "instances": sum(len(i) for g in groups for i in g.instances),
        "lights": lights,
        "materials": sorted(materials),
        "images": sorted(images),
        "warnings": observer.warnings + observer.errors,
    }
