"""PointMR's RenderEngine: final renders and material previews here, the rendered viewport in viewport.py."""

from __future__ import annotations

import time
import traceback
import weakref

import bpy

from . import kernel_cache, observer, passes
from .job import RenderJob
from .report import Reporter

POLL_SECONDS = 0.1  # how often Esc is looked at
SHOW_SECONDS = 1.0  # how often a final render's unfinished image is shown
PREVIEW_SAMPLES, PREVIEW_CONES = 16, 1  # of a material preview, which is small and asked for at every change
_viewports = weakref.WeakSet()  # to be stopped when the add-on goes


class PointMRRender(bpy.types.RenderEngine):
    """Engine POINTMR. Blender makes one instance per render job, per preview and per rendered viewport.

    With Persistent Data, one renders all frames of an animation, and images after it: it keeps what it made of the
    scene.
    """

    bl_idname = "POINTMR"
    bl_label = "PointMR"
    bl_use_preview = True
    bl_use_shading_nodes_custom = False  # the standard shader nodes are ours too
    bl_use_eevee_viewport = True  # for the Material Preview mode of viewports
    bl_use_exclude_layers = True

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.scene = None  # the engine's scene, from update() to render()
        self.settings = None
        self.reporter = None
        self.viewport = None
        self._kept: dict = {}  # the engine's Cache, by view layer

    def update_render_passes(self, scene=None, renderlayer=None):
        for p in passes.list_passes(renderlayer):
            self.register_pass(scene, renderlayer, p.name, len(p.channels), p.channels, p.kind)

    # Final render and preview. Blender calls update() and render() once per view layer.

    def update(self, data, depsgraph):
        """Read the scene, while Blender holds it still."""
        from . import sync

        if self.reporter is None:
            self.reporter = Reporter(self._say)
        self.scene = self.settings = None
        layer = depsgraph.view_layer_eval
        observer.current.reading(layer.name)
        try:
            self.update_stats("", "PointMR: reading the scene")
            kernel_cache.prepare()
            self.scene = sync.export(
                depsgraph, report=self.reporter, cancel=self._stopped, progress=self._export_progress
            )
            self.settings = render_settings(depsgraph.scene_eval, layer, self)
            observer.current.exported(layer.name, self.scene, self.settings)
            if self.scene.camera is None:  # and why, has been said
                self.scene = None
        except sync.Cancelled:
            pass
        except Exception as error:
            self._fail(error)
        self.reporter.flush()

    def render(self, depsgraph):
        """Render what update() read, and give Blender the result."""
        if self.scene is None or self.settings is None or self._stopped():
            return  # cancelled, or an error that is already shown
        scene, settings, self.scene = self.scene, self.settings, None
        layer = depsgraph.view_layer_eval
        try:
            persists = depsgraph.scene_eval.render.use_persistent_data and not self.is_preview
            self._render_layer(scene, settings, layer, self._cache_of(layer) if persists else None)
        except Exception as error:
            self._fail(error)
        finally:
            self.reporter.close()

    def _stopped(self) -> bool:
        return self.test_break() or observer.current.stopped()

    def _say(self, levels, message):
        if self.is_preview:
            return  # a material's little picture must not interrupt the user
        self.report(levels, message)
        observer.current.message(min(levels), message)

    def _export_progress(self, fraction, text):
        observer.current.progress(0.0, text or "reading the scene")
        self.update_stats("", f"PointMR: {text}" if text else "PointMR: reading the scene")

    def _cache_of(self, layer):
        from pointmr_engine.render import Cache

        return self._kept.setdefault(layer.name, Cache())

    def _render_layer(self, scene, settings, layer, cache):
        cold = kernel_cache.is_cold()
        if cold:
            self.reporter("INFO", "PointMR: the first render compiles its kernels, a minute or two, once")
            self.reporter.flush()
        for p in passes.list_passes(layer):
            if p.key != "combined":  # which Blender always makes
                self.add_pass(p.name, len(p.channels), p.channels, layer=layer.name)
        x0, y0, x1, y1 = settings.region or (0, 0, settings.width, settings.height)
        result = self.begin_result(0, 0, x1 - x0, y1 - y0, layer=layer.name)
        job = RenderJob(scene, settings, cache)
        finished = False
        try:
            finished = self._watch(job, result, layer, cold)
            if finished:
                write_passes(result, layer, job.frame)
                self._stamp(job.frame, settings)
                observer.current.finished(layer.name, job.frame)
        finally:
            job.cancel()
            if not finished:  # it may go on for a while, with its cache
                self._kept.clear()
            self.end_result(result, cancel=not finished, do_merge_results=True)
        if finished:
            self.update_progress(1.0)
            for warning in job.frame.warnings:
                self.reporter("WARNING", warning)

    def _watch(self, job, result, layer, cold) -> bool:
        """Show progress and tiles until the job is done; False when the user stopped it. Raises its error."""
        combined = pass_named(result, "Combined")
        image, shown = None, time.monotonic()
        while not job.wait(POLL_SECONDS):
            if self._stopped():
                job.cancel()  # it ends at its next tile; nobody needs to wait for that
                return False
            text = job.text or "rendering"
            if cold and job.fraction <= 0.0:
                text += " (compiling kernels, first time only)"
            self.update_stats("", f"PointMR: {text}")
            self.update_progress(job.fraction)
            observer.current.progress(job.fraction, text)
            self.reporter.flush()
            if time.monotonic() - shown >= SHOW_SECONDS and combined is not None:
                tiles = job.take_tiles()
                if tiles:
                    image = show_tiles(combined, tiles, image, result)
                    self.update_result(result)
                shown = time.monotonic()
        if job.error is not None:
            raise job.error
        return not self._stopped()

    def _stamp(self, frame, settings):
        """Say in the image's metadata how it was made."""
        result = self.get_result()
        facts = dict(frame.stats)
        if settings.method == "forward":
            facts["samples"] = f"{settings.forward.samples_per_pixel:g}"
        elif settings.method == "raytrace":
            facts = {**facts, "cones": settings.raytrace.cones}
            facts.pop("samples", None)
        for key in ("method", "samples", "cones", "triangles", "unique_triangles"):
            if key in facts:
                result.stamp_data_add_field(f"PointMR {key.replace('_', ' ')}", str(facts[key]))

    def _fail(self, error):
        """Show an error where the user looks, in the render window and in the report; bugs leave a traceback."""
        from pointmr_engine.scene.errors import SceneError

        if isinstance(error, SceneError):
            message = f"PointMR: {error}"
        else:
            traceback.print_exception(error)
            message = f"PointMR: {type(error).__name__}: {error}"
        if not bpy.app.background:  # the report is enough there, and makes bpy.ops raise
            self.error_set(message)
        self._say({"ERROR"}, message)

    # Rendered viewport

    def view_update(self, context, depsgraph):
        self._viewport().update(context, depsgraph)

    def view_draw(self, context, depsgraph):
        self._viewport().draw(context, depsgraph)

    def _viewport(self):
        if self.viewport is None:
            from .viewport import Viewport

            self.viewport = Viewport(self)
            _viewports.add(self.viewport)
        return self.viewport


def render_settings(scene, layer, engine):
    """The engine's settings for this render; a preview takes few samples."""
    from . import sync

    settings = sync.settings_from_blender(scene, layer, report=engine.reporter)
    settings.passes = passes.engine_passes(layer)
    if engine.is_preview:
        settings.samples = min(settings.samples, PREVIEW_SAMPLES)
        settings.raytrace.cones = PREVIEW_CONES
    return settings


def pass_named(result, name):
    """The pass of a RenderResult's only layer with this name, or None."""
    return next((p for p in result.layers[0].passes if p.name == name), None)


def write_passes(result, layer, frame) -> None:
    """Copy the frame's passes into Blender's result."""
    for p in passes.list_passes(layer):
        target, pixels = pass_named(result, p.name), frame.passes.get(p.key)
        if target is not None and pixels is not None:
            target.rect.foreach_set(pixels.ravel())


def show_tiles(target, tiles, image, result):
    """Put finished tiles into the pass shown meanwhile; returns the image they were gathered in, (h, w, 4)
    float32.
    """
    import numpy as np

    if image is None:
        image = np.zeros((result.resolution_y, result.resolution_x, 4), np.float32)
    for tile in tiles:
        h, w = tile.pixels.shape[:2]
        image[tile.y : tile.y + h, tile.x : tile.x + w] = tile.pixels
    target.rect.foreach_set(image.ravel())
    return image


def register() -> None:
    bpy.utils.register_class(PointMRRender)


def unregister() -> None:
    for viewport in list(_viewports):
        viewport.close()
    bpy.utils.unregister_class(PointMRRender)
