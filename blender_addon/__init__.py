"""PointMR as a Blender render engine: `register()` adds engine id POINTMR, its settings, panels and
instancer.

Nothing here imports numba or the engine's kernels: they are loaded by the first render, so Blender starts as
fast as before.
"""

from __future__ import annotations


def _modules() -> tuple:
    # late, so that the package's parts that need no Blender (the command line's help) load without bpy
    from . import ahead, engine, instancer, operators, preferences, properties, ui

    return preferences, properties, operators, instancer, engine, ui, ahead


_registered: list = []


def register() -> None:
    """Register everything; a second call changes nothing. What fails half way is taken back."""
    if _registered:
        return
    try:
        for module in _modules():
            module.register()
            _registered.append(module)
    except BaseException:
        unregister()
        raise


def unregister() -> None:
    """Take back what `register` did; harmless when it was not called."""
    while _registered:
        _registered.pop().unregister()
