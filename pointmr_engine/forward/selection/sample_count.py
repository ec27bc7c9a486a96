"""How many points are enough: the probability that a pixel of a fully covered image stays empty.

Random draws (talk: "Correct Images"): k points on an area of a pixels miss one of its pixels with probability
(1 - 1/a)^k <= e^(-k/a), so some of them with at most a e^(-k/a) = f for k = a (ln a + ln 1/f). Each box gets its own
random number of points, Poisson-distributed about the expected one, so that boxes need not know of each other: a pixel
that expects rho of them is empty with probability e^-rho, the same density.
Stratified: one point in each of k equal pieces of the area, taken along the octree's order. A pixel that has the shares
p_i of some pieces (their sum is rho) stays empty with probability prod(1 - p_i) <= e^-rho; with 0 as soon as a whole
piece lies in it. How often that is depends on the shape of the pieces: simulated for planes of all orientations in the
octree's order, with triangles up to the largest that are sampled, the mean probability is about e^(-1.2 rho^1.2)
(rho = 2: 0.06, 4: 0.002, 6: 4e-5, 10: 4e-9).
"""

from __future__ import annotations

import math

STRATIFIED = 1.2  # factor and exponent of the simulated law


def random_count(area: float, failure: float) -> int:
    """Random points that leave no hole in `area` pixels but with probability `failure`: a (ln a + ln 1/f)."""
    return math.ceil(area * points_per_pixel("random", area, failure))


def points_per_pixel(draws: str, area: float, failure: float) -> float:
    """Density, in points per pixel of area, that covers `area` (>= 1) pixels but with probability `failure`.

    draws: "random" or "stratified". Raises KeyError for another.
    """
    empty = max(math.log(max(area, 1.0) / failure), 0.0)  # -ln of the probability allowed to each pixel
    return {
        "random": empty,
        "stratified": min(empty, (empty / STRATIFIED) ** (1.0 / STRATIFIED)),
    }[draws]


def hole_probability(draws: str, density: float) -> float:
    """Probability that a pixel that expects `density` points gets none. Raises KeyError for unknown draws."""
    exponent = {
        "random": density,
        "stratified": max(density, STRATIFIED * density**STRATIFIED),
    }[draws]
    return math.exp(-exponent)
