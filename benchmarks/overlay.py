"""Laid over Cycles: every feature scene and the real scenes, `distributed` against the reference, passed or not.

    python -m benchmarks.overlay [--scenes features real] [--method distributed] [--samples 256] [--no-write]
    python -m benchmarks.overlay --method raytrace --samples 4 --real-samples 4
    python -m benchmarks.overlay --method raytrace --samples 4 --scenes random_1-40 --no-write

A feature scene passes with a relative MSE under 0.002 and a mean FLIP under 0.03, a real scene with a mean FLIP under
0.08. The relative MSE is that of one render, its noise included; of a random scene, which may be noisy by its nature,
noise is taken off. Samples of `raytrace` are cones. Writes
docs/benchmarks/overlay.md and contact sheets, for other methods than `distributed` with its name in theirs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path

from benchmarks import pictures, sources
from benchmarks.judge import FIRST_SEED
from benchmarks.methods import Method, add_bounces, bounces, read_exr
from benchmarks.metrics import deviation
from benchmarks.processes import Worker, WorkerError
from benchmarks.reference import reference
from benchmarks.report import cell, command, markdown

MAX_REL_MSE = 0.002
MAX_FLIP = {"feature": 0.03, "random": 0.06, "real": 0.08, "blend": 0.08}
SMALL = ("feature", "random")  # kinds whose scenes share processes, and are rendered twice


class Keeper:
    """A worker that is kept from scene to scene, and started again when it has died."""

    def __init__(self, log: Path):
        self.log, self.worker = log, None

    def get(self) -> Worker:
        if self.worker is None or not self.worker.alive:
            self.close()
            self.worker = Worker(self.log)
        return self.worker

    def close(self) -> None:
        if self.worker is not None:
            self.worker.close()
            self.worker = None


def lay_over(name: str, options, keepers: dict[str, Keeper]) -> dict:
    """Render one scene twice with the method (two seeds) and compare; returns a JSON-able record."""
    out = Path(options.out)
    record = {"scene": name}
    try:
        source = sources.find(name)
        record["kind"] = source.kind
        size = options.size or source.size
        small = source.kind in SMALL
        reference_samples = options.reference_samples if small else options.real_reference_samples
        cycles = keepers["cycles"]
        if not small:
            cycles.close()  # so that a big scene's memory goes with its process
        truth = reference(
            source, size, reference_samples, options.threads, Path(options.cache), bounces(options),
            LazyWorker(cycles),
        )  # fmt: skip
        method = Method(options.method, options.samples if small else options.real_samples)
        keeper = keepers["method"]
        if not small:
            keeper.close()
        worker = keeper.get()
        worker.load(source.argument, method, size, options.threads, bounces(options))
        images, answers = [], []
        folder = out / "renders"
        folder.mkdir(parents=True, exist_ok=True)
        for seed in (FIRST_SEED, FIRST_SEED + 1)[: 2 if small else 1]:
            path = folder / f"{name}-{method.name}-{seed}.exr"
            answers.append(worker.render(seed, path))
            images.append(read_exr(str(path))[0])
    except (WorkerError, FileNotFoundError, KeyError) as error:
        return record | {"failure": str(error), "passed": False}
    record |= asdict(deviation(images, truth.halves))
    record |= {
        "size": list(size),
        "samples": method.samples,
        "reference_samples": reference_samples,
        "render_s": answers[-1]["render_s"],
        "total_s": answers[-1]["total_s"],
        "peak_mb": answers[-1]["peak_mb"],
        "missing": answers[0]["missing"],
    }
    measured = {"feature": record["rel_mse"], "random": record["bias"] - 3.0 * record["bias_error"]}
    record["passed"] = bool(
        measured.get(source.kind, 0.0) < MAX_REL_MSE
        and record["flip"] < MAX_FLIP[source.kind]
        and not record["not_finite"]
    )
    sheet = pictures.comparison(images[0], truth.image, name, method.label)
    picture = out / "pictures" / f"{name}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(picture)
    record["picture"] = str(picture)
    return record


class LazyWorker:
    """Stands for a kept worker that is started only when a reference is not in the cache."""

    def __init__(self, keeper: Keeper):
        self.keeper = keeper

    def load(self, *args):
        return self.keeper.get().load(*args)

    def render(self, *args):
        return self.keeper.get().render(*args)


COLUMNS = (
    ("relMSE", "rel_mse", ".2e"),
    ("of it noise", "noise", ".2e"),
    ("bias", "bias", ".2e"),
    ("+-", "bias_error", ".1e"),
    ("FLIP", "flip", ".4f"),
    ("alpha error", "alpha", ".4f"),
)


def table(records: list[dict]) -> str:
    """One line a scene, and whether it passed."""
    rows = []
    for r in records:
        verdict = "pass" if r["passed"] else "**FAIL**"
        if "failure" in r:
            rows.append([r["scene"], "**FAIL**", *["-"] * len(COLUMNS)])
        else:
            rows.append([r["scene"], verdict, *[cell(r[key], pattern) for _, key, pattern in COLUMNS]])
    text = markdown(["scene", "verdict", *[c[0] for c in COLUMNS]], rows)
    failures = [f"- {r['scene']}: {r['failure']}" for r in records if "failure" in r]
    return "\n".join([text, *failures])


PREAMBLE = f"""\
`{{method}}` at {{samples}} {{unit}} a pixel ({{real_samples}} on real scenes) against Cycles at {{reference_samples}}
({{real_reference_samples}}): same film, filter and bounces, no diffuse bounces; adaptive sampling, denoiser and
clamping off.

relMSE = mean((I-R)^2/(R^2+0.01)) of one render, noise and all; noise is its variance, from two seeds; bias is
relMSE less the noise of render and reference, and scatters around zero. FLIP is its mean, LDR, 67 pixels per degree,
Standard view. A feature scene passes below relMSE {MAX_REL_MSE} and FLIP {MAX_FLIP["feature"]}, a random scene if its
bias may be below {MAX_REL_MSE} and FLIP is below {MAX_FLIP["random"]}, a real scene below FLIP {MAX_FLIP["real"]}."""


def page(options) -> str:
    """Name of the page, and of its pictures, of a method: another one where diffuse light bounces."""
    method = "" if options.method == "distributed" else f"-{options.method}"
    return f"overlay{method}{'-bounces' if options.diffuse_bounces else ''}"


def document(records: list[dict], command: str, options) -> str:
    """The Markdown page: the command, what is measured, one table for each kind of scene."""
    kinds = defaultdict(list)
    for r in records:
        kinds[r.get("kind", "real")].append(r)
    lines = [
        "# Laid over Cycles",
        "",
        f"`{command}`",
        "",
        PREAMBLE.format(**vars(options), unit="cones" if options.method == "raytrace" else "samples"),
    ]
    for kind, title in (
        ("feature", "Feature scenes"),
        ("random", "Random scenes"),
        ("real", "Real scenes"),
        ("blend", "Files"),
    ):
        if kinds[kind]:
            passed = sum(r["passed"] for r in kinds[kind])
            lines += ["", f"## {title}: {passed} of {len(kinds[kind])} pass", "", table(kinds[kind])]
            lines += ["", f"![{title}]({page(options)}-{kind}.png)"]
    return "\n".join(lines) + "\n"


def contact_sheets(records: list[dict], folder: Path, name: str) -> None:
    """One PNG of all comparisons for each kind of scene, named `name` and the kind."""
    from PIL import Image

    kinds = defaultdict(list)
    for r in records:
        if "picture" in r:
            sheet = Image.open(r["picture"]).convert("RGB")
            kinds[r["kind"]].append(sheet.resize((sheet.width // 2, sheet.height // 2), Image.LANCZOS))
    for kind, rows in kinds.items():
        pictures.contact_sheet(rows, folder / f"{name}-{kind}.png", columns=2)


def arguments(argv: list[str] | None = None):
    parser = argparse.ArgumentParser(prog="benchmarks.overlay", description=__doc__.split("\n\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["features", "real"])
    parser.add_argument("--method", default="distributed", help="or cycles, to see the judge's own noise")
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--real-samples", type=int, default=256)
    parser.add_argument("--reference-samples", type=int, default=1024)
    parser.add_argument("--real-reference-samples", type=int, default=512)
    parser.add_argument("--size", type=lambda t: tuple(int(v) for v in t.split("x")))
    add_bounces(parser)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--out", default="out/overlay")
    parser.add_argument("--cache", default="out/references")
    parser.add_argument("--docs", default="docs/benchmarks")
    parser.add_argument("--no-write", action="store_true", help="leave the folder of documents alone")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    options = arguments(argv)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    keepers = {k: Keeper(out / f"{k}.log") for k in ("cycles", "method")}
    records = []
    with contextlib.ExitStack() as stack:
        for keeper in keepers.values():
            stack.callback(keeper.close)
        for name in sources.names(options.scenes):
            record = lay_over(name, options, keepers)
            records.append(record)
            print(table([record]).splitlines()[2], record.get("failure", ""), flush=True)
    typed = command("benchmarks.overlay", argv)
    text = document(records, typed, options)
    folder = out if options.no_write else Path(options.docs)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{page(options)}.md").write_text(text)
    (out / "overlay.json").write_text(json.dumps({"command": typed, "records": records}, indent=1))
    contact_sheets(records, folder, page(options))
    failed = [r["scene"] for r in records if not r["passed"]]
    print(
        f"{len(records) - len(failed)} of {len(records)} pass"
        + (f"; failed: {', '.join(failed)}" if failed else "")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
