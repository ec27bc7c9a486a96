"""Hue, saturation and value or lightness: as numpy a dozen passes over the batch, half of them for naught."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted


@device
def _hue(r, g, b, high, delta):
    """Hue 0..1 of a colour whose largest channel is `high`, by delta, not 0, more than the least."""
    if r == high:
        hue = (g - b) / delta
    elif g == high:
        hue = np.float32(2) + (b - r) / delta
    else:
        hue = np.float32(4) + (r - g) / delta
    hue /= np.float32(6)
    return hue + np.float32(1) if hue < 0 else hue


@uncounted
def fill_hsv(rgb, out):
    """out (n, 3) float32 = hue 0..1, saturation and value of rgb (n, 3) float32."""
    for k in range(len(rgb)):
        r, g, b = rgb[k, 0], rgb[k, 1], rgb[k, 2]
        high = max(r, g, b)
        delta = high - min(r, g, b)
        hue = saturation = np.float32(0)
        if high != 0:
            saturation = delta / high
        if delta != 0 and saturation != 0:
            hue = _hue(r, g, b, high, delta)
        out[k, 0], out[k, 1], out[k, 2] = hue, saturation, high


@uncounted
def fill_hsl(rgb, out):
    """out (n, 3) float32 = hue 0..1, saturation and lightness of rgb (n, 3) float32."""
    one, two = np.float32(1), np.float32(2)
    for k in range(len(rgb)):
        r, g, b = rgb[k, 0], rgb[k, 1], rgb[k, 2]
        high, low = max(r, g, b), min(r, g, b)
        delta = high - low
        lightness = min((high + low) / two, one)
        scale = two - high - low if lightness > np.float32(0.5) else high + low
        hue = saturation = np.float32(0)
        if delta != 0:
            saturation = delta / scale if scale != 0 else delta
            hue = _hue(r, g, b, high, delta)
        out[k, 0], out[k, 1], out[k, 2] = hue, saturation, lightness


@uncounted
def fill_rgb(hsv, out):
    """out (n, 3) float32 = the colours of hsv (n, 3) float32, of which a hue of 1 is 0 again."""
    one = np.float32(1)
    for k in range(len(hsv)):
        h, s, v = hsv[k, 0], hsv[k, 1], hsv[k, 2]
        h = np.float32(0) if h == one else h * np.float32(6)
        sector = np.float32(math.floor(h))
        f = h - sector
        p, q, t = v * (one - s), v * (one - s * f), v * (one - s * (one - f))
        r, g, b = v, p, q
        if s == 0:
            r, g, b = v, v, v
        elif sector == 0:
            r, g, b = v, t, p
        elif sector == 1:
            r, g, b = q, v, p
        elif sector == 2:
            r, g, b = p, v, t
        elif sector == 3:
            r, g, b = p, q, v
        elif sector == 4:
            r, g, b = t, p, v
        out[k, 0], out[k, 1], out[k, 2] = r, g, b
