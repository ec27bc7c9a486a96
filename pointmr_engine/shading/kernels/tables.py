"""Tables over 0..1, as Color Ramp and curves have them: as numpy a dozen passes over a batch of a thousand points."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted


@uncounted
def fill_from_table(table, t, interpolate, extrapolate, out):
    """out (n, k) float32 = values of table (m, k) float32 at t (n,) float32, linear between entries or stepped;
    beyond 0..1 those of its ends, or of the lines that its first and last two make. NaN is 0."""
    one, last = np.float32(1), np.int64(len(table) - 1)
    for n in range(len(t)):
        x = t[n]
        inside = min(max(x, np.float32(0)), one) if x == x else np.float32(0)
        position = inside * np.float32(last)
        i = np.int64(position)
        f = position - np.float32(i)
        following = min(i + 1, last)
        for k in range(table.shape[1]):
            value = table[i, k]
            if interpolate:
                value = value * (one - f) + table[following, k] * f
            if extrapolate and last > 0:
                if x < 0:
                    value += x * np.float32(last) * (table[1, k] - table[0, k])
                elif x > 1:
                    value += (x - one) * np.float32(last) * (table[last, k] - table[last - 1, k])
            out[n, k] = value
