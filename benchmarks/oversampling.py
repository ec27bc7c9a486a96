"""Oversampling of the sampling strategies: how many samples each takes to cover a surface, with the radius verified.

    python -m benchmarks.oversampling [--output docs/benchmarks/oversampling] [--seeds 6]

Oversampling o = N pi d^2 / A: the area of all discs of the covering radius d over that of the surface. For d stands the
radius that is proven for every point of the surface (`coverage.verified_radius`), not the one that was asked for.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.report import markdown
from benchmarks.sources import scenes_folder
from benchmarks.speed_rays import read_ply
from pointmr_engine.hierarchy.coverage import fill_uncovered, verified_radius
from pointmr_engine.hierarchy.pieces import cut
from pointmr_engine.hierarchy.strategies import neighbourhood, random_points
from pointmr_engine.hierarchy.surface_samples import sample_triangles

TALK = "neighbourhood, random order"
METHODS = ("random", "jittered_grid", "quantised_grid", TALK, "neighbourhood")
# the plane's theory: worst case of the talk; mean over all orientations; None: depends on the number
WORST = {
    "random": None,
    "jittered_grid": 9 * math.pi,
    "quantised_grid": 9 * math.pi / 4,
    TALK: 2 * math.pi / math.sqrt(3),
    "neighbourhood": 2 * math.pi / math.sqrt(3) / 0.95**2,
}
MEAN = {
    "random": None,
    "jittered_grid": 4.5 * math.pi,
    "quantised_grid": 4.5 * math.pi / 4,
    TALK: 2.19,
    "neighbourhood": None,
}
OPTIMUM = 2 * math.pi / math.sqrt(27)


def plane(seed: int) -> np.ndarray:
    """The unit square, turned at random: (2, 3, 3)."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) @ turn
    return corners[[[0, 1, 2], [0, 2, 3]]]


def torus(seed: int, rings: int = 150) -> np.ndarray:
    """A torus turned at random: (2 rings^2, 3, 3)."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    a = np.arange(rings) * 2 * np.pi / rings
    a, b = np.meshgrid(a, a, indexing="ij")
    p = (
        np.stack([(1 + 0.4 * np.cos(b)) * np.cos(a), (1 + 0.4 * np.cos(b)) * np.sin(a), 0.4 * np.sin(b)], -1)
        @ turn
    )
    q, r, s = np.roll(p, -1, 0), np.roll(p, (-1, -1), (0, 1)), np.roll(p, -1, 1)
    return np.concatenate(
        [np.stack([p, q, r], 2).reshape(-1, 3, 3), np.stack([p, r, s], 2).reshape(-1, 3, 3)]
    )


def leaves(seed: int, count: int = 2000) -> np.ndarray:
    """A cloud of rhombic leaves, 0.04 long and 0.02 wide, in the unit ball: (2 count, 3, 3)."""
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    centre = rng.normal(size=(count, 3))
    centre *= (rng.uniform(0, 1, count) ** (1 / 3) / np.linalg.norm(centre, axis=1))[:, None]
    along, across = 0.02 * frame[:, 0], 0.01 * frame[:, 1]
    a, b, c, d = centre - along, centre + across, centre + along, centre - across
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(positions (V, 3), triangles (T, 3)) of an .obj file of triangles."""
    positions, triangles = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            positions.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
            triangles += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return np.array(positions), np.array(triangles)


def scans() -> dict[str, Callable[[int], np.ndarray]]:
    """The scans of POINTMR_SCENES that are there, by name."""
    folder = scenes_folder()
    found = {}
    for name, file, read in (
        ("bunny", "stanford-bunny.obj", read_obj),
        ("nefertiti", "nefertiti.obj", read_obj),
        ("dragon", "dragon_vrip.ply.gz", read_ply),
    ):
        if folder is not None and (folder / "scans" / file).is_file():
            positions, triangles = read(folder / "scans" / file)
            mesh = positions[triangles].astype(np.float64)
            found[name] = lambda seed, mesh=mesh: mesh
    return found


def area_of(triangles: np.ndarray) -> float:
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


def random_theory(m: float) -> float:
    """Mean oversampling of just enough random points on a surface of m discs' area, without edges.

    Discs around N = m o random points leave about N (o - 1) exp(-o) holes (the Euler characteristic of what they
    cover). One is left at o = ln m + ln o + ln(o - 1), to which the mean of the extreme's law, Gumbel's, adds 0.58. The
    leading terms for large m are ln m + 2 ln ln m.
    """
    o = 3.0
    for _ in range(100):
        o = max(math.log(m) + math.log(o) + math.log(o - 1), 2.0)
    return o + 0.5772


def in_random_order(triangles: np.ndarray, spacing: float, seed: int) -> np.ndarray:
    """Samples of the talk's neighbourhood-based sampling, holes between the candidates filled: (K, 3)."""
    pieces = cut(triangles, spacing / 4)
    chosen = neighbourhood.select(pieces.position, pieces.area, spacing, seed, "random").position
    return np.concatenate([chosen, fill_uncovered(triangles, chosen, spacing).position])


def from_random_candidates(triangles: np.ndarray, spacing: float, seed: int) -> tuple[np.ndarray, int]:
    """Samples chosen in random order from the talk's candidates, a (ln a + ln 1/f) random points; their number."""
    pieces = cut(triangles, spacing / 32)  # so fine that their centres pass for random points
    number = random_points.count(area_of(triangles), spacing, 1e-3)
    drawn = np.unique(random_points.draw(pieces.area, number, seed))
    return neighbourhood.select(
        pieces.position[drawn], pieces.area[drawn], spacing, seed, "random"
    ).position, number


def measure(triangles: np.ndarray, spacing: float, method: str, seed: int) -> dict:
    """Samples, verified radius (per radius asked), oversampling by both radii, and CPU seconds."""
    start = time.process_time()
    if method == TALK:
        samples = in_random_order(triangles, spacing, seed)
    else:
        samples = sample_triangles(triangles, spacing, method, seed).position
    seconds = time.process_time() - start
    radius = verified_radius(triangles, samples)
    area = area_of(triangles)
    return {
        "samples": len(samples),
        "radius": radius / spacing,
        "asked": len(samples) * math.pi * spacing**2 / area,
        "o": len(samples) * math.pi * radius**2 / area,
        "random_theory": random_theory(area / (math.pi * radius**2)),
        "seconds": seconds,
    }


def rows_of(name: str, make: Callable[[int], np.ndarray], cells: float, seeds: int) -> list[list[str]]:
    """Rows of the table for one surface, at a spacing of which `cells` squares make up its area."""
    rows = []
    for method in METHODS:
        results = []
        for seed in range(seeds):
            triangles = make(seed)
            results.append(measure(triangles, math.sqrt(area_of(triangles) / cells), method, seed))
        mean = {key: float(np.mean([r[key] for r in results])) for key in results[0]}
        o = [r["o"] for r in results]
        theory = mean["random_theory"] if method == "random" else MEAN[method]
        rows.append(
            [
                name,
                method,
                f"{mean['samples']:.0f}",
                f"{mean['radius']:.3f}",
                f"{mean['asked']:.2f}",
                f"**{np.mean(o):.2f}**",
                f"{min(o):.2f} - {max(o):.2f}",
                f"{theory:.2f}" if theory else "-",
                f"{WORST[method]:.1f}" if WORST[method] else "-",
                f"{mean['seconds']:.2f}",
            ]
        )
        print(" ".join(rows[-1]), flush=True)
    return rows


def candidate_rows(seeds: int, cells: float = 3600.0) -> list[list[str]]:
    """Rows that compare candidates: the talk's random points, and pieces of several sizes, all in random order."""
    spacing = math.sqrt(1 / cells)
    rows = []
    for finer in (0, 2, 3, 4, 6, 8):
        o, radius, candidates, added = [], [], [], []
        for seed in range(seeds):
            triangles = plane(seed)
            if finer:
                pieces = cut(triangles, spacing / finer)
                number = len(pieces.area)
                samples = neighbourhood.select(pieces.position, pieces.area, spacing, seed, "random").position
            else:
                samples, number = from_random_candidates(triangles, spacing, seed)
            before = verified_radius(triangles, samples)
            radius.append(before / spacing)
            o.append(len(samples) * math.pi * before**2)
            candidates.append(number / cells)
            extra = fill_uncovered(triangles, samples, spacing).position
            added.append((len(samples) + len(extra)) * math.pi * spacing**2)
        name = f"pieces of d / {finer}" if finer else "random points (talk)"
        rows.append(
            [
                name,
                f"{np.mean(candidates):.0f}",
                f"{np.mean(radius):.3f}",
                f"{np.mean(o):.2f}",
                f"{np.mean(added):.2f}",
            ]
        )
        print(" ".join(rows[-1]), flush=True)
    return rows


def plot(path: Path, seeds: int) -> None:
    """Oversampling against the number of squares of the spacing on the surface, on the torus."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    counts = np.geomspace(100, 30_000, 7)
    figure, axes = pyplot.subplots(figsize=(7, 5), constrained_layout=True)
    colours = {}
    for method in METHODS:
        mean, low, high, theory = [], [], [], []
        for cells in counts:
            results = []
            for seed in range(seeds):
                triangles = torus(seed)
                results.append(measure(triangles, math.sqrt(area_of(triangles) / cells), method, seed))
            o = [r["o"] for r in results]
            mean.append(np.mean(o))
            low.append(min(o))
            high.append(max(o))
            theory.append(np.mean([r["random_theory"] for r in results]))
        (line,) = axes.plot(counts, mean, "o-", label=method, markersize=3)
        colours[method] = line.get_color()
        axes.fill_between(counts, low, high, alpha=0.2, color=line.get_color(), linewidth=0)
        if method == "random":
            axes.plot(counts, theory, ":", color=line.get_color(), label="theory of random points")
    axes.axhline(
        MEAN[TALK], linestyle=":", color=colours[TALK], label="random order in the plane, mean: 2.19"
    )
    axes.axhline(OPTIMUM, linestyle="--", color="black", label="optimum in the plane: 1.21")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="area / d^2, d the spacing that is asked for",
        ylabel="oversampling N pi d^2 / A, d verified",
        title="Samples to cover a torus",
        yticks=(1, 1.5, 2, 3, 4, 6, 8, 12, 16, 20),
        yticklabels=("1", "1.5", "2", "3", "4", "6", "8", "12", "16", "20"),
    )
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.13))
    figure.savefig(path, dpi=120)


def main() -> None:
    """Write the tables to OUTPUT.md and the plot to OUTPUT.png."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks/oversampling"))
    parser.add_argument("--seeds", type=int, default=6, help="orientations and seeds that are averaged")
    arguments = parser.parse_args()
    for method in METHODS:
        measure(plane(0), 0.2, method, 0)  # compiled before it is measured
    rows = rows_of("plane", plane, 6400, arguments.seeds)
    rows += rows_of("torus", torus, 6400, arguments.seeds)
    rows += rows_of("2000 leaves, coarse", leaves, 400, 2)
    rows += rows_of("2000 leaves, fine", leaves, 100_000, 2)
    missing = ""
    found = scans()
    for name, make in found.items():
        rows += rows_of(name, make, 6400, 2)
    if not found:
        missing = "\nThe scans were not measured: POINTMR_SCENES is not set, or does not hold them.\n"
        print(missing)
    candidates = candidate_rows(arguments.seeds)
    output = arguments.output
    output.parent.mkdir(parents=True, exist_ok=True)
    plot(output.with_suffix(".png"), min(arguments.seeds, 3))
    header = [
        "surface",
        "strategy",
        "samples",
        "d verified / asked",
        "o by d asked",
        "o",
        "least - most",
        "theory, mean plane",
        "worst plane",
        "CPU s",
    ]
    text = f"""# Oversampling of the sampling strategies

`python -m benchmarks.oversampling`

o = N pi d^2 / A: samples N that cover a surface of area A with a covering radius d that is proven for every point of it
(branch and bound, 0.1 % tolerance). The spacing asked for is sqrt(A / 6400), but for the leaves sqrt(A / 400) and
sqrt(A / 100,000). Means of {arguments.seeds} orientations and seeds (leaves and scans: 2). The optimum in the plane is
{OPTIMUM:.2f} (hexagonal). CPU time is that of the whole: pieces, choice, filling of holes, moments; one thread.

{markdown(header, rows)}
{missing}
- `random`: a (ln a + ln 1/f) points, f = 0.001, a = A / d^2, drawn twice counted once. Theory: o = ln m + 2 ln o and
  lower terms, m = A / (pi d^2), for the radius that is really covered, on a surface without edges. Only this strategy's
  samples per area grow with the surface, and only it may leave holes: specks and spikes apart are easily missed.
- Grids by theory are for the radius asked for, in a plane without edges: 9 pi / 2 and 9 pi / 8 on average over all
  orientations (a plane meets 3/2 cells per squared side), the talk's worst cases twice that. A point anywhere in its
  cell covers more than is asked for: neighbouring cells help.
- `{TALK}` is the talk's greedy removal, holes between the candidates filled; `neighbourhood` looks
  at the candidates in a sweep instead, and keeps of four around the next uncovered one that which covers most. It
  covers the candidates within 0.95 d, and so seldom needs filling. Worst planes: by packing.
- Leaves apart need a sample each, however far it could reach: by the coarse spacing, area is not what decides.

![Oversampling against the size of the surface]({output.with_suffix(".png").name})

## Candidates
Greedy removal in random order on planes, from different candidates: the radius that they cover by themselves, o for
it, and o when holes are filled so that the radius asked for holds.

{markdown(["candidates", "per d^2", "d verified / asked", "o", "o, filled"], candidates)}

Random candidates cover no radius for certain, and leave every sample's own area to chance; the pieces' areas and
moments sum exactly to the surface's.
"""
    output.with_suffix(".md").write_text(text)


if __name__ == "__main__":
    main()
