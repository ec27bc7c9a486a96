"""Frame time against what the talk's formulas name: triangles, projected area, relative depth range, epsilon.

    python -m benchmarks.forward.output_sensitivity [--parts triangles area depth epsilon] [--rounds 3] [--size 640]

O(log tau + h + a log n) static, O(log tau + h + a log a log n) dynamic; n triangles, h height of the hierarchy, a
projected area, tau relative depth range. Each part changes one quantity and keeps the others. Times are processor
seconds of one image, best of the rounds, mean over the views.
"""

from __future__ import annotations

import json

import numpy as np

from benchmarks.forward import scenes
from benchmarks.forward.measuring import OUT, arguments, fly, growth, plot, settings, write
from benchmarks.report import command, markdown

METHODS = {
    "static": {},
    "dynamic, random": {"sampling": "dynamic", "draws": "random"},
    "dynamic, stratified": {"sampling": "dynamic", "draws": "stratified"},
}
LEVELS = range(10)
WIDTHS = (80, 160, 320, 640, 1280)
DEPTHS = (1e1, 1e2, 1e3, 1e5, 1e7, 1e9)
EPSILONS = (0.002, 0.01, 0.05, 0.25, 1.0, 4.0)


def measure(flight, rounds: int, width: int, **options) -> dict:
    """Mean processor seconds and counts of one image of a flight."""
    r = fly(flight, settings(width, width * 3 // 4, **options), rounds)
    c = r["counters"]
    return {
        "s": float(np.mean(r["processor"])),
        "wall": float(np.mean(r["wall"])),
        "triangles": float(r["triangles"]),
        "nodes": c.get("nodes", 0.0),
        "drawn": c.get("surfels", 0.0) + c.get("triangles", 0.0) + c.get("points", 0.0),
    }


def sweep(what: str, flights: dict, methods: list[str], o, change=lambda value: {}) -> dict:
    """{method: [measurement for every value]}; flights: value -> flight."""
    found = {}
    for method in methods:
        found[method] = []
        for value, flight in flights.items():
            more = dict(change(value))
            width = more.pop("width", o.size)
            m = measure(flight, o.rounds, width, **METHODS[method], **more) | {what: value}
            found[method].append(m)
            print(method, m, flush=True)
    return found


def column(rows: list[dict], name: str) -> np.ndarray:
    return np.array([r[name] for r in rows], float)


def table(what: str, found: dict) -> str:
    """All measurements of a part."""
    rows = [
        [
            method,
            f"{r[what]:.3g}",
            f"{r['s']:.3f}",
            f"{r['wall']:.3f}",
            f"{r['nodes']:.3g}",
            f"{r['drawn']:.3g}",
        ]
        for method, found_rows in found.items()
        for r in found_rows
    ]
    return markdown(["sampling", what, "processor s", "wall s", "nodes", "samples and triangles drawn"], rows)


def log_fit(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """y ~ c0 + c1 ln x."""
    c1, c0 = np.polyfit(np.log(x), y, 1)
    return float(c0), float(c1)


def main() -> None:
    o = arguments(
        __doc__,
        parts=["triangles", "area", "depth", "epsilon"],
        methods=list(METHODS),
        rounds=3,
        size=640,
    )
    panels, sections, record = [], [], {}
    if "triangles" in o.parts:
        found = sweep("triangles", {k: scenes.carpet(k) for k in LEVELS}, o.methods, o)
        for rows in found.values():
            for r, level in zip(rows, LEVELS, strict=True):
                r["triangles"] = float(scenes.carpet(level, 1).triangles)
        record["triangles"] = found
        panels.append(
            {
                "title": "a meadow of one area, ever more triangles",
                "xlabel": "triangles",
                "ylabel": "processor s an image",
                "curves": {m: (column(r, "triangles"), column(r, "s")) for m, r in found.items()},
            }
        )
        said = []
        for m, r in found.items():
            n, s = column(r, "triangles"), column(r, "s")
            said.append(
                f"- {m}: from {n[0]:.0e} to {n[-1]:.0e} triangles {s[-1] / s[0]:.2f} times the time; "
                f"log n grows {np.log(n[-1]) / np.log(n[0]):.2f}-fold; from {n[3]:.0e} on {s[-1] / s[3]:.2f} times"
            )
        sections.append(("Triangles", "\n".join(said), table("triangles", found)))
    if "area" in o.parts:
        found = sweep("width", {w: scenes.carpet(5) for w in WIDTHS}, o.methods, o, lambda w: {"width": w})
        record["area"] = found
        panels.append(
            {
                "title": "the meadow of 10^10 triangles, larger images",
                "xlabel": "pixels",
                "yscale": "log",
                "ylabel": "processor s an image",
                "curves": {m: (0.75 * column(r, "width") ** 2, column(r, "s")) for m, r in found.items()},
            }
        )
        said = [
            f"- {m}: time grows with pixels^{growth(column(r, 'width')[1:] ** 2, column(r, 's')[1:]):.2f} (from "
            f"160 x 120 on)"
            for m, r in found.items()
        ]
        sections.append(("Projected area", "\n".join(said), table("width", found)))
    if "depth" in o.parts:
        found = sweep("tau", {t: scenes.depths(t) for t in DEPTHS}, o.methods, o)
        record["depth"] = found
        panels.append(
            {
                "title": "1,200 trees of one size in the image",
                "xlabel": "relative depth range tau",
                "ylabel": "processor s an image",
                "curves": {m: (column(r, "tau"), column(r, "s")) for m, r in found.items()},
            }
        )
        said = []
        for m, r in found.items():
            c0, c1 = log_fit(column(r, "tau"), column(r, "s"))
            said.append(f"- {m}: {c0:.3f} s + {1e3 * c1:.1f} ms ln tau")
        sections.append(("Relative depth range", "\n".join(said), table("tau", found)))
    if "epsilon" in o.parts:
        methods = [m for m in o.methods if "dynamic" in m]
        found = sweep(
            "epsilon", {e: scenes.forest(5000, 4) for e in EPSILONS}, methods, o, lambda e: {"epsilon": e}
        )
        record["epsilon"] = found
        panels.append(
            {
                "title": "the forest of 4 * 10^8 triangles",
                "xlabel": "epsilon",
                "ylabel": "processor s an image",
                "curves": {m: (column(r, "epsilon"), column(r, "s")) for m, r in found.items()},
            }
        )
        said = [
            f"- {m}: least time at epsilon = {column(r, 'epsilon')[np.argmin(column(r, 's'))]:g}"
            for m, r in found.items()
        ]
        sections.append(("Epsilon", "\n".join(said), table("epsilon", found)))
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "output_sensitivity.json").write_text(json.dumps(record))
    if panels:
        plot(o.output / "forward-output-sensitivity.png", panels)
    head = (
        f"# Forward mapping: output sensitivity\n\n`{command('benchmarks.forward.output_sensitivity')}`, "
        f"{o.size} x {o.size * 3 // 4} pixels unless a width is given.\n\n"
        "Static sampling ought to take O(log tau + h + a log n), dynamic sampling O(log tau + h + a log a log "
        "n). The meadow "
        "gets 16 times the triangles with each level while its area, depth and angles stay. Processor seconds "
        "of one image.\n\n"
        "![output sensitivity](forward-output-sensitivity.png)"
    )
    body = [f"## {title}\n\n{said}\n\n{rows}" for title, said, rows in sections]
    write(o.output, "forward-output-sensitivity.md", "\n\n".join([head, *body]))


if __name__ == "__main__":
    main()
