"""The bias of method "raytrace" taken apart: coverage, shading and occlusion, each with the others switched off.

    python -m benchmarks.multires.bias [--scenes dragon_far ...] [--size 160x120] [--cones 1] [--images 6]
        [--kinds coverage silhouettes shading shadows all] [--reference-samples 1024]

Bias is relMSE less the noise of the images and of the reference, both told from independent seeds. What does not change
from seed to seed belongs to it: the pattern of samples and of subpixels, too. It is not additive: what is switched off
is missing from the reference, too, and the images are brighter or darker. The last column is the mean of ours over the
reference's. Writes docs/benchmarks/raytrace-bias.md.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from benchmarks import pictures
from benchmarks.judge import size_of
from benchmarks.metrics import deviation, over_backdrop
from benchmarks.multires import variants
from benchmarks.multires.renderers import Renderer, add_options, reference
from benchmarks.multires.scenes import SUBJECTS
from benchmarks.processes import WorkerError
from benchmarks.report import command, markdown

SEED = 11
COLUMNS = ["scene", "what is on", "cones", "relMSE", "of it noise", "bias", "+-", "mean"]


def measure(subject: str, kind: str, o: argparse.Namespace, typed: str) -> list[dict]:
    """Rows of one variant of a scene, one for each number of cones."""
    name = f"{subject}:{kind}"
    halves = reference(name, o.size, o.reference_samples, o.threads, o.cache, typed)
    folder = o.out / "bias" / subject / kind
    rows = []
    with Renderer(folder / "ours.log") as renderer:
        renderer.open(name, "raytrace", o.size, o.threads)
        for cones in o.cones:
            images = [renderer.image(folder / f"{cones}", cones, SEED + k)[0] for k in range(o.images)]
            found = deviation(images, halves)
            ours, truth = (over_backdrop(np.mean(i, axis=0)) for i in (images, halves))
            pictures.comparison(
                images[0], np.mean(halves, axis=0), name, f"raytrace:{cones}"
            ).save(folder / f"{cones}.png")  # fmt: skip
            rows.append({
                "scene": subject, "kind": kind, "cones": cones, "error": found.rel_mse - found.reference_noise,
                "noise": found.noise, "bias": found.bias, "bias_error": found.bias_error,
                "mean": float(ours.mean() / truth.mean()),
            })  # fmt: skip
            print(json.dumps(rows[-1]), flush=True)
    return rows


def row_of(row: dict) -> list[str]:
    errors = (f"{row[name]:.2e}" for name in ("error", "noise", "bias", "bias_error"))
    return [row["scene"], row["kind"], str(row["cones"]), *errors, f"{row['mean']:.4f}"]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.multires.bias", description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--scenes", nargs="+", choices=list(SUBJECTS), default=["dragon_near", "dragon_far", "fence"]
    )
    parser.add_argument("--kinds", nargs="+", choices=list(variants.ABOUT), default=list(variants.ABOUT))
    parser.add_argument("--size", type=size_of, default=(160, 120))
    parser.add_argument("--cones", nargs="+", type=int, default=[1])
    parser.add_argument("--images", type=int, default=6, help="seeds of ours")
    parser.add_argument("--reference-samples", type=int, default=1024, help="in seeds of 512, at least two")
    add_options(parser)
    o = parser.parse_args(argv)
    typed = command("benchmarks.multires.bias", argv)
    rows, failed = [], 0
    for subject in o.scenes:
        for kind in o.kinds:
            try:
                rows += measure(subject, kind, o, typed)
            except (FileNotFoundError, WorkerError) as error:
                print(f"{subject}, {kind}: {error}", file=sys.stderr)
                failed += 1
    if not rows:
        return 1
    text = [
        '# The bias of method "raytrace" taken apart',
        f"`{typed}`",
        __doc__.split("\n\n")[2].partition(" Writes")[0],
        "\n".join(f"- `{kind}`: {about}" for kind, about in variants.ABOUT.items()),
        markdown(COLUMNS, map(row_of, rows)),
    ]
    o.docs.mkdir(parents=True, exist_ok=True)
    (o.docs / "raytrace-bias.md").write_text("\n\n".join(text) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
