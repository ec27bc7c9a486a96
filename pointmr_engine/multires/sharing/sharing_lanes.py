"""Fragments that share light, eight at a time: which eights can hear each other, and what one hears of eight.

Eight rows of the table of what fragments tell each other lie side by side, column by column (LANE_FLOATS for each
eight), and so do the bounds of eight such eights (BOUND_FLOATS).
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointmr_engine.numerics.simd import WIDTH, _i64, _load, _mask
from pointmr_engine.numerics.simd_terms import Term, Terms

# Rows of the table of what fragments tell each other, by channel or axis: what rays about them met, place and normal in
# the world, from how wide an angle light arrives, their cone; how much they count, by channel, what arrives times that,
# and how what arrives changes with the normal.
NEARNESS, PLACE, FACING, ANGLE, AT_X, AT_Y, HEARD, ARRIVED, TURNED = 0, 1, 4, 7, 8, 9, 10, 13, 16
COLUMNS = 19
BOUNDED = 10  # the first columns, of which eights have bounds: the least of each, then the most
LANE_FLOATS, BOUND_FLOATS = COLUMNS * WIDTH, 2 * BOUNDED * WIDTH

# Rows of the table of what they receive: of HEARD, ARRIVED and TURNED, and of normals, weighted as HEARD
SUM_HEARD, SUM_ARRIVED, SUM_TURNED, SUM_FACING = 0, 3, 6, 9
SUMS = 12

ALMOST = 0.9999  # of a cosine of normals whose sum has been rounded

# of who hears: 1 / the change at which it hears no more; the change by turning; 1 / (cones squared) where it does not
NARROW, TURN, FALLOFF = range(3)
TERMS = 3


def _square(x: Term, y: Term, z: Term) -> Term:
    return (x * x).plus_product(y, y).plus_product(z, z)


def _rows(t: Terms, data, eight, one):
    """(theirs, its): what reads a row of eight values from offset `eight` on, and one value from `one` on, splat."""
    b = t.builder

    def at(base, row: int):
        return b.add(base, ir.Constant(_i64, row * WIDTH))

    def theirs(row: int) -> Term:
        return Term(b, _load(b, data, at(eight, row)))

    def its(row: int) -> Term:
        return t.splat(b.load(b.gep(data, [at(one, row)])))

    return theirs, its


@intrinsic
def hearing(typingctx, bounds, group, own, terms):
    """Bit mask of the eights 8 group..8 group + 7 of which one may hear something that lies in `own`'s bounds.

    bounds: address of float32, BOUND_FLOATS a group; own: number of an eight; terms: address of float32, NARROW to
    FALLOFF, of the row in `own` that hears most.
    """
    i, u = types.int64, types.uint64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, term = t.pointer(args[0]), t.pointer(args[3])
        base = builder.mul(args[1], ir.Constant(_i64, BOUND_FLOATS))
        shift = builder.lshr(args[2], ir.Constant(_i64, 3))
        lane = builder.and_(args[2], ir.Constant(_i64, WIDTH - 1))
        mine = builder.add(builder.mul(shift, ir.Constant(_i64, BOUND_FLOATS)), lane)

        theirs, its = _rows(t, data, base, mine)

        def gap(column):
            high, low = BOUNDED + column, column
            return (theirs(low) - its(high)).at_least(its(low) - theirs(high)).at_least(0.0)

        def product(column):
            a, b, c, d = its(column), its(BOUNDED + column), theirs(column), theirs(BOUNDED + column)
            return (a * c).at_least(a * d).at_least((b * c).at_least(b * d))

        facing = (product(FACING) + product(FACING + 1)) + product(FACING + 2)
        near = its(NEARNESS).at_least(theirs(NEARNESS))
        moved = _square(*(gap(PLACE + c) for c in range(3))).sqrt() * near
        turned = (t.constant(ALMOST) - facing).at_least(0.0).sqrt()
        change = (moved + gap(ANGLE)).plus_product(turned, t.broadcast(term, TURN)) * t.broadcast(
            term, NARROW
        )
        x, y = gap(AT_X), gap(AT_Y)
        apart = (x * x).plus_product(y, y) * t.broadcast(term, FALLOFF)
        return t.bits(builder.and_(change < 1.0, apart < 1.0))

    return i(u, i, i, u), codegen


@intrinsic
def hear_eight(typingctx, rows, eight, own, lane, terms, itself, sums):
    """Add to sums what the row `lane` of the eight `own` hears of the rows of an eight.

    rows: address of float32, LANE_FLOATS an eight; terms: address of float32, NARROW to FALLOFF, of the row; itself:
    mask of the row, which it hears whole; sums: address of SUMS rows of eight float32.
    """
    i, u = types.int64, types.uint64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, term, out = t.pointer(args[0]), t.pointer(args[4]), t.pointer(args[6])
        base, mine = (builder.mul(eight, ir.Constant(_i64, LANE_FLOATS)) for eight in args[1:3])
        theirs, its = _rows(t, data, base, builder.add(mine, args[3]))

        def away(column):
            return theirs(column) - its(column)

        normal = [theirs(FACING + c) for c in range(3)]
        facing = normal[0] * its(FACING)
        facing = facing.plus_product(normal[1], its(FACING + 1)).plus_product(normal[2], its(FACING + 2))
        moved = _square(*(away(PLACE + c) for c in range(3)))
        near = its(NEARNESS).at_least(theirs(NEARNESS))
        turned = (t.constant(1.0) - facing).at_least(0.0)
        turn, narrow = t.broadcast(term, TURN), t.broadcast(term, NARROW)
        x, y = away(AT_X), away(AT_Y)
        one = t.constant(1.0)
        apart = one - (x * x).plus_product(y, y) * t.broadcast(term, FALLOFF)
        # few are heard: roots are taken where neither part of the change alone is too much
        square = narrow * narrow
        parts = (moved * near * near * square).at_least(turned * turn * turn * square)
        same = builder.bitcast(builder.trunc(args[5], ir.IntType(WIDTH)), _mask)
        heard = builder.or_(builder.and_(parts < 1.0, apart > 0.0), same)

        def add(row, a, b):
            before = Term(builder, _load(builder, out, ir.Constant(_i64, row * WIDTH)))
            t.store(before.plus_product(a, b), out, row)

        with builder.if_then(builder.icmp_unsigned("!=", t.bits(heard), ir.Constant(_i64, 0))):
            change = (moved.sqrt() * near + away(ANGLE).abs()).plus_product(turned.sqrt(), turn)
            weight = one.where(same, (one - change * narrow).at_least(0.0) * apart.at_least(0.0))
            counts = [theirs(HEARD + c) for c in range(3)]
            total = weight * (counts[0] + counts[1] + counts[2])
            for c in range(3):
                add(SUM_HEARD + c, weight, counts[c])
                add(SUM_ARRIVED + c, weight, theirs(ARRIVED + c))
                add(SUM_TURNED + c, weight, theirs(TURNED + c))
                add(SUM_FACING + c, total, normal[c])
        return context.get_dummy_value()

    return types.void(u, i, i, i, u, i, u), codegen
