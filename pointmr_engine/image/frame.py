"""A finished image: pixels, passes, statistics."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

CHANNELS = {
    "combined": 4,
    "depth": 1,
    "position": 3,
    "normal": 3,
    "diffuse_color": 3,
    "emission": 3,
    "object_index": 1,
    "material_index": 1,
    "sample_count": 1,
}
NOTHING = 1e10  # depth where no surface was hit


@dataclass
class Frame:
    """What a render returns. Width and height are those of the rendered region (the whole image without one).

    passes: name -> (height, width, channels) float32, bottom row first, scene-linear Rec.709; "combined" is
    premultiplied RGBA. region: (x0, y0, x1, y1) in the whole image of full_width x full_height pixels, None for all.
    stats: counters, times and sizes by name. warnings: what was skipped or replaced, in words.
    """

    width: int
    height: int
    passes: dict[str, np.ndarray] = field(default_factory=dict)
    stats: dict = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    region: tuple[int, int, int, int] | None = None
    full_width: int = 0
    full_height: int = 0

    def whole(self) -> Frame:
        """The frame at the whole image's size; outside the region transparent black, depth 1e10. Itself without one."""
        if self.region is None or (self.width, self.height) == (self.full_width, self.full_height):
            return self
        x0, y0, x1, y1 = self.region
        passes = {}
        for name, pixels in self.passes.items():
            canvas = np.zeros((self.full_height, self.full_width, pixels.shape[2]), np.float32)
            if name == "depth":
                canvas.fill(NOTHING)
            canvas[y0:y1, x0:x1] = pixels
            passes[name] = canvas
        return Frame(self.full_width, self.full_height, passes, self.stats, self.warnings, None, 0, 0)
