"""Writes docs/images/: rendered PNG pictures of out/ in 256 dithered colours, which keeps them small.

.venv/bin/python scenes_blend/previews.py still_life forest_1e15 stadium
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    for name in sys.argv[1:]:
        picture = Image.open(ROOT / "out" / f"{name}.png").convert("RGB")
        # a few rounds of k-means, or else the palette forgets small bright things
        few = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=8)
        small = picture.quantize(palette=few, dither=Image.Dither.FLOYDSTEINBERG)
        target = ROOT / "docs" / "images" / f"{name}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        small.save(target, optimize=True)
        print(target, f"{target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
