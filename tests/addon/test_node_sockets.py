"""Every socket of the nodes that are translated has a place in the engine, or is known not to."""

from itertools import product

import pytest

bpy = pytest.importorskip("bpy")

from blender_addon.sync import node_table  # noqa: E402
from pointmr_engine.shading.nodes import NODES, SHADERS  # noqa: E402

_SCATTERING = {"Scale", "Radius", "IOR", "Roughness", "Anisotropy"}
_HAIR = (
    "Absorption Coefficient, Radial Roughness, Coat, IOR, Offset, Random Roughness, Random, Melanin, Melanin Redness, "
    "Tint, Random Color, Aspect Ratio, R lobe, TT lobe, TRT lobe, RoughnessV"
)
# what the engine has in another form, or says in a warning that it lacks (docs/nodes.md)
ELSEWHERE = {
    "add_shader": {"Shader", "Shader_001"},
    "mix_shader": {"Shader", "Shader_001"},
    "metallic": {"IOR", "Extinction"},
    "geometry": {"Random Per Island", "Pointiness"},
    "ambient_occlusion": {"Distance", "Normal"},
    "identity_vector": {"Radius"},
    "hair": set(_HAIR.split(", ")),
    "toon": {"Size", "Smooth"},
    "subsurface": _SCATTERING,
    "principled": {f"Subsurface {name}" for name in _SCATTERING},
}


def every_form(node):
    """The node once for every combination of its choices, those of its type of data and kind of model."""
    shared = {p.identifier for p in bpy.types.Node.bl_rna.properties}
    choices = [
        p
        for p in node.bl_rna.properties
        if p.type == "ENUM" and not p.is_readonly and p.identifier not in shared
    ]
    for values in product(*([e.identifier for e in p.enum_items] for p in choices)):
        for p, value in zip(choices, values, strict=True):
            try:
                setattr(node, p.identifier, value)
            except TypeError:  # not with the others
                break
        else:
            yield node


def translated():
    """Names of Blender's shader nodes that have a rule."""
    names = (n for n in dir(bpy.types) if n.startswith("ShaderNode") and n != "ShaderNode")
    return [
        n
        for n in names
        if n.removeprefix("ShaderNode") in (*node_table.RULES, "MapRange", "Mix", "BsdfMetallic")
    ]


@pytest.mark.parametrize("name", [n for n in translated() if "Eevee" not in n])
def test_no_socket_is_lost(name):
    tree = bpy.data.materials.new(name).node_tree
    lost, known = set(), None
    for node in every_form(tree.nodes.new(name)):
        rule = node_table.rule_of(node)
        if rule is None:
            continue
        known = NODES.get(rule.kind) or SHADERS[rule.kind]
        read = {s.identifier for s in node.inputs if rule.input_name(s.identifier) in known.inputs}
        lost |= {s.identifier for s in node.inputs if s.enabled} - read
        if rule.kind in NODES:
            made = {s.identifier for s in node.outputs if rule.output_name(s.identifier) in known.outputs}
            lost |= {s.identifier for s in node.outputs if s.enabled} - made
    assert lost <= (ELSEWHERE.get(known.kind, set()) if known else set())
