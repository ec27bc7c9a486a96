"""Who hears whom among fragments that share light: eights of them that are alike, and what each receives.

Light that changes fast is shared by few: of the pairs of fragments within reach of each other one in ten in the open,
one in a hundred where there are other things near. So fragments that lie, face and look alike become eights, halved
along what changes most (a k-d tree's order), and eights are compared by their bounds first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.multires.sharing.sharing_lanes import (
    ANGLE,
    AT_X,
    BOUND_FLOATS,
    BOUNDED,
    COLUMNS,
    FACING,
    FALLOFF,
    HEARD,
    LANE_FLOATS,
    NARROW,
    NEARNESS,
    SUMS,
    TERMS,
    TURN,
    hear_eight,
    hearing,
)
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.simd import WIDTH, trailing_zeros

FAR = 1e30  # bounds of nothing


class Eights(NamedTuple):
    """A table's rows in eights, those of a block of cones one after the other; the last of a block is filled up."""

    row: np.ndarray  # (E, 8) int32 of the table; -1: filled up
    block: np.ndarray  # (blocks + 1,) int32: first eights of blocks, which come line by line
    lanes: np.ndarray  # (E, LANE_FLOATS) float32: the rows, by sharing_lanes
    bounds: np.ndarray  # (E / 8 + 1, BOUND_FLOATS) float32
    terms: np.ndarray  # (TERMS,) float32: what sharing_lanes reads of who hears
    sums: np.ndarray  # (SUMS, 8) float32: what one row hears, lane by lane
    address: np.ndarray  # (4,) uint64: of lanes, bounds, terms and sums


def allocate_eights(rows: int, blocks: int) -> Eights:
    """Room for so many rows of a table and blocks of cones, undefined."""
    eights, f = rows // WIDTH + blocks, np.float32
    lanes, bounds = np.empty((eights, LANE_FLOATS), f), np.empty((eights // WIDTH + 1, BOUND_FLOATS), f)
    terms, sums = np.empty(TERMS, f), np.empty((SUMS, WIDTH), f)
    address = np.array([a.ctypes.data for a in (lanes, bounds, terms, sums)], np.uint64)
    block = np.empty(blocks + 1, np.int32)
    return Eights(np.empty((eights, WIDTH), np.int32), block, lanes, bounds, terms, sums, address)


@device
def _widest(table, order, first, end, turn, cones):
    """(column, middle) of the extent of rows order[first..end] along which light changes most; -1: along none."""
    best, column, middle = np.float32(0), np.int64(-1), np.float32(0)
    near = np.float32(0)
    for k in range(first, end):
        near += table[NEARNESS, order[k]]
    near /= np.float32(end - first)
    for c in range(1, BOUNDED):
        low = high = table[c, order[first]]
        for k in range(first + 1, end):
            v = table[c, order[k]]
            low, high = min(low, v), max(high, v)
        change = high - low
        if c < FACING:
            change *= near
        elif c < ANGLE:
            change *= turn
        elif c >= AT_X:
            change *= cones
        if change > best:
            best, column, middle = change, np.int64(c), np.float32(0.5) * (low + high)
    return column, middle


@device
def _divide(table, order, first, end, column, middle):
    """Order the rows order[first..end] so that the first of them are those below `middle`, but for whole eights.

    Returns where the others begin.
    """
    i, k = first, end - 1
    while i <= k:
        if table[column, order[i]] < middle:
            i += 1
        else:
            order[i], order[k] = order[k], order[i]
            k -= 1
    cut = first + max((i - first + WIDTH // 2) // WIDTH, 1) * WIDTH
    cut = min(cut, first + (end - first - 1) // WIDTH * WIDTH)
    while i != cut:  # the nearest to the middle change sides
        best = i if i < cut else first
        for k in range(i, end) if i < cut else range(first, i):
            nearer = table[column, order[k]] < table[column, order[best]]
            if nearer == (i < cut):
                best = k
        if i < cut:
            order[best], order[i] = order[i], order[best]
            i += 1
        else:
            i -= 1
            order[best], order[i] = order[i], order[best]
    return cut


@device
def _put_alike_together(table, order, first, end, turn, cones, stack):
    """Order order[first..end] as the leaves of a k-d tree of these rows come, eights but for the last."""
    stack[0], top = end, 1
    while top > 0:
        end = np.int64(stack[top - 1])
        column = np.int64(-1)
        if end - first > WIDTH:
            column, middle = _widest(table, order, first, end, turn, cones)
        if column < 0:
            first = end
            top -= 1
        else:
            stack[top] = _divide(table, order, first, end, column, middle)
            top += 1


@device
def _fill(table, order, first, end, number, eights):
    """The eight `number` is of the rows order[first..end] of a table."""
    lanes, group, lane = eights.lanes, number // WIDTH, number % WIDTH
    for k in range(WIDTH):
        there = first + k < end
        row = order[min(first + k, end - 1)]
        eights.row[number, k] = row if there else -1
        for c in range(COLUMNS):
            lanes[number, c * WIDTH + k] = table[c, row] if there or c < HEARD else np.float32(0)
    for c in range(BOUNDED):
        low = high = lanes[number, c * WIDTH]
        for k in range(1, WIDTH):
            v = lanes[number, c * WIDTH + k]
            low, high = min(low, v), max(high, v)
        eights.bounds[group, c * WIDTH + lane] = low
        eights.bounds[group, (BOUNDED + c) * WIDTH + lane] = high


@uncounted
def gather_eights(table, begin, side, turn, cones, order, stack, eights):
    """Fill `eights` with the rows of a table (COLUMNS, F), in blocks of side x side cones.

    begin (rows, columns + 1) int32: first rows of cones; turn, cones: by how much light changes as a normal turns by 1,
    and from cone to cone. order (F,) int32 and stack (F,) int32 to work in.
    """
    rows, columns = begin.shape[0], begin.shape[1] - 1
    number, b = np.int64(0), np.int64(0)
    for j in range(0, rows, side):
        for i in range(0, columns, side):
            eights.block[b] = number
            b += 1
            n = np.int64(0)
            for q in range(j, min(j + side, rows)):
                for s in range(begin[q, i], begin[q, min(i + side, columns)]):
                    order[n] = s
                    n += 1
            if n > 0:
                _put_alike_together(table, order, np.int64(0), n, turn, cones, stack)
            for first in range(0, n, WIDTH):
                _fill(table, order, first, min(first + WIDTH, n), number, eights)
                number += 1
    eights.block[b] = number
    group, lane = number // WIDTH, number % WIDTH
    for k in range(lane, WIDTH):
        for c in range(BOUNDED):
            eights.bounds[group, c * WIDTH + k] = np.float32(FAR)
            eights.bounds[group, (BOUNDED + c) * WIDTH + k] = np.float32(-FAR)


@device
def _heard_by(eights, own, first, end, heard, n):
    """Append those of the eights first..end that `own` may hear to heard (E,) int32; returns its new length."""
    bounds, terms = eights.address[1], eights.address[2]
    for group in range(first // WIDTH, (end + WIDTH - 1) // WIDTH):
        mask = hearing(bounds, group, own, terms)
        at = group * WIDTH
        while mask != 0:
            number = at + trailing_zeros(mask)
            mask &= mask - 1
            if first <= number < end:
                heard[n] = number
                n += 1
    return n


@device
def _narrow(change):
    return np.float32(1) / max(change, np.float32(1e-12))


@uncounted
def hear_all(eights, across, turn, falloff, error, heard, received):
    """received (SUMS, F) float32: what the rows of a table receive together.

    across: blocks in a line; falloff: 1 / (cones squared) at which nobody hears, a block's side at most; error: at how
    much change, of what arrives from a hemisphere, sharing ends; heard (E,) int32 to work in.
    """
    block, terms, sums = eights.block, eights.terms, eights.sums
    rows, of, out = eights.address[0], eights.address[2], eights.address[3]
    down = (len(block) - 1) // across
    terms[TURN], terms[FALLOFF] = turn, falloff
    for j in range(down):
        for i in range(across):
            left, right = max(i - 1, 0), min(i + 2, across)
            for own in range(block[j * across + i], block[j * across + i + 1]):
                widest = np.float32(0)
                for k in range(WIDTH):
                    widest = max(widest, eights.lanes[own, ANGLE * WIDTH + k])
                terms[NARROW] = _narrow(error * widest)
                n = np.int64(0)
                for q in range(max(j - 1, 0), min(j + 2, down)):
                    first, end = np.int64(block[q * across + left]), np.int64(block[q * across + right])
                    n = _heard_by(eights, np.int64(own), first, end, heard, n)
                for k in range(WIDTH):
                    row = np.int64(eights.row[own, k])
                    if row < 0:
                        break
                    sums[:] = np.float32(0)
                    terms[NARROW] = _narrow(error * eights.lanes[own, ANGLE * WIDTH + k])
                    for h in range(n):
                        number = np.int64(heard[h])
                        itself = np.int64(1) << k if number == own else np.int64(0)
                        hear_eight(rows, number, np.int64(own), np.int64(k), of, itself, out)
                    for c in range(SUMS):
                        total = np.float32(0)
                        for lane in range(WIDTH):
                            total += sums[c, lane]
                        received[c, row] = total


def receive(table, begin, reach: int, turn, error, received) -> None:
    """Fill received (SUMS, F) float32 with what the rows of a table (COLUMNS, F) float32 receive of each other.

    begin (rows, columns + 1) int32: first rows of cones; reach: cones within which they hear each other; turn, error:
    of what arrives from a hemisphere, how much changes with the root of 1 less the cosine of normals, and at how much
    change sharing ends.
    """
    rows, lines, columns = table.shape[1], len(begin), begin.shape[1] - 1
    side = reach + 1  # what is two blocks away is not heard
    across, down = -(-columns // side), -(-lines // side)
    eights = allocate_eights(rows, across * down)
    work = np.empty((2, rows), np.int32)
    # a normal that turns by x is off by x / root 2 in the root of 1 less the cosine
    by_turn, by_cone = np.float32(turn / math.sqrt(2.0)), np.float32(error / side)
    gather_eights(table, begin, np.int64(side), by_turn, by_cone, *work, eights)
    heard = np.empty(len(eights.row), np.int32)
    hear_all(eights, np.int64(across), turn, np.float32(1.0 / side**2), error, heard, received)
