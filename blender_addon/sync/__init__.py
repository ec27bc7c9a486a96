"""From Blender's evaluated scene to the engine's: one module per data type, one way through (`export`)."""

from __future__ import annotations

from .report import Cancelled

__all__ = ["Cancelled", "export", "settings_from_blender"]


def export(depsgraph, *, report=None, cancel=None, progress=None, view_layer=None, camera=None):
    """The depsgraph's scene as a `pointmr_engine.scene.scene.Scene`, instances kept nested.

    report(level, message) with level "INFO", "WARNING" or "ERROR" receives each message once, naming the object;
    cancel() -> bool is asked at least every 0.1 s where anything is read; progress(fraction 0..1, text).
    view_layer: None takes the depsgraph's. camera: an Object to render from, None takes the scene's.
    What cannot be read is left out with a warning; a missing or unsupported camera leaves `scene.camera` None, with an
    error. Raises Cancelled.
    """
    # The module is not named export: importing it would put it in this function's place.
    from .scene import export_scene

    return export_scene(
        depsgraph, report=report, cancel=cancel, progress=progress, view_layer=view_layer, camera=camera
    )


def settings_from_blender(scene, view_layer=None, *, report=None):
    """`pointmr_engine.scene.settings.RenderSettings` from scene.render, scene.pointmr and the view layer's passes.

    view_layer: None takes the scene's first. A property that the add-on did not register keeps the engine's default.
    """
    from .settings import render_settings

    return render_settings(scene, view_layer, report=report)
