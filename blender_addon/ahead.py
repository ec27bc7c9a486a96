"""Compiling ahead: after Blender has started, a process in the background compiles kernels that are not on disk yet.

It ends with Blender. Renders need not wait for it: what it has compiled by then they need not compile.
"""

from __future__ import annotations

import os
import subprocess
import sys

import bpy

from . import kernel_cache, preferences

DELAY = 5.0  # seconds after the start
_running: list[subprocess.Popen] = []


def wanted() -> bool:
    """Whether somebody sits in front of Blender, has not forbidden it, and kernels are missing."""
    return not bpy.app.background and preferences.compile_ahead() and not kernel_cache.note().exists()


def begin() -> None:
    """Start the process, if it is wanted. A timer calls this once; what fails is left to the first render."""
    try:
        if _running or not wanted():
            return
        kernel_cache.prepare()
        path = os.pathsep.join([str(kernel_cache.engine_folder().parent), *(p for p in sys.path if p)])
        command = [sys.executable, "-m", "pointmr_engine.ahead", "--with-parent"]
        _running.append(
            subprocess.Popen(
                [*command, "--note", str(kernel_cache.note())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": path},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        )
    except (OSError, ImportError) as error:
        print(f"PointMR: kernels are not compiled ahead: {error}")


def stop() -> None:
    """End the process, if it runs."""
    while _running:
        process = _running.pop()
        process.stdin.close()
        try:
            process.wait(2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def register() -> None:
    if not bpy.app.background:
        bpy.app.timers.register(begin, first_interval=DELAY, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(begin):
        bpy.app.timers.unregister(begin)
    stop()
