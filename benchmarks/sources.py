"""What can be rendered by name: .blend files, feature scenes, random scenes, and real scenes with a driver."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Source:
    """A scene by name. `load` leaves it as bpy.context.scene; `content` identifies what it loads, for caches.

    size: its usual (width, height). overrides: render settings under Cycles' names that the scene asks for.
    """

    name: str
    load: Callable[[], None]
    content: str
    size: tuple[int, int]
    overrides: dict = field(default_factory=dict)
    kind: str = "blend"  # "feature", "random", "real" or "blend"
    path: Path | None = None

    @property
    def argument(self) -> str:
        """How another process is told of this scene."""
        return str(self.path) if self.path else self.name


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, 16 hex digits."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def text_hash(*parts: object) -> str:
    """SHA-256 of the JSON of anything, 16 hex digits."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def scenes_folder() -> Path | None:
    """The folder of third-party scenes (environment variable POINTMR_SCENES), or None."""
    folder = os.environ.get("POINTMR_SCENES")
    return Path(folder) if folder and Path(folder).is_dir() else None


def open_blend(path: Path) -> None:
    """Open a .blend file without running its scripts. Raises FileNotFoundError when it is not there."""
    import bpy

    if not Path(path).is_file():
        raise FileNotFoundError(f"no such scene: {path}")
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=False, load_ui=False)


def exported():
    """(the engine's scene, its settings, seconds to read them) of bpy.context.scene as a final render reads it.

    Modifiers and hair are as dense as they render, and not as the viewport shows them. Makes ours the render engine.
    """
    import bpy

    import blender_addon
    from blender_addon.headless import FrameObserver, run_render

    blender_addon.register()
    bpy.context.scene.render.engine = "POINTMR"
    observer = FrameObserver(export_only=True)
    run_render(observer)
    return next(iter(observer.scenes.values())), observer.settings, observer.seconds["sync"]


def find(name: str) -> Source:
    """The source of a name: a path to a .blend, a feature scene, random_SEED, or a real scene. Raises KeyError if none
    is meant.
    """
    from benchmarks import features, random_scenes, real

    if name in features.FEATURES:
        return features.source(name)
    if name in real.REAL:
        return real.source(name)
    if random_scenes.expand(name) == [name]:
        return random_scenes.source(name)
    path = Path(name)
    if path.suffix == ".blend":
        path = path.resolve()
        content = f"{path.name}:{file_hash(path)}"
        return Source(path.stem, lambda: open_blend(path), content, (320, 240), path=path)
    known = ", ".join([*features.FEATURES, *real.REAL, "random_SEED"])
    raise KeyError(f"'{name}' is neither a .blend file nor one of: {known}")


def names(patterns: list[str]) -> list[str]:
    """Expand "features", "real", "random_1-20" and patterns like "light_*" into names of scenes; the rest is left as it
    is.
    """
    from fnmatch import fnmatch

    from benchmarks import features, random_scenes, real

    found = []
    for pattern in patterns:
        if pattern == "features":
            found += list(features.FEATURES)
        elif pattern == "real":
            found += list(real.REAL)
        elif any(c in pattern for c in "*?["):
            found += [n for n in [*features.FEATURES, *real.REAL] if fnmatch(n, pattern)]
        else:
            found += random_scenes.expand(pattern) or [pattern]
    return list(dict.fromkeys(found))
