"""A real Blender with its window on a virtual screen, driven from outside.

POINTMR_GUI_BLENDER says where it is: a Blender executable (Xvfb's xvfb-run and xdotool must be installed beside), or a
folder that is the root of an installation with all three, entered by chroot (needs root rights; mounts are private).
POINTMR_GUI_PYTHONPATH: further folders for Blender's Python, e.g. one that holds OpenEXR or numba.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

VARIABLE = "POINTMR_GUI_BLENDER"
REPOSITORY = Path(__file__).resolve().parents[2]
SCREEN = (1600, 1000)
ALARMS = ("Traceback", "Concurrent access", "EXCEPTION_ACCESS", "Segmentation fault", "is a bug")


@dataclass
class Session:
    """What a session left: its recorded values, and Blender's log."""

    values: dict
    log: str

    def alarms(self) -> list[str]:
        """Lines of the log that no healthy session has."""
        return [line for line in self.log.splitlines() if any(a in line for a in ALARMS)]


def command(blender: Path, script: Path, shared: Path) -> list[str]:
    """The command line that runs `script` in Blender on a virtual screen whose pixels lie in shared/screen."""
    (shared / "screen").mkdir(exist_ok=True)
    home = shared / "home"
    home.mkdir(exist_ok=True)
    python_path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("POINTMR_GUI_PYTHONPATH")]))
    environment = {
        "HOME": str(home),
        "LANG": "C.UTF-8",
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "GALLIUM_DRIVER": "llvmpipe",
        "PYTHONPATH": python_path,
        "POINTMR_SESSION": str(shared),
    }
    width, height = SCREEN
    screen = f"-screen 0 {width}x{height}x24 +extension GLX -nolisten tcp -fbdir {shared / 'screen'}"
    inner = ["/usr/bin/env", "-i", *(f"{k}={v}" for k, v in environment.items())]
    inner += ["xvfb-run", "-a", "-s", screen]
    inner += ["blender" if blender.is_dir() else str(blender)]
    inner += [
        "--factory-startup",
        "--python-use-system-env",
        "--window-geometry",
        "0",
        "0",
        str(width),
        str(height),
    ]
    inner += ["--python-exit-code", "1", "--python", str(script)]
    if not blender.is_dir():
        return inner
    mounts = [f"mount -t proc proc {blender}/proc", f"mount -t tmpfs tmpfs {blender}/dev/shm"]
    for folder in (REPOSITORY, shared):
        inside = f"{blender}{folder}"
        mounts += [
            f"mkdir -p {shlex.quote(inside)}",
            f"mount --bind {shlex.quote(str(folder))} {shlex.quote(inside)}",
        ]
    script_text = " && ".join(mounts) + f" && exec chroot {shlex.quote(str(blender))} {shlex.join(inner)}"
    return ["unshare", "-m", "sh", "-ec", script_text]


def run_session(name: str, shared: Path, timeout: float = 180) -> Session:
    """Run sessions/`name`.py in Blender. Skips without one; fails when it hangs or its own checks fail."""
    where = os.environ.get(VARIABLE)
    if not where:
        pytest.skip(f"{VARIABLE} is not set: no Blender with a window to test in")
    script = Path(__file__).parent / "sessions" / f"{name}.py"
    log_file = shared / "blender.log"
    with open(log_file, "w") as log:
        process = subprocess.Popen(
            command(Path(where).resolve(), script, shared.resolve()),
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.wait()
            pytest.fail(f"session {name} hangs after {timeout:.0f} s\n{log_file.read_text()[-3000:]}")
    text = log_file.read_text()
    result = shared / "result.json"
    if not result.exists():
        pytest.fail(f"session {name} ended without a result\n{text[-3000:]}")
    values = json.loads(result.read_text())
    if values.get("failure"):
        pytest.fail(f"session {name}: {values['failure']}\n{text[-2000:]}")
    return Session(values, text)
