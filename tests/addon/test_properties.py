"""Properties, panels and registration."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import bpy
import pytest

import blender_addon

ADDON = Path(blender_addon.__file__).parent


@pytest.fixture(autouse=True)
def registered():
    bpy.ops.wm.read_factory_settings(use_empty=False)
    blender_addon.register()
    bpy.context.scene.render.engine = "POINTMR"
    yield


def run(code: str) -> str:
    """Run Python code in a fresh process with bpy; its output."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=ADDON.parent
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(name: str) -> dict[str, int]:
    return {i.identifier: i.value for i in bpy.context.scene.pointmr.bl_rna.properties[name].enum_items}


def test_enum_items_have_fixed_numbers():
    """Files store the number: these never change."""
    assert numbers("method") == {"CONVENTIONAL": 2, "DISTRIBUTED": 3}
    assert numbers("pixel_filter_type") == {"BOX": 0, "GAUSSIAN": 1, "BLACKMAN_HARRIS": 2}


def test_settings_survive_a_file(tmp_path):
    settings = bpy.context.scene.pointmr
    settings.method, settings.pixel_filter_type, settings.samples = "CONVENTIONAL", "GAUSSIAN", 77
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    settings = bpy.context.scene.pointmr
    assert (settings.method, settings.pixel_filter_type, settings.samples) == ("CONVENTIONAL", "GAUSSIAN", 77)
    assert bpy.context.scene.render.engine == "POINTMR"


@pytest.mark.parametrize(
    ("name", "value", "target", "expected"),
    [
        ("method", "CONVENTIONAL", "method", "conventional"),
        ("samples", 37, "samples", 37),
        ("seed", 5, "seed", 5),
        ("pixel_filter_type", "GAUSSIAN", "pixel_filter", "gaussian"),
        ("filter_width", 2.5, "filter_width", 2.5),
        ("max_bounces", 3, "max_bounces", 3),
        ("glossy_bounces", 2, "glossy_bounces", 2),
        ("transmission_bounces", 9, "transmission_bounces", 9),
        ("transparent_max_bounces", 7, "transparent_max_bounces", 7),
        ("caustics_reflective", False, "caustics_reflective", False),
        ("caustics_refractive", False, "caustics_refractive", False),
        ("film_exposure", 2.0, "film_exposure", 2.0),
        ("sample_clamp_direct", 4.0, "clamp_direct", 4.0),
        ("sample_clamp_indirect", 6.0, "clamp_indirect", 6.0),
    ],
)
def test_every_property_reaches_the_engine(name, value, target, expected):
    from blender_addon import sync

    scene = bpy.context.scene
    assert getattr(sync.settings_from_blender(scene), target) != expected
    setattr(scene.pointmr, name, value)
    assert getattr(sync.settings_from_blender(scene), target) == expected


def test_animated_seed_changes_with_the_frame():
    from blender_addon import sync

    scene = bpy.context.scene
    scene.pointmr.use_animated_seed = True
    scene.frame_set(1)
    first = sync.settings_from_blender(scene).seed
    scene.frame_set(2)
    assert sync.settings_from_blender(scene).seed != first


def test_blenders_panels_are_shared_and_replaced_ones_are_not():
    from bl_ui import properties_data_camera, properties_data_light, properties_material, properties_render

    assert "POINTMR" in properties_render.RENDER_PT_color_management.COMPAT_ENGINES
    assert "POINTMR" in properties_data_camera.DATA_PT_camera_dof.COMPAT_ENGINES
    assert "POINTMR" in properties_material.EEVEE_MATERIAL_PT_context_material.COMPAT_ENGINES
    assert "POINTMR" not in properties_data_light.DATA_PT_light.COMPAT_ENGINES
    assert "POINTMR" not in properties_render.RENDER_PT_simplify.COMPAT_ENGINES


def test_registering_twice_and_unregistering_leaves_nothing():
    out = run("""
import bpy

def seen():
    names = set(dir(bpy.types)) | {f"Scene.{p}" for p in bpy.types.Scene.bl_rna.properties.keys()}
    names |= {f"Object.{p}" for p in bpy.types.Object.bl_rna.properties.keys()}
    names |= {f"ViewLayer.{p}" for p in bpy.types.ViewLayer.bl_rna.properties.keys()}
    names |= {f"{c.__name__} {e}" for c in bpy.types.Panel.__subclasses__()
              for e in getattr(c, "COMPAT_ENGINES", ())}
    names |= {f"{n} {h}" for n in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, n), list)
              for h in getattr(bpy.app.handlers, n)}
    return names

import blender_addon
modules = blender_addon._modules()  # defines Python classes, registers nothing
own = {c.__name__ for c in bpy.types.Panel.__subclasses__() if c.__module__.startswith("blender_addon")}
before = {n for n in seen() if n.split()[0] not in own}
for _ in range(2):
    blender_addon.register()
    blender_addon.register()
    assert hasattr(bpy.context.scene, "pointmr")
    blender_addon.unregister()
    blender_addon.unregister()
after = {n for n in seen() if n.split()[0] not in own}
print(sorted(after - before), sorted(before - after))
""")
    assert out.splitlines()[-1] == "[] []"


def test_importing_and_registering_loads_no_kernels():
    out = run("""
import sys, bpy, blender_addon
blender_addon.register()
print([m for m in ("numba", "llvmlite", "OpenEXR") if m in sys.modules])
""")
    assert out.splitlines()[-1] == "[]"


def test_what_blender_loads_imports_itself_by_relative_names():
    """As an extension the package is called bl_ext.user_default.pointmr, not blender_addon."""
    command_line = {"cli.py", "batch.py", "headless.py"}
    absolute = [
        f"{path.relative_to(ADDON)}: {line}"
        for path in ADDON.rglob("*.py")
        if path.name not in command_line and path.relative_to(ADDON).parts[0] != "command"
        for line in path.read_text().splitlines()
        if re.match(r"\s*(from|import) blender_addon\b", line)
    ]
    assert absolute == []
