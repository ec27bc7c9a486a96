"""The `pointmr` command: renders .blend files without a window, and says what is in them."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from . import batch
from .headless import FAILED, INTERRUPTED, CommandError, option_of


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit code: 0 done, 1 failed, 2 bad input, 3 unwritable output, 130 interrupted."""
    options = build_parser().parse_args(arguments)
    try:
        return options.run(options)
    except CommandError as error:
        print(f"pointmr: error: {error}", file=sys.stderr)
        return error.code
    except KeyboardInterrupt:
        if not getattr(options, "worker", False):  # whose parent says it for all
            print("pointmr: interrupted; finished frames are kept", file=sys.stderr)
        sys.stdout.flush()
        os._exit(INTERRUPTED)  # a normal exit would wait for a kernel that is being compiled
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED


def build_parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    parser = argparse.ArgumentParser(prog="pointmr", description="Render Blender files with PointMR.")
    commands = parser.add_subparsers(required=True, metavar="command")

    render = commands.add_parser("render", help="render frames of a .blend file to OpenEXR or PNG")
    render.set_defaults(run=_run_render)
    add = render.add_argument
    add("file", type=Path, metavar="FILE.blend")
    add(
        "-f",
        "--frames",
        type=_frames,
        metavar="LIST",
        help="frames: 1-24, 1,3,5-9 or 1-100/10; default: the file's own",
    )
    add(
        "-o",
        "--output",
        metavar="PATH",
        help="output/####.exr or .png; #### is the frame; default: out/FILE.exr",
    )
    add(
        "--method",
        metavar="NAME",
        help="raytrace, forward, conventional or distributed; default, here and below: as the file has it",
    )
    add("--samples", type=_positive, metavar="N", help="samples per pixel of the other methods than raytrace")
    add("--size", type=_size, metavar="640x480", help="size of the image in pixels")
    add("--camera", metavar="NAME", help="object name of the camera to render from")
    add("--seed", type=_natural, metavar="N", help="seed of the random numbers")
    add("--threads", type=_natural, metavar="N", help="threads of each process; 0: one per core")
    add(
        "--as-cycles",
        action="store_true",
        help="bounces, caustics, Filter Glossy, clamping, pixel filter, exposure and seed as the file has them for "
        "Cycles",
    )
    add("--png", action="store_true", help="write a PNG beside each EXR, in the scene's own view transform")
    add("--half", action="store_true", help="colours as half floats in EXR files")
    add(
        "--compositing",
        action="store_true",
        help="let the file's compositor work on the PNG (it may write other files)",
    )
    add(
        "--keep-existing",
        action="store_true",
        help="skip frames whose files exist, to go on with a broken batch",
    )
    add("--jobs", type=_positive, default=1, metavar="N", help="frames in N processes side by side")
    add("--part", metavar="K/N", help="only the K-th of N shares of the frames, for several machines")
    add("--stats", type=Path, metavar="FILE.json", help="write times, memory and counters of every frame")
    add(
        "--scripts",
        action="store_true",
        help="run the file's Python scripts and drivers: only if you trust it",
    )
    add("-v", "--verbose", action="store_true", help="show Blender's own output")
    add("--worker", action="store_true", help=argparse.SUPPRESS)
    _add_own(render.add_argument_group("method raytrace", EXPLAINED), RAYTRACE)
    _add_own(render.add_argument_group("method forward", EXPLAINED), FORWARD)

    info = commands.add_parser("info", help="say what a .blend file holds, as the renderer sees it")
    info.set_defaults(run=_run_info)
    info.add_argument("file", type=Path, metavar="FILE.blend")
    info.add_argument("--json", action="store_true", help="as JSON")
    info.add_argument("--scripts", action="store_true", help="run the file's Python scripts and drivers")
    return parser


EXPLAINED = "Choices are explained in Blender's panel."

# The properties of scene.pointmr that only one method reads: what their options take, and say.
RAYTRACE = {
    "raytrace_cones": ("N", "cones per pixel: 1, 4, 16, 64"),
    "raytrace_footprint": ("X", "size of the smallest detail that is looked at, against a cone's, 0.25 to 4"),
    "raytrace_secondary": ("NAME", "what finds shadows and reflections: cones, rays"),
    "raytrace_visibility": ("NAME", "how cones from the camera see what is in front: masks, alpha"),
    "raytrace_keep_sets": (None, "keep sample sets on disk for the next run"),
}
FORWARD = {
    "forward_sampling": ("NAME", "samples made once, or drawn for each image: static, dynamic"),
    "forward_samples_per_pixel": ("X", "surface samples for each pixel's area, 0.05 to 64; also: --samples"),
    "forward_epsilon": ("X", "dynamic: how unevenly one box may be sampled"),
    "forward_failure": ("X", "random samples: probability of a hole in the image"),
    "forward_draws": ("NAME", "dynamic: random, stratified"),
    "forward_strategy": ("NAME", "static: random, jittered_grid, quantised_grid, neighbourhood"),
    "forward_reconstruction": ("NAME", "pixel, gaussian, subpixel, analytic"),
    "forward_subpixels": ("N", "subpixels along a pixel's side: 2, 4, 8"),
    "forward_shading": ("NAME", "simple: colours as when sampled; full: materials at what is visible"),
    "forward_shadows": (None, "shadows by depth maps"),
    "forward_backface_culling": (None, "leave out surfaces seen from behind"),
    "forward_occlusion_culling": (None, "leave out what is hidden"),
    "forward_keep_sets": (None, "static: keep sample sets on disk for the next run"),
}


def _add_own(group, properties: dict) -> None:
    for name, (takes, text) in properties.items():
        if takes is None:
            kind = {"action": argparse.BooleanOptionalAction}
        else:
            kind = {"metavar": takes}
        group.add_argument(f"--{option_of(name)}", dest=name, help=text, **kind)


def _number(text: str, least: int) -> int:
    if not text.isdigit() or int(text) < least:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least {least}")
    return int(text)


def _positive(text: str) -> int:
    return _number(text, 1)


def _natural(text: str) -> int:
    return _number(text, 0)


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.lower().partition("x")
    if not (x and width.isdigit() and height.isdigit() and int(width) > 0 and int(height) > 0):
        raise argparse.ArgumentTypeError(f"'{text}' is not a size such as 640x480")
    return int(width), int(height)


def _frames(text: str) -> list[int]:
    try:
        return batch.parse_frames(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _run_render(options: argparse.Namespace) -> int:
    from .command.render import command_render

    return command_render(options)


def _run_info(options: argparse.Namespace) -> int:
    from .command.info import command_info

    return command_info(options)


if __name__ == "__main__":
    sys.exit(main())
