"""The judge itself: its measures on images whose error is known, its cache, and its settings of Cycles."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import features, metrics, sources
from benchmarks.methods import Method, parse_methods, read_exr
from benchmarks.processes import Worker, WorkerError
from benchmarks.reference import key_of, reference


def noisy(truth: np.ndarray, sigma: float, seed: int) -> np.ndarray:
    return truth + np.random.default_rng(seed).normal(0, sigma, truth.shape) * [1, 1, 1, 0]


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    image = np.random.default_rng(0).uniform(0.1, 0.9, (64, 64, 4))
    image[..., 3] = 1.0
    return image


def test_noise_alone_is_no_bias(truth):
    renders = [noisy(truth, 0.1, 10 + s) for s in range(2)]
    halves = [noisy(truth, 0.05, 100 + s) for s in range(2)]
    found = metrics.deviation(renders, halves)
    weight = np.mean(1 / (truth[..., :3] ** 2 + 0.01))
    assert found.noise == pytest.approx(0.01 * weight, rel=0.1)
    assert found.reference_noise == pytest.approx(0.0025 / 2 * weight, rel=0.1)
    assert abs(found.bias) < 4 * found.bias_error
    assert found.rel_mse == pytest.approx(found.noise + found.reference_noise + found.bias)


def test_bias_is_found_under_noise(truth):
    renders = [noisy(truth * [1.1, 1.1, 1.1, 1], 0.05, 10 + s) for s in range(2)]
    halves = [noisy(truth, 0.02, 100 + s) for s in range(2)]
    found = metrics.deviation(renders, halves)
    exact = metrics.relative_mse(truth * [1.1, 1.1, 1.1, 1], truth)
    assert found.bias == pytest.approx(exact, abs=4 * found.bias_error)
    assert found.bias > 4 * found.bias_error


def test_one_render_has_unknown_noise(truth):
    found = metrics.deviation([truth], [truth, truth])
    assert found.rel_mse == 0.0 and found.flip == 0.0 and np.isnan(found.bias)


def test_not_finite_values_are_counted_not_spread(truth):
    broken = truth.copy()
    broken[3, 4, 0] = np.nan
    found = metrics.deviation([broken, truth], [truth, truth])
    assert found.not_finite == 1 and np.isfinite(found.rel_mse)


def test_alpha_counts_as_error(truth):
    clear = np.zeros_like(truth)
    found = metrics.deviation([clear], [truth, truth])
    assert found.alpha == 1.0
    assert metrics.relative_mse(clear, np.zeros_like(truth)) == 0.0


def test_images_of_other_size_are_refused(truth):
    with pytest.raises(ValueError, match="shape"):
        metrics.deviation([truth[:32]], [truth, truth])


def test_srgb_as_blender_shows_it():
    values = metrics.srgb(np.array([-1.0, 0.0, 0.0031308, 0.18, 1.0, 7.0]))
    assert values == pytest.approx([0, 0, 0.04045, 0.46135, 1, 1], abs=1e-4)


def test_methods_are_read_from_words():
    assert parse_methods(["distributed:4,16", "cycles:8", "conventional", "raytrace:1,16"]) == [
        Method("distributed", 4),
        Method("distributed", 16),
        Method("cycles", 8),
        Method("conventional", 1),
        Method("raytrace", 1),
        Method("raytrace", 16),
    ]
    with pytest.raises(ValueError, match="raytrace:3.*1, 4, 16, 64"):
        parse_methods(["raytrace:4,3"])
    with pytest.raises(ValueError, match="eevee"):
        parse_methods(["eevee:4"])


def test_a_reference_is_known_by_its_content():
    a, b = sources.find("light_point_sharp"), sources.find("light_point_soft")
    key = key_of(a, (8, 8), 16, {})
    assert key == key_of(a, (8, 8), 16, {})
    others = [key_of(b, (8, 8), 16, {}), key_of(a, (8, 9), 16, {}), key_of(a, (8, 8), 32, {})]
    assert len({key, *others, key_of(a, (8, 8), 16, {"max_bounces": 1})}) == 5


def test_every_feature_says_what_it_shows():
    assert len(features.FEATURES) >= 100
    silent = [n for n, f in features.FEATURES.items() if not (f.build.__doc__ or "").strip()]
    assert not silent


def test_unknown_scenes_are_named():
    with pytest.raises(KeyError, match="no_such_scene"):
        sources.find("no_such_scene")


def test_random_scenes_are_named_by_seeds():
    assert sources.names(["random_3-5", "bmw27"]) == ["random_3", "random_4", "random_5", "bmw27"]
    a, b = sources.find("random_3"), sources.find("random_4")
    assert a.kind == "random" and a.content != b.content
    with pytest.raises(KeyError, match="random_SEED"):
        sources.find("random_3-4")


def test_a_seed_draws_the_same_scene_again():
    bpy = pytest.importorskip("bpy")

    def drawn(seed: int) -> list:
        sources.find(f"random_{seed}").load()
        found = [(o.name, *np.round(np.array(o.matrix_world).ravel(), 5)) for o in bpy.data.objects]
        return found + [(n.bl_idname, m.name) for m in bpy.data.materials for n in m.node_tree.nodes]

    first = [drawn(seed) for seed in range(1, 6)]
    assert first == [drawn(seed) for seed in range(1, 6)]
    assert len({str(scene) for scene in first}) == 5


def test_cycles_is_set_up_fairly_and_its_error_falls(keepers, tmp_path):
    source = sources.find("light_point_soft")
    worker = keepers["cycles"].get()
    truth = reference(source, (32, 24), 512, 2, tmp_path, worker=worker)
    assert reference(source, (32, 24), 512, 2, tmp_path, worker=None).image == pytest.approx(truth.image)
    assert not np.array_equal(*truth.halves)
    errors = []
    for samples in (8, 128):
        worker.load("light_point_soft", Method("cycles", samples), (32, 24), 2)
        images = []
        for seed in (1, 2):
            worker.render(seed, tmp_path / "render.exr")
            images.append(read_exr(str(tmp_path / "render.exr"))[0])
        errors.append(metrics.deviation(images, truth.halves).rel_mse)
    assert errors[1] < errors[0] / 4


def test_a_scene_that_cannot_be_loaded_is_an_error_of_its_worker(tmp_path):
    with Worker(tmp_path / "log") as worker, pytest.raises(WorkerError, match="missing.blend"):
        worker.load(str(tmp_path / "missing.blend"), Method("cycles", 1), (8, 8))
