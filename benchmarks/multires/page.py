"""The page and the plots of benchmarks.multires.curves."""

from __future__ import annotations

import math
from pathlib import Path

from benchmarks.multires.crossing import crossing
from benchmarks.multires.scenes import SUBJECTS
from benchmarks.report import cell, markdown

RIVALS = ("cycles", "distributed")
COLUMNS = (
    ("method", "label", ""),
    ("relMSE", "error", ".2e"),
    ("of it noise", "noise", ".1e"),
    ("bias", "bias", ".1e"),
    ("+-", "bias_error", ".0e"),
    ("FLIP", "flip", ".4f"),
    ("render s", "render_s", ".3f"),
    ("prepare s", "prepare_s", ".2f"),
    ("peak MB", "peak_mb", ".0f"),
)
INTRODUCTION = """# Method "raytrace": error against time

Written by `python -m benchmarks.multires.curves`; each scene's section has its command.

- relMSE is mean((I-R)^2/(R^2+0.01)) less the reference's noise; bias is relMSE less the noise of the image too, with
  its standard error. FLIP: mean, LDR, 67 pixels per degree.
- render s: the median of one more image of a scene that is ready: for ours all of `render` with what it kept, for
  Cycles its own account of rendering. prepare s: reading the scene from Blender, and what the first image takes more
  (hierarchies, sample sets; for Cycles its synchronisation and BVH). Kernels are compiled before. Peak MB: of the
  process, Blender and all numbers of samples of a method included.
- N*: the samples a pixel at which the rival's measured curve crosses our error, between points on a log-log plot; ~
  where it had to be extrapolated along its last two points; "never" where it levels off above. Time at equal error:
  what the rival takes there, divided by our time (above 1: we are faster), preparation apart | together.
- All methods: the same filter (Blackman-Harris, 1.5), bounces (no diffuse ones), lights and threads, two or more seeds
  of reference. All render in turn in one run."""


def of_method(result: dict, method: str) -> list[dict]:
    """The rows of a method that did not fail, fewest samples first."""
    good = (r for r in result["rows"] if r["method"] == method and "failure" not in r)
    return sorted(good, key=lambda r: r["samples"])


def equal_error(result: dict, row: dict, rival: str) -> list[str]:
    """[N*, N* by FLIP, time apart | together] of a rival at the error of one of our rows; dashes if it has no curve."""
    curve = of_method(result, rival)
    found, flip = crossing(curve, row["error"]), crossing(curve, row["flip"], "flip")
    if found is None:
        return ["-", "-", "-"]
    if found.how == "never":
        return ["never", "-" if flip is None else flip.text(), "never"]
    ready = curve[0]["prepare_s"]
    apart = found.seconds / row["render_s"]
    together = (found.seconds + ready) / (row["render_s"] + row["prepare_s"])
    mark = "~" if found.how == "extrapolated" else ""
    return [found.text(), "-" if flip is None else flip.text(), f"{mark}{apart:.3g} \\| {together:.3g}"]


def comparison(results: list[dict]) -> str:
    """The table of N* and times at equal error: one row a scene and quality."""
    header = ["scene", "cones", "relMSE", "FLIP", "render s", "x `conventional`"]
    for rival in RIVALS:
        header += [f"N* {rival}", "by FLIP", "time at equal error"]
    rows = []
    for result in results:
        plain = of_method(result, "conventional")
        for row in of_method(result, result["ours"]):
            times = row["render_s"] / plain[0]["render_s"] if plain else math.nan
            values = [row["error"], row["flip"], row["render_s"], times]
            cells = [cell(v, f) for v, f in zip(values, (".2e", ".4f", ".3f", ".2f"), strict=True)]
            rivals = [c for rival in RIVALS for c in equal_error(result, row, rival)]
            rows.append([result["scene"], str(row["samples"]), *cells, *rivals])
    return markdown(header, rows)


def section(result: dict) -> str:
    """One scene: what it is, the command, all rows, failures."""
    name = result["scene"]
    good = [r for r in result["rows"] if "failure" not in r]
    count = next((r["stats"].get("triangles") for r in good if r["stats"].get("triangles")), None)
    facts = [SUBJECTS[name].about, f"{result['size'][0]} x {result['size'][1]}"]
    facts += [f"{count:.3g} triangles"] if count else []
    facts += [f"reference: {result['reference']}", result["machine"]]
    lines = [f"## {name}", f"{'; '.join(facts)}.", f"`{result['command']}`"]
    if good:
        lines.append(f"![{name}]({page_name(result)}-{name}.png)")
        lines.append(
            markdown([c[0] for c in COLUMNS], [[cell(r.get(k), f) for _, k, f in COLUMNS] for r in good])
        )
    failures = [f"- {r['label']}: {r['failure']}" for r in result["rows"] if "failure" in r]
    if failures:
        lines.append("\n".join(failures))
    return "\n\n".join(lines)


def page_name(result: dict) -> str:
    """Of the page of a result's method and size, and of its plots."""
    return f"{result['ours']}-{result['size'][0]}x{result['size'][1]}"


def write(results: list[dict], folder: Path) -> None:
    """The page of results of one method and size, and a plot a scene, into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    name = page_name(results[0])
    parts = [INTRODUCTION, "## Equal error", comparison(results), *map(section, results)]
    beside = folder / f"{name}.part"
    beside.write_text("\n\n".join(parts) + "\n")
    beside.rename(folder / f"{name}.md")
    for result in results:
        plot(result, folder / f"{name}-{result['scene']}.png")


def plot(result: dict, path: Path) -> None:
    """relMSE and FLIP against render time, log-log; each point with its samples."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4.0), dpi=100)
    methods = dict.fromkeys(r["method"] for r in result["rows"])
    for axis, key, label in zip(axes, ("error", "flip"), ("relative MSE", "mean FLIP"), strict=True):
        for method in methods:
            mine = [r for r in of_method(result, method) if r[key] > 0.0]
            if not mine:
                continue
            style = "o-" if method == result["ours"] else "s--" if method == "conventional" else ".-"
            axis.plot([r["render_s"] for r in mine], [r[key] for r in mine], style, label=method)
            for r in mine:
                at = (r["render_s"], r[key])
                axis.annotate(str(r["samples"]), at, textcoords="offset points", xytext=(4, 4), fontsize=7)
        axis.set(xscale="log", yscale="log", title=result["scene"], xlabel="one image, s", ylabel=label)
        axis.grid(True, which="both", alpha=0.25)
        for side in (axis.xaxis, axis.yaxis):  # labels of the decades, and few between them
            side.set_minor_formatter(ticker.LogFormatter(minor_thresholds=(1.0, 0.5)))
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
