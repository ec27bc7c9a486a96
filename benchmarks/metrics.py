"""Error measures between linear images, and how much of an error is noise.

Images are float32 arrays (height, width, 4), scene-linear Rec.709 with premultiplied alpha, bottom row first or last
alike. Both images are laid over the same grey before anything is measured, so that an error of alpha counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BACKDROP = 0.18  # scene-linear grey behind a transparent film
EPSILON = 0.01  # keeps dark pixels of the reference from ruling the relative error


def over_backdrop(image: np.ndarray) -> np.ndarray:
    """Lay a premultiplied RGBA image over the backdrop: float64 (h, w, 3)."""
    image = np.asarray(image, dtype=np.float64)
    return image[..., :3] + (1.0 - image[..., 3:4]) * BACKDROP


def srgb(linear: np.ndarray) -> np.ndarray:
    """Blender's Standard view: clamp scene-linear values to [0, 1] and encode as sRGB."""
    x = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 1e-9), 1 / 2.4) - 0.055)


def relative_square(difference: np.ndarray, reference: np.ndarray) -> float:
    """mean(difference^2 / (reference^2 + 0.01)) over pixels and channels."""
    return float(np.mean(difference**2 / (reference**2 + EPSILON)))


def relative_mse(image: np.ndarray, reference: np.ndarray) -> float:
    """Relative mean square error of one premultiplied RGBA image against another."""
    r = over_backdrop(reference)
    return relative_square(over_backdrop(image) - r, r)


def flip(image: np.ndarray, reference: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean FLIP (LDR, 67 pixels per degree) and its map (h, w) of image against reference, in the Standard view."""
    import flip_evaluator

    encode = [np.ascontiguousarray(srgb(over_backdrop(i)), dtype=np.float32) for i in (reference, image)]
    error_map, mean, _ = flip_evaluator.evaluate(
        encode[0], encode[1], "LDR", applyMagma=False, parameters={"ppd": 67.0}
    )
    return float(mean), np.asarray(error_map, dtype=np.float32).reshape(encode[0].shape[:2] + (-1,))[..., 0]


@dataclass(frozen=True)
class Deviation:
    """How far independent renders of one method lie from the reference.

    rel_mse: mean over the renders of their relative MSE, noise and all.
    noise, reference_noise: what of it is the variance of one render and of the reference, from independent halves.
    bias: rel_mse less both, an unbiased estimate of the relative MSE that endless samples would leave (it scatters
    around zero, so it may be negative); bias_error: its standard error, from its spread over the pixels.
    flip: mean FLIP of the first render. alpha: mean absolute error of alpha.
    not_finite: values of the first render that are NaN or infinite.
    """

    rel_mse: float
    noise: float
    reference_noise: float
    bias: float
    bias_error: float
    flip: float
    alpha: float
    not_finite: int


def sample_variance(images: list[np.ndarray]) -> np.ndarray:
    """Unbiased variance of one image per pixel and channel, from independent renders of it."""
    return np.var(np.stack(images), axis=0, ddof=1)


def deviation(renders: list[np.ndarray], reference_halves: list[np.ndarray]) -> Deviation:
    """Compare independent renders of one method with independent halves of a reference.

    With a single render its noise cannot be told from bias: noise, bias and bias_error are NaN then.
    """
    if any(r.shape != reference_halves[0].shape for r in renders):
        shapes = [r.shape for r in renders]
        raise ValueError(f"renders of shape {shapes} against a reference of {reference_halves[0].shape}")
    reference_rgba = np.mean(reference_halves, axis=0)
    halves = [over_backdrop(h) for h in reference_halves]
    reference = over_backdrop(reference_rgba)
    images = [over_backdrop(np.nan_to_num(r)) for r in renders]
    weight = reference**2 + EPSILON
    square = np.mean([(i - reference) ** 2 for i in images], axis=0) / weight
    unknown = np.full_like(square, np.nan)
    noise = sample_variance(images) / weight if len(images) > 1 else unknown
    reference_noise = sample_variance(halves) / len(halves) / weight if len(halves) > 1 else unknown
    # Neighbours share samples through the pixel filter: some two pixels count as one independent draw.
    bias = np.mean(square - noise - reference_noise, axis=-1)
    first = np.nan_to_num(renders[0])
    return Deviation(
        rel_mse=float(square.mean()),
        noise=float(noise.mean()),
        reference_noise=float(reference_noise.mean()),
        bias=float(bias.mean()),
        bias_error=float(bias.std() * np.sqrt(2.0 / bias.size)),
        flip=flip(first, reference_rgba)[0],
        alpha=float(np.mean(np.abs(first[..., 3] - reference_rgba[..., 3]))),
        not_finite=int(np.count_nonzero(~np.isfinite(renders[0]))),
    )
