"""One renderer in one process, with any number of samples from render to render, and the camera moved at will.

An order to render: {"seed", "out", "samples", "fresh", "camera"}. Ours keeps what it prepared from image to image, and
prepares anew where "fresh" is true, so that preparation is measured apart; its image goes to an .npy file, top row up.
Cycles prepares anew for every image and accounts for it apart. "camera": 4x4, a motion in the camera's own frame.
"""

from __future__ import annotations

import gc
import os
import time
from dataclasses import replace

import numpy as np

from benchmarks.worker import Job, peak_mb, serve

OUTER = "DISTRIBUTED"  # the method set in Blender's scene, to read settings that all of ours share


class Rival(Job):
    """A scene rendered by Blender: by Cycles."""

    def __init__(self, order: dict):
        super().__init__(order)
        self.camera = None

    def source(self, name: str):
        from benchmarks.multires import scenes

        return scenes.source(name)

    def answer(self, order: dict) -> dict:
        import bpy
        from mathutils import Matrix

        self.method = replace(self.method, samples=order["samples"])
        if order.get("camera") is not None:
            item = bpy.context.scene.camera
            if self.camera is None:
                bpy.context.view_layer.update()  # a scene that was just built has no matrices yet
                place, turn, _ = item.matrix_world.decompose()
                self.camera = Matrix.LocRotScale(place, turn, None)
            item.matrix_world = self.camera @ Matrix(order["camera"])
        return self.render(order["seed"], order["out"])


class Ours:
    """A scene read once from Blender and rendered by the engine again and again."""

    def __init__(self, order: dict):
        import bpy

        import blender_addon
        from benchmarks import methods
        from benchmarks.multires import scenes
        from benchmarks.sources import exported
        from pointmr_engine.render import Cache

        blender_addon.register()

        self.name, self.blender, self.baseline = order["method"], bpy.app.version_string, peak_mb()
        source = scenes.source(order["scene"])
        source.load()
        shared = methods.Method(OUTER.lower(), 1)
        overrides = source.overrides | order["overrides"]
        self.missing = methods.configure(
            bpy.context.scene, shared, 0, order["size"], overrides, order["threads"]
        )
        self.loaded = peak_mb()
        self.scene, settings, self.export_s = exported()
        self.settings = replace(settings, passes=("combined",))
        self.new_cache, self.cache, self.warm = Cache, Cache(), False

    def chosen(self, order: dict):
        """RenderSettings of an order. "samples" are rays, cones or, for forward mapping, surface samples a pixel."""
        s, n = replace(self.settings, method=self.name, seed=order["seed"]), order["samples"]
        if self.name == "raytrace":
            return replace(s, raytrace=replace(s.raytrace, cones=n))
        if self.name == "forward":
            return replace(s, forward=replace(s.forward, samples_per_pixel=n, subpixels=8, shading="full"))
        return replace(s, samples=n)

    def view(self, motion):
        """The scene from the moved camera; all else is shared, so that the cache knows it again."""
        if motion is None:
            return self.scene
        base = np.array(self.scene.camera.world_from_camera, float)
        base[:3, :3] /= np.linalg.norm(base[:3, :3], axis=0)
        return replace(
            self.scene, camera=replace(self.scene.camera, world_from_camera=base @ np.array(motion))
        )

    def answer(self, order: dict) -> dict:
        """Render one image; times in seconds, memory in MB."""
        from pointmr_engine import render

        scene, settings = self.view(order.get("camera")), self.chosen(order)
        if not self.warm:
            render(scene, settings, cache=self.cache)  # compiles kernels, or loads them
            self.warm = True
        if order.get("fresh"):
            self.cache = None
            gc.collect()
            self.cache = self.new_cache()
        start = time.perf_counter()
        frame = render(scene, settings, cache=self.cache)
        seconds = time.perf_counter() - start
        beside = f"{order['out']}.part.npy"
        np.save(beside, frame.passes["combined"][::-1])
        os.replace(beside, order["out"])
        return {
            "render_s": seconds,
            "before_s": self.export_s,
            "peak_mb": peak_mb(),
            "loaded_mb": self.loaded,
            "missing": self.missing,
            "stats": frame.stats,
            "warnings": frame.warnings[:10],
        }


def make(order: dict) -> Rival | Ours:
    """The job of an order to load."""
    return Rival(order) if order["method"] == "cycles" else Ours(order)


if __name__ == "__main__":
    serve(make)
