"""Multilayer OpenEXR in Blender's naming, through the OpenEXR package.

As Blender 5.0 writes it: one part per pass, named "ViewLayer.Depth", whose channels carry the full name,
"ViewLayer.Depth.Z".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointmr_engine.image.files import reason, whole_file
from pointmr_engine.image.frame import NOTHING, Frame
from pointmr_engine.scene.errors import SceneError

# pass -> Blender's name (from 5.0 on), channel letters, whether it is colour
PASSES = {
    "combined": ("Combined", "RGBA", True),
    "depth": ("Depth", "Z", False),
    "position": ("Position", "XYZ", False),
    "normal": ("Normal", "XYZ", False),
    "diffuse_color": ("Diffuse Color", "RGB", True),
    "emission": ("Emission", "RGB", True),
    "object_index": ("Object Index", "X", False),
    "material_index": ("Material Index", "X", False),
    "sample_count": ("Debug Sample Count", "X", False),
}
_SHORT_NAMES = {
    "DiffCol": "diffuse_color",
    "Emit": "emission",
    "IndexOB": "object_index",
    "IndexMA": "material_index",
}
_KEYS = {name: key for key, (name, _, _) in PASSES.items()} | _SHORT_NAMES
_HALF_MAX = 65504.0


def write(
    path: str | Path,
    frames: Frame | dict[str, Frame],
    half: bool = False,
    pixel_aspect: float = 1.0,
    metadata: dict[str, str] | None = None,
) -> None:
    """Write all passes as one multilayer file, ZIP compressed, float32; with `half`, colours as half floats.

    frames: one frame, written as layer "ViewLayer", or frames by layer name; a region is set into its whole image.
    metadata: further header attributes. Written beside and renamed, so that `path` is never half a file. Raises
    SceneError, naming the path, if it cannot be written.
    """
    import OpenEXR

    layers = {"ViewLayer": frames} if isinstance(frames, Frame) else frames
    parts = []
    for layer, frame in layers.items():
        for key, pixels in frame.whole().passes.items():
            name, letters, is_color = PASSES[key]
            header = {
                "compression": OpenEXR.ZIP_COMPRESSION,
                "type": OpenEXR.scanlineimage,
                "pixelAspectRatio": float(pixel_aspect),
                "colorInteropID": "lin_rec709_scene" if is_color else "data",
            }
            if not parts:
                header |= {"BlenderMultiChannel": "Blender V2.55.1 and newer", "Software": "PointMR"}
                header |= {k: str(v) for k, v in (metadata or {}).items()}
            channels = {}
            for i, letter in enumerate(letters):
                values = pixels[::-1, :, i]
                if half and is_color:
                    values = np.clip(values, -_HALF_MAX, _HALF_MAX).astype(np.float16)
                channels[f"{layer}.{name}.{letter}"] = np.ascontiguousarray(values)
            parts.append(OpenEXR.Part(header, channels, f"{layer}.{name}"))
    with whole_file(path) as part:
        OpenEXR.File(parts).write(str(part))


def read(path: str | Path) -> dict[str, np.ndarray]:
    """Passes of a multilayer file, ours or Blender's: name -> (height, width, channels) float32, bottom row first.

    Known passes have the engine's names ("depth"), others the file's. Those of the first layer are plain; others have
    theirs in front, as "Layer.depth". A file without layers gives "combined". Raises SceneError, naming the path.
    """
    import OpenEXR

    path = Path(path)
    if not path.is_file():
        raise SceneError(f"cannot read '{path}': no such file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes, first_layer = {}, None
            for part in file.parts:
                for channel in part.channels:
                    layer, name, letter = _split(channel)
                    first_layer = layer if first_layer is None else first_layer
                    key = _KEYS.get(name, name)
                    key = key if layer == first_layer else f"{layer}.{key}"
                    pixels = np.asarray(part.channels[channel].pixels, np.float32)
                    planes.setdefault(key, {})[letter] = _in_display_window(pixels, part, key)
    except (OSError, RuntimeError, ValueError) as error:
        raise SceneError(f"cannot read '{path}': {reason(error)}") from error
    return {key: np.stack([p[c] for c in sorted(p, key=_order)], -1)[::-1] for key, p in planes.items()}


def _split(channel: str) -> tuple[str, str, str]:
    """Layer, pass and letter of a channel's name; layers may contain dots, and plain files have neither."""
    pieces = channel.rsplit(".", 2)
    if len(pieces) == 3:
        return pieces[0], pieces[1], pieces[2]
    return "", pieces[0] if len(pieces) == 2 else "combined", pieces[-1]


def _order(letter: str) -> int:
    order = "RGBAXYZVW".find(letter.upper()[:1])
    return order if order >= 0 else 99


def _in_display_window(pixels: np.ndarray, part, key: str) -> np.ndarray:
    (x0, y0), (x1, y1) = part.header["displayWindow"]
    (left, top), _ = part.header["dataWindow"]
    height, width = int(y1 - y0 + 1), int(x1 - x0 + 1)
    if pixels.shape == (height, width) and (left, top) == (x0, y0):
        return pixels
    canvas = np.full((height, width), NOTHING if key.endswith("depth") else 0.0, np.float32)
    x, y = int(left - x0), int(top - y0)
    inside = pixels[max(-y, 0) : height - y, max(-x, 0) : width - x]
    canvas[max(y, 0) : max(y, 0) + inside.shape[0], max(x, 0) : max(x, 0) + inside.shape[1]] = inside
    return canvas
