"""Fixed parameters of shader nodes: properties, tables of ramps and curves, images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

TABLE_SIZE = 257  # as Cycles samples ramps and curves


def _ramp(node, context) -> dict:
    ramp = node.color_ramp
    table = np.array([ramp.evaluate(i / (TABLE_SIZE - 1)) for i in range(TABLE_SIZE)], np.float32)
    return {"table": table, "interpolate": ramp.interpolation != "CONSTANT"}


def _curve_table(mapping, count: int) -> dict:
    """Curves 0 to count - 1 sampled over the range that all of them span; a combined fourth curve comes first."""
    mapping.initialize()
    curves = list(mapping.curves)
    xs = [p.location[0] for c in curves for p in c.points]
    low, high = min(xs, default=0.0), max(xs, default=1.0)
    if high <= low:
        high = low + 1.0
    positions = [low + i / (TABLE_SIZE - 1) * (high - low) for i in range(TABLE_SIZE)]
    if len(curves) > count:
        positions = [mapping.evaluate(curves[count], x) for x in positions]
    table = np.array([[mapping.evaluate(c, x) for c in curves[:count]] for x in positions], np.float32)
    return {"table": table, "low": low, "high": high, "extrapolate": mapping.extend == "EXTRAPOLATED"}


def _image(node, context) -> dict:
    return {
        "image": context.images.get(node.image, getattr(node, "image_user", None)) if node.image else None,
        "interpolation": node.interpolation,
        # Cycles divides by alpha only where the alpha output is used
        "unassociate": any(s.identifier == "Alpha" and s.is_linked for s in node.outputs),
    }


def _texture_coordinate(node, context) -> dict:
    if node.object is None:
        return {}
    m = node.object.matrix_world.inverted_safe()
    return {"object_from_world": np.array(m, np.float64)[:3]}


def _attribute(node, context) -> dict:
    return {"name": node.attribute_name, "type": node.attribute_type}


def _mix(node, context) -> dict:
    return {
        "blend": node.blend_type if node.data_type == "RGBA" else "MIX",
        "clamp_factor": node.clamp_factor,
        "clamp_result": node.clamp_result and node.data_type == "RGBA",
        "non_uniform": node.data_type == "VECTOR" and node.factor_mode == "NON_UNIFORM",
    }


def _ies(node, context) -> dict:
    import bpy

    if node.mode == "INTERNAL":
        return {"ies": node.ies.as_string() if node.ies else ""}
    path = Path(bpy.path.abspath(node.filepath, library=node.id_data.library))
    try:
        return {"ies": path.read_text(errors="replace")}
    except OSError as error:
        context.warn(node, f"cannot read the IES file: {error}")
        return {}


def _sky(node, context) -> dict:
    names = (
        "sky_type",
        "sun_disc",
        "sun_size",
        "sun_intensity",
        "sun_elevation",
        "sun_rotation",
        "altitude",
        "air_density",
        "ozone_density",
        "turbidity",
        "ground_albedo",
    )
    params = {name: getattr(node, name) for name in names if hasattr(node, name)}
    # 4.x called aerosols dust
    params["aerosol_density"] = getattr(node, "aerosol_density", getattr(node, "dust_density", 1.0))
    params["sun_direction"] = tuple(getattr(node, "sun_direction", (0.0, 0.0, 1.0)))
    return params


def _principled(node, context) -> dict:
    return {"distribution": node.distribution.lower(), "subsurface_method": node.subsurface_method}


def _distribution(node, context) -> dict:
    return {"distribution": node.distribution.lower()}


PARAMS = {
    "BsdfPrincipled": _principled,
    "BsdfAnisotropic": _distribution,
    "BsdfGlossy": _distribution,
    "BsdfGlass": _distribution,
    "BsdfRefraction": _distribution,
    "BsdfMetallic": _distribution,
    "BsdfSheen": _distribution,
    "ValToRGB": _ramp,
    "RGBCurve": lambda node, context: _curve_table(node.mapping, 3),
    "VectorCurve": lambda node, context: _curve_table(node.mapping, 3),
    "FloatCurve": lambda node, context: _curve_table(node.mapping, 1),
    "TexImage": lambda node, context: {
        **_image(node, context),
        "projection": node.projection,
        "blend": node.projection_blend,
        "extension": node.extension,
    },
    "TexEnvironment": lambda node, context: {**_image(node, context), "projection": node.projection},
    "TexCoord": _texture_coordinate,
    "UVMap": lambda node, context: {"layer": node.uv_map},
    "Attribute": _attribute,
    "VertexColor": lambda node, context: {"name": node.layer_name},
    "Tangent": lambda node, context: {
        "direction": node.direction_type,
        "axis": node.axis,
        "layer": node.uv_map,
    },
    "NormalMap": lambda node, context: {"space": node.space, "layer": node.uv_map},
    "Normal": lambda node, context: {"direction": tuple(node.outputs["Normal"].default_value)},
    "Bump": lambda node, context: {"invert": node.invert},
    "Displacement": lambda node, context: {"space": node.space},
    "VectorDisplacement": lambda node, context: {"space": node.space},
    "Mapping": lambda node, context: {"type": node.vector_type},
    "Math": lambda node, context: {"operation": node.operation, "clamp": node.use_clamp},
    "VectorMath": lambda node, context: {"operation": node.operation},
    "Clamp": lambda node, context: {"type": node.clamp_type},
    "MapRange": lambda node, context: {"interpolation": node.interpolation_type, "clamp": node.clamp},
    "Mix": _mix,
    "MixRGB": lambda node, context: {"blend": node.blend_type, "clamp_result": node.use_clamp},
    "SeparateColor": lambda node, context: {"mode": node.mode},
    "CombineColor": lambda node, context: {"mode": node.mode},
    "VectorRotate": lambda node, context: {"type": node.rotation_type, "invert": node.invert},
    "VectorTransform": lambda node, context: {
        "type": node.vector_type,
        "from": node.convert_from,
        "to": node.convert_to,
    },
    "TexNoise": lambda node, context: {
        "dimensions": node.noise_dimensions,
        "type": node.noise_type,
        "normalize": node.normalize,
    },
    "TexVoronoi": lambda node, context: {
        "dimensions": node.voronoi_dimensions,
        "metric": node.distance,
        "feature": node.feature,
        "normalize": node.normalize,
    },
    "TexWhiteNoise": lambda node, context: {"dimensions": node.noise_dimensions},
    "TexWave": lambda node, context: {
        "type": node.wave_type,
        "bands": node.bands_direction,
        "rings": node.rings_direction,
        "profile": node.wave_profile,
    },
    "TexMagic": lambda node, context: {"depth": node.turbulence_depth},
    "TexBrick": lambda node, context: {
        "offset": node.offset,
        "offset_frequency": node.offset_frequency,
        "squash": node.squash,
        "squash_frequency": node.squash_frequency,
    },
    "TexGradient": lambda node, context: {"type": node.gradient_type},
    "TexSky": _sky,
    "TexIES": _ies,
}
