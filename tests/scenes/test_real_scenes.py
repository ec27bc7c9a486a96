"""Real scenes by one cone a pixel, laid over Cycles: neither their light nor their error may drift away unseen."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import sources
from benchmarks.methods import Method, read_exr
from benchmarks.metrics import deviation
from benchmarks.reference import reference

SIZE = (96, 72)
# of one cone a pixel: relative MSE without the noise of the reference, as measured and half as much again
MAX_ERROR = {"gn_trees": 0.018, "still_life": 0.018, "dragon_near": 0.002, "hair": 0.02}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not sources.scenes_folder(), reason="POINTMR_SCENES does not name a folder of third-party scenes"
    ),
]


@pytest.mark.parametrize("name", MAX_ERROR)
def test_light_and_error_of_one_cone_a_pixel(name, keepers, tmp_path):
    source = sources.find(name)
    truth = reference(source, SIZE, 256, 2, tmp_path, worker=keepers["cycles"].get())
    worker = keepers["method"].get()
    worker.load(source.argument, Method("raytrace", 1), SIZE, 2)
    images = []
    for seed in (1, 2):
        worker.render(seed, tmp_path / f"{seed}.exr")
        images.append(read_exr(str(tmp_path / f"{seed}.exr"))[0])
    found = deviation(images, truth.halves)
    print(name, found, np.sum(np.mean(images, axis=0)[..., :3]) / np.sum(truth.image[..., :3]))
    light = np.sum(np.mean(images, axis=0)[..., :3]) / np.sum(truth.image[..., :3])
    assert light == pytest.approx(1.0, abs=0.02)
    assert found.rel_mse - found.reference_noise < MAX_ERROR[name], f"{name}: {found}"
