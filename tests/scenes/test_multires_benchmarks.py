"""The benchmarks of method raytrace: where curves cross, what their tables say, and how a film's popping is told."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.multires import page, scenes
from benchmarks.multires.crossing import crossing
from benchmarks.multires.path import motion, temporal_error
from benchmarks.multires.renderers import seeds_of


def curve(error, samples=(1, 4, 16, 64)) -> list[dict]:
    """A rival whose image takes 0.1 s and 0.01 s a sample more."""
    return [{"samples": n, "render_s": 0.1 + 0.01 * n, "error": error(n), "flip": error(n)} for n in samples]


def test_crossing_of_pure_noise_is_exact():
    found = crossing(curve(lambda n: 0.8 / n), 0.8 / 8)
    assert found.how == "measured" and found.samples == pytest.approx(8.0)
    assert 0.14 < found.seconds < 0.26
    beyond = crossing(curve(lambda n: 0.8 / n), 0.8 / 256)
    assert beyond.how == "extrapolated" and beyond.samples == pytest.approx(256.0)
    assert beyond.text().startswith("~")
    less = crossing(curve(lambda n: 0.8 / n), 1.6)
    assert less.how == "extrapolated" and less.samples == pytest.approx(0.5)


def test_a_curve_that_levels_off_never_crosses():
    assert crossing(curve(lambda n: 0.1 + 1e-6 / n), 0.01).text() == "never"
    assert crossing(curve(lambda n: 1.0)[:1], 0.1) is None


def test_page_tells_times_at_equal_error_and_failures(tmp_path):
    common = {"noise": 0.0, "bias": 0.0, "bias_error": 0.0, "peak_mb": 100.0, "stats": {}, "prepare_s": 1.0}
    rows = [{"method": "raytrace", "label": "raytrace:1", "samples": 1, "render_s": 0.2, "error": 0.1,
             "flip": 0.1, **common}]  # fmt: skip
    rows += [
        {"method": "cycles", "label": f"cycles:{r['samples']}", **r, **common} for r in curve(lambda n: 1 / n)
    ]
    rows += [{"method": "distributed", "label": "distributed:1", "samples": 1, "failure": "out of memory"}]
    rows += [{"method": "conventional", "label": "conventional", "samples": 1, "render_s": 0.1, "error": 1.0,
              "flip": 0.5, **common}]  # fmt: skip
    result = {"scene": "gn_trees", "command": "x", "size": [8, 8], "ours": "raytrace", "reference": "r",
              "machine": "m", "rows": rows}  # fmt: skip
    samples, _, times = page.equal_error(result, rows[0], "cycles")
    assert float(samples) == pytest.approx(10.0, rel=0.01)
    apart, together = (float(t) for t in times.split("\\|"))
    assert apart == pytest.approx(1.0, rel=0.1) and together == pytest.approx(1.0, rel=0.02)
    pytest.importorskip("matplotlib", reason="plots need the bench extra")
    page.write([result], tmp_path)
    text = (tmp_path / "raytrace-8x8.md").read_text()
    assert "out of memory" in text and "| 2.00 |" in text
    assert (tmp_path / "raytrace-8x8-gn_trees.png").is_file() and "(raytrace-8x8-gn_trees.png)" in text


def test_change_of_level_is_told_from_change_of_scene():
    rng = np.random.default_rng(0)
    truth = rng.random((6, 4, 5, 3))
    # a constant bias does not flicker
    assert temporal_error(truth + 0.3, truth) == pytest.approx(np.zeros(5))
    popped = truth.copy()
    popped[3:] += 0.2
    assert temporal_error(popped, truth) == pytest.approx([0, 0, 0.2, 0, 0])


def test_the_path_moves_rigidly_and_starts_at_the_scenes_own_camera():
    assert motion(0.0, 5.0) == pytest.approx(np.eye(4))
    m = motion(0.37, 5.0)
    assert m[:3, :3] @ m[:3, :3].T == pytest.approx(np.eye(3)) and m[2, 3] < 0.0


def test_references_grow_by_seeds():
    assert seeds_of(1024) == (2, 512) and seeds_of(4096) == (8, 512) and seeds_of(64) == (2, 32)


def test_a_builders_reference_does_not_hang_on_other_builders():
    text = scenes.builder_text(scenes.SUBJECTS["forest_cut"].build)
    assert "<module" not in text  # says where things are installed, and no two clones would share references
    assert '"realise"' in text and '"CUT"' in text and '"fence"' not in text
    with pytest.raises(KeyError, match="no_such"):
        scenes.source("no_such")
