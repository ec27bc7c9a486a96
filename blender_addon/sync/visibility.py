"""Who is seen: objects of a view layer or a collection, and the rays that may see them."""

from __future__ import annotations

from pointmr_engine.scene.group import (
    CAMERA,
    DIFFUSE,
    GLOSSY,
    SHADOW,
    SHADOW_CATCHER,
    TRANSMISSION,
    VISIBLE,
    VOLUME_SCATTER,
)

RAY_FLAGS = (
    ("visible_camera", CAMERA),
    ("visible_diffuse", DIFFUSE),
    ("visible_glossy", GLOSSY),
    ("visible_transmission", TRANSMISSION),
    ("visible_shadow", SHADOW),
    ("visible_volume_scatter", VOLUME_SCATTER),
)


def ray_visibility(ob) -> int:
    """The object's ray visibility, and whether it is a shadow catcher, as bits of `scene.group`."""
    bits = VISIBLE
    if ob.is_shadow_catcher and ob.type != "LIGHT":
        bits |= SHADOW_CATCHER
    for name, bit in RAY_FLAGS:
        if not getattr(ob, name):
            bits &= ~bit
    return bits


def below(own: int, above: int, flags: int) -> int:
    """The bits of what an object of bits `above`, and with further `flags`, places."""
    return (own & above & VISIBLE) | ((own | above) & SHADOW_CATCHER) | flags


def is_final(depsgraph) -> bool:
    """Whether the depsgraph was evaluated for rendering (else for the viewport)."""
    return depsgraph.mode == "RENDER"


def is_disabled(item, final: bool) -> bool:
    """Whether an object or collection is switched off for renders (or, if not `final`, in viewports)."""
    return item.hide_render if final else item.hide_viewport


def instanced_by_parent(ob) -> bool:
    """Whether Blender hides an object in its own place because its parent instances its children."""
    return ob.parent is not None and ob.parent.instance_type in {"VERTS", "FACES"}


def shows_itself(ob, is_instancer: bool, final: bool) -> bool:
    """Whether an object's own geometry is shown: instancers may hide theirs."""
    return not is_instancer or (ob.show_instancer_for_render if final else ob.show_instancer_for_viewport)


def collection_members(collection, final: bool) -> list[tuple[object, int]]:
    """(object, index) of what instancing the collection shows, child collections included, each object once.

    The index counts hidden objects too: Blender makes instances' ids of it. View layers have no say here.
    """
    order: dict[int, list] = {}

    def gather(c, hidden: bool) -> None:
        hidden = hidden or is_disabled(c, final)
        for ob in c.objects:
            entry = order.setdefault(ob.as_pointer(), [ob, False])
            entry[1] = entry[1] or not (hidden or is_disabled(ob, final))
        for child in c.children:
            gather(child, hidden)

    gather(collection, False)
    return [(ob, i) for i, (ob, visible) in enumerate(order.values()) if visible]


def layer_objects(depsgraph) -> list[object]:
    """Evaluated objects that the view layer (and background scenes) place in the world, visible or only instancing.

    Includes the children that a parent instances in its place, and instancers that hide their own geometry.
    """
    final = is_final(depsgraph)
    scene, layer = depsgraph.scene, depsgraph.view_layer
    found: dict[int, object] = {}

    def gather(layer_collection, hidden: bool) -> None:
        c = layer_collection.collection
        hidden = hidden or is_disabled(c, final) or (not final and layer_collection.hide_viewport)
        if not (hidden or layer_collection.exclude):
            for ob in c.objects:
                found.setdefault(ob.as_pointer(), ob)
        for child in layer_collection.children:  # a child of an excluded collection may be included by itself
            gather(child, hidden)

    gather(layer.layer_collection, False)
    own = len(found)
    background, seen = scene.background_set, {scene.as_pointer()}
    while background is not None and background.as_pointer() not in seen:
        seen.add(background.as_pointer())
        for ob, _ in collection_members(background.collection, final):
            found.setdefault(ob.as_pointer(), ob)
        background = background.background_set
    result = []
    for i, ob in enumerate(found.values()):
        evaluated = ob.evaluated_get(depsgraph)
        # visibility may be animated, which only the evaluated object knows
        if not is_evaluated(evaluated) or is_disabled(evaluated, final):
            continue
        if final or i >= own or not hidden_by_eye(ob, layer):
            result.append(evaluated)
    return result


def hidden_by_eye(ob, view_layer) -> bool:
    """Whether the user closed an object's eye in this view layer (viewports only)."""
    try:
        return ob.hide_get(view_layer=view_layer)
    except RuntimeError:  # not in this layer
        return False


def is_evaluated(id_block) -> bool:
    return bool(id_block.is_evaluated)
