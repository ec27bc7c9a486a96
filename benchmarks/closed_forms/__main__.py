"""Prints and writes the errors of methods against closed forms: `python -m benchmarks.closed_forms`."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.closed_forms.cases import all_cases
from benchmarks.closed_forms.stage import Case
from benchmarks.report import markdown
from pointmr_engine import RenderSettings, SceneError, render
from pointmr_engine.render import Cache
from pointmr_engine.scene.settings import RaytraceSettings

OUT = Path(__file__).parents[2] / "docs" / "benchmarks" / "closed_forms.md"
METHODS = [
    *("distributed:64", "distributed:1024", "forward"),
    *("raytrace:1", "raytrace:4", "raytrace:16", "raytrace:64"),
]
TEXT = """# Closed forms

`python -m benchmarks.closed_forms`. Scenes whose exact image is known by formula (`benchmarks/closed_forms/`, a file
for each kind, the formula at its head): root mean square error of the image in percent of the exact image's range
(for coverage and world light: of full coverage, of the unshaded floor). The pixel filter is the same on both sides:
Blackman-Harris, 1.5 pixels. `distributed:N` has N rays a pixel, `raytrace:N` has N cones. "Formula": what the images of
`distributed:1024` under two seeds have in common against the formula, in the same unit: root of the mean product of
their differences from it, with the standard error that noise leaves in it. It would show a wrong formula.

Bounds for `raytrace`: 2 % at one cone, 0.5 % at 64; flat patches 1 %.

"""


def raytrace_exists() -> bool:
    """Whether this engine can render method "raytrace" at all."""
    return importlib.util.find_spec("pointmr_engine.multires") is not None


def settings_of(case: Case, method: str, **values) -> RenderSettings:
    """Settings for "distributed:SAMPLES", "forward", "raytrace:CONES" or "raytrace:CONES:SECONDARY"."""
    name, *options = method.split(":")
    if name == "raytrace":
        secondary = options[1] if len(options) > 1 else "cones"
        values["raytrace"] = RaytraceSettings(cones=int(options[0]), secondary=secondary)
    elif options:
        values["samples"] = int(options[0])
    return case.render_settings(method=name, **values)


def image_of(case: Case, scene, method: str, cache: Cache | None = None, **values) -> np.ndarray:
    """(height, width, 4) float64: the case's scene by a method as `settings_of` names it."""
    frame = render(scene, settings_of(case, method, **values), cache=cache)
    return frame.passes["combined"].astype(np.float64)


def formula_error(
    case: Case, exact: np.ndarray, first: np.ndarray, second: np.ndarray
) -> tuple[float, float]:
    """(common difference of two seeds' images from the formula, standard error), relative to the range.

    The first is the signed root of the mean product of the two differences, the second of that mean's error.
    """
    span = case.range or float(exact.max() - exact.min())
    product = (first[..., 0] - exact) * (second[..., 0] - exact) / span**2
    mean, error = product.mean(), product.std() / np.sqrt(product.size)
    return float(np.copysign(np.sqrt(abs(mean)), mean)), float(np.sqrt(error))


def picture(exact: np.ndarray, image: np.ndarray, scale: int = 6) -> np.ndarray:
    """Exact image, image and 10 times their difference about grey, from top to bottom, enlarged; 8 bits."""
    top = max(float(exact.max()), 1e-6)
    rows = [exact / top, image[..., 0] / top, 0.5 + 10.0 * (image[..., 0] - exact) / top]
    grey = np.concatenate([np.pad(r[::-1], ((0, 1), (0, 0))) for r in rows])
    bytes_ = np.clip(255.0 * grey + 0.5, 0, 255).astype(np.uint8)
    return np.repeat(np.repeat(bytes_, scale, 0), scale, 1)


def row(case: Case, methods: list[str], folder: Path | None) -> list[str]:
    """One line of the table; a dash where the method is not there, a note where it refuses the scene."""
    exact, scene, cache = case.exact(), case.scene(), Cache()
    cells = [case.name]
    for method in methods:
        if method.startswith("raytrace") and not raytrace_exists():
            cells.append("-")
            continue
        try:
            image = image_of(case, scene, method, cache)
        except SceneError as problem:
            cells.append(str(problem)[:40])
            continue
        cells.append(f"{100.0 * case.error(image, exact):.2f}")
        if folder is not None:
            name = f"{case.name.replace(',', '').replace(' ', '_')}-{method.replace(':', '_')}.png"
            Image.fromarray(picture(exact, image)).save(folder / name)
        if method == "distributed:1024":
            again = image_of(case, scene, method, cache, seed=1)
            cells.append(
                "{:.2f} +- {:.2f}".format(*(100.0 * v for v in formula_error(case, exact, image, again)))
            )
    return [*cells, case.what]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.closed_forms", description=__doc__)
    parser.add_argument("cases", nargs="*", help="names or parts of names; none: all")
    parser.add_argument("--methods", nargs="+", default=METHODS, help=f"default: {' '.join(METHODS)}")
    parser.add_argument("--pictures", type=Path, help="folder for exact image, image and difference")
    arguments = parser.parse_args()
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    chosen = [c for c in all_cases() if not arguments.cases or any(p in c.name for p in arguments.cases)]
    header = ["case", *arguments.methods, "what"]
    if "distributed:1024" in header:
        header.insert(header.index("distributed:1024") + 1, "formula")
    rows = []
    for case in chosen:
        rows.append(row(case, arguments.methods, arguments.pictures))
        print(*rows[-1][:-1], sep=" | ", flush=True)
    text = markdown(header, rows)
    print("\n" + text)
    if not arguments.cases and arguments.methods == METHODS:
        note = "" if raytrace_exists() else '\nMethod "raytrace" is not there yet.\n'
        OUT.write_text(TEXT + text + "\n" + note)


if __name__ == "__main__":
    main()
