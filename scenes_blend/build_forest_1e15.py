"""Builds forest_1e15.blend: a mountain forest of more than 10^15 instanced triangles.

    .venv/bin/python scenes_blend/build_forest_1e15.py [FOLDER]

needle or leaf -> shoot or twig -> spray or branch -> limb -> tree -> grove (32 m) -> stand (384 m) -> land (90 km).
Shoots and twigs are placed by geometry nodes; from limbs upward PointMR's instancer places collections, which Blender
would expand. Trees near the camera stand on the terrain one by one, groves follow to 3 km, stands to 45 km.
"""

from __future__ import annotations

import bpy
import numpy as np
import plants
from forest_land import FAR, GROVE, MIDDLE, NEAR, STAND, TREE_LINE, height, noise, slopes, terrain_mesh
from forest_looks import bark, ground_material, leaf, rock_material, sky, water_material
from parts import add, camera, collection, mesh, new_scene, save, target_folder
from plants import scatter

# Plants


def all_trees():
    """(species as a collection of tree collections, {name: indices}) and the parts that undergrowth uses."""
    rng = np.random.default_rng(7)
    brown = bark("Bark", (0.030, 0.022, 0.015), (0.11, 0.085, 0.060))
    grey = bark("Grey bark", (0.06, 0.055, 0.048), (0.17, 0.16, 0.14))
    white = bark("Birch bark", (0.035, 0.030, 0.028), (0.62, 0.60, 0.55), (1.2, 1.2, 5.0))
    trees = []

    needles = leaf("Needles", (0.012, 0.034, 0.014), (0.040, 0.075, 0.026), (1.3, 1.5, 0.7))
    shoot = plants.holding("Shoot", plants.needle_shoot("Shoot", needles, brown, rng))
    spray = plants.branching(
        "Spray", shoot, brown, rng, 16, 0.80, 0.007, -0.06, 0.90, 0.12, 0.05, (1.0, 1.25), 0.02
    )
    bough = plants.branching(
        "Spruce branch", spray, brown, rng, 34, 2.6, 0.03, 0.10, 1.0, 0.16, 0.08, (1.0, 1.35), -0.05
    )
    for i, (tall, whorls) in enumerate(((24, 25), (19, 22), (27, 27))):
        trees.append(plants.conifer(f"Spruce {i}", bough, brown, rng, tall, 2.6, whorls))

    def leafy(name, leaves, skin, twig, limb_bend, shapes, **tree):
        t = plants.holding(f"{name} twig", plants.leafy_twig(f"{name} twig", leaves, skin, rng, **twig))
        branch = plants.branching(f"{name} branch", t, skin, rng, 30, 1.35, 0.012, limb_bend * 0.6)
        limb = plants.branching(f"{name} limb", branch, skin, rng, 15, 3.2, 0.05, limb_bend, 1.0, 0.55, 0.22)
        for i, (tall, crown, count) in enumerate(shapes):
            trees.append(plants.broadleaf(f"{name} {i}", limb, skin, rng, tall, 4.1, crown, count, **tree))
        return limb

    beech = leaf("Beech leaves", (0.045, 0.095, 0.018), (0.105, 0.165, 0.030), (1.5, 1.6, 0.6))
    limb = leafy(
        "Beech", beech, grey, dict(count=24, size=0.085), 0.06, ((21, 4.6, 58), (18, 4.0, 50)), base=0.24
    )
    amber = leaf("Amber leaves", (0.30, 0.105, 0.012), (0.46, 0.22, 0.022), (1.4, 1.1, 0.5))
    leafy("Maple", amber, grey, dict(count=22, size=0.095), 0.05, ((15, 3.7, 46),), base=0.22)
    birch = leaf("Birch leaves", (0.11, 0.15, 0.022), (0.26, 0.235, 0.030), (1.5, 1.5, 0.5))
    shape = ((20, 3.1, 60), (17, 2.7, 54))
    leafy(
        "Birch",
        birch,
        white,
        dict(count=22, size=0.080, droop=0.35),
        -0.16,
        shape,
        base=0.28,
        trunk=0.0115,
        upward=0.9,
    )

    forest = collection("Trees")
    names = {}
    for i, c in enumerate(sorted(trees, key=lambda c: c.name)):
        forest.children.link(c)
        names.setdefault(c.name.split()[0], []).append(i)
    return forest, names, limb


def undergrowth(limb):
    """A collection of low things: bush, fern, grass, flowers, three rocks; and the index of each by name."""
    rng = np.random.default_rng(21)
    green = leaf("Fern fronds", (0.050, 0.105, 0.016), (0.10, 0.155, 0.028), (1.5, 1.6, 0.6))
    grass = leaf("Grass", (0.085, 0.150, 0.022), (0.25, 0.26, 0.060), (1.3, 1.4, 0.6))
    bloom = leaf("Petals", (0.55, 0.10, 0.42), (0.85, 0.62, 0.75), (1, 1, 1))
    stone = rock_material()
    low = collection("Undergrowth")
    made = [plants.holding("Fern", plants.fern("Fern", green, rng))]
    tufts = [plants.blades(f"Tuft {i}", grass, rng, 46, h, 0.011, 0.16) for i, h in enumerate((0.42, 0.30))]
    kinds = collection("Tufts")
    for t in tufts:
        kinds.children.link(plants.holding(t.name, t))
    patch = collection("Grass")
    g = (
        np.stack(np.meshgrid(np.arange(6), np.arange(6)), -1).reshape(-1, 2) / 6.0
        - 0.42
        + rng.normal(0, 0.06, (36, 2))
    )
    scatter("Grass tufts", patch, kinds, np.c_[g, 0 * g[:, 0]], rng.uniform(-1, 1, (36, 3)) * (0.1, 0.1, 3.1),
            rng.uniform(0.6, 1.15, 36), rng.integers(0, 2, 36), native=True)  # fmt: skip
    made.append(patch)
    heads = collection("Flowers")
    stem = plants.blades("Flower stems", grass, rng, 9, 0.5, 0.008, 0.25)
    add("Flower stems", stem, heads)
    shape, faces = plants.leaf_shape(1.0, 0.7)
    a, r = rng.uniform(0, 6.28, 60), 0.28 * np.sqrt(rng.random(60))
    at = np.stack([r * np.cos(a), r * np.sin(a), rng.uniform(0.25, 0.62, 60)], 1)
    p = plants.placed(shape, at, rng.uniform(-3, 3, (60, 3)) * (0.3, 0.3, 1), np.full(60, 0.055))
    add(
        "Petals",
        mesh("Petals", p.reshape(-1, 3), (faces + 8 * np.arange(60)[:, None, None]).reshape(-1, 3), [bloom]),
        heads,
    )
    made.append(heads)
    made += [plants.holding(f"Rock {i}", plants.rock(f"Rock {i}", stone, rng)) for i in range(3)]
    bush = collection("Bush")
    d = np.stack(
        [np.cos(np.arange(7) * 2.4), np.sin(np.arange(7) * 2.4), 0.9 + 0.3 * np.sin(np.arange(7) * 5)], 1
    )
    scatter("Bush limbs", bush, limb, np.zeros((7, 3)), plants.frames(d), np.linspace(0.42, 0.30, 7))
    made.append(bush)
    for c in made:
        low.children.link(c)
    return low, {c.name: i for i, c in enumerate(sorted(made, key=lambda c: c.name))}


# Placing


def mixture(x, y, rng, names):
    """Which tree stands where: spruce on cool ground, birch and maple in drifts, beech between."""
    a, b = noise(x / 130, y / 130, 31), noise(x / 75, y / 75, 32)
    kind = np.where(a + 0.35 * rng.normal(size=len(x)) > -0.05, 0, 1)  # 0 spruce, 1 beech
    drift = b + 0.3 * rng.normal(size=len(x))
    kind = np.where(drift > 0.50, 2, kind)  # birch
    kind = np.where(drift < -0.58, 3, kind)  # maple
    species = [names["Spruce"], names["Beech"], names["Birch"], names["Maple"]]
    pick = rng.random(len(x))
    return np.array([species[k][int(p * len(species[k]))] for k, p in zip(kind, pick, strict=True)])


def jittered(low, high, step, jitter, rng):
    """Points of a staggered grid over a square, moved at random."""
    n = int((high - low) / step)
    i, j = np.meshgrid(np.arange(n), np.arange(n))
    x = low + (i + 0.5 + 0.25 * np.where(j % 2, 1, -1)) * step + rng.uniform(-jitter, jitter, i.shape) * step
    y = low + (j + 0.5) * step + rng.uniform(-jitter, jitter, i.shape) * step
    return x.ravel(), y.ravel()


def upright(n, rng, tilt=0.03):
    """Turned at random about z, in steps that compress well, and hardly leaning."""
    lean = np.round(rng.normal(0, tilt, (n, 2)) * 64) / 64
    return np.c_[lean, rng.integers(0, 64, n) * (2 * np.pi / 64)]


def rounded(x, y, z, step):
    return np.round(np.stack([x, y, z], 1) / step) * step


def groves(trees, names, low, index):
    """Six tiles of forest, 32 m wide. A collection of collections."""
    result = collection("Groves")
    for k in range(6):
        rng = np.random.default_rng(100 + k)
        grove = collection(f"Grove {k}", result)
        x, y = jittered(-GROVE / 2, GROVE / 2, 4.57, 0.30, rng)
        keep = rng.random(len(x)) < 0.93
        x, y = x[keep], y[keep]
        pick = mixture(x + 400 * k, y + 170 * k, rng, names)
        scatter(f"Grove trees {k}", grove, trees, rounded(x, y, 0 * x, 1 / 16), upright(len(x), rng),
                rng.integers(11, 19, len(x)) / 16, pick)  # fmt: skip
        m = 60
        kinds = rng.choice(
            [index["Fern"], index["Bush"], index["Rock 0"], index["Rock 2"]], m, p=(0.55, 0.3, 0.08, 0.07)
        )
        p = rng.uniform(-GROVE / 2, GROVE / 2, (m, 2))
        scatter(f"Grove undergrowth {k}", grove, low, rounded(*p.T, 0 * p[:, 0], 1 / 16), upright(m, rng),
                rng.integers(10, 24, m) / 16, kinds)  # fmt: skip
    return result


def stands(grove_tiles):
    """Four tiles of 12 x 12 groves. A collection of collections."""
    result = collection("Stands")
    n = round(STAND / GROVE)
    i, j = np.meshgrid(np.arange(n), np.arange(n))
    at = (np.stack([i.ravel(), j.ravel(), 0 * i.ravel()], 1) - [(n - 1) / 2, (n - 1) / 2, 0]) * GROVE
    for k in range(4):
        rng = np.random.default_rng(200 + k)
        stand = collection(f"Stand {k}", result)
        at[:, 2] = np.round(2.5 * noise(at[:, 0] / 60 + 9 * k, at[:, 1] / 60, 41) * 4) / 4
        turn = np.c_[np.zeros((n * n, 2)), rng.integers(0, 4, n * n) * np.pi / 2]
        scatter(f"Stand groves {k}", stand, grove_tiles, at, turn, np.ones(n * n), rng.integers(0, 6, n * n))
    return result


def tiles(step, inner, outer):
    """Centres of the square tiles between two distances."""
    n = int(np.ceil(outer / step))
    c = np.arange(-n, n + 1) * step
    x, y = (v.ravel() for v in np.meshgrid(c, c))
    r = np.hypot(x, y)
    keep = (r >= inner) & (r < outer)
    return x[keep], y[keep]


def open_ground(x, y):
    """True where the view is kept free: the meadow, and a widening gap down to the lake."""
    gap = 6.5 + 0.46 * np.maximum(y, 0) + 5 * noise(x / 22, y / 22, 51)
    lane = (np.abs(x - 0.03 * y) < gap) & (y > -12) & (y < 195 + 20 * noise(x / 40, 0 * y, 53))
    sunny = (y < 10 - 0.25 * x) & (y > -45) & (x < 6)  # lets the sun onto the meadow
    return lane | sunny | (np.hypot(x, y) < 9 + 3 * noise(x / 9, y / 9, 52))


def plant_landscape(trees, names, low, index, grove_tiles, stand_tiles):
    top = bpy.context.scene.collection
    rng = np.random.default_rng(3)

    # near: trees one by one
    x, y = jittered(-NEAR, NEAR, 5.0, 0.30, rng)
    r = np.hypot(x, y)
    keep = (r < NEAR) & ~open_ground(x, y) & (y > -130) & (rng.random(len(x)) < 0.94) & (height(x, y) > 1.0)
    x, y = x[keep], y[keep]
    scatter("Trees nearby", top, trees, rounded(x, y, height(x, y), 1 / 16), upright(len(x), rng),
            rng.integers(11, 20, len(x)) / 16, mixture(x, y, rng, names))  # fmt: skip

    # the frame of the picture
    heroes = np.array(
        [
            *[
                (-7.4, 15.5, 0.95, "Birch"),
                (-9.8, 18, 0.85, "Birch"),
                (-13, 25, 1.0, "Maple"),
                (-17.5, 31, 1.1, "Beech"),
            ],
            *[
                (-20, 38, 1.15, "Spruce"),
                (-6.6, 36, 0.28, "Spruce"),
                (-9.5, 33, 0.5, "Spruce"),
                (-3.2, 47, 0.22, "Spruce"),
            ],
            *[
                (11.2, 21, 1.0, "Spruce"),
                (13.8, 25, 1.0, "Beech"),
                (17, 33, 1.15, "Spruce"),
                (9.4, 27, 0.40, "Spruce"),
            ],
            *[
                (22, 40, 1.1, "Birch"),
                (27, 60, 1.0, "Maple"),
                (-30, 62, 1.0, "Maple"),
                (7.0, 34, 0.20, "Spruce"),
            ],
        ],
        object,
    )
    x, y, size = heroes[:, :3].astype(float).T
    which = [names[kind][i % len(names[kind])] for i, kind in enumerate(heroes[:, 3])]
    scatter(
        "Trees in front", top, trees, np.stack([x, y, height(x, y)], 1), upright(len(x), rng), size, which
    )

    # groves: where the ground is dry all over the tile
    x, y = tiles(GROVE, NEAR + 4, MIDDLE)
    lowest = np.min([height(x + i, y + j) for i in (-14, 0, 14) for j in (-14, 0, 14)], 0)
    keep = lowest > 1.5
    x, y = x[keep], y[keep]
    z = 0.5 * (height(x, y) + lowest[keep])
    turn = np.c_[np.zeros((len(x), 2)), rng.integers(0, 4, len(x)) * np.pi / 2]
    scatter("Groves in the valley", top, grove_tiles, rounded(x, y, z, 0.25), turn, np.ones(len(x)),
            rng.integers(0, 6, len(x)))  # fmt: skip

    # stands: tilted with the land
    x, y = tiles(STAND, MIDDLE + STAND * 0.45, FAR)
    h = height(x, y)
    gx, gy = slopes(x, y, STAND / 2)
    keep = (h > 12) & (h < TREE_LINE + 160 * noise(x / 900, y / 900, 61)) & (np.hypot(gx, gy) < 0.95)
    x, y, h, gx, gy = x[keep], y[keep], h[keep], gx[keep], gy[keep]
    quarter = rng.integers(0, 4, len(x)) * np.pi / 2
    ahead = np.stack([np.cos(quarter), np.sin(quarter), gx * np.cos(quarter) + gy * np.sin(quarter)], 1)
    normal = np.stack([-gx, -gy, np.ones(len(x))], 1)
    turn = np.round(plants.frames(ahead, normal) * 256) / 256
    steep = np.sqrt(1 + gx**2 + gy**2)
    scatter("Stands to the horizon", top, stand_tiles, rounded(x, y, h, 1.0), turn, np.round(1.02 * steep * 32) / 32,
            rng.integers(0, 4, len(x)))  # fmt: skip

    # the meadow: grass and flowers in view, ferns and bushes at its edge, rocks
    x, y = jittered(-70, 70, 0.92, 0.3, rng)
    keep = (np.hypot(x, y) < 68) & (y > 0.5) & (np.abs(x) < 3 + 0.75 * y) & (noise(x / 5, y / 5, 71) > -0.75)
    x, y = x[keep], y[keep]
    flowery = (noise(x / 7, y / 7, 72) > 0.15) & (rng.random(len(x)) < 0.5)
    kind = np.where(flowery, index["Flowers"], index["Grass"])
    gx, gy = slopes(x, y, 0.5)
    lie = np.round(np.stack([np.arctan(gy), -np.arctan(gx), 0 * x], 1) * 64) / 64
    scatter(
        "Meadow", top, low, rounded(x, y, height(x, y), 1 / 64), lie, rng.integers(11, 19, len(x)) / 16, kind
    )
    x, y = jittered(-110, 110, 2.6, 0.4, rng)
    edge = ~open_ground(x, y)
    keep = (
        (np.hypot(x, y) < 105) & (y > -5) & (np.abs(x) < 8 + 0.9 * y) & (edge | (rng.random(len(x)) < 0.06))
    )
    keep &= np.hypot(x, y) > 5
    x, y = x[keep], y[keep]
    kind = rng.choice(
        [index["Fern"], index["Bush"], index["Rock 0"], index["Rock 1"]], len(x), p=(0.62, 0.26, 0.06, 0.06)
    )
    scatter("Undergrowth nearby", top, low, rounded(x, y, height(x, y), 1 / 64), upright(len(x), rng, 0.08),
            rng.integers(10, 26, len(x)) / 16, kind)  # fmt: skip
    boulders = np.array(
        [
            (-3.6, 8.2, 1.9, 0),
            (-5.2, 9.6, 1.2, 1),
            (4.9, 10.8, 1.5, 2),
            (2.2, 15.5, 1.0, 1),
            (-1.6, 21, 1.4, 2),
        ]
        + [(6.5, 13.5, 0.8, 0), (-2.2, 6.6, 0.55, 2)]
    )
    x, y, size, which = boulders.T
    scatter("Boulders", top, low, np.stack([x, y, height(x, y) + 0.05], 1), upright(len(x), rng, 0.15), size,
            index["Rock 0"] + which.astype(int))  # fmt: skip


def build() -> None:
    scene = new_scene()
    trees, names, limb = all_trees()
    low, index = undergrowth(limb)
    grove_tiles = groves(trees, names, low, index)
    plant_landscape(trees, names, low, index, grove_tiles, stands(grove_tiles))
    add("Terrain", terrain_mesh(ground_material()))
    a = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    disc = np.stack([3000 * np.cos(a), 1700 + 3000 * np.sin(a), 0 * a], 1)
    add("Lake", mesh("Lake", disc, [range(64)], [water_material()], smooth=False))

    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.color, lamp.angle = 6.5, (1.0, 0.84, 0.62), np.radians(0.6)
    add("Sun", lamp, rotation=(np.radians(55), 0, np.radians(-72)))
    scene.world = sky()

    eye = (0.0, 0.0, float(height(0, 0)) + 2.6)
    camera("Camera", eye, (0.9, 40.0, eye[2] - 5.2), 30)
    scene.camera.data.clip_end = 200000.0
    scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", 32
    scene.pointmr.max_bounces = 3
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.exposure = 0.75
    scene.view_settings.look = "AgX - Medium High Contrast"


if __name__ == "__main__":
    build()
    print(save("forest_1e15.blend", target_folder()))
