"""Build the add-on as a Blender extension: one zip with the add-on, the engine and the wheels that it needs.

    python blender_addon/build_extension.py [--platforms linux-x64 windows-x64 macos-arm64] [--output dist]

Blender unpacks the wheels that fit its own Python and platform. The engine is one of them, a pure Python
wheel: so inside Blender it is the top-level package pointmr_engine, as everywhere else. Needs pip and a
network; run it from a checkout.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ADDON = Path(__file__).resolve().parent
PROJECT = ADDON.parent
PYTHONS = ("3.11", "3.13")  # of Blender 4.2 to 5.0, and of 5.1 and of what distributions build
PLATFORM_TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64", "macosx_12_0_arm64", "macosx_11_0_arm64"),
}
COMMAND_LINE = {"cli.py", "batch.py", "headless.py", "command"}  # serve programs outside Blender
NOT_SHIPPED = {"build_extension.py", "__pycache__", "blender_manifest.toml"} | COMMAND_LINE


def this_platform() -> str:
    """The key of PLATFORM_TAGS for the running machine."""
    system = {"Linux": "linux-x64", "Windows": "windows-x64", "Darwin": "macos-arm64"}
    return system.get(platform.system(), "linux-x64")


def dependencies() -> list[str]:
    """What the wheels must provide: the engine's requirements without numpy, and numba's llvmlite."""
    with open(PROJECT / "pyproject.toml", "rb") as file:
        required = tomllib.load(file)["project"]["dependencies"]
    return [r for r in required if not r.startswith("numpy")]


def fetch_wheels(folder: Path, platforms: list[str], pythons: tuple[str, ...]) -> None:
    """Download the binary wheels of all dependencies into `folder`."""
    for name in platforms:
        for python in pythons:
            base = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
            base += ["--only-binary=:all:", "--python-version", python, "--implementation", "cp"]
            base += [f"--platform={tag}" for tag in PLATFORM_TAGS[name]]
            # Resolve with dependencies, so that llvmlite fits numba, then drop the numpy that came along.
            subprocess.run([*base, "--dest", str(folder), *dependencies()], check=True)
    for numpy in folder.glob("numpy-*.whl"):
        numpy.unlink()


def engine_wheel(folder: Path, version: str) -> Path:
    """Write pointmr_engine as a pure Python wheel."""
    info = f"pointmr_engine-{version}.dist-info"
    engine = PROJECT / "pointmr_engine"
    files = {
        p.relative_to(PROJECT).as_posix(): p.read_bytes()
        for p in sorted(engine.rglob("*"))
        if p.suffix in (".py", ".npz", ".npy") and "__pycache__" not in p.parts
    }
    files[f"{info}/METADATA"] = (
        f"Metadata-Version: 2.1\nName: pointmr-engine\nVersion: {version}\nLicense: GPL-3.0-or-later\n"
    ).encode()
    files[f"{info}/WHEEL"] = (
        b"Wheel-Version: 1.0\nGenerator: pointmr\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    )
    record = ""
    for name, data in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        record += f"{name},sha256={digest},{len(data)}\n"
    files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    path = folder / f"pointmr_engine-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for name, data in files.items():
            wheel.writestr(name, data)
    return path


def manifest(version: str, platforms: list[str], wheels: list[str]) -> str:
    """The add-on's manifest with version, platforms and wheels filled in."""
    text = (ADDON / "blender_manifest.toml").read_text()
    lines = ["platforms = [" + ", ".join(f'"{p}"' for p in platforms) + "]", "wheels = ["]
    lines += [f'  "./wheels/{w}",' for w in wheels] + ["]", ""]
    head, mark, permissions = text.partition("[permissions]")
    shipped = tomllib.loads(text)["version"]
    head = head.replace(f'version = "{shipped}"', f'version = "{version}"', 1)
    return head + "\n".join(lines) + "\n" + mark + permissions


def stage(folder: Path, platforms: list[str], pythons: tuple[str, ...] = PYTHONS, fetch: bool = True) -> None:
    """Lay out the extension in `folder`; without `fetch`, only the engine is among its wheels."""
    with open(PROJECT / "pyproject.toml", "rb") as file:
        version = tomllib.load(file)["project"]["version"]
    shutil.copytree(
        ADDON, folder, dirs_exist_ok=True, ignore=lambda _, names: NOT_SHIPPED.intersection(names)
    )
    if (PROJECT / "LICENSE").exists():
        shutil.copy(PROJECT / "LICENSE", folder)
    wheels = folder / "wheels"
    wheels.mkdir()
    if fetch:
        fetch_wheels(wheels, platforms, pythons)
    engine_wheel(wheels, version)
    names = sorted(p.name for p in wheels.iterdir())
    (folder / "blender_manifest.toml").write_text(manifest(version, platforms, names))


def build(output: Path, platforms: list[str], pythons: tuple[str, ...] = PYTHONS, fetch: bool = True) -> Path:
    """Build the zip in `output`; its path."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "pointmr"
        stage(folder, platforms, pythons, fetch)
        with open(folder / "blender_manifest.toml", "rb") as file:
            version = tomllib.load(file)["version"]
        target = output / f"pointmr-{version}-{'-'.join(p.replace('-', '_') for p in platforms)}.zip"
        partial = target.with_suffix(".part")
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(p for p in folder.rglob("*") if p.is_file()):
                # Wheels are compressed already.
                how = zipfile.ZIP_STORED if path.suffix == ".whl" else zipfile.ZIP_DEFLATED
                archive.write(path, path.relative_to(folder).as_posix(), compress_type=how)
        partial.replace(target)
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description="Build PointMR as a Blender extension.")
    parser.add_argument("--platforms", nargs="+", choices=sorted(PLATFORM_TAGS), default=[this_platform()])
    parser.add_argument("--pythons", nargs="+", default=list(PYTHONS), help="Python versions of Blender")
    parser.add_argument("--output", type=Path, default=PROJECT / "dist")
    arguments = parser.parse_args()
    path = build(arguments.output, arguments.platforms, tuple(arguments.pythons))
    print(f"{path} ({path.stat().st_size / 1e6:.0f} MB)")
    print("Install it in Blender: Edit > Preferences > Get Extensions > Install from Disk")


if __name__ == "__main__":
    main()
