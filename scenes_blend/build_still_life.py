"""Builds still_life.blend: fruit, glass and brass on a table, in the light of a window.

    .venv/bin/python scenes_blend/build_still_life.py [FOLDER]

Light does not bounce between diffuse surfaces here: six panes of soft light, a dim fill and the world light the scene.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler, Vector
from parts import (
    Nodes,
    add,
    area,
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
from still_life_looks import brass, glass, label_image, linen_image, plate_image, skin, wall, wood
from still_life_shapes import (
    APPLE,
    BOTTLE,
    BOWL,
    CANDLE,
    CANDLESTICK,
    FLAME,
    GOBLET,
    JUG,
    LEMON,
    ORANGE,
    PEAR,
    WINE,
    apple_shape,
    box,
    cloth,
    spout,
    tube,
)

TABLE = 0.0  # height of the table top


def build() -> None:
    scene = new_scene()
    oak, plaster, gold = wood(), wall(), brass()
    steel = material("Silver", base_color=(0.82, 0.80, 0.77), metallic=1.0, roughness=0.16)
    stem = material("Stem", base_color=(0.07, 0.035, 0.015), roughness=0.8)
    linen = material(
        "Linen",
        lambda n: {
            "base_color": n("TexImage", image=image("linen", linen_image())),
            "normal": n(
                "Bump", strength=0.25, distance=0.001, height=n("TexImage", image=bpy.data.images["linen"])
            ),
        },
        roughness=0.85,
        sheen_weight=0.3,
        specular_ior_level=0.2,
    )
    glaze = material(
        "Glazed pattern",
        lambda n: {"base_color": n("TexImage", image=image("plate", plate_image()))},
        roughness=0.12,
        coat_weight=0.5,
        coat_roughness=0.04,
    )

    # The room
    add(
        "Table", mesh("Table", *box(1.5, 0.8, 0.045), [oak], smooth=False), location=(0, 0.12, TABLE - 0.0225)
    )
    add("Wall", mesh("Wall", *box(6, 0.1, 4), [plaster], smooth=False), location=(0, 1.15, 1))
    add("Cloth", cloth([linen]), location=(0.085, 0.035, TABLE), rotation=(0, 0, 0.0))

    # Glass
    green = glass("Green glass", (0.16, 0.42, 0.13), shadow=(0.35, 0.55, 0.28))
    clear = glass("Clear glass", shadow=(0.94, 0.94, 0.94))
    wine = glass("Red wine", (0.62, 0.02, 0.05), ior=1.34, shadow=(0.75, 0.09, 0.10))
    bottle = add("Bottle", lathe("Bottle", BOTTLE, [green], 64), location=(-0.172, 0.165, TABLE))
    u, v = np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 2))
    turned = np.stack(
        [0.0389 * np.sin(u * 2.5 - 1.25), -0.0389 * np.cos(u * 2.5 - 1.25), 0.065 + 0.072 * v], -1
    )
    paper = material(
        "Label", lambda n: {"base_color": n("TexImage", image=image("label", label_image()))}, roughness=0.7
    )
    uv = np.stack([u, v], -1).reshape(-1, 2)
    add("Label", mesh("Label", turned.reshape(-1, 3), grid_faces(2, 40), [paper], uv),
        location=bottle.location, rotation=(0, 0, 0.32))  # fmt: skip
    cork = material("Cork", lambda n: {
        "base_color": n.ramp(n("TexNoise", vector=n("TexCoord").outputs["Object"], scale=300, detail=3),
                             (0.4, (0.18, 0.09, 0.04)), (0.6, (0.42, 0.25, 0.12)))}, roughness=0.8)  # fmt: skip
    add("Cork", lathe("Cork", [(0, 0.30), (0.0104, 0.30), (0.0104, 0.30), (0.0108, 0.334), (0.0108, 0.334),
                               (0.0095, 0.336), (0, 0.336)], [cork], 32), location=bottle.location)  # fmt: skip
    glass_at = (-0.062, -0.012, TABLE)
    add("Wine glass", lathe("Wine glass", GOBLET, [clear], 64), location=glass_at)
    add("Wine", lathe("Wine", WINE, [wine], 64), location=glass_at)

    # Brass
    add("Candlestick", lathe("Candlestick", CANDLESTICK, [gold], 64), location=(0.265, 0.20, TABLE))
    wax = material("Wax", base_color=(0.86, 0.78, 0.62), roughness=0.45, emission_color=(1.0, 0.55, 0.22),
                   emission_strength=0.035)  # fmt: skip
    add("Candle", lathe("Candle", CANDLE, [wax], 48), location=(0.265, 0.20, TABLE))
    flame = material("Flame", lambda n: n("Emission", n("Blackbody", 2100.0), 26.0))
    add("Flame", lathe("Flame", FLAME, [flame], 24), location=(0.265, 0.20, TABLE))
    add("Wick", tube("Wick", [(0, 0, 0.216), (0.0003, 0, 0.222), (0.001, 0, 0.229)], 0.0008, [stem], 8),
        location=(0.265, 0.20, TABLE))  # fmt: skip
    jug_at = (-0.288, 0.075, TABLE)
    add("Jug", lathe("Jug", JUG, [gold], 96, shape=spout), location=jug_at, rotation=(0, 0, 2.6))
    t = np.linspace(0, 1, 40)[:, None]
    a, b, c, d = (
        np.array(p) for p in ((0.026, 0, 0.168), (0.085, 0, 0.205), (0.098, 0, 0.095), (0.050, 0, 0.062))
    )
    handle = (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d
    add("Handle", tube("Handle", handle, 0.0042, [gold], 16), location=jug_at, rotation=(0, 0, 2.6))

    # The bowl and its fruit
    bowl_at = np.array((0.105, 0.085, TABLE + 0.002))
    add("Bowl", lathe("Bowl", BOWL, [glaze], 72, uv=True), location=bowl_at)
    red = skin("Red apple", ((0.34, (0.60, 0.36, 0.06)), (0.46, (0.42, 0.035, 0.018)), (0.62, (0.24, 0.008, 0.010))),
               dots=(42, (0.62, 0.42, 0.16)))  # fmt: skip
    yellow = skin("Golden apple", ((0.35, (0.62, 0.50, 0.07)), (0.55, (0.66, 0.40, 0.05)), (0.72, (0.60, 0.13, 0.03))),
                  dots=(38, (0.40, 0.30, 0.06)))  # fmt: skip
    pear = skin("Pear", ((0.36, (0.36, 0.36, 0.05)), (0.55, (0.52, 0.44, 0.07)), (0.68, (0.52, 0.20, 0.04))),
                roughness=0.4, dots=(60, (0.24, 0.18, 0.05)))  # fmt: skip
    lemon = skin("Lemon", ((0.3, (0.80, 0.55, 0.02)), (0.7, (0.86, 0.66, 0.04))), rough_bump=(34, 0.5))
    orange = skin("Orange", ((0.3, (0.80, 0.22, 0.008)), (0.7, (0.86, 0.30, 0.015))), rough_bump=(46, 0.6))
    apples = [
        lathe(f"Apple {i}", APPLE, [m], 40, shape=apple_shape(i)) for i, m in enumerate((red, yellow, red))
    ]
    pear_mesh, lemon_mesh = lathe("Pear", PEAR, [pear], 40), lathe("Lemon", LEMON, [lemon], 40)
    orange_mesh = lathe("Orange", ORANGE, [orange], 40)
    stalk = tube("Stalk", [(0, 0, 0.055), (0.001, 0, 0.066), (0.003, 0.001, 0.078), (0.007, 0.002, 0.088)],
                 [0.0012, 0.0011, 0.0012, 0.0019], [stem])  # fmt: skip
    pear_stalk = tube("Pear stalk", [(0, 0, 0.105), (0.001, 0, 0.118), (0.005, 0.001, 0.133)],
                      [0.0014, 0.0013, 0.0020], [stem])  # fmt: skip

    def fruit(name, data, middle, position, rotation, stalks=None):
        turn = Euler(rotation)
        at = Vector(position) - turn.to_matrix() @ Vector((0, 0, middle))
        add(name, data, location=at, rotation=rotation)
        if stalks is not None:
            add(name + " stalk", stalks, location=at, rotation=rotation)

    def in_bowl(name, data, middle, x, y, z, rotation, stalks=None):
        fruit(name, data, middle, bowl_at + (x, y, z), rotation, stalks)

    in_bowl("Apple in bowl", apples[0], 0.037, -0.048, -0.034, 0.066, (0.25, -0.25, 0.4), stalk)
    in_bowl("Golden apple in bowl", apples[1], 0.037, 0.038, -0.042, 0.066, (0.30, 0.35, 1.0), stalk)
    in_bowl("Orange in bowl", orange_mesh, 0.037, 0.042, 0.040, 0.066, (0.5, 0.9, 0))
    in_bowl("Orange behind", orange_mesh, 0.037, -0.042, 0.044, 0.066, (1.5, 0.3, 0))
    in_bowl("Apple on top", apples[2], 0.037, -0.004, 0.004, 0.118, (-0.2, 0.35, 2.0), stalk)
    in_bowl("Pear in bowl", pear_mesh, 0.04, 0.085, 0.002, 0.103, (0.15, 0.75, 0.2), pear_stalk)
    fruit("Pear on table", pear_mesh, 0.04, (0.300, 0.035, TABLE + 0.0375), (1.42, 0.1, -2.2), pear_stalk)
    fruit("Lemon", lemon_mesh, 0.038, (0.055, -0.125, TABLE + 0.0305), (1.45, 0.0, 0.9))
    fruit("Orange on table", orange_mesh, 0.037, (-0.015, -0.090, TABLE + 0.0395), (0.3, 0.4, 0.2))

    # Half a lemon, its cut face to the light
    half_lemon(lemon, (0.150, -0.155, TABLE + 0.004))

    # Grapes, instanced
    grape = material(
        "Grape",
        lambda n: {
            "base_color": n.ramp(
                n("ObjectInfo").outputs["Random"],
                (0.0, (0.045, 0.006, 0.030)),
                (0.6, (0.085, 0.010, 0.040)),
                (1.0, (0.15, 0.028, 0.05)),
            )
        },
        roughness=0.28,
        coat_weight=0.3,
        coat_roughness=0.25,
        subsurface_weight=0.0,
    )
    grapes([grape], stem, (0.205, -0.035))
    knife(steel, material("Horn", base_color=(0.03, 0.018, 0.012), roughness=0.3, coat_weight=0.4))

    # Light: a window of six panes to the left, a dim fill from the right, a dim world
    center, right, up = np.array((-1.15, -0.35, 0.78)), np.array((0.42, -0.908, 0)), np.array((0, 0, 1.0))
    for i in range(2):
        for j in range(3):
            at = center + (i - 0.5) * 0.40 * right + (j - 1) * 0.36 * up
            area(f"Pane {i}{j}", (0.36, 0.32), 8.5, at, at + (0.9, 0.42, -0.22), (1.0, 0.93, 0.82))
    area("Fill", (1.4, 1.2), 4.0, (1.3, -0.9, 0.9), (0.1, 0.1, 0.1), (0.62, 0.76, 1.0))
    world = bpy.data.worlds.new("Room")
    n = Nodes(world)
    height = n("SeparateXYZ", n("TexCoord").outputs["Generated"]).outputs["Z"]
    fill = n.ramp(n.math("MULTIPLY_ADD", height, 0.5, 0.5), (0.3, (0.020, 0.014, 0.010)), (0.6, (0.050, 0.048, 0.050)),
                  (1.0, (0.085, 0.090, 0.105)))  # fmt: skip
    n.surface(n("Background", fill, 1.0), "OutputWorld")
    scene.world = world

    camera("Camera", (0.10, -1.12, 0.36), (0.004, 0.05, 0.112), 58.5, focus=(0.0, -0.06, 0.05), fstop=7.0)
    scene.pointmr.method, scene.pointmr.samples = "RAYTRACE", 32
    scene.pointmr.max_bounces, scene.pointmr.transmission_bounces = 12, 12
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"


def half_lemon(peel, at):
    def flesh_build(n):
        p = n("SeparateXYZ", n("TexCoord").outputs["Object"])
        x, y = p.outputs["X"], p.outputs["Y"]
        r = n.math("SQRT", n.math("ADD", n.math("MULTIPLY", x, x), n.math("MULTIPLY", y, y)))
        turn = n.math("MULTIPLY", n.math("ARCTAN2", y, x), 9 / (2 * np.pi))
        wall_at = n.math("ABSOLUTE", n.math("SUBTRACT", n.math("FRACT", turn), 0.5))
        wall_wide = n.math("MULTIPLY", wall_at, r)
        spokes = n.math("LESS_THAN", n.math("MULTIPLY", wall_wide, 1.0), 0.0012)
        rim = n.math("GREATER_THAN", r, 0.0232)
        core = n.math("LESS_THAN", r, 0.0022)
        pith = n.math("MAXIMUM", n.math("MAXIMUM", spokes, rim), core)
        juice = n("TexVoronoi", vector=n("TexCoord").outputs["Object"], scale=330)
        flesh = n.ramp(juice.outputs["Distance"], (0.0, (0.60, 0.40, 0.035)), (0.8, (0.34, 0.19, 0.010)))
        return {
            "base_color": n.mix(pith, flesh, (0.66, 0.58, 0.33)),
            "roughness": n("MapRange", pith, 0, 1, 0.28, 0.6).outputs[0],
            "normal": n("Bump", strength=0.5, distance=0.001, height=juice.outputs["Distance"]),
        }

    flesh = material("Lemon flesh", flesh_build)
    cut = [(r, z) for r, z in LEMON if z <= 0.032]
    profile = [*cut, (0.0275, 0.038), (0.0275, 0.038)]
    rotation = (1.0, 0.10, -0.55)
    ob = add("Half lemon", lathe("Half lemon", profile, [peel], 40), location=at, rotation=rotation)
    face = lathe("Lemon face", [(0.0275, 0.038), (0.0275, 0.038), (0.022, 0.0378), (0, 0.0378)], [flesh], 40)
    add("Lemon face", face, location=at, rotation=rotation)
    lift(ob)
    bpy.data.objects["Lemon face"].location = ob.location


def lift(ob) -> None:
    """Move an object so that its lowest vertex touches the cloth."""
    turn = np.array(ob.rotation_euler.to_matrix())
    p = np.array([v.co for v in ob.data.vertices]) @ turn.T
    ob.location.z = TABLE + 0.004 - p[:, 2].min()


def grapes(materials, stem, at):
    """A bunch: spheres dropped onto each other, sharing one mesh."""
    rng = np.random.default_rng(11)
    r, placed = 0.0098, []
    data = lathe(
        "Grape", [(r * np.sin(t), -r * 1.12 * np.cos(t)) for t in np.linspace(0, np.pi, 13)], materials, 28, 2
    )
    bunch = collection("Grapes", bpy.context.scene.collection)
    for _ in range(900):
        x, y = rng.normal(0, (0.036, 0.021))
        z = r
        for p in placed:
            d2 = (p[0] - x) ** 2 + (p[1] - y) ** 2
            if d2 < (1.9 * r) ** 2:
                z = max(z, p[2] + np.sqrt((1.9 * r) ** 2 - d2))
        if z < 0.050 - 0.9 * np.hypot(x, 1.6 * y) and len(placed) < 75:
            placed.append((x, y, z))
    turn = 0.5
    for i, (x, y, z) in enumerate(placed):
        where = (
            at[0] + x * np.cos(turn) - y * np.sin(turn),
            at[1] + x * np.sin(turn) + y * np.cos(turn),
            TABLE + 0.003 + z,
        )
        add(f"Grape {i}", data, bunch, where, rng.uniform(-0.8, 0.8, 3), rng.uniform(0.9, 1.06))
    path = [
        (-0.035, -0.02, 0.04),
        (-0.01, -0.004, 0.045),
        (0.02, 0.008, 0.055),
        (0.05, 0.02, 0.07),
        (0.058, 0.03, 0.071),
    ]
    add("Grape stem", tube("Grape stem", path, [0.001, 0.0014, 0.0016, 0.0018, 0.0022], [stem]),
        bunch, (at[0], at[1], TABLE))  # fmt: skip


def knife(steel, horn):
    """A fruit knife that lies over the table's edge."""
    t = np.linspace(0, 1, 30)
    top = np.stack([0.115 * t, 0.0085 * (1 - t**3), 0 * t], 1)
    bottom = np.stack([0.115 * t, -0.0075 * (1 - t**1.6), 0 * t], 1)
    thick = 0.0009 * (1 - 0.7 * t)
    rings = []
    for side in (-1, 1):
        rings.append(top + np.stack([0 * t, 0 * t, side * thick], 1))
    rows = np.stack([rings[0], rings[1], bottom], 1)  # a triangle across: spine, and the edge
    faces = grid_faces(30, 3, wrap=True)
    where, rotation = (-0.175, -0.130, TABLE + 0.0045), (0.25, -0.035, 0.42)
    add(
        "Blade",
        mesh("Blade", rows.reshape(-1, 3), faces, [steel], smooth=False),
        location=where,
        rotation=rotation,
    )
    grip = tube(
        "Grip",
        [(x, -0.0003, 0) for x in np.linspace(0.002, -0.085, 14)],
        0.0058 * np.array([0.3, 0.85, 1, 0.95, 0.92, 0.95, 1, 1.06, 1.12, 1.16, 1.18, 1.12, 0.9, 0.3]),
        [horn],
        20,
    )
    add("Grip", grip, location=where, rotation=rotation, scale=(1, 1, 0.75))


if __name__ == "__main__":
    build()
    print(save("still_life.blend", target_folder()))
