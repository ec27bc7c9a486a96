"""Pictures of a comparison: side by side with difference and FLIP map, contact sheets, and the plot of error against
time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.metrics import flip, over_backdrop, srgb

LABEL_HEIGHT = 14


def to_bytes(linear: np.ndarray) -> np.ndarray:
    """RGBA or RGB linear (h, w, c) -> sRGB uint8 (h, w, 3), as the Standard view shows it."""
    rgb = over_backdrop(linear) if linear.shape[-1] == 4 else linear
    return np.round(srgb(rgb) * 255).astype(np.uint8)


def heat(values: np.ndarray) -> np.ndarray:
    """A map of values 0..1 (h, w) in the magma colours of FLIP, uint8."""
    from matplotlib import colormaps

    return np.round(colormaps["magma"](np.clip(values, 0, 1))[..., :3] * 255).astype(np.uint8)


def difference(image: np.ndarray, reference: np.ndarray, gain: float) -> np.ndarray:
    """Signed difference in the Standard view times gain around mid-grey: brighter than the reference is lighter."""
    delta = srgb(over_backdrop(image)) - srgb(over_backdrop(reference))
    return np.round(np.clip(0.5 + gain * delta, 0, 1) * 255).astype(np.uint8)


def labelled(tile: np.ndarray, text: str):
    """A Pillow image of a tile with a line of text below it."""
    from PIL import Image, ImageDraw

    height, width = tile.shape[:2]
    sheet = Image.new("RGB", (width, height + LABEL_HEIGHT), (24, 24, 24))
    sheet.paste(Image.fromarray(tile), (0, 0))
    ImageDraw.Draw(sheet).text((3, height + 1), text, fill=(230, 230, 230))
    return sheet


def comparison(image: np.ndarray, reference: np.ndarray, name: str, label: str, gain: float = 5.0):
    """Ours | reference | difference times gain | FLIP map, as one Pillow image."""
    from PIL import Image

    scale = max(1, round(240 / image.shape[1]))
    mean, error_map = flip(image, reference)
    tiles = (
        (to_bytes(image), f"{name}: {label}"),
        (to_bytes(reference), "Cycles, reference"),
        (difference(image, reference, gain), f"difference x {gain:g}"),
        (heat(error_map), f"FLIP {mean:.4f}"),
    )
    parts = [labelled(np.repeat(np.repeat(t, scale, 0), scale, 1), text) for t, text in tiles]
    sheet = Image.new("RGB", (sum(p.width for p in parts), parts[0].height))
    left = 0
    for part in parts:
        sheet.paste(part, (left, 0))
        left += part.width
    return sheet


def contact_sheet(rows: list, path: Path, columns: int = 1) -> None:
    """Stack Pillow images into one PNG, `columns` side by side."""
    from PIL import Image

    if not rows:
        return
    width, height = max(r.width for r in rows), max(r.height for r in rows)
    lines = -(-len(rows) // columns)
    sheet = Image.new("RGB", (width * columns, height * lines), (24, 24, 24))
    for i, row in enumerate(rows):
        sheet.paste(row, (width * (i % columns), height * (i // columns)))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)


def plot_error_time(scene: str, points: list[dict], path: Path) -> None:
    """Log-log plot of relative MSE (less the reference's noise) against the seconds of the render phase."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(6, 4.2), dpi=120)
    for name in dict.fromkeys(p["method"] for p in points):
        mine = sorted((p for p in points if p["method"] == name), key=lambda p: p["samples"])
        x, y = [p["render_s"] for p in mine], [max(p["error"], 1e-8) for p in mine]
        axis.plot(x, y, "o-", label=name)
        for p, px, py in zip(mine, x, y, strict=True):
            axis.annotate(str(p["samples"]), (px, py), textcoords="offset points", xytext=(4, 4), fontsize=7)
    axis.set(xscale="log", yscale="log", title=scene, xlabel="render phase, seconds", ylabel="relative MSE")
    axis.grid(True, which="both", alpha=0.3)
    axis.legend()
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    pyplot.close(figure)
