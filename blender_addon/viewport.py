"""The rendered viewport: the scene is read when it changes, a thread refines the image, drawing only shows
the newest.

Coarse pixels or few samples first, then more, then their average (refinement.py). A change of view or scene
ends the running pass and starts again. Only `Viewport` talks to Blender, always on the main thread.
"""

from __future__ import annotations

import os
import threading
import time
import traceback
import weakref
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from . import kernel_cache
from .refinement import ForwardPace, ray_steps, with_samples

POLL_SECONDS = 0.05
# the engine's phases whose results its cache keeps for all views of a scene
PREPARATIONS = (
    "checking the scene",
    "loading kernels",
    "compiling materials",
    "reading the world",
    "building hierarchies",
    "gathering lights",
)
SENSOR = 36.0  # mm; any value would do, since focal lengths are expressed against it


class View(NamedTuple):
    """What a viewport looks through: 4x4 matrices as row-major tuples, region size in pixels."""

    view_matrix: tuple
    window_matrix: tuple
    perspective: bool
    through_camera: bool
    width: int
    height: int


@dataclass
class Picture:
    """Pixels (h, w, 4) float32, bottom row first, each `scale` screen pixels wide; samples averaged so far."""

    pixels: np.ndarray
    scale: int
    samples: float
    version: int


def view_from_context(context) -> View:
    """The view of the region that is being drawn."""
    region3d, region = context.region_data, context.region
    return View(
        tuple(tuple(row) for row in region3d.view_matrix),
        tuple(tuple(row) for row in region3d.window_matrix),
        region3d.is_perspective,
        region3d.view_perspective == "CAMERA",
        region.width,
        region.height,
    )


def camera_from_view(view: View, scale: int = 1, lens=None):
    """The engine's camera for `view`, its image made of ceil(width / scale) x ceil(height / scale) pixels.

    The image starts at the region's lower left corner and may reach beyond its other edges by less than one
    coarse pixel. lens: the scene's camera, whose aperture and focus are used when the viewport looks through
    it.
    """
    from pointmr_engine.scene.camera import Camera

    p = np.array(view.window_matrix, np.float64)
    world_from_camera = np.linalg.inv(np.array(view.view_matrix, np.float64))
    w, h = view.width, view.height
    wide, high = -(-w // scale) * scale, -(-h // scale) * scale
    # The projection's third column (perspective) or fourth (orthographic) is twice the shift of the image's centre.
    shift = (p[:2, 2] if view.perspective else -p[:2, 3]) / 2
    camera = Camera(
        sensor_fit="HORIZONTAL",
        sensor_width=SENSOR,
        shift_x=(shift[0] * w + (wide - w) / 2) / wide,
        shift_y=(shift[1] * h + (high - h) / 2) / wide,
        name="Viewport",
    )
    if view.perspective:
        camera.focal_length = SENSOR * p[0, 0] / 2 * w / wide
        camera.clip_start = p[2, 3] / (p[2, 2] - 1)
        far = p[2, 3] / (p[2, 2] + 1) if p[2, 2] < -1 else np.inf
        camera.clip_end = far if far > camera.clip_start else np.inf
    else:
        camera.kind = "ORTHOGRAPHIC"
        camera.ortho_scale = 2 / p[0, 0] * wide / w
        near, far = (p[2, 3] + 1) / p[2, 2], (p[2, 3] - 1) / p[2, 2]
        # An orthographic viewport sees what is behind its eye as well: step back, so that all lies in front.
        world_from_camera = world_from_camera @ translation(0, 0, -near)
        camera.clip_start, camera.clip_end = 0.0, far - near
    camera.world_from_camera = world_from_camera
    if lens is not None and view.through_camera and lens.fstop > 0:
        same_kind = lens.kind == camera.kind == "PERSPECTIVE"
        camera.fstop = lens.fstop * camera.focal_length / lens.focal_length if same_kind else lens.fstop
        camera.focus_distance = lens.focus_distance
        camera.blades, camera.blade_rotation = lens.blades, lens.blade_rotation
        camera.aperture_ratio = lens.aperture_ratio
    return camera


def translation(x, y, z) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


class Refiner:
    """The thread behind a viewport. It knows nothing of Blender; `picture` is its newest image, `text` its
    state.
    """

    def __init__(self):
        self.picture: Picture | None = None
        self.text = ""
        self.error: BaseException | None = None
        self._wake = threading.Condition()
        self._request = None
        self._generation = 0
        self._versions = 0
        self._closed = False
        self._pace = ForwardPace()
        self._cache = None  # the engine's, of the newest scene: a change of view alone builds nothing again
        self._thread = threading.Thread(target=self._run, name="PointMR viewport", daemon=True)
        self._thread.start()

    def start(self, scene, settings, view: View, pixel_size: int = 1) -> None:
        """Render this from now on; what was running ends at its next tile."""
        with self._wake:
            self._request = (scene, settings, view, pixel_size)
            self._generation += 1
            self.error = None
            self._wake.notify()

    def stop(self) -> None:
        """Stop rendering, and keep the picture."""
        with self._wake:
            self._request = None
            self._generation += 1

    def close(self) -> None:
        """End the thread, at the next tile; does not wait for it."""
        with self._wake:
            self._closed = True
            self._generation += 1
            self._wake.notify()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._request is not None or self._closed)
                if self._closed:
                    return
                request, generation = self._request, self._generation
                self._request = None
            try:
                self._refine(generation, *request)
            except BaseException as error:
                if generation == self._generation:
                    self.error = error

    def _refine(self, generation, scene, settings, view, pixel_size) -> None:
        self.text = "Compiling kernels, first time only" if kernel_cache.is_cold() else "Loading kernels"
        kernel_cache.prepare()
        from pointmr_engine.render import Cache, render

        if self._cache is None:
            self._cache = Cache()

        def progress(fraction, text, tile=None) -> bool:
            if average is None and text not in ("rendering", "done"):
                self.text = text.capitalize()
            return self._outdated(generation, scene, text)

        lens, total = scene.camera, settings.samples
        if settings.method == "raytrace":
            total = settings.raytrace.cones
            steps = self._pace.sketched_steps(scene, total, pixel_size)
        elif settings.method == "forward":
            steps = self._pace.steps(scene, settings.forward, total, pixel_size)
        else:
            steps = ray_steps(total, pixel_size)
        average, done, number = None, 0.0, 0
        step = next(steps, None)
        while step is not None:
            size = {"width": -(-view.width // step.scale), "height": -(-view.height // step.scale)}
            batch = replace(with_samples(settings, step, number), **size)
            camera = camera_from_view(view, step.scale, lens)
            start = time.perf_counter()
            frame = render(replace(scene, camera=camera), batch, progress=progress, cache=self._cache)
            if generation != self._generation or frame is None:
                return
            seconds = time.perf_counter() - start
            pixels = np.ascontiguousarray(frame.passes["combined"], np.float32)
            if step.averaged:
                weight = step.samples / (done + step.samples)
                average = pixels if average is None else average + (pixels - average) * np.float32(weight)
                done += step.samples
                number += 1
                pixels = average
            self._show(generation, pixels, step.scale, done)
            try:
                step = steps.send(seconds)
                self.text = f"Sample {done:.0f}/{total}" if done else "Refining"
            except StopIteration:
                step, self.text = None, ""

    def _outdated(self, generation, scene, text) -> bool:
        """Whether to end a pass. What prepares the scene goes on when only the view changed, for it is kept."""
        with self._wake:
            if generation == self._generation:
                return False
            same_scene = not self._closed and self._request is not None and self._request[0] is scene
            return text not in PREPARATIONS or not same_scene

    def _show(self, generation, pixels, scale, samples) -> None:
        with self._wake:
            if generation == self._generation:
                self._versions += 1
                self.picture = Picture(pixels, scale, samples, self._versions)


class Viewport:
    """One rendered viewport: `update` when the scene changes, `draw` for every redraw, `close` at its end."""

    def __init__(self, engine):
        self._engine = weakref.ref(engine)
        self._refiner = Refiner()
        self._scene = self._settings = None
        self._view: View | None = None
        self._pixel_size = 1
        self._texture = None
        self._drawn = 0
        self._said = ""
        self._message = ""
        self._closed = False
        import bpy

        # The thread must not call Blender, so the main thread looks for news.
        bpy.app.timers.register(self._poll, first_interval=POLL_SECONDS)

    def close(self) -> None:
        self._closed = True
        self._refiner.close()

    def update(self, context, depsgraph) -> None:
        """Read the scene again. Runs on the main thread: what it costs is the export, never the rendering."""
        from . import preferences, sync

        engine = self._engine()
        self._refiner.stop()
        self._message = ""
        try:
            kernel_cache.prepare()
            scene = depsgraph.scene_eval
            self._scene = sync.export(depsgraph, report=self._report)
            settings = sync.settings_from_blender(scene, depsgraph.view_layer_eval)
            settings = replace(settings, region=None, pixel_aspect=1.0, passes=("combined",))
            settings.samples = scene.pointmr.preview_samples
            settings.raytrace.cones = int(scene.pointmr.raytrace_preview_cones)
            settings.threads = preferences.viewport_threads() or max(1, (os.cpu_count() or 2) - 1)
            self._settings = settings
            size = scene.render.preview_pixel_size
            self._pixel_size = 1 if size == "AUTO" else int(size)
        except Exception as error:
            traceback.print_exception(error)
            self._scene, self._message = None, str(error)
        self._view = None  # the next draw starts rendering
        if engine is not None:
            engine.tag_redraw()

    def draw(self, context, depsgraph) -> None:
        """Show the newest image; start again if the view changed since the last one."""
        view = view_from_context(context)
        if view != self._view and self._scene is not None:
            self._view = view
            self._refiner.start(self._scene, self._settings, view, self._pixel_size)
        picture = self._refiner.picture
        if picture is None:
            return
        import gpu
        from gpu_extras.presets import draw_texture_2d

        height, width = picture.pixels.shape[:2]
        if self._texture is None or self._drawn != picture.version:
            data = gpu.types.Buffer("FLOAT", width * height * 4, picture.pixels.reshape(-1))
            self._texture = gpu.types.GPUTexture((width, height), format="RGBA32F", data=data)
            self._drawn = picture.version
        engine = self._engine()
        gpu.state.blend_set("ALPHA_PREMULT")
        engine.bind_display_space_shader(depsgraph.scene)
        draw_texture_2d(self._texture, (0, 0), width * picture.scale, height * picture.scale)
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")

    def _report(self, level, message) -> None:
        if level == "ERROR":
            self._message = message

    def _poll(self):
        """On the main thread, from Blender's timer: ask for a redraw when there is something new to show."""
        engine = self._engine()
        if self._closed or engine is None:
            self.close()
            return None
        try:
            engine.is_preview  # noqa: B018  raises once Blender has freed the engine under its Python object
            error = self._refiner.error
            text = self._message or (f"{type(error).__name__}: {error}" if error else self._refiner.text)
            if text != self._said:
                self._said = text
                engine.update_stats("PointMR", text)
                engine.tag_redraw()
            picture = self._refiner.picture
            if picture is not None and picture.version != self._drawn:
                engine.tag_redraw()
        except ReferenceError:
            self.close()
            return None
        return POLL_SECONDS
