"""Blender's shader node trees to engine graphs."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.shading.nodes import NODES
from pointmr_engine.shading.nodes.registry import From

from .derived import DERIVED, STRAND
from .node_table import Rule, params_of, rule_of

_WRAPPERS = {"VALUE": "value", "INT": "value", "BOOLEAN": "value", "RGBA": "rgb", "VECTOR": "identity_vector"}
_WRAPPED = {"value": ("value", "value"), "rgb": ("color", "color"), "identity_vector": ("vector", "vector")}


class Scope(NamedTuple):
    """Where a node is: its tree, and the group nodes that lead there. `path` makes keys unique."""

    path: str
    group: Any  # the group node this tree is inside, None at the root
    outer: Scope | None


_ROOT = Scope("", None, None)


class Translator:
    """One tree being translated. Sockets are followed through reroutes, muted nodes and groups to real nodes."""

    def __init__(self, node_tree, report, images) -> None:
        self.tree = node_tree
        self.images = images
        self.report = report
        self.graph = Graph()
        self._converts = bpy.app.version < (5, 0, 0)
        self._waiting: list[tuple[str, Any, Scope, Rule]] = []
        self._said: set[str] = set()

    def warn(self, node, message: str) -> None:
        """Report something about a node, once per kind of node and message."""
        text = f"node '{node.name}' ({node.bl_label}) {message}"
        if (node.bl_idname, message) not in self._said:
            self._said.add((node.bl_idname, message))
            self.report("WARNING", text)

    def run(self) -> Graph:
        """Translate what the active output shows."""
        output = active_output(self.tree)
        if output is None:
            return self.graph
        surface = output.inputs.get("Surface")
        self.graph.surface = self._shader_link(surface)
        volume = output.inputs.get("Volume")
        if volume is not None and volume.is_linked:
            self.report("WARNING", "volume shaders are not rendered")
            if self.graph.surface is None and output.bl_idname == "ShaderNodeOutputMaterial":
                # a volume alone leaves its surface invisible
                self.graph.nodes["volume only"] = Node("transparent", {"color": (1.0, 1.0, 1.0)})
                self.graph.surface = Link("volume only", "bsdf")
        displacement = output.inputs.get("Displacement")
        if displacement is not None and displacement.is_linked:
            link = self.value(displacement, _ROOT)
            self.graph.displacement = link if isinstance(link, Link) else None
        while self._waiting:
            self._translate(*self._waiting.pop())
        return self.graph

    def _shader_link(self, socket) -> Link | None:
        link = self.value(socket, _ROOT) if socket is not None else None
        return link if isinstance(link, Link) else None

    # ---- values of sockets

    def value(self, socket, scope: Scope) -> Link | Any:
        """What feeds an input socket: a Link, a constant, or None for the node's own default."""
        while True:
            link = (
                next((k for k in socket.links if k.is_valid and not k.is_muted), None)
                if socket.is_linked
                else None
            )
            if link is None:
                return constant_of(socket)
            node, output = link.from_node, link.from_socket
            if node.bl_idname == "NodeReroute":
                if not node.inputs[0].is_linked:
                    return constant_of(socket)
                socket = node.inputs[0]
            elif node.mute:
                inner = next((k.from_socket for k in node.internal_links if k.to_socket == output), None)
                if inner is None:
                    return constant_of(socket)
                socket = inner
            elif node.bl_idname == "NodeGroupInput":
                return self._from_outside(output, scope, socket)
            elif node.bl_idname == "ShaderNodeGroup" or getattr(node, "node_tree", None) is not None:
                return self._from_group(node, output, scope, socket)
            else:
                return self._from_node(node, output, scope, socket)

    def _from_outside(self, output, scope: Scope, asking) -> Link | Any:
        """A group's input, seen from inside: what feeds the group node's socket."""
        if scope.group is None:
            return constant_of(asking)
        outer = next((s for s in scope.group.inputs if s.identifier == output.identifier), None)
        if outer is None:
            return constant_of(asking)
        value = self.value(outer, scope.outer)
        if value is None and outer.type in _WRAPPERS:
            # a hidden value is a value here: inner sockets read it instead of the point
            value = plain(outer.default_value)
        return self._converted(value, outer, scope, f"input {outer.identifier}")

    def _from_group(self, group, output, scope: Scope, asking) -> Link | Any:
        """A group's output: what feeds it inside."""
        tree = group.node_tree
        if tree is None:
            return constant_of(asking)
        outputs = [n for n in tree.nodes if n.bl_idname == "NodeGroupOutput"]
        inside = next((n for n in outputs if n.is_active_output), outputs[0] if outputs else None)
        socket = None
        if inside is not None:
            socket = next((s for s in inside.inputs if s.identifier == output.identifier), None)
        if socket is None:
            return constant_of(asking)
        inner = Scope(f"{scope.path}{group.name}/", group, scope)
        return self._converted(self.value(socket, inner), socket, inner, f"output {socket.identifier}")

    def _converted(self, value: Link | Any, socket, scope: Scope, name: str) -> Link | Any:
        """A value that passes a group's border takes the type of the border's socket, before Blender 5.

        Since 5.0 groups are inlined before conversions are made.
        """
        kind = _WRAPPERS.get(socket.type)
        if not self._converts or not isinstance(value, Link) or kind is None:
            return value
        into, out = _WRAPPED[kind]
        key = f"{scope.path}{name}"
        self.graph.nodes[key] = Node(kind, {into: value})
        return Link(key, out)

    def _from_node(self, node, output, scope: Scope, asking) -> Link | Any:
        name = node.bl_idname.removeprefix("ShaderNode")
        if name in ("Value", "RGB"):
            return plain(output.default_value)
        if name == "Attribute" and node.attribute_type == "VIEW_LAYER":
            return self._view_layer_attribute(node, output)
        read = {"NewGeometry": DERIVED, "HairInfo": STRAND}.get(name, {}).get(output.identifier)
        if read is not None:
            self.graph.nodes[read] = Node("attribute", params={"name": read, "type": "GEOMETRY"})
            return Link(read, "fac")
        # without smoothing, light falls as it does without the node
        quadratic = name == "LightFalloff" and output.identifier == "Quadratic"
        if quadratic and self.value(node.inputs["Smooth"], scope) == 0.0:
            return self.value(node.inputs["Strength"], scope)
        rule = rule_of(node)
        if rule is None:
            self.warn(node, "is not supported; its default is used")
            return constant_of(asking)
        key = f"{scope.path}{node.name}"
        if key not in self.graph.nodes:
            self.graph.nodes[key] = Node(rule.kind)
            self._waiting.append((key, node, scope, rule))
        return Link(key, rule.output_name(output.identifier))

    def _view_layer_attribute(self, node, output) -> Any:
        """A custom property or RNA path of the view layer or scene: one value for the whole image."""
        value: Any = None
        for owner in (bpy.context.view_layer, bpy.context.scene, getattr(bpy.context.scene, "world", None)):
            if owner is None or value is not None:
                continue
            try:
                value = owner[node.attribute_name]
            except (KeyError, TypeError):
                try:
                    value = owner.path_resolve(node.attribute_name)
                except (ValueError, AttributeError):
                    value = None
        if value is None:
            return 0.0
        return plain(value)

    # ---- nodes

    def _translate(self, key: str, node, scope: Scope, rule: Rule) -> None:
        inputs: dict[str, Any] = {}
        for socket in node.inputs:
            name = rule.input_name(socket.identifier)
            if name is None or name in inputs or (not socket.enabled and not socket.is_linked):
                continue
            value = self.value(socket, scope)
            if value is None and reads_hidden(rule.kind, name):
                value = constant_of(socket, hidden=True)
            if value is not None:
                inputs[name] = value
        params = params_of(node, self)
        if rule.warning:
            self.warn(node, rule.warning)
        if node.bl_idname == "ShaderNodeBsdfMetallic" and node.fresnel_type == "PHYSICAL_CONDUCTOR":
            conductor = {"ior": inputs.pop("ior", None), "extinction": inputs.pop("extinction", None)}
            self.graph.nodes[f"{key}/conductor"] = Node("conductor", conductor)
            for name in ("base_color", "edge_tint"):
                inputs[name] = Link(f"{key}/conductor", name)
        self._texture_mapping(key, node, rule, inputs)
        self.graph.nodes[key] = Node(rule.kind, inputs, params)

    def _texture_mapping(self, key: str, node, rule: Rule, inputs: dict[str, Any]) -> None:
        """The mapping that texture nodes carry inside, where a script has set it."""
        mapping = getattr(node, "texture_mapping", None)
        if mapping is None or "vector" not in {s.identifier.lower() for s in node.inputs}:
            return
        location, rotation, scale = (tuple(getattr(mapping, n)) for n in ("translation", "rotation", "scale"))
        if (location, rotation, scale) == ((0, 0, 0), (0, 0, 0), (1, 1, 1)):
            return
        vector = inputs.get("vector")
        if vector is None:
            source = {"TexImage": "uv", "TexEnvironment": "generated"}
            name = source.get(node.bl_idname.removeprefix("ShaderNode"), "generated")
            self.graph.nodes[f"{key}/coordinates"] = Node("texture_coordinate")
            vector = Link(f"{key}/coordinates", name)
        self.graph.nodes[f"{key}/mapping"] = Node(
            "mapping",
            {"vector": vector, "location": location, "rotation": rotation, "scale": scale},
            {"type": mapping.vector_type},
        )
        inputs["vector"] = Link(f"{key}/mapping", "vector")


def plain(value: Any) -> Any:
    """A socket's value as a float or a tuple of floats."""
    if isinstance(value, (int, float, bool)):
        return float(value)
    try:
        return tuple(float(v) for v in value)
    except (TypeError, ValueError):
        return 0.0


def constant_of(socket, hidden: bool = False) -> Any:
    """An unlinked input's value, None where the node has a default of its own (normals, coordinates) or no value.

    hidden: values that Blender does not show count, too.
    """
    if (
        (socket.hide_value and not hidden)
        or not hasattr(socket, "default_value")
        or socket.type not in _WRAPPERS
    ):
        return None
    return plain(socket.default_value)


def reads_hidden(kind: str, name: str) -> bool:
    """Whether an input of the engine's node without a link is the value that Blender does not show, as in Cycles."""
    known = NODES[kind].inputs.get(name) if kind in NODES else None
    return known is not None and not isinstance(known[1], From)


def active_output(tree):
    """The output node that a Cycles render shows."""
    try:
        return tree.get_output_node("CYCLES")
    except (AttributeError, TypeError):
        outputs = [n for n in tree.nodes if n.bl_idname.startswith("ShaderNodeOutput") and n.inputs]
        return next((n for n in outputs if getattr(n, "is_active_output", False)), None)


def translate(node_tree, report, images) -> Graph:
    """The engine's graph of a material's, world's or light's node tree.

    Groups are inlined, reroutes and muted nodes bypassed, sockets named by table. report(level, message) is told each
    unsupported node once; images is an `images.ImageSync`.
    """
    return Translator(node_tree, report, images).run()
