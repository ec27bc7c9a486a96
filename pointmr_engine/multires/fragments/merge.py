"""The A-buffer of a tile: fragments of one surface in a pixel become one, shaded once.

Fragments merge where they lie in one plane, within the pixel's footprint, and face the same way (talk: fragments of
overlapping depth are one surface). Attributes are averaged by the subpixels that each fragment is seen in, so that the
weights are true coverages; the mean normal is shorter than 1 by as much as the normals differ.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.subpixel_places import place_of
from pointmr_engine.forward.reconstruction.fragments import Fragments
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import pixel_seed

FACING = 0.94  # least cosine between the normals of fragments that merge
APART = 0.75  # footprints: farthest from each other's planes


@device
def mergeable(f: Fragments, g, k, footprint):
    """Whether fragment k continues the surface of g."""
    if f.part[g] != f.part[k]:
        return False
    ax, ay, az = np.float64(f.geometric[g, 0]), np.float64(f.geometric[g, 1]), np.float64(f.geometric[g, 2])
    bx, by, bz = np.float64(f.geometric[k, 0]), np.float64(f.geometric[k, 1]), np.float64(f.geometric[k, 2])
    if ax * bx + ay * by + az * bz < FACING:
        return False
    dx = f.position[k, 0] - f.position[g, 0]
    dy = f.position[k, 1] - f.position[g, 1]
    dz = f.position[k, 2] - f.position[g, 2]
    reach = APART * footprint
    if abs(dx * ax + dy * ay + dz * az) > reach or abs(dx * bx + dy * by + dz * bz) > reach:
        return False
    if f.triangle[g] == f.triangle[k] and f.row[g] == f.row[k]:
        return True
    # short normals stand for clumps, zero ones are looked up later: only what is alike is averaged
    a = f.normal[g, 0] ** 2 + f.normal[g, 1] ** 2 + f.normal[g, 2] ** 2
    b = f.normal[k, 0] ** 2 + f.normal[k, 1] ** 2 + f.normal[k, 2] ** 2
    return abs(a - b) < np.float32(0.25)


@device
def copy_fragment(f: Fragments, g, k):
    """Fragment g becomes what fragment k is."""
    f.entry[g], f.x[g], f.y[g], f.count[g] = f.entry[k], f.x[k], f.y[k], f.count[k]
    f.part[g], f.triangle[g], f.row[g] = f.part[k], f.triangle[k], f.row[k]
    f.place[g, 0], f.place[g, 1] = f.place[k, 0], f.place[k, 1]
    for c in range(3):
        f.position[g, c] = f.position[k, c]
        f.normal[g, c] = f.normal[k, c]
        f.geometric[g, c] = f.geometric[k, c]
        f.albedo[g, c] = f.albedo[k, c]
        f.emission[g, c] = f.emission[k, c]


@device
def rank_of(f: Fragments, k, x, y):
    """By which fragments of a cell represent others: large ones near its middle (x, y), in subpixels of the tile.

    What is read at the cell's edge makes fine textures noisy; of coarse meshes, the largest part says most of the rest.
    Small triangles are one fragment, whose place may lie in the next cell.
    """
    dx, dy = f.x[k] - x, f.y[k] - y
    return np.float32(-(dx * dx + dy * dy) / f.count[k] ** 2)


@device
def join(f: Fragments, g, k, stands):
    """Average fragment k into g. stands: k represents both from now on."""
    n, m = np.float32(f.count[g]), np.float32(f.count[k])
    s = m / (n + m)
    if stands:
        f.entry[g], f.part[g], f.triangle[g], f.row[g] = f.entry[k], f.part[k], f.triangle[k], f.row[k]
        f.place[g, 0], f.place[g, 1] = f.place[k, 0], f.place[k, 1]
    f.x[g] += s * (f.x[k] - f.x[g])
    f.y[g] += s * (f.y[k] - f.y[g])
    f.count[g] += f.count[k]
    for c in range(3):
        f.position[g, c] += s * (f.position[k, c] - f.position[g, c])
        f.normal[g, c] += s * (f.normal[k, c] - f.normal[g, c])
        f.geometric[g, c] += s * (f.geometric[k, c] - f.geometric[g, c])
        f.albedo[g, c] += s * (f.albedo[k, c] - f.albedo[g, c])
        f.emission[g, c] += s * (f.emission[k, c] - f.emission[g, c])


@uncounted
def renumber(ids, width, height, into):
    """ids of a tile: what each fragment is part of."""
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            if k >= 0:
                ids[y, x] = into[k]


@uncounted
def choose_seen(ids, width, height, left, low, shift, count, times, seen):
    """seen (F, 2) float32: where in the tile one of the subpixels that show each fragment 0..count looks, by a hash.

    shift: of subpixels.Target; times (F,) int32 to work in; left, low: the tile's first subpixel in the image.
    """
    for k in range(count):
        times[k] = 0
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            if k < 0:
                continue
            times[k] += 1
            h = pixel_seed(np.int64(left + x), np.int64(low + y), np.int64(0))
            if np.int64(h) * np.int64(times[k]) < np.int64(1) << 32:
                seen[k, 0], seen[k, 1] = place_of(shift, x, y)


@uncounted
def merge_fragments(
    ids, width, height, subpixels, perspective, pixel, fragments: Fragments, count, into, rank
):
    """Merge fragments 0..count of a tile in place; `ids` then holds the merged ones' numbers; returns how many.

    pixel: width of a pixel's footprint at depth 1 (perspective) or in metres; into (F,) int32, rank (F,) float32 to
    work in. Fragments must be numbered in the order in which the tile's pixels show them (fragments.find_fragments).
    """
    f, groups = fragments, np.int64(0)
    for k in range(count):
        into[k] = -1
    for top in range(0, height, subpixels):
        for left in range(0, width, subpixels):
            first = groups
            for y in range(top, min(top + subpixels, height)):
                for x in range(left, min(left + subpixels, width)):
                    k = np.int64(ids[y, x])
                    if k < 0 or into[k] >= 0:
                        continue
                    footprint = pixel
                    if perspective:
                        footprint = pixel * f.position[k, 2]
                    found = np.int64(-1)
                    for g in range(first, groups):
                        if mergeable(f, g, k, footprint):
                            found = g
                            break
                    own = rank_of(f, k, left + 0.5 * subpixels, top + 0.5 * subpixels)
                    if found >= 0:
                        join(f, found, k, own > rank[found])
                        rank[found] = max(own, rank[found])
                        into[k] = found
                    else:
                        if groups != k:
                            copy_fragment(f, groups, k)
                        rank[groups] = own
                        into[k] = groups
                        groups += 1
    renumber(ids, width, height, into)
    return groups


@uncounted
def thin_margin(ids, width, height, margin, cone, fragments: Fragments, count, kept, first):
    """Leave one fragment, the one seen most, of each cone in a margin that no pixel's filter reaches; returns how many.

    What lies there only tells others of its light, and one fragment of a cone tells as much as all. Of margin subpixels
    on every side, and cones with `cone` a side; kept, first (F,) int32 to work in.
    """
    f = fragments
    for k in range(count):
        kept[k], first[k] = -1, -1
    for top in range(0, height, cone):
        for left in range(0, width, cone):
            inner = margin <= left and left + cone <= width - margin
            inner = inner and margin <= top and top + cone <= height - margin
            most = np.int64(-1)
            for y in range(top, min(top + cone, height)):
                for x in range(left, min(left + cone, width)):
                    k = np.int64(ids[y, x])
                    if k < 0:
                        continue
                    if inner:
                        kept[k] = k
                    elif most < 0 or f.count[k] > f.count[most]:
                        most = k
            if most >= 0:
                kept[most] = most
                for y in range(top, min(top + cone, height)):
                    for x in range(left, min(left + cone, width)):
                        k = np.int64(ids[y, x])
                        if k >= 0 and first[k] < 0:
                            first[k] = most
    groups = np.int64(0)
    for k in range(count):
        if kept[k] == k:
            if groups != k:
                copy_fragment(f, groups, k)
            kept[k] = groups
            groups += 1
    for k in range(count):
        if kept[k] < 0 <= first[k]:
            kept[k] = kept[first[k]]
    renumber(ids, width, height, kept)
    return groups
