"""Gaps between the ellipses of one surface are closed; what is open for another reason is not."""

import numpy as np
import pytest

from pointmr_engine.forward.drawing.subpixels import View, allocate_target, clear, close_gaps, gap_limits

SIDE = 16
SURFEL, CLUMP, TRIANGLE = 0, 1, 2  # entries
ENTRIES = np.array([8, 9, -1], np.int64)  # as draw.Entries has them
VIEW = View(True, 1000.0, 1000.0, 0.0, 0.0, 0.1, 100.0, 0.0, 0.0)


def drawn(inside, nearness=0.1, entry=SURFEL):
    """A target whose subpixels `inside` (SIDE, SIDE) show an entry at some nearness."""
    target = allocate_target(SIDE, SIDE)
    clear(target, SIDE)
    target.depth[:SIDE, :SIDE] = np.where(inside, nearness, 0.0)
    target.ids[:SIDE, :SIDE] = np.where(inside, entry, -1)
    return target


def closed(target, subpixel=1e-3):
    n = np.int64(SIDE)
    return close_gaps(target, n, n, ENTRIES, gap_limits(VIEW, subpixel))


def with_holes(*holes):
    inside = np.ones((SIDE, SIDE), bool)
    for y, x in holes:
        inside[y, x] = False
    return inside


@pytest.mark.parametrize(
    "holes", [[(5, 5)], [(5, 5), (5, 6)], [(5, 5), (6, 5)], [(5, 5), (6, 6)], [(3, 3), (9, 12)]]
)
def test_holes_in_a_surface_are_closed(holes):
    target = drawn(with_holes(*holes))
    assert closed(target) == len(holes)
    assert (target.ids[:SIDE, :SIDE] == SURFEL).all()
    assert (target.depth[:SIDE, :SIDE] > 0).all()


def test_a_hole_beside_a_triangle_is_closed_by_the_surfels():
    target = drawn(with_holes((5, 5)))
    target.ids[5, 4] = TRIANGLE
    assert closed(target) == 1
    assert target.ids[5, 5] == SURFEL


def test_notches_of_an_outline_stay():
    inside = np.zeros((SIDE, SIDE), bool)
    inside[:8] = True
    inside[7, ::2] = False  # as ellipses leave it
    inside[3:6, 0] = False
    assert closed(drawn(inside)) == 0


def test_what_lies_apart_in_depth_is_not_one_surface():
    """Needles before the sky: side by side in the image, and far from each other."""
    nearness = np.full((SIDE, SIDE), 0.1)
    nearness[:, 6:] = 0.085
    assert closed(drawn(with_holes((8, 5)), nearness)) == 0
    nearness[:, 6:] = 0.0995  # a steep surface
    assert closed(drawn(with_holes((8, 5)), nearness)) == 1


@pytest.mark.parametrize("entry", [CLUMP, TRIANGLE])
def test_clumps_and_triangles_have_no_gaps(entry):
    assert closed(drawn(with_holes((5, 5)), entry=entry)) == 0


def test_limits_of_parallel_views_are_metres():
    parallel = VIEW._replace(perspective=False, depth_scale=0.01)
    assert gap_limits(parallel, 0.5)[1] == 0
    assert gap_limits(parallel, 0.5)[0] == pytest.approx(2 * gap_limits(parallel, 0.25)[0])
