"""Where numba keeps compiled kernels, decided before numba is first imported.

numba looks whether a kernel's own file changed, not whether a file it calls did. So outside a source checkout
each version of the engine gets a folder of its own, named by a hash of its sources, in the user's cache
folder: an updated add-on never runs old kernels, and an add-on installed where nothing may be written still
keeps what it compiled.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

KEPT_VERSIONS = 3


def engine_folder() -> Path:
    """The folder of the package pointmr_engine, found without importing it."""
    spec = importlib.util.find_spec("pointmr_engine")
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("PointMR's engine (the package pointmr_engine) is not installed beside the add-on")
    return Path(next(iter(spec.submodule_search_locations)))


def user_cache_folder() -> Path:
    """The operating system's folder for caches of this user."""
    home = Path.home()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    if sys.platform == "darwin":
        return home / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")


def writable(folder: Path) -> bool:
    """Whether a file can be made in `folder`, which is created if need be (asking permissions alone can
    mislead).
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def source_hash(engine: Path) -> str:
    """A short hash over the engine's Python files."""
    digest = hashlib.sha256()
    for path in sorted(engine.rglob("*.py")):
        digest.update(path.relative_to(engine).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def folder() -> Path:
    """Where compiled kernels are kept: NUMBA_CACHE_DIR if set, the source tree of a checkout, else the user's
    cache.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"])
    engine = engine_folder()
    if (engine.parent / "pyproject.toml").exists() and writable(engine):
        return engine
    user = os.getuid() if hasattr(os, "getuid") else "user"
    bases = (user_cache_folder() / "pointmr", Path(tempfile.gettempdir()) / f"pointmr-{user}")
    base = next((b for b in bases if writable(b)), None)
    if base is None:
        tried = ", ".join(map(str, bases))
        raise OSError(f"no writable folder for compiled kernels: set NUMBA_CACHE_DIR (tried {tried})")
    return base / source_hash(engine)


def prepare() -> None:
    """Point numba at `folder()`, before the engine's kernels are imported; later calls cost nothing."""
    chosen = folder()
    if chosen == engine_folder() or os.environ.get("NUMBA_CACHE_DIR"):
        return
    chosen.mkdir(parents=True, exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = str(chosen)
    if "numba" in sys.modules:  # another add-on came first: numba has read its environment already
        sys.modules["numba"].config.CACHE_DIR = str(chosen)
    folders = (p for p in chosen.parent.iterdir() if p.is_dir() and re.fullmatch("[0-9a-f]{16}", p.name))
    versions = sorted(folders, key=lambda p: p.stat().st_mtime)
    for old in versions[:-KEPT_VERSIONS]:
        if old != chosen:
            shutil.rmtree(old, ignore_errors=True)


def is_cold() -> bool:
    """Whether no kernel compiled for this Python is on disk, so that the first render must compile."""
    tag = f"*.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    return not folder().is_dir() or next(folder().rglob(tag), None) is None


def note() -> Path:
    """The file that `pointmr_engine.ahead` makes when it has compiled all for this Python."""
    return folder() / f"ahead.py{sys.version_info.major}{sys.version_info.minor}"


def clear() -> int:
    """Delete compiled kernels of all Python versions; the number of files deleted."""
    count = 0
    if folder().is_dir():
        for path in folder().glob("ahead.py[0-9]*"):
            path.unlink(missing_ok=True)
        for path in [*folder().rglob("*.nbi"), *folder().rglob("*.nbc")]:
            path.unlink(missing_ok=True)
            count += 1
    return count
