"""Builds stadium.blend: 16,416 football fans of about 6,400 triangles each, 105 million triangles.

    .venv/bin/python scenes_blend/build_stadium.py [FOLDER]

Eight figures, placed on the seats by geometry nodes: native instances, with colours from Object Info's Random.
"""

from __future__ import annotations

import bpy
import numpy as np
from parts import (
    Nodes,
    add,
    camera,
    collection,
    grid_faces,
    image,
    lathe,
    material,
    mesh,
    new_scene,
    save,
    target_folder,
)
from plants import scatter, tube

ROWS, SECTORS, SEATS = 27, 32, 19  # 27 rows of 32 sectors of 19 seats: 16,416
DEEP, RISE, GANGWAY = 0.82, 0.50, 12  # of a row, in metres; the row behind the gangway
CORE_X, CORE_Y, FRONT = (
    42.0,
    24.0,
    20.0,
)  # the bowl: a rectangle's half sides, and how far from it the first row is
REFERENCE = 24.0  # distance at which seats are evenly spaced


# The bowl


def bowl(t, out):
    """(position (N, 2), inward direction (N, 2)) at fractions t of the round, `out` metres from the core rectangle."""
    t, out = np.broadcast_arrays(np.asarray(t, float) % 1, np.asarray(out, float))
    corner = REFERENCE * np.pi / 2
    # starting in the middle of the +x end: half an end, a corner, a side, a corner, an end, ...
    lengths = np.array([CORE_Y, corner, 2 * CORE_X, corner, 2 * CORE_Y, corner, 2 * CORE_X, corner, CORE_Y])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    s = t * starts[-1]
    k = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, 8)
    f = (s - starts[k]) / lengths[k]
    begin = np.array([(CORE_X, 0), (CORE_X, CORE_Y), (CORE_X, CORE_Y), (-CORE_X, CORE_Y), (-CORE_X, CORE_Y),
                      (-CORE_X, -CORE_Y), (-CORE_X, -CORE_Y), (CORE_X, -CORE_Y), (CORE_X, -CORE_Y)])  # fmt: skip
    end = np.roll(begin, -1, axis=0)
    end[8] = (CORE_X, 0)
    end[[1, 3, 5, 7]] = begin[[1, 3, 5, 7]]
    angle = np.array([0, 0, 1, 1, 2, 2, 3, 3, 4])[k] * np.pi / 2 + np.where(k % 2 == 1, f, 0) * np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    return begin[k] + f[..., None] * (end[k] - begin[k]) + normal * out[..., None], -normal


def row_floor(row):
    """(distance from the core, height) of a row's floor, at the feet."""
    row = np.asarray(row, float)
    behind = row >= GANGWAY
    return FRONT + DEEP * row + np.where(behind, 1.6, 0.0), 1.3 + RISE * row + np.where(behind, 1.1, 0.0)


def sweep(name, profile, materials, around=320, smooth=False, part=(0.0, 1.0)):
    """A mesh of (out, z) points swept around the bowl."""
    closed = part == (0.0, 1.0)
    t = np.linspace(*part, around, endpoint=not closed)
    out, z = np.asarray(profile, float).T
    at, _ = bowl(t[None, :], out[:, None])
    points = np.concatenate([at, np.broadcast_to(z[:, None, None], (*at.shape[:2], 1))], -1)
    faces = grid_faces(len(out), around, wrap=closed)
    u, v = np.meshgrid(t, np.linspace(0, 1, len(out)))
    return mesh(name, points.reshape(-1, 3), faces, materials, np.stack([u, v], -1).reshape(-1, 2), smooth)


# People


def ellipsoid(center, radii, around, along, low=0.0):
    """(positions, quads) of an ellipsoid, or of its part above the fraction `low` of its height."""
    polar = np.linspace(np.pi * (1 - low) - 1e-3, 1e-3, along + 1)
    a = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.sin(polar)[:, None] * np.cos(a), np.sin(polar)[:, None] * np.sin(a),
                     np.cos(polar)[:, None] + 0 * a], -1)  # fmt: skip
    return (ring * radii + center).reshape(-1, 3), grid_faces(along + 1, around, wrap=True)


def limb(points, radii, sides=16, steps=6):
    """A tube along joints, with rounded bends and ends."""
    points, radii = np.asarray(points, float), np.asarray(radii, float)
    t = np.linspace(0, len(points) - 1, steps * (len(points) - 1) + 1)
    path = np.stack([np.interp(t, np.arange(len(points)), points[:, i]) for i in range(3)], 1)
    soft = path.copy()
    soft[1:-1] = (path[:-2] + 2 * path[1:-1] + path[2:]) / 4
    r = np.interp(t, np.arange(len(points)), radii)
    first, last = soft[0] - soft[1], soft[-1] - soft[-2]
    first, last = first / np.linalg.norm(first), last / np.linalg.norm(last)
    soft = np.concatenate([[soft[0] + first * r[0] * 0.6], soft, [soft[-1] + last * r[-1] * 0.6]])
    return tube(soft, np.r_[r[0] * 0.25, r, r[-1] * 0.25], sides)


SHIRT, SKIN, HAIR, TROUSERS, SHOES, SCARF = range(6)


def person(name, materials, seated, elbows, hands, lean=0.0, extra=None, cap=False) -> bpy.types.Mesh:
    """A figure facing +x, its feet at the origin. elbows, hands: two points each, for a standing figure."""
    pieces = []

    def piece(kind, made):
        pieces.append((kind, *made))

    drop = -0.42 if seated else 0.0
    hip = np.array((-0.10 if seated else 0.0, 0, 0.90 + drop))

    def up(points):  # of the trunk and what hangs on it: leaning from the hip
        p = np.asarray(points, float) + (hip[0], 0, drop)
        high = p[..., 2:] - hip[2]
        return p + np.concatenate([lean * high, 0 * high, 0 * high], -1)

    z = np.array([0.82, 0.90, 1.00, 1.12, 1.26, 1.38, 1.45, 1.485])
    wide = np.array([0.150, 0.172, 0.160, 0.158, 0.185, 0.198, 0.150, 0.060])
    thick = np.array([0.105, 0.122, 0.112, 0.112, 0.128, 0.115, 0.085, 0.058])
    a = 2 * np.pi * np.arange(26) / 26
    fine = np.linspace(0, 7, 20)
    height = np.interp(fine, np.arange(8), z)
    ring = np.stack([np.interp(fine, np.arange(8), thick)[:, None] * np.cos(a),
                     np.interp(fine, np.arange(8), wide)[:, None] * np.sin(a), height[:, None] + 0 * a], -1)  # fmt: skip
    piece(SHIRT, (up(ring).reshape(-1, 3), grid_faces(20, 26, wrap=True)))
    piece(SKIN, limb(up([(0, 0, 1.44), (0.015, 0, 1.56)]), (0.056, 0.052), 12, 3))
    head = up((0.025, 0, 1.655))
    piece(SKIN, ellipsoid(head, (0.098, 0.078, 0.122), 28, 20))
    piece(SKIN, ellipsoid(head + (0.098, 0, -0.012), (0.020, 0.013, 0.022), 8, 4))
    for side in (-1, 1):
        piece(SKIN, ellipsoid(head + (-0.008, side * 0.078, -0.01), (0.020, 0.010, 0.030), 8, 4))
    hair = SCARF if cap else HAIR
    piece(hair, ellipsoid(head + (-0.016, 0, 0.020), (0.100, 0.087, 0.118), 28, 12, low=0.36))
    if cap:
        piece(hair, ellipsoid(head + (0.085, 0, 0.048), (0.085, 0.070, 0.010), 20, 6))
    for i, side in enumerate((-1, 1)):
        shoulder, elbow, hand = up((0, side * 0.185, 1.405)), up(elbows[i]), up(hands[i])
        middle = 0.55 * elbow + 0.45 * shoulder
        piece(SHIRT, limb([shoulder, middle, 0.9 * elbow + 0.1 * shoulder], (0.070, 0.060, 0.058), 14, 5))
        piece(SKIN, limb([0.8 * elbow + 0.2 * shoulder, elbow, hand], (0.044, 0.043, 0.030), 12, 5))
        along = (hand - elbow) / np.linalg.norm(hand - elbow)
        piece(SKIN, ellipsoid(hand + 0.05 * along, (0.042, 0.036, 0.048), 12, 8))
        knee = (hip[0] + 0.44, side * 0.12, 0.50) if seated else (0.03, side * 0.105, 0.49)
        ankle = (hip[0] + 0.42, side * 0.12, 0.09) if seated else (-0.01, side * 0.115, 0.09)
        piece(TROUSERS, limb([hip + (0, side * 0.085, -0.02), knee, ankle], (0.098, 0.066, 0.052), 16, 7))
        piece(SHOES, ellipsoid(np.array(ankle) + (0.065, 0, -0.045), (0.135, 0.050, 0.048), 16, 8))
    for kind, made in extra or ():
        piece(kind, (up(made[0]), made[1]))
    points = np.concatenate([p for _, p, _ in pieces])
    first = np.cumsum([0] + [len(p) for _, p, _ in pieces])
    faces = np.concatenate([q + n for (_, _, q), n in zip(pieces, first[:-1], strict=True)])
    index = np.concatenate([np.full(len(q), k) for k, _, q in pieces])
    return mesh(name, points, faces, materials, material_index=index)


def held_scarf():
    """A scarf between two raised hands."""
    u, v = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(0, 1, 7))
    p = np.stack([0.10 + 0.02 * np.sin(5 * u + 3 * v), 0.62 * u, 1.98 - 0.19 * v - 0.06 * (1 - u**2)], -1)
    return p.reshape(-1, 3), grid_faces(7, 33)


def held_flag():
    """A flag on a stick in the left hand, as (kind, (positions, faces)) pairs."""
    stick = limb([(0.12, 0.40, 1.75), (0.12, 0.52, 3.05)], (0.010, 0.010), 8, 4)
    u, v = np.meshgrid(np.linspace(0, 1, 25), np.linspace(0, 1, 13))
    p = np.stack(
        [0.12 + 0.09 * u * np.sin(7 * u + 2 * v), 0.515 - 1.05 * u - 0.06 * v, 3.0 - 0.72 * v - 0.10 * u**2],
        -1,
    )
    return (SHOES, stick), (SCARF, (p.reshape(-1, 3), grid_faces(13, 25)))


def figures(materials) -> bpy.types.Collection:
    """Eight poses. A collection of collections."""

    def both(x, y, z):
        return np.array([(x, -y, z), (x, y, z)])

    result = collection("Fans")
    one_up = (
        np.array([(0.06, -0.27, 1.12), (0.08, 0.34, 1.62)]),
        np.array([(0.30, -0.16, 1.10), (0.12, 0.40, 1.84)]),
    )
    poses = {
        "arms up": dict(seated=False, elbows=both(0.06, 0.34, 1.62), hands=both(0.10, 0.43, 1.88)),
        "clapping": dict(
            seated=False, elbows=both(0.14, 0.29, 1.16), hands=both(0.38, 0.05, 1.30), lean=0.05
        ),
        "scarf": dict(
            seated=False,
            elbows=both(0.08, 0.34, 1.66),
            hands=both(0.10, 0.40, 1.93),
            extra=[(SCARF, held_scarf())],
        ),
        "watching": dict(
            seated=False, elbows=both(-0.04, 0.27, 1.12), hands=both(0.07, 0.25, 0.90), lean=0.03
        ),
        "sitting": dict(seated=True, elbows=both(0.06, 0.28, 1.14), hands=both(0.30, 0.13, 1.00), lean=0.10),
        "sitting with a cap": dict(
            seated=True, elbows=both(0.12, 0.24, 1.12), hands=both(0.32, 0.06, 1.20), lean=0.22, cap=True
        ),
        "flag": dict(seated=False, elbows=one_up[0], hands=one_up[1], extra=held_flag()),
        "fist": dict(seated=False, elbows=one_up[0], hands=one_up[1], lean=0.08, cap=True),
    }
    for name, pose in poses.items():
        c = collection(f"Fan {name}", result)
        add(c.name, person(c.name, materials, **pose), c)
    return result


def people_materials():
    def chance(n, factor):
        """A random number of the instance's own, another for each factor."""
        return n.math("FRACT", n.math("MULTIPLY", n("ObjectInfo").outputs["Random"], factor))

    def pick(n, factor, *colors):
        stops = [(i / len(colors), c) for i, c in enumerate(colors)]
        return n.ramp(chance(n, factor), *stops, interpolation="CONSTANT")

    def teams(n, factor, home, away):
        side = n("Attribute", attribute_type="INSTANCER", attribute_name="away").outputs["Fac"]
        return n.mix(side, pick(n, factor, *home), pick(n, factor, *away))

    red, wine, white, cream = (
        (0.55, 0.012, 0.018),
        (0.30, 0.008, 0.02),
        (0.74, 0.73, 0.70),
        (0.62, 0.55, 0.42),
    )
    blue, navy, sky, sun = (0.015, 0.07, 0.46), (0.012, 0.025, 0.13), (0.16, 0.42, 0.74), (0.78, 0.52, 0.03)
    black, grey, denim = (0.015, 0.015, 0.017), (0.15, 0.155, 0.165), (0.035, 0.06, 0.13)
    home = (red, red, white, red, wine, black, red, denim, red, cream, red, grey)
    away = (blue, blue, sun, blue, navy, sky, blue, white)
    skins = (
        (0.62, 0.36, 0.25),
        (0.52, 0.28, 0.18),
        (0.40, 0.20, 0.12),
        (0.66, 0.42, 0.32),
        (0.20, 0.09, 0.05),
        (0.09, 0.04, 0.025),
    )
    hairs = (
        (0.02, 0.012, 0.008),
        (0.06, 0.03, 0.014),
        (0.16, 0.085, 0.03),
        (0.38, 0.25, 0.10),
        (0.01, 0.01, 0.01),
        (0.35, 0.34, 0.33),
    )

    def cloth(name, build, roughness=0.8):
        return material(
            name, lambda n: {"base_color": build(n)}, roughness=roughness, specular_ior_level=0.25
        )

    def thin(n, color):
        return n("MixShader", 0.45, n("BsdfDiffuse", color), n("BsdfTranslucent", color))

    return [
        cloth("Shirt", lambda n: teams(n, 1.0, home, away)),
        cloth("Skin", lambda n: pick(n, 17.3, *skins), 0.5),
        cloth("Hair", lambda n: pick(n, 31.7, *hairs), 0.6),
        cloth("Trousers", lambda n: pick(n, 7.9, denim, black, denim, grey, navy, (0.20, 0.15, 0.09))),
        cloth("Shoes", lambda n: pick(n, 5.3, black, white, grey, wine)),
        material("Scarf", lambda n: thin(n, teams(n, 11.1, (red, white, red, wine), (blue, sun, sky)))),
    ]


def crowd(fans) -> None:
    rng = np.random.default_rng(16416)
    row, sector, seat = (
        v.ravel() for v in np.meshgrid(range(ROWS), range(SECTORS), range(SEATS), indexing="ij")
    )
    n = len(row)
    t = (sector + 0.035 + 0.93 * (seat + 0.5) / SEATS) / SECTORS
    t += rng.normal(0, 0.00006, n)
    out, z = row_floor(row)
    at, inward = bowl(t, out + 0.30 + rng.normal(0, 0.025, n))
    turn = np.arctan2(inward[:, 1], inward[:, 0]) + rng.normal(0, 0.16, n)
    away = ((t > 0.565) & (t < 0.69)).astype(float)  # the visitors' blocks
    # whole blocks rise together; a few hold flags
    mood = (
        np.sin(2 * np.pi * 5 * t + 1.0) + 0.5 * np.sin(2 * np.pi * 13 * t + 0.2 * row) + rng.normal(0, 0.7, n)
    )
    lively, calm = (
        rng.choice([0, 1, 2, 7, 3], n, p=(0.33, 0.22, 0.19, 0.16, 0.10)),
        rng.choice([3, 4, 5, 1], n, p=(0.15, 0.5, 0.25, 0.1)),
    )
    pose = np.where(mood > -0.15, lively, calm)
    pose[(rng.random(n) < 0.02) & (row > 4)] = 6
    order = [
        "Fan arms up",
        "Fan clapping",
        "Fan scarf",
        "Fan watching",
        "Fan sitting",
        "Fan sitting with a cap",
        "Fan flag",
        "Fan fist",
    ]
    index = np.argsort(np.argsort(order))[pose]
    p = np.round(np.c_[at, z] * 64) / 64
    euler = np.round(np.c_[np.zeros((n, 2)), turn] * 64) / 64
    ob = scatter("Crowd", None, fans, p, euler, rng.integers(59, 68, n) / 64, index, native=True)
    stored = ob.data.attributes.new("away", "FLOAT", "POINT")
    stored.data.foreach_set("value", away.astype(np.float32))


# The ground


def pitch() -> None:
    def build(n):
        at = n("SeparateXYZ", n("TexCoord").outputs["Object"])
        stripe = n.math(
            "GREATER_THAN",
            n.math("FRACT", n.math("DIVIDE", n.math("ADD", at.outputs["X"], 57.75), 10.5)),
            0.5,
        )
        other = n.math(
            "GREATER_THAN", n.math("FRACT", n.math("DIVIDE", n.math("ADD", at.outputs["Y"], 51.0), 17.0)), 0.5
        )
        fine = n("TexNoise", vector=n("TexCoord").outputs["Object"], scale=1.4, detail=6, roughness=0.7)
        tone = n.math(
            "ADD",
            n.math("MULTIPLY", stripe, 0.30),
            n.math("MULTIPLY_ADD", other, 0.10, n.math("MULTIPLY", fine, 0.6)),
        )
        return {"base_color": n.ramp(tone, (0.22, (0.030, 0.105, 0.018)), (0.75, (0.075, 0.20, 0.034)))}

    grass = material("Grass", build, roughness=0.85, specular_ior_level=0.2)
    x, y = np.meshgrid([-58.5, 58.5], [-39.5, 39.5])
    p = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    add("Pitch", mesh("Pitch", p, grid_faces(2, 2), [grass], smooth=False))
    points, faces = [], []

    def stroke(path, closed=False):
        path = np.asarray(path, float)
        ahead = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
        side = np.stack([-ahead[:, 1], ahead[:, 0]], 1) / np.linalg.norm(ahead, axis=1)[:, None] * 0.07
        first = sum(map(len, points))
        points.append(
            np.concatenate(
                [np.c_[path + side, np.full(len(path), 0.012)], np.c_[path - side, np.full(len(path), 0.012)]]
            )
        )
        faces.append(grid_faces(2, len(path), wrap=closed)[:, ::-1] + first)

    def line(*ends):
        for a, b in zip(ends[:-1], ends[1:], strict=True):
            a, b = np.array(a, float), np.array(b, float)
            d = 0.07 * (b - a) / np.linalg.norm(b - a)
            stroke([a - d, b + d])

    def arc(x, y, r, start, stop):
        a = np.linspace(start, stop, 64)
        stroke(np.stack([x + r * np.cos(a), y + r * np.sin(a)], 1))

    line((-52.5, -34), (52.5, -34), (52.5, 34), (-52.5, 34), (-52.5, -34))
    line((0, -34), (0, 34))
    arc(0, 0, 9.15, 0, 2 * np.pi)
    arc(0, 0, 0.12, 0, 2 * np.pi)
    for s in (-1, 1):
        line((52.5 * s, -20.16), (36 * s, -20.16), (36 * s, 20.16), (52.5 * s, 20.16))
        line((52.5 * s, -9.16), (47 * s, -9.16), (47 * s, 9.16), (52.5 * s, 9.16))
        arc(41.5 * s, 0, 0.12, 0, 2 * np.pi)
        half = np.arccos(5.5 / 9.15)
        turn = np.pi if s > 0 else 0
        arc(41.5 * s, 0, 9.15, turn - half, turn + half)
    chalk = material("Chalk", base_color=(0.8, 0.8, 0.8), roughness=0.9)
    add("Lines", mesh("Lines", np.concatenate(points), np.concatenate(faces), [chalk], smooth=False))
    posts, net = (
        material("Posts", base_color=(0.85, 0.85, 0.85), roughness=0.3),
        material("Net", base_color=(0.7, 0.7, 0.7)),
    )
    for s in (-1, 1):
        g = 52.5 * s
        frame = [(g, -3.66, 0), (g, -3.66, 2.44), (g, 3.66, 2.44), (g, 3.66, 0)]
        pieces = [
            tube(np.array([a, b], float), np.full(2, 0.06), 10)
            for a, b in zip(frame[:-1], frame[1:], strict=True)
        ]
        back = g + 1.9 * s
        for w in np.linspace(-3.66, 3.66, 30):
            pieces.append(
                tube(np.array([(g, w, 2.44), (g + 0.9 * s, w, 2.35), (back, w, 0)]), np.full(3, 0.012), 3)
            )
        for f in np.linspace(0.1, 1.0, 11):
            pieces.append(
                tube(
                    np.array(
                        [
                            (g + s * (0.9 + f), -3.66, 2.35 * (1 - f)),
                            (g + s * (0.9 + f), 3.66, 2.35 * (1 - f)),
                        ]
                    ),
                    np.full(2, 0.012),
                    3,
                )
            )
        p = np.concatenate([q for q, _ in pieces])
        first = np.cumsum([0] + [len(q) for q, _ in pieces])
        f = np.concatenate([q + n for (_, q), n in zip(pieces, first[:-1], strict=True)])
        index = np.concatenate([np.full(len(q), int(i > 2)) for i, (_, q) in enumerate(pieces)])
        add(f"Goal {s}", mesh(f"Goal {s}", p, f, [posts, net], material_index=index))


def players(fans) -> None:
    """Two elevens, the referee and the ball."""
    rng = np.random.default_rng(11)
    home = [
        (-50, 0),
        (-30, -18),
        (-33, -6),
        (-33, 7),
        (-29, 19),
        (-12, -10),
        (-15, 3),
        (-8, 15),
        (6, -14),
        (11, 2),
        (7, 17),
    ]
    away = [
        (50, 1),
        (31, -17),
        (34, -5),
        (33, 6),
        (30, 18),
        (17, -12),
        (20, 0),
        (16, 12),
        (-4, -8),
        (-3, 7),
        (9, 5),
    ]
    at = np.array(home + away + [(2, -3)], float) + rng.normal(0, 1.2, (23, 2))
    ball = np.array((8.5, 3.4))
    turn = np.arctan2(ball[1] - at[:, 1], ball[0] - at[:, 0])
    shirts = [material("Home kit", base_color=(0.60, 0.012, 0.02), roughness=0.7), material("Away kit", base_color=(0.02, 0.09, 0.55), roughness=0.7),
              material("Referee's kit", base_color=(0.02, 0.02, 0.02), roughness=0.7)]  # fmt: skip
    data = bpy.data.objects["Fan watching"].data
    for i, (p, a) in enumerate(zip(at, turn, strict=True)):
        ob = add(f"Player {i + 1}", data, location=(*p, 0), rotation=(0, 0.05, a))
        team = 2 if i == 22 else i // 11
        for slot, m in ((SHIRT, shirts[team]), (TROUSERS, shirts[team])):
            ob.material_slots[slot].link = "OBJECT"
            ob.material_slots[slot].material = m
    shape = [(0.11 * np.sin(a), 0.11 - 0.11 * np.cos(a)) for a in np.linspace(0, np.pi, 9)]
    add(
        "Ball",
        lathe("Ball", shape, [material("Ball", base_color=(0.85, 0.85, 0.82), roughness=0.3)], 24),
        location=(*ball, 0),
    )


def advertisement(width=1024, height=64) -> np.ndarray:
    """Boards around the pitch."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("RGB", (width, height), (12, 14, 22))
    draw = ImageDraw.Draw(picture)
    words = (("PointMR", (244, 240, 230), (160, 16, 24)), ("105 MILLION TRIANGLES", (250, 206, 40), (16, 22, 60)),
             ("surfels united", (20, 30, 40), (226, 226, 214)), ("RAYS & CONES", (240, 240, 240), (14, 92, 62)))  # fmt: skip
    x = 0
    for (text, ink, ground), share in zip(words, (0.20, 0.36, 0.22, 0.22), strict=True):
        w = int(width * share)
        draw.rectangle((x, 0, x + w, height), fill=ground)
        draw.text((x + w / 2, height / 2), text, fill=ink, font=ImageFont.load_default(34), anchor="mm")
        x += w
    return np.asarray(picture, float) / 255


def stands() -> None:
    concrete = material("Concrete", lambda n: {"base_color": n.ramp(
        n("TexNoise", vector=n("TexCoord").outputs["Object"], scale=0.8, detail=6, roughness=0.7),
        (0.35, (0.16, 0.155, 0.15)), (0.65, (0.30, 0.29, 0.28)))}, roughness=0.85)  # fmt: skip
    seats = material("Seats", base_color=(0.34, 0.02, 0.03), roughness=0.4)
    steel = material("White steel", base_color=(0.72, 0.73, 0.75), roughness=0.4)
    profile = [(FRONT - 0.9, 0.0), (FRONT - 0.9, 1.3 + 0.9), (FRONT - 0.75, 1.3 + 0.9), (FRONT - 0.75, 1.3)]
    for row in range(ROWS):
        out, z = row_floor(row)
        if row:
            profile.append((out - 0.1, profile[-1][1]))
        profile += [(out - 0.1, float(z))]
    top_out, top = profile[-1][0] + 1.2, profile[-1][1]
    profile += [(top_out, top), (top_out, top + 1.6), (top_out + 0.3, top + 1.6), (top_out + 0.3, 0)]
    add("Terraces", sweep("Terraces", profile, [concrete]))
    for row in range(ROWS):  # a bench for each row
        out, z = row_floor(row)
        bench = [
            (out + 0.05, z + 0.40),
            (out + 0.06, z + 0.44),
            (out + 0.46, z + 0.42),
            (out + 0.56, z + 0.80),
            (out + 0.60, z + 0.80),
            (out + 0.50, z + 0.38),
        ]
        add(f"Bench {row}", sweep(f"Bench {row}", bench, [seats], 160))

    boards = material("Boards", lambda n: {"base_color": n("TexImage", vector=n("Mapping", vector=n("TexCoord").outputs["UV"], scale=(10, 1, 1)),
                                                            image=image("boards", advertisement()))}, roughness=0.3)  # fmt: skip
    add("Boards", sweep("Boards", [(FRONT - 3.2, 1.0), (FRONT - 3.0, 0.02)], [boards], 240))
    track = material("Track", base_color=(0.13, 0.15, 0.16), roughness=0.8)
    add("Track", sweep("Track", [(8.0, -0.02), (FRONT - 0.8, -0.02)], [track], 160))

    # The roof, open over the pitch, with trusses and columns
    sheet = material(
        "Roof",
        lambda n: n(
            "MixShader", 0.35, n("BsdfDiffuse", (0.70, 0.70, 0.70)), n("BsdfTranslucent", (0.75, 0.74, 0.70))
        ),
    )
    inner, outer = FRONT + 9, top_out + 3
    add("Roof", sweep("Roof", [(outer, top + 7.5), (inner, top + 10.5)], [sheet], 192))
    add(
        "Roof edge",
        sweep(
            "Roof edge", [(inner, top + 10.6), (inner - 0.25, top + 10.4), (inner, top + 9.7)], [steel], 192
        ),
    )
    pieces = []
    for k in range(48):
        t = (k + 0.5) / 48

        def at(out, z, t=t):
            return np.r_[bowl(t, out)[0], z]

        upper = np.array(
            [at(o, top + 7.4 + 3.0 * (outer - o) / (outer - inner)) for o in np.linspace(outer, inner, 9)]
        )
        lower = np.array(
            [
                at(o, top + 7.4 + 3.0 * f - 1.9 * np.sin(np.pi * (0.15 + 0.85 * f)))
                for o, f in zip(np.linspace(outer, inner, 9), np.linspace(0, 1, 9), strict=True)
            ]
        )
        pieces += [tube(upper, np.full(9, 0.11), 8), tube(lower, np.full(9, 0.11), 8)]
        for i in range(8):
            pieces.append(tube(np.array([upper[i], lower[i + 1]]), np.full(2, 0.05), 6))
            pieces.append(tube(np.array([lower[i], upper[i]]), np.full(2, 0.05), 6))
        pieces.append(tube(np.array([at(outer, 0), at(outer, top + 7.5)]), np.full(2, 0.28), 12))
    p = np.concatenate([q for q, _ in pieces])
    first = np.cumsum([0] + [len(q) for q, _ in pieces])
    add(
        "Trusses",
        mesh(
            "Trusses",
            p,
            np.concatenate([q + n for (_, q), n in zip(pieces, first[:-1], strict=True)]),
            [steel],
        ),
    )
    ground = material("Ground", base_color=(0.10, 0.10, 0.095), roughness=0.9)
    a = 2 * np.pi * np.arange(48) / 48
    add(
        "Ground",
        mesh(
            "Ground",
            np.stack([900 * np.cos(a), 900 * np.sin(a), np.full(48, -0.05)], 1),
            [range(48)],
            [ground],
            smooth=False,
        ),
    )


def sky() -> bpy.types.World:
    world = bpy.data.worlds.new("Sky")
    n = Nodes(world)
    parts = n("SeparateXYZ", n("TexCoord").outputs["Generated"])
    z = parts.outputs["Z"]
    blue = n.ramp(
        z,
        (0.0, (0.78, 0.80, 0.84)),
        (0.15, (0.45, 0.60, 0.86)),
        (0.45, (0.20, 0.38, 0.78)),
        (1.0, (0.10, 0.24, 0.62)),
    )
    over = n.math("ADD", n.math("MAXIMUM", z, 0.0), 0.12)
    plane = n(
        "CombineXYZ",
        n.math("DIVIDE", parts.outputs["X"], over),
        n.math("DIVIDE", parts.outputs["Y"], over),
        0.0,
    )
    puffs = n("TexNoise", vector=plane, scale=1.3, detail=7, roughness=0.55)
    cover = n.math(
        "MULTIPLY", n("MapRange", puffs, 0.50, 0.68).outputs[0], n("MapRange", z, 0.02, 0.2).outputs[0]
    )
    color = n.mix(cover, blue, n.ramp(puffs, (0.52, (0.98, 0.96, 0.93)), (0.75, (0.70, 0.74, 0.80))))
    n.surface(
        n("Background", n.mix(n.math("LESS_THAN", z, 0.0), color, (0.12, 0.12, 0.11)), 0.9), "OutputWorld"
    )
    return world


def build() -> None:
    scene = new_scene()
    fans = figures(people_materials())
    crowd(fans)
    pitch()
    players(fans)
    stands()
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.color, lamp.angle = 5.0, (1.0, 0.90, 0.74), np.radians(0.6)
    add("Sun", lamp, rotation=(np.radians(48), 0, np.radians(140)))
    scene.world = sky()
    t, row = 0.842, 15
    out, z = row_floor(row)
    at, inward = bowl(t, out)
    eye = (*at, float(z) + 2.35)
    camera("Camera", eye, (-17.0, 2.5, 0.0), 26)
    scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", 32
    scene.pointmr.max_bounces = 3
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 0.6


if __name__ == "__main__":
    build()
    print(save("stadium.blend", target_folder()))
