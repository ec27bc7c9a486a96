"""What a walk draws into: each shape has one name here, whatever the kind of target.

`subpixels.Target` keeps the nearest entry of every subpixel, `multires.alpha.a_buffer.Layers` a list of all that a cell
shows. A kernel is compiled for the kind that it gets, so that neither pays for the other.
"""

from __future__ import annotations

from numba.extending import overload

from pointmr_engine.forward.drawing.cut_out_cover import cover_cut_out
from pointmr_engine.forward.drawing.subpixels import Target, cover_ellipse, cover_triangle

_OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True, "_nrt": False}


def put_ellipse(
    target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, opacity, area, phase
):
    """Draw an ellipse as subpixels.cover_ellipse does; area: of its piece in the image,
    surfel_lanes.SEEN."""
    raise NotImplementedError


def put_triangle(target, width, height, x, y, w, entry):
    """Draw a triangle as subpixels.cover_triangle does."""
    raise NotImplementedError


def put_cut_out(target, width, height, perspective, x, y, w, at, entry, cells, start, side, key):
    """Draw a triangle with holes as cut_out_cover.cover_cut_out does."""
    raise NotImplementedError


def puts(shape, kind):
    """Decorator: the function returns what draws `shape` (one of the above) into a target of class `kind`."""

    def register(choose):
        def chosen(target, *args):
            return choose() if getattr(target, "instance_class", None) is kind else None

        overload(shape, jit_options=_OPTIONS, strict=False)(chosen)
        return choose

    return register


@puts(put_ellipse, Target)
def _ellipse():
    def draw(target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, opacity, area, phase):
        return cover_ellipse(
            target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, opacity, phase
        )

    return draw


@puts(put_triangle, Target)
def _triangle():
    def draw(target, width, height, x, y, w, entry):
        return cover_triangle(target, width, height, x, y, w, entry)

    return draw


@puts(put_cut_out, Target)
def _cut_out():
    def draw(target, width, height, perspective, x, y, w, at, entry, cells, start, side, key):
        return cover_cut_out(target, width, height, perspective, x, y, w, at, entry, cells, start, side, key)

    return draw
