"""Feature scenes laid over Cycles, small: what differs beyond noise is a wrong feature."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import features, sources
from benchmarks.methods import Method, read_exr
from benchmarks.metrics import deviation
from benchmarks.reference import reference

SMALL = (64, 48)
MAX_BIAS = 0.002
MAX_FLIP = 0.035
QUICK = (
    "light_point_soft",
    "light_spot_blend",
    "light_area_ellipse",
    "light_world_equirectangular",
    "light_emissive_mesh",
    "lens_shift_fit_vertical",
    "lens_dof_blades",
    "principled_metal_roughness",
    "principled_transmission",
    "principled_coat",
    "bsdf_mix",
    "texture_image",
    "texture_noise",
    "instance_nested",
    "instance_geometry_nodes",
    "film_transparent",
    "film_visibility",
)
NAMES = [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in features.FEATURES]


@pytest.mark.parametrize("name", NAMES)
def test_feature_lies_over_cycles(name, keepers, tmp_path):
    source = sources.find(name)
    size = SMALL if source.size[0] >= source.size[1] else SMALL[::-1]
    truth = reference(source, size, 256, 2, tmp_path, worker=keepers["cycles"].get())
    worker = keepers["method"].get()
    worker.load(source.argument, Method("distributed", 64), size, 2)
    images = []
    for seed in (1, 2):
        worker.render(seed, tmp_path / f"{seed}.exr")
        images.append(read_exr(str(tmp_path / f"{seed}.exr"))[0])
    found = deviation(images, truth.halves)
    both = deviation([np.mean(images, axis=0)], truth.halves)
    assert found.not_finite == 0
    assert found.bias - 3.0 * found.bias_error < MAX_BIAS, f"{name}: {found}"
    assert both.flip < MAX_FLIP, f"{name}: {both}"
    assert found.alpha < 0.01, f"{name}: {found}"
