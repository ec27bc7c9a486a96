"""What a node reads from the point itself: Geometry, Object Info, Attribute, Light Path, Fresnel, ..."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading import points as P
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import (
    cross,
    dot,
    length,
    normalize,
    stack,
    transform_point,
    transform_transposed,
)


def reader(table: dict[str, tuple[str, ...]]):
    """`reads` of a node whose outputs each need the points' fields that `table` lists."""

    def reads(params: dict, wanted: frozenset[str]) -> set[str]:
        return {need for output in wanted for need in table.get(output, ())}

    return reads


def _float(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float32)


# ---- what unlinked inputs read


@node("implicit:normal", {}, {"value": VECTOR}, reads=lambda params, wanted: ("normal",))
def _normal(c: Call) -> np.ndarray:
    return c.points.normal


@node(
    "implicit:object_incoming",
    {},
    {"value": VECTOR},
    reads=lambda params, wanted: ("incoming", "world_from_part"),
)
def _object_incoming(c: Call) -> np.ndarray:
    return normal_to_object(c.points, c.points.incoming)


@node("implicit:generated", {}, {"value": VECTOR}, reads=lambda params, wanted: ("generated",))
def _generated(c: Call) -> np.ndarray:
    return c.points.generated


@node("implicit:position", {}, {"value": VECTOR}, reads=lambda params, wanted: ("position",))
def _position(c: Call) -> np.ndarray:
    return _float(c.points.position)


@node("implicit:incoming", {}, {"value": VECTOR}, reads=lambda params, wanted: ("incoming",))
def _incoming(c: Call) -> np.ndarray:
    return c.points.incoming


@node("implicit:uv", {}, {"value": VECTOR}, reads=lambda params, wanted: ("uv:",))
def _uv(c: Call) -> np.ndarray:
    return uv_vector(c.points.uvs[""])


def uv_vector(uv: np.ndarray) -> np.ndarray:
    """(n, 3) from (n, 2), z = 0."""
    return np.concatenate([uv, np.zeros((len(uv), 1), np.float32)], 1)


_TANGENT = ("generated", "normal", "world_from_part")


@node(
    "implicit:tangent",
    {},
    {"value": VECTOR},
    reads=lambda params, wanted: _TANGENT,
    varying=frozenset({"surface"}),
)
def _tangent(c: Call) -> np.ndarray:
    return radial_tangent(c.points, c.points.generated, c.points.normal, "Z")


def radial_tangent(points: P.SurfacePoints, around: np.ndarray, normal: np.ndarray, axis: str) -> np.ndarray:
    """(n, 3) unit tangents that run around an axis through the middle of generated space."""
    x, y, z = around[:, 0] - 0.5, around[:, 1] - 0.5, around[:, 2] - 0.5
    zero = np.zeros_like(x)
    t = stack(zero, -z, y) if axis == "X" else stack(-z, zero, x) if axis == "Y" else stack(-y, x, zero)
    return project_tangent(normal_to_world(points, t), normal)


def project_tangent(tangent: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The unit vector nearest to `tangent` that is square to `normal`."""
    return cross(normal, normalize(cross(tangent, normal)))


def normal_to_world(points: P.SurfacePoints, n: np.ndarray) -> np.ndarray:
    """Unit world normals of normals in the object's space."""
    from pointmr_engine.numerics.transforms import inverse_linear

    if points.world_from_part is None:
        return normalize(n)
    return normalize(transform_transposed(inverse_linear(points.world_from_part), n))


def normal_to_object(points: P.SurfacePoints, n: np.ndarray) -> np.ndarray:
    """Unit normals in the object's space of world normals."""
    return n if points.world_from_part is None else normalize(transform_transposed(points.world_from_part, n))


# ---- nodes

_GEOMETRY = {
    "position": ("position",),
    "tangent": _TANGENT,
    "true_normal": ("geometric_normal",),
    "incoming": ("incoming",),
    "parametric": ("barycentric",),
    "backfacing": ("backfacing",),
}


@node(
    "geometry",
    {"shading_normal": (VECTOR, From("normal"))},
    {
        "position": VECTOR,
        "normal": VECTOR,
        "tangent": VECTOR,
        "true_normal": VECTOR,
        "incoming": VECTOR,
        "parametric": VECTOR,
        "backfacing": FLOAT,
    },
    reads=reader(_GEOMETRY),
    ignores=lambda params, wanted: () if "normal" in wanted else ("shading_normal",),
    varying=frozenset({"instance"}),
)
def _geometry(c: Call) -> dict[str, np.ndarray]:
    p, out = c.points, {}
    for name in c.wanted:
        if name == "position":
            out[name] = _float(p.position)
        elif name == "normal":
            out[name] = c["shading_normal"]
        elif name == "tangent":
            out[name] = radial_tangent(p, p.generated, p.normal, "Z")
        elif name == "true_normal":
            out[name] = p.geometric_normal
        elif name == "incoming":
            out[name] = p.incoming
        elif name == "parametric":
            u, v = p.barycentric[:, 0], p.barycentric[:, 1]
            out[name] = stack(1 - u - v, u, np.zeros_like(u))
        else:
            out[name] = _float(p.backfacing)
    return out


_OBJECT_INFO = {
    "location": ("object_location",),
    "color": ("object_color",),
    "alpha": ("object_color",),
    "object_index": ("object_index",),
    "material_index": (),
    "random": ("object_random",),
}


@node(
    "object_info",
    {},
    {
        "location": VECTOR,
        "color": COLOR,
        "alpha": FLOAT,
        "object_index": FLOAT,
        "material_index": FLOAT,
        "random": FLOAT,
    },
    reads=reader(_OBJECT_INFO),
)
def _object_info(c: Call) -> dict[str, np.ndarray]:
    """params: material_index, of the material whose graph it is (scene.material.Material.surface_graph)."""
    p, out = c.points, {}
    for name in c.wanted:
        if name == "location":
            out[name] = p.object_location
        elif name == "color":
            out[name] = p.object_color[:, :3]
        elif name == "alpha":
            out[name] = p.object_color[:, 3]
        elif name == "object_index":
            out[name] = _float(p.object_index)
        elif name == "material_index":
            out[name] = np.full(1, c.params.get("material_index", 0), np.float32)
        else:
            out[name] = p.object_random
    return out


def _attribute_reads(params: dict, wanted: frozenset[str]) -> tuple[str]:
    group = "attribute" if params.get("type", "GEOMETRY") == "GEOMETRY" else "instance_attribute"
    return (f"{group}:{params.get('name', '')}",)


@node(
    "attribute",
    {},
    {"color": COLOR, "vector": VECTOR, "fac": FLOAT, "alpha": FLOAT},
    reads=_attribute_reads,
)
def _attribute(c: Call) -> dict[str, np.ndarray]:
    """params: name, type "GEOMETRY" or what an instance carries ("OBJECT", "INSTANCER")."""
    own = c.params.get("type", "GEOMETRY") == "GEOMETRY"
    values = (c.points.attributes if own else c.points.instance_attributes)[c.params.get("name", "")]
    mean = (values[:, 0] + values[:, 1] + values[:, 2]) * np.float32(1 / 3)
    return {"color": values[:, :3], "vector": values[:, :3], "fac": mean, "alpha": values[:, 3]}


@node(
    "color_attribute",
    {},
    {"color": COLOR, "alpha": FLOAT},
    reads=lambda params, wanted: (f"attribute:{params.get('name', '')}",),
)
def _color_attribute(c: Call) -> dict[str, np.ndarray]:
    """params: name, "" for the mesh's active colours."""
    values = c.points.attributes[c.params.get("name", "")]
    return {"color": values[:, :3], "alpha": values[:, 3]}


@node(
    "camera_data",
    {},
    {"view_vector": VECTOR, "view_z_depth": FLOAT, "view_distance": FLOAT},
    reads=lambda params, wanted: ("position", "camera_from_world"),
)
def _camera_data(c: Call) -> dict[str, np.ndarray]:
    v = transform_point(c.points.camera_from_world, c.points.position).astype(np.float32)
    return {"view_vector": normalize(v), "view_z_depth": v[:, 2], "view_distance": length(v)}


_RAY_BITS = {
    "is_camera_ray": P.RAY_CAMERA,
    "is_shadow_ray": P.RAY_SHADOW,
    "is_diffuse_ray": P.RAY_DIFFUSE,
    "is_glossy_ray": P.RAY_GLOSSY,
    "is_singular_ray": P.RAY_SINGULAR | P.RAY_MIRRORED,
    "is_reflection_ray": P.RAY_REFLECTION,
    "is_transmission_ray": P.RAY_TRANSMISSION,
}
_RAY_FIELDS = {
    "ray_length": "ray_length",
    "ray_depth": "ray_depth",
    "diffuse_depth": "diffuse_depth",
    "glossy_depth": "glossy_depth",
    "transmission_depth": "transmission_depth",
    "transparent_depth": "transparent_depth",
}
_LIGHT_PATH = dict.fromkeys(_RAY_BITS, ("ray_kind",)) | {k: (v,) for k, v in _RAY_FIELDS.items()}


@node(
    "light_path",
    {},
    {**dict.fromkeys(_LIGHT_PATH, FLOAT), "is_volume_scatter_ray": FLOAT, "portal_depth": FLOAT},
    reads=reader(_LIGHT_PATH),
)
def _light_path(c: Call) -> dict[str, np.ndarray]:
    p, out = c.points, {}
    for name in c.wanted:
        if name in _RAY_BITS:
            out[name] = _float((p.ray_kind & np.uint8(_RAY_BITS[name])) != 0)
        elif name in _RAY_FIELDS:
            out[name] = _float(getattr(p, _RAY_FIELDS[name]))
        else:
            out[name] = np.zeros(1, np.float32)
    return out


def fresnel_dielectric(cosine: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Reflectance (n,) of a smooth dielectric of relative index eta."""
    c = np.abs(cosine)
    g = eta * eta - 1 + c * c
    root = np.sqrt(np.maximum(g, 0))
    a = (root - c) / (root + c)
    b = (c * (root + c) - 1) / (c * (root - c) + 1)
    return np.where(g > 0, a * a * (1 + b * b) / 2, 1)


_FACING = ("incoming", "backfacing")


@node(
    "fresnel",
    {"ior": (FLOAT, 1.5), "normal": (VECTOR, From("normal"))},
    {"fac": FLOAT},
    reads=lambda params, wanted: _FACING,
)
def _fresnel(c: Call) -> np.ndarray:
    eta = np.maximum(c["ior"], 1e-5)
    eta = np.where(c.points.backfacing, 1 / eta, eta)
    return fresnel_dielectric(dot(c.points.incoming, c["normal"]), eta)


@node(
    "layer_weight",
    {"blend": (FLOAT, 0.5), "normal": (VECTOR, From("normal"))},
    {"fresnel": FLOAT, "facing": FLOAT},
    reads=reader({"fresnel": _FACING, "facing": ("incoming",)}),
)
def _layer_weight(c: Call) -> dict[str, np.ndarray]:
    cosine, blend = dot(c.points.incoming, c["normal"]), c["blend"]
    out = {}
    if "fresnel" in c.wanted:
        eta = np.maximum(1 - blend, 1e-5)
        out["fresnel"] = fresnel_dielectric(cosine, np.where(c.points.backfacing, eta, 1 / eta))
    if "facing" in c.wanted:
        b = np.clip(blend, 0, 1 - 1e-5)
        exponent = np.where(b < 0.5, 2 * b, 0.5 / (1 - b))
        out["facing"] = 1 - np.where(blend == 0.5, np.abs(cosine), np.power(np.abs(cosine), exponent))
    return out


@node("ambient_occlusion", {"color": (COLOR, 1.0)}, {"color": COLOR, "ao": FLOAT})
def _ambient_occlusion(c: Call) -> dict[str, np.ndarray]:
    return {"color": c["color"], "ao": np.ones(1, np.float32)}
