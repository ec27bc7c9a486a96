"""Builds stadium.blend: 16,416 football fans of about 6,400 triangles each, 105 million triangles.

    .venv/bin/python scenes_blend/build_stadium.py [FOLDER]

Eight figures, placed on the seats by geometry nodes: native instances, with colours from Object Info's Random.
"""

from __future__ import annotations

import bpy
import numpy as np
from football_pitch import pitch
from parts import Nodes, add, camera, image, lathe, material, mesh, new_scene, save, target_folder
from people import SHIRT, TROUSERS, figures, people_materials
from plants import scatter, tube
from stadium_bowl import FRONT, ROWS, SEATS, SECTORS, bowl, row_floor, sweep


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
    shirts = [
        material("Home kit", base_color=(0.60, 0.012, 0.02), roughness=0.7),
        material("Away kit", base_color=(0.02, 0.09, 0.55), roughness=0.7),
        material("Referee's kit", base_color=(0.02, 0.02, 0.02), roughness=0.7),
    ]
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
    words = (
        ("PointMR", (244, 240, 230), (160, 16, 24)),
        ("105 MILLION TRIANGLES", (250, 206, 40), (16, 22, 60)),
        ("surfels united", (20, 30, 40), (226, 226, 214)),
        ("RAYS & CONES", (240, 240, 240), (14, 92, 62)),
    )
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

    boards = material(
        "Boards",
        lambda n: {
            "base_color": n(
                "TexImage",
                vector=n("Mapping", vector=n("TexCoord").outputs["UV"], scale=(10, 1, 1)),
                image=image("boards", advertisement()),
            )
        },
        roughness=0.3,
    )
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
