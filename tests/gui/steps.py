"""Inside Blender: run a test session step by step, between redraws, and write down what was seen.

A session is a generator function: it acts as a user, and yields the seconds to wait (the window lives on meanwhile), or
a function to wait for until it returns true.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import time
import traceback
import zlib
from pathlib import Path

import bpy
import numpy as np

SHARED = Path(os.environ["POINTMR_SESSION"])
values: dict = {}
LONGEST_WAIT = 400.0  # a first render compiles its kernels


def run(session) -> None:
    """Run the session's steps from Blender's timer, write result.json, and quit."""
    steps = session()
    waiting: dict = {"for": None, "since": 0.0}

    def finish(failure: str | None = None):
        values["failure"] = failure
        (SHARED / "result.json").write_text(json.dumps(values))
        os.sync()
        bpy.ops.wm.quit_blender()

    def tick():
        try:
            if waiting["for"] is not None:
                if not waiting["for"]():
                    if time.monotonic() - waiting["since"] > LONGEST_WAIT:
                        raise TimeoutError(f"waited in vain at line {steps.gi_frame.f_lineno}")
                    return 0.05
                waiting["for"] = None
            step = next(steps)
            if callable(step):
                waiting.update({"for": step, "since": time.monotonic()})
                return 0.05
            return step
        except StopIteration:
            finish()
        except BaseException:
            screenshot("failure")
            finish(traceback.format_exc())
        return None

    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.use_save_prompt = False
    bpy.app.timers.register(tick, first_interval=1.5)


def key(*names: str) -> None:
    """Press keys, by their X names ("F12", "Escape", "ctrl+z")."""
    subprocess.run(["xdotool", "key", *names], check=True)


def click(x: float, y: float, button: int = 1) -> None:
    """Click at window coordinates, y from the bottom as Blender counts."""
    move(x, y)
    time.sleep(0.15)
    subprocess.run(["xdotool", "click", str(button)], check=True)


def move(x: float, y: float) -> None:
    height = bpy.context.window_manager.windows[0].height
    subprocess.run(["xdotool", "mousemove", str(int(x)), str(int(height - 1 - y))], check=True)


def area_of(kind: str):
    """The first area of this type in the first window."""
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def region_of(area, kind: str = "WINDOW"):
    return next(r for r in area.regions if r.type == kind)


def screen() -> np.ndarray:
    """The screen's pixels, uint8 (height, width, 3), top row first."""
    data = (SHARED / "screen" / "Xvfb_screen0").read_bytes()  # the X server's XWD file
    head = struct.unpack(">25I", data[:100])
    size, width, height, stride, colours = head[0], head[4], head[5], head[12], head[19]
    rows = np.frombuffer(data, np.uint8, stride * height, size + 12 * colours).reshape(height, stride)
    return rows[:, : width * 4].reshape(height, width, 4)[:, :, 2::-1]


def region_pixels(region) -> np.ndarray:
    """The screen's pixels inside a region, top row first."""
    height = bpy.context.window_manager.windows[0].height
    pixels = screen()
    top = height - region.y - region.height
    return pixels[top : top + region.height, region.x : region.x + region.width]


def screenshot(name: str) -> None:
    """Save the screen as a PNG beside the result."""
    rgb = screen()
    height, width, _ = rgb.shape
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rgb.reshape(height, width * 3)], 1).tobytes()

    def chunk(tag, body):
        return struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    png = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(raw, 6))
        + chunk(b"IEND", b"")
    )
    (SHARED / f"{name}.png").write_bytes(png)


def register_addon() -> None:
    import blender_addon

    blender_addon.register()


def small_scene(size: tuple[int, int] = (320, 240), samples: int = 4) -> None:
    """Blender's start-up scene with PointMR, its cube red, small and quick."""
    scene = bpy.context.scene
    scene.render.engine = "POINTMR"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", samples
    material = bpy.data.objects["Cube"].active_material
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.05, 0.02, 1)
