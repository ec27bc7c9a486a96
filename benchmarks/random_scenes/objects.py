"""Objects drawn at random: solids, leaf clouds and strands, moved and keyframed, repeated by instancers."""

from __future__ import annotations

from random import Random

import bpy
import numpy as np

from benchmarks.features import stage

CHANCE_OF_KEYFRAMES = 0.3
LAST_FRAME = 10


def solid(surface, dice: Random) -> bpy.types.Object:
    """One of the stage's solids above the middle of the floor."""
    at = (dice.uniform(-2.2, 2.2), dice.uniform(-1.5, 2.5), dice.uniform(0.4, 1.4))
    kind = dice.choice(["sphere", "coarse", "cube", "torus", "monkey", "plane"])
    if kind in ("sphere", "coarse"):
        return stage.sphere(surface, at, dice.uniform(0.3, 0.8), segments=12 if kind == "coarse" else 64)
    if kind == "cube":
        return stage.cube(surface, at, dice.uniform(0.5, 1.2), dice.choice([0, 0.06]), dice.uniform(0, 3))
    if kind == "torus":
        return stage.torus(surface, at, dice.uniform(0.4, 0.8), dice.uniform(0.1, 0.3))
    if kind == "monkey":
        return stage.monkey(surface, at, dice.uniform(0.4, 0.8), dice.uniform(0, 3))
    return stage.plane(
        surface, at, dice.uniform(0.6, 1.5), (dice.uniform(-1.5, 1.5), dice.uniform(-1.5, 1.5), 0)
    )


def leaf_cloud(surface, dice: Random) -> bpy.types.Object:
    """Hundreds to thousands of small squares within a ball, each with the whole UV square."""
    rng = np.random.default_rng(dice.randrange(2**32))
    count, radius = dice.choice([300, 3000]), dice.uniform(0.5, 1.0)
    side = radius * dice.uniform(0.6, 1.2) / count**0.4
    middle = rng.normal(size=(count, 3))
    middle *= radius * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(middle, axis=1, keepdims=True)
    axes = np.linalg.qr(rng.normal(size=(count, 3, 2)))[0].transpose(2, 0, 1) * side
    corners = [middle + sx * axes[0] + sy * axes[1] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    positions = np.stack(corners, 1).reshape(-1, 3)
    uv = np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (count, 1))
    faces = np.arange(4 * count).reshape(-1, 4)
    at = (dice.uniform(-2, 2), dice.uniform(-0.5, 2.5), radius * dice.uniform(0.7, 1.2))
    return stage.mesh_object("Leaves", positions, faces, surface, at=at, uv=uv)


def strands(surface, dice: Random) -> bpy.types.Object:
    """A tuft of bent strands that thin out towards their tips."""
    rng = np.random.default_rng(dice.randrange(2**32))
    count, points = dice.choice([60, 600]), 6
    along = np.linspace(0, 1, points)[None, :, None]
    root = np.concatenate([rng.uniform(-0.8, 0.8, (count, 2)), np.zeros((count, 1))], 1)[:, None]
    aim = np.concatenate([rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(0.6, 1.4, (count, 1))], 1)[:, None]
    bend = rng.uniform(-0.5, 0.5, (count, 1, 3)) * (1, 1, 0)
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([points] * count)
    data.points.foreach_set("position", (root + along * aim + along**2 * bend).astype(np.float32).ravel())
    radius = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    thick = dice.choice([0.003, 0.012]) * (1 - 0.8 * along[..., 0])
    radius.data.foreach_set("value", np.repeat(thick, count, 0).astype(np.float32).ravel())
    data.materials.append(surface)
    item = stage.link(bpy.data.objects.new("Strands", data))
    item.location = (dice.uniform(-1.5, 1.5), dice.uniform(-0.5, 2), 0)
    return item


def drawn_by_place(places: np.ndarray, dice: Random) -> np.ndarray:
    """(n,) float32 in 0..1, as good as random, of what lies at places (n, 3): Blender's order of a primitive's faces
    differs from process to process.
    """
    ways = [dice.uniform(20, 60) for _ in range(3)]
    return (1000.0 * np.sin(np.round(places.astype(np.float64), 4) @ ways) % 1.0).astype(np.float32)


def places_of(item: bpy.types.Object, domain: str) -> np.ndarray:
    """(n, 3) float32: where an object's vertices ("POINT"), faces ("FACE") or face corners ("CORNER") are; corners
    halfway to the middle of their faces.
    """
    mesh = item.data
    vertices, faces = (
        np.empty((len(mesh.vertices), 3), np.float32),
        np.empty((len(mesh.polygons), 3), np.float32),
    )
    mesh.vertices.foreach_get("co", vertices.ravel())
    mesh.polygons.foreach_get("center", faces.ravel())
    if domain != "CORNER":
        return vertices if domain == "POINT" else faces
    size, of = np.empty(len(faces), np.int32), np.empty(len(mesh.loops), np.int32)
    mesh.polygons.foreach_get("loop_total", size)
    mesh.loops.foreach_get("vertex_index", of)
    return 0.5 * (vertices[of] + np.repeat(faces, size, 0))


def give_shades(item: bpy.types.Object, dice: Random) -> None:
    """The attribute `shade` that materials may read, a random number for each vertex, face or face corner."""
    domain = dice.choice(["POINT", "FACE", "CORNER"])
    values = item.data.attributes.new("shade", "FLOAT", domain).data
    values.foreach_set("value", drawn_by_place(places_of(item, domain), dice))


def mixed_slots(item: bpy.types.Object, surface, dice: Random) -> None:
    """A second material on some of the faces."""
    item.data.materials.append(surface)
    second = drawn_by_place(places_of(item, "FACE"), dice) < 0.5
    item.data.polygons.foreach_set("material_index", second.astype(np.int32))


def change(item: bpy.types.Object, dice: Random) -> None:
    """Turn, stretch or mirror it, repeat it by a modifier, hide it from some rays, move it in time."""
    if dice.random() < 0.4:
        item.scale = tuple(dice.choice([-1, 1, 1]) * dice.uniform(0.5, 1.5) for _ in range(3))
    if dice.random() < 0.3:
        item.rotation_euler = tuple(dice.uniform(-1, 1) for _ in range(3))
    if item.type == "MESH" and dice.random() < 0.15:
        item.modifiers.new("Array", "ARRAY").count = 3
    for name, chance in (("camera", 0.1), ("glossy", 0.1)):
        setattr(item, f"visible_{name}", dice.random() >= chance)
    if dice.random() < 0.15:
        # not from shadow rays alone: what rays of lobes meet besides, Cycles weighs against these, and how much of a
        # shadow is left goes by its probabilities of sampling
        for name in ("shadow", "diffuse", "glossy", "transmission"):
            setattr(item, f"visible_{name}", False)
    if dice.random() < CHANCE_OF_KEYFRAMES:
        for frame in (1, LAST_FRAME):
            if frame == LAST_FRAME:
                item.location.x += dice.uniform(-1, 1)
                item.location.z += dice.uniform(0, 0.5)
                item.rotation_euler.z += dice.uniform(-2, 2)
            for name in ("location", "rotation_euler"):
                item.keyframe_insert(name, frame=frame)


def single(surfaces, dice: Random) -> bpy.types.Object:
    """Any object of one or two of the materials."""
    surface = dice.choice(surfaces)
    kind = dice.random()
    if kind < 0.08:
        item = strands(surface, dice)
    else:
        item = leaf_cloud(surface, dice) if kind < 0.2 else solid(surface, dice)
        give_shades(item, dice)
        if dice.random() < 0.2:
            mixed_slots(item, dice.choice(surfaces), dice)
    change(item, dice)
    return item


def empties(items: list[bpy.types.Object], dice: Random) -> None:
    """A collection of some of the objects, shown again by empties, half of the time within another collection's."""
    group = bpy.data.collections.new("Group")
    for item in dice.sample(items, min(2, len(items))):
        group.objects.link(item)
    if dice.random() < 0.5:
        outer = bpy.data.collections.new("Outer")
        for _ in range(dice.randint(2, 5)):
            outer.objects.link(empty(group, dice, 0.8))
        group = outer
    for _ in range(dice.randint(2, 12)):
        stage.link(empty(group, dice, 4.0))


def empty(group: bpy.types.Collection, dice: Random, spread: float) -> bpy.types.Object:
    """An empty that shows a collection, turned, scaled, perhaps stretched or mirrored; not linked yet."""
    item = bpy.data.objects.new("Empty", None)
    item.instance_type, item.instance_collection = "COLLECTION", group
    item.location = (
        dice.uniform(-spread, spread),
        spread * dice.uniform(-0.25, 1.25),
        dice.uniform(-0.2, 0.5),
    )
    item.rotation_euler = (dice.uniform(-0.3, 0.3), 0, dice.uniform(0, 6))
    size = dice.uniform(0.3, 1.2)
    item.scale = (size, size * dice.choice([1, 1, 0.6]), size * dice.choice([1, -1, 1]))
    return item


def on_parts(surfaces, dice: Random) -> None:
    """A solid repeated on the vertices or faces of another."""
    parent = stage.sphere(
        dice.choice(surfaces), (dice.uniform(-2, 2), dice.uniform(0, 3), 1), 0.9, segments=12
    )
    child = stage.cube(dice.choice(surfaces), (0, 0, 0), dice.uniform(0.1, 0.3), dice.choice([0, 0.02]), 0)
    child.parent = parent
    parent.instance_type = dice.choice(["VERTS", "FACES"])
    parent.use_instance_vertices_rotation = parent.use_instance_faces_scale = dice.random() < 0.5
    parent.show_instancer_for_render = dice.random() < 0.7


def field(surfaces, dice: Random) -> None:
    """Hundreds to thousands of one small object all over the floor, on the vertices of a mesh."""
    rng = np.random.default_rng(dice.randrange(2**32))
    places = rng.uniform((-4, -2, 0), (4, 8, 0), (dice.choice([300, 3000]), 3))
    parent = stage.mesh_object("Field", places, [])
    child = dice.choice([leaf_cloud, leaf_cloud, strands, solid])(dice.choice(surfaces), dice)
    size = dice.uniform(0.05, 0.25)
    child.location, child.scale = (0, 0, 0), (size, size, size)
    child.parent, parent.instance_type = parent, "VERTS"


def objects(surfaces, dice: Random) -> None:
    """A floor and what stands on it."""
    floor = stage.matte(name="Floor") if dice.random() < 0.6 else dice.choice(surfaces)
    stage.plane(floor, size=12.0)
    items = [single(surfaces, dice) for _ in range(dice.randint(3, 6))]
    if dice.random() < 0.4:
        empties(items, dice)
    if dice.random() < 0.15:
        on_parts(surfaces, dice)
    if dice.random() < 0.15:
        field(surfaces, dice)
