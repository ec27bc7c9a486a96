"""Method "raytrace" against exact images known by formula, and the formulas against exact rays.

All cases and methods: `python -m benchmarks.closed_forms`, docs/benchmarks/closed_forms.md.
"""

import functools

import numpy as np
import pytest

from benchmarks.closed_forms.__main__ import formula_error, image_of
from benchmarks.closed_forms.cases import all_cases
from pointmr_engine.render import Cache

CASES = {case.name: case for case in all_cases()}
JUDGED = [  # one or two of a kind: what a minute allows
    "penumbra of a disk",
    "penumbra of a square",
    "narrow penumbra",
    "penumbra of the sun",
    "defocused far edge",
    "defocused near edge",
    "plane mirror",
    "mirrored sphere, middle",
    "rough mirror 0.2",
    "rough mirror 0.35",
    "rough mirror 0.5",
    "flat patch, edge",
    "flat patch, slanted",
    "waves of 4 pixels",
    "waves of 2.5 pixels",
    "sky beside a wall",
    "sky at a contact",
    "sky under a roof",
    "sphere from inside",
]
PATCH = 0.01  # bound of flat patches
BOUNDS = {1: 0.02, 64: 0.005}  # by cones a pixel


@functools.cache
def exact_of(name: str) -> np.ndarray:
    return CASES[name].exact()


@functools.cache
def scene_of(name: str):
    return CASES[name].scene()


def image(name: str, method: str, cache: Cache | None = None, **values) -> np.ndarray:
    return image_of(CASES[name], scene_of(name), method, cache, **values)


def agrees(name: str, moved: int = 0) -> bool:
    """Whether a case's exact image, moved by so many pixels to the right, is what exact rays converge to."""
    cache, exact = Cache(), exact_of(name)
    first, second = (image(name, "distributed:128", cache, seed=seed)[:, moved:] for seed in (1, 2))
    common, error = formula_error(CASES[name], exact[:, : exact.shape[1] - moved], first, second)
    return common < 3.0 * error + 1e-3


@pytest.mark.parametrize("name", JUDGED)
def test_formulas_agree_with_exact_rays(name):
    assert agrees(name)


def test_a_wrong_formula_is_noticed():
    assert not agrees("penumbra of a disk", moved=1)


@pytest.mark.parametrize("name", JUDGED)
@pytest.mark.parametrize("cones", list(BOUNDS))
def test_cones_meet_the_exact_image(name, cones):
    bound = PATCH if "patch" in name else BOUNDS[cones]
    error = CASES[name].error(image(name, f"raytrace:{cones}"), exact_of(name))
    assert error <= bound, f"{100.0 * error:.2f} % of the range"
