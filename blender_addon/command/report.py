"""What `pointmr render` shows: a progress bar, messages, and a summary of each frame."""

from __future__ import annotations

import sys
from pathlib import Path

from ..headless import Options

STEPS = 1024  # of a frame's progress


class Report:
    """Progress bar (from the first frame on), messages (each once) and one summary per frame."""

    def __init__(self, options: Options, several: bool, frames: int):
        self.frames: list[dict] = []
        self._said: set[str] = set()
        self._fractions: dict[int, float] = {}
        self._several = several
        self._name, self._total = options.file.stem, float(frames)
        self._bar = None

    def begin(self, frame: int) -> None:
        """A frame begins."""
        self.progress(frame, 0.0, "opening")

    def _open_bar(self) -> None:
        from tqdm import tqdm

        self._bar = tqdm(
            total=self._total,
            desc=self._name,
            file=sys.stderr,
            bar_format="{desc}: {percentage:3.0f}% |{bar}| {elapsed}<{remaining}{postfix}",
            mininterval=0.1 if sys.stderr.isatty() else 10.0,
            leave=False,
        )

    def _write(self, text: str, file) -> None:
        if self._bar is None:
            print(text, file=file)
        else:
            self._bar.write(text, file=file)

    def progress(self, frame: int, fraction: float, text: str) -> None:
        """A frame is done to a share of 0..1."""
        if self._bar is None:
            self._open_bar()
        before = self._fractions.get(frame, 0.0)
        # in steps of a power of two, whose sums are exact: tqdm warns of a bar that is beyond its end by a rounding
        self._fractions[frame] = max(before, round(min(fraction, 1.0) * STEPS) / STEPS)
        self._bar.set_postfix_str(f"frame {frame}: {text}" if self._several else text, refresh=False)
        self._bar.update(self._fractions[frame] - before)

    def message(self, level: str, text: str) -> None:
        """A message, each once; errors are told by `failed`."""
        if text not in self._said and level != "ERROR":
            self._said.add(text)
            prefix = "warning: " if level == "WARNING" else ""
            self._write(f"{prefix}{text}", sys.stderr)

    def done(self, rendered: dict, memory: int) -> None:
        """A frame is finished: its summary."""
        self.progress(rendered["frame"], 1.0, "done")
        self.frames.append({**rendered, "peak_memory": memory})
        self._write(summary(rendered, memory), sys.stdout)

    def failed(self, frame: int, reason: str) -> None:
        """A frame could not be rendered."""
        self.progress(frame, 1.0, "failed")
        self._write(f"frame {frame} failed: {reason}", sys.stderr)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()


def summary(rendered: dict, memory: int) -> str:
    """A frame's summary: what was rendered, seconds by phase, what the method counted, memory, files."""
    stats, seconds = rendered["stats"], dict(rendered["seconds"])
    settings = stats["settings"]
    lines = [f"frame {rendered['frame']}: {settings['width']}x{settings['height']}, {settings['method']}"]
    if settings["method"] == "forward":
        forward = settings["forward"]
        lines[0] += f", {forward['sampling']}, {forward['samples_per_pixel']:g} samples per pixel"
    elif settings["method"] == "raytrace":
        lines[0] += _cones(settings["raytrace"])
    elif settings["method"] != "conventional":
        lines[0] += f", {count(settings['samples'], 'sample')} per pixel"
    if {"unique_triangles", "triangles", "nesting"} <= set(stats):
        unique, instanced = stats["unique_triangles"], stats["triangles"]
        lines.append(
            f"  triangles: {unique:,} unique, {instanced:,} instanced, nested {stats['nesting']} deep"
        )
    whole = sum(seconds.values())
    write = seconds.pop("write")
    seconds.pop("render")  # for which the engine's own phases stand
    seconds |= {**stats.get("times", {}), "write": write}
    phases = ", ".join(f"{phase} {s:.2f} s" for phase, s in seconds.items() if s >= 0.005)
    lines.append(f"  time: {phases}; together {whole:.2f} s")
    counted = [f"{n:,} {name.replace('_', ' ')}" for name, n in stats.get("counters", {}).items() if n]
    if counted:
        lines.append(f"  counted: {', '.join(counted)}")
    if settings["method"] == "raytrace" and stats.get("needs"):
        lines += needs_lines(stats["needs"])
    if rendered["stats"].get("cold"):
        lines.append("  (kernels were compiled, which only a first render does)")
    lines.append(f"  peak memory: {memory / 2**20:,.0f} MB")
    lines += [f"  {Path(path).resolve()}" for path in rendered["files"]]
    return "\n".join(lines)


def _cones(raytrace: dict) -> str:
    """How method raytrace was asked to work, what is not the default only where it is so."""
    text = f", {count(raytrace['cones'], 'cone')} per pixel"
    if raytrace["footprint"] != 1.0:
        text += f", footprint {raytrace['footprint']:g}"
    if raytrace["visibility"] != "masks":
        text += f", visibility {raytrace['visibility']}"
    return text + (", secondary rays" if raytrace["secondary"] == "rays" else "")


def needs_lines(needs: dict) -> list[str]:
    """What a frame required, with its amount if it has one, and what it could do without."""
    needed, spared = [], []
    for key, value in needs.items():
        name, value = key.replace("_", " "), value.tolist() if hasattr(value, "tolist") else value
        if not value:
            spared.append(name)
        elif value is True:
            needed.append(name)
        elif isinstance(value, (tuple, list, set, frozenset)):
            needed.append(f"{name} ({', '.join(map(str, value))})")
        else:
            needed.append(f"{name} {value:,}" if isinstance(value, int) else f"{name} {value}")
    lines = [("needed", needed), ("not needed", spared)]
    return [f"  {title}: {', '.join(names)}" for title, names in lines if names]


def count(n: int, what: str) -> str:
    return f"{n:,} {what}" if n == 1 else f"{n:,} {what}s"


def plain(value):
    """numpy's numbers and arrays, and what else JSON does not know, for json.dump."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return sorted(value) if isinstance(value, (set, frozenset)) else str(value)
