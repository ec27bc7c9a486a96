"""Properties, panels and registration."""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

import blender_addon
from blender_addon import kernel_cache
from pointmr_engine import ForwardSettings, RaytraceSettings, RenderSettings

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
    assert numbers("method") == {"RAYTRACE": 0, "FORWARD": 1, "CONVENTIONAL": 2, "DISTRIBUTED": 3}
    assert (
        numbers("raytrace_cones") == numbers("raytrace_preview_cones") == {"1": 1, "4": 4, "16": 16, "64": 64}
    )
    assert numbers("raytrace_secondary") == {"CONES": 0, "RAYS": 1}
    assert numbers("raytrace_visibility") == {"MASKS": 0, "ALPHA": 1}
    assert numbers("pixel_filter_type") == {"BOX": 0, "GAUSSIAN": 1, "BLACKMAN_HARRIS": 2}
    assert numbers("forward_sampling") == {"STATIC": 0, "DYNAMIC": 1}
    assert numbers("forward_draws") == {"RANDOM": 0, "STRATIFIED": 1}
    assert numbers("forward_reconstruction") == {"PIXEL": 0, "GAUSSIAN": 1, "SUBPIXEL": 2, "ANALYTIC": 3}
    assert numbers("forward_subpixels") == {"2": 2, "4": 4, "8": 8}
    assert numbers("forward_shading") == {"SIMPLE": 0, "FULL": 1}
    assert numbers("forward_strategy") == {
        "RANDOM": 0,
        "JITTERED_GRID": 1,
        "QUANTISED_GRID": 2,
        "NEIGHBOURHOOD": 3,
    }


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
        ("method", "FORWARD", "method", "forward"),
        ("method", "DISTRIBUTED", "method", "distributed"),
        ("samples", 37, "samples", 37),
        ("seed", 5, "seed", 5),
        ("pixel_filter_type", "GAUSSIAN", "pixel_filter", "gaussian"),
        ("filter_width", 2.5, "filter_width", 2.5),
        ("max_bounces", 3, "max_bounces", 3),
        ("diffuse_bounces", 5, "diffuse_bounces", 5),
        ("glossy_bounces", 2, "glossy_bounces", 2),
        ("transmission_bounces", 9, "transmission_bounces", 9),
        ("transparent_max_bounces", 7, "transparent_max_bounces", 7),
        ("caustics_reflective", False, "caustics_reflective", False),
        ("caustics_refractive", False, "caustics_refractive", False),
        ("blur_glossy", 0.5, "filter_glossy", 0.5),
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


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("sampling", "DYNAMIC", "dynamic"),
        ("samples_per_pixel", 0.25, 0.25),
        ("epsilon", 0.75, 0.75),
        ("failure", 0.125, 0.125),
        ("draws", "RANDOM", "random"),
        ("strategy", "QUANTISED_GRID", "quantised_grid"),
        ("reconstruction", "ANALYTIC", "analytic"),
        ("subpixels", "8", 8),
        ("shading", "SIMPLE", "simple"),
        ("shadows", False, False),
        ("backface_culling", True, True),
        ("occlusion_culling", False, False),
    ],
)
def test_every_property_of_forward_mapping_reaches_the_engine(name, value, expected):
    from blender_addon import sync

    scene = bpy.context.scene
    setattr(scene.pointmr, f"forward_{name}", value)
    forward = sync.settings_from_blender(scene).forward
    others = dataclasses.replace(forward, **{name: getattr(ForwardSettings(), name)})
    assert getattr(forward, name) == expected
    assert dataclasses.astuple(others) == pytest.approx(dataclasses.astuple(ForwardSettings()))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("cones", "16", 16),
        ("footprint", 0.5, 0.5),
        ("secondary", "RAYS", "rays"),
        ("visibility", "ALPHA", "alpha"),
    ],
)
def test_every_property_of_raytracing_reaches_the_engine(name, value, expected):
    from blender_addon import sync

    scene = bpy.context.scene
    setattr(scene.pointmr, f"raytrace_{name}", value)
    raytrace = sync.settings_from_blender(scene).raytrace
    assert raytrace == RaytraceSettings(**{name: expected})


@pytest.mark.parametrize("method", ["FORWARD", "RAYTRACE"])
def test_the_ends_of_every_range_are_accepted_by_the_engine(method):
    from blender_addon import sync

    scene = bpy.context.scene
    own = scene.pointmr
    own.method = method
    for name, rna in own.bl_rna.properties.items():
        if name.startswith(f"{method.lower()}_"):
            if rna.type == "ENUM":
                values = [item.identifier for item in rna.enum_items]
            else:
                values = [False, True] if rna.type == "BOOLEAN" else [rna.hard_min, rna.hard_max]
            for value in [*values, rna.default]:
                setattr(own, name, value)
                sync.settings_from_blender(scene).validate()


@pytest.mark.parametrize("method", ["forward", "raytrace"])
def test_sample_sets_are_kept_where_preferences_say(monkeypatch, tmp_path, method):
    from blender_addon import preferences, sync

    scene = bpy.context.scene

    def folder():
        return getattr(sync.settings_from_blender(scene), method).cache_folder

    assert folder() is None
    setattr(scene.pointmr, f"{method}_keep_sets", True)
    monkeypatch.setattr(kernel_cache, "user_cache_folder", lambda: tmp_path)
    assert folder() == str(tmp_path / "pointmr" / "samples")
    chosen = SimpleNamespace(sample_folder=str(tmp_path / "chosen"))
    monkeypatch.setattr(preferences, "_found", lambda: chosen)
    assert folder() == str(tmp_path / "chosen")


def test_only_kernels_of_old_versions_are_cleared_away(monkeypatch, tmp_path):
    """Sample sets lie beside them."""
    names = [f"{i:016x}" for i in range(kernel_cache.KEPT_VERSIONS + 2)]
    for i, name in enumerate([*names, "samples"]):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (i, i) if name != "samples" else (0, 0))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path / names[-1])
    monkeypatch.setattr(kernel_cache, "sys", SimpleNamespace(modules={}))
    try:
        kernel_cache.prepare()
    finally:
        os.environ.pop("NUMBA_CACHE_DIR", None)
    assert sorted(p.name for p in tmp_path.iterdir()) == [*names[2:], "samples"]


def test_light_paths_are_taken_from_cycles():
    """The operator; what it takes reaches the engine."""
    from blender_addon import sync
    from blender_addon.operators import SHARED_WITH_CYCLES, take_from_cycles

    scene = bpy.context.scene
    own, cycles = scene.pointmr, scene.cycles
    cycles.diffuse_bounces, cycles.max_bounces, cycles.caustics_refractive = 3, 7, False
    cycles.pixel_filter_type, cycles.sample_clamp_indirect, cycles.seed = "GAUSSIAN", 5.0, 11
    samples, cones = own.samples, own.raytrace_cones
    assert bpy.ops.pointmr.take_from_cycles() == {"FINISHED"}
    assert all(getattr(own, name) == getattr(cycles, name) for name in SHARED_WITH_CYCLES)
    assert (own.samples, own.raytrace_cones) == (samples, cones)
    settings = sync.settings_from_blender(scene)
    assert (settings.diffuse_bounces, settings.max_bounces, settings.caustics_refractive) == (3, 7, False)
    assert (settings.pixel_filter, settings.clamp_indirect, settings.seed) == ("gaussian", 5.0, 11)
    assert take_from_cycles(scene) == []
    cycles.film_exposure = 2.0
    assert take_from_cycles(scene) == ["film_exposure"] and own.film_exposure == 2.0


def test_all_that_cycles_names_alike_is_taken():
    """Whoever adds a property that Cycles has under the same name says here or there whether it is taken."""
    from blender_addon.operators import SHARED_WITH_CYCLES

    scene = bpy.context.scene
    alike = {n for n in scene.pointmr.bl_rna.properties.keys() if n in scene.cycles.bl_rna.properties}
    assert alike - {"name", "rna_type"} == {*SHARED_WITH_CYCLES, "samples", "preview_samples"}


def test_without_cycles_there_is_nothing_to_take():
    from blender_addon.operators import POINTMR_OT_take_from_cycles, take_from_cycles

    scene = SimpleNamespace(name="Shot", pointmr=bpy.context.scene.pointmr)
    assert not POINTMR_OT_take_from_cycles.poll(SimpleNamespace(scene=scene))
    with pytest.raises(ValueError, match="'Shot' has no Cycles settings"):
        take_from_cycles(scene)


def test_panels_follow_the_method():
    """Forward mapping's panels show for it alone, raytracing's for it alone; those of rays for all but the former."""
    from blender_addon.ui import forward, raytrace, render

    context, own = bpy.context, bpy.context.scene.pointmr
    for method in ("CONVENTIONAL", "DISTRIBUTED", "FORWARD", "RAYTRACE"):
        own.method = method
        assert all(panel.poll(context) == (method == "RAYTRACE") for panel in raytrace.classes)
        assert all(panel.poll(context) == (method == "FORWARD") for panel in forward.classes)
        assert render.POINTMR_RENDER_PT_light_paths.poll(context) == (method != "FORWARD")


def drawn(panel) -> list[str]:
    """The properties that a panel shows."""
    shown = []

    class Layout:
        def prop(self, owner, name, **options):
            assert name in owner.bl_rna.properties
            shown.append(name)

        def row(self, **options):
            return self

        column = row

    panel.draw(SimpleNamespace(layout=Layout()), bpy.context)
    return shown


def test_panels_show_what_matters_for_the_choice():
    from blender_addon.ui import forward, render

    def all_shown():
        return {name for panel in forward.classes for name in drawn(panel)} | set(
            drawn(render.POINTMR_RENDER_PT_sampling_render)
        )

    own = bpy.context.scene.pointmr
    own.method = "FORWARD"
    static = all_shown()
    assert {"forward_strategy", "forward_keep_sets", "forward_samples_per_pixel"} <= static
    assert not static & {"forward_draws", "forward_epsilon", "forward_failure", "samples"}
    own.forward_strategy = "RANDOM"
    assert "forward_failure" in all_shown()
    own.forward_sampling = "DYNAMIC"
    dynamic = all_shown()
    assert {"forward_draws", "forward_epsilon", "forward_failure"} <= dynamic
    assert not dynamic & {"forward_strategy", "forward_keep_sets"}
    every = {name for name in own.bl_rna.properties.keys() if name.startswith("forward_")}
    assert static | dynamic == every
    own.forward_reconstruction = "PIXEL"
    assert "forward_subpixels" not in all_shown()


def test_panels_of_raytracing_show_its_settings_and_no_samples():
    from blender_addon.ui import raytrace, render

    own = bpy.context.scene.pointmr
    panels = [
        *raytrace.classes,
        render.POINTMR_RENDER_PT_sampling_render,
        render.POINTMR_RENDER_PT_sampling_viewport,
    ]
    every = {name for name in own.bl_rna.properties.keys() if name.startswith("raytrace_")}
    own.method = "RAYTRACE"
    assert {name for panel in panels for name in drawn(panel)} == every
    own.method = "DISTRIBUTED"
    assert {name for panel in panels[1:] for name in drawn(panel)} == {"samples", "preview_samples"}


def test_raytracing_is_the_method_where_none_was_chosen():
    from blender_addon import sync

    assert RenderSettings().method == sync.settings_from_blender(bpy.context.scene).method == "raytrace"


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
