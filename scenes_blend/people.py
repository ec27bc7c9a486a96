"""Football fans: figures of about 6,400 triangles in eight poses, and what they wear."""

from __future__ import annotations

import bpy
import numpy as np
from parts import add, collection, grid_faces, material, mesh
from plants import tube


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
    ring = np.stack(
        [
            np.interp(fine, np.arange(8), thick)[:, None] * np.cos(a),
            np.interp(fine, np.arange(8), wide)[:, None] * np.sin(a),
            height[:, None] + 0 * a,
        ],
        -1,
    )
    piece(SHIRT, (up(ring).reshape(-1, 3), grid_faces(20, 26, wrap=True)))
    piece(SKIN, limb(up([(0, 0, 1.44), (0.015, 0, 1.56)]), (0.056, 0.052), 12, 3))
    head = up((0.025, 0, 1.655))
    piece(SKIN, ellipsoid(head, (0.098, 0.078, 0.122), 28, 20))
    piece(SKIN, ellipsoid(head + (0.098, 0, -0.012), (0.020, 0.013, 0.022), 8, 5))
    for side in (-1, 1):
        piece(SKIN, ellipsoid(head + (-0.008, side * 0.078, -0.01), (0.020, 0.010, 0.030), 8, 5))
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
