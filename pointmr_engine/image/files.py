"""Image files that are either whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pointmr_engine.scene.errors import SceneError


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; renamed to `path` when the block ends well, removed when it does not.

    Missing folders are made. What fails in writing is raised as a SceneError that names `path`.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError("it is a folder")
        yield part
        os.replace(part, path)
    except (OSError, RuntimeError) as error:
        raise SceneError(f"cannot write '{path}': {reason(error)}") from error
    finally:
        part.unlink(missing_ok=True) if part.parent.is_dir() else None


def reason(error: BaseException) -> str:
    """The system's words for an error, without its number and path."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
