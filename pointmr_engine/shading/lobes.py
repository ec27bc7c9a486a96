"""BSDF lobes: leaves and view become lobes, which are evaluated and sampled.

Per batch: `reset(lobes, view)`, then `append(...)` for every leaf of every material's points, then per point
the njit functions `evaluate` and `sample`. Directions point away from the surface: `wi` to the viewer, `wo` to
the light; both are tuples of three float64. Values are BSDF times |cos|.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading import leaves
from pointmr_engine.shading.bsdf import diffuse, glossy, sheen, velvet
from pointmr_engine.shading.bsdf.albedo_tables import Tables, load_tables  # noqa: F401
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    BUMP_CORRECTION,
    BUMPED,
    COLUMN_COUNT,
    F0,
    HAS_DIFFUSE,  # noqa: F401  (from here on also the public names of lobes)
    HAS_EVALUATION,  # noqa: F401
    HAS_SINGULAR,  # noqa: F401
    HAS_TRANSMISSION,  # noqa: F401
    IOR,
    KIND_MASK,
    LABEL_DIFFUSE,
    LABEL_GLOSSY,
    LABEL_NONE,
    LABEL_REFLECT,
    LABEL_SINGULAR,
    LABEL_TRANSMIT,
    LABEL_TRANSPARENT,
    NORMAL,
    OREN_NAYAR,
    SAMPLE,
    SHEEN,
    SINGULAR_LOBE,
    TANGENT,
    TRANSLUCENT,
    VELVET,
    WEIGHT,
    Lobes,
    View,
)
from pointmr_engine.shading.bsdf.vector import (
    combine,
    cosine_hemisphere,
    cross,
    dot,
    load3,
    mean,
    normalized,
    row3,
    to_world,
)
from pointmr_engine.shading.leaves import Leaf

_NO_VECTOR = np.zeros((1, 3), np.float32)
_BLACK = (0.0, 0.0, 0.0)


def allocate(n: int, max_lobes: int, tables: Tables | None = None) -> Lobes:
    """Room for n points of up to max_lobes lobes each (a Principled leaf needs up to 7, any other leaf 1)."""
    tables = tables or load_tables()
    rows = max(n, 1)
    return Lobes(
        np.zeros(rows, np.int32),
        np.zeros((rows, max(max_lobes, 1)), np.int32),
        np.zeros((rows, max(max_lobes, 1), COLUMN_COUNT), np.float32),
        np.zeros((rows, 3), np.float32),
        np.zeros((rows, 3), np.float32),
        np.zeros(rows, np.float32),
        np.zeros((rows, 3), np.float32),
        np.zeros(rows, np.uint8),
        np.zeros((rows, 3), np.float32),
        np.zeros((rows, 3), np.float32),
        tables.film,
    )


def reset(lobes: Lobes, view: View, bump_correction: bool = True) -> None:
    """Empty the first len(view.incoming) points and note their normals.

    bump_correction: soften the shadow terminator of bumped normals and keep reflections above the surface.
    """
    n = len(view.incoming)
    lobes.count[:n] = 0
    lobes.emission[:n] = 0.0
    lobes.transparency[:n] = 0.0
    lobes.holdout[:n] = 0.0
    lobes.diffuse_color[:n] = 0.0
    lobes.flags[:n] = BUMP_CORRECTION if bump_correction else 0
    lobes.normal[:n] = view.normal
    lobes.geometric_normal[:n] = view.geometric_normal


def append(
    lobes: Lobes,
    leaf: Leaf,
    rows: np.ndarray,
    view: View,
    tables: Tables,
    reflective_caustics: bool = True,
    refractive_caustics: bool = True,
) -> None:
    """Expand a leaf into lobes of the points `rows` ((m,) distinct int64, rows of view and lobes).

    The leaf's block and normals have m rows or 1. Weights and parameters are clamped as Cycles does; values that
    are not finite count as 0. A point without room for another lobe keeps what it has. A leaf that could be
    anisotropic is not where its tangent is missing or zero.
    """
    if len(rows) == 0:
        return
    rows = np.ascontiguousarray(rows, np.int64)
    block = np.ascontiguousarray(leaf.block, np.float32)
    if not np.isfinite(block.sum()):
        block = np.nan_to_num(block, nan=0.0, posinf=0.0, neginf=0.0)
    if not block.flags.writeable:
        # a read-only array is another type to numba, for which all would compile once more
        block = block.copy()
    kind = leaf.kind
    if kind in (leaves.TRANSPARENT, leaves.EMISSION, leaves.BACKGROUND, leaves.HOLDOUT):
        _append_sums(lobes, kind, rows, block[:, :3])
        return
    if leaf.surface_normal is not None:
        lobes.normal[rows] = leaf.surface_normal
    normals = _vectors(leaf.normal)
    multiple = leaf.distribution == "multi_ggx"
    modifiers = BECKMANN if leaf.distribution == "beckmann" else 0
    if leaf.distribution == "sharp" and kind in (leaves.GLOSSY, leaves.GLASS, leaves.REFRACTION):
        block = block.copy()
        block[:, leaves.COLUMNS[kind].index("roughness")] = 0.0
    reflective, refractive = bool(reflective_caustics), bool(refractive_caustics)

    from pointmr_engine.shading.bsdf import principled, simple

    if kind == leaves.PRINCIPLED:
        coat_normals, tangents = _vectors(leaf.coat_normal), _vectors(leaf.tangent)
        principled.append(
            lobes,
            rows,
            view,
            tables,
            block,
            normals,
            coat_normals,
            tangents,
            reflective,
            refractive,
            multiple,
        )
    elif kind in (leaves.DIFFUSE, leaves.SUBSURFACE, leaves.TRANSLUCENT):
        simple.append_diffuse(lobes, rows, view, block, normals, kind == leaves.TRANSLUCENT)
    elif kind == leaves.SHEEN and leaf.distribution == "ashikhmin":
        simple.append_velvet(lobes, rows, view, block, normals)
    elif kind == leaves.SHEEN:
        simple.append_sheen(lobes, rows, view, tables, block, normals)
    elif kind == leaves.GLOSSY:
        if leaf.distribution == "ashikhmin_shirley":
            modifiers = ASHIKHMIN_SHIRLEY
        tangents = _vectors(leaf.tangent)
        simple.append_glossy(
            lobes, rows, view, tables, block, normals, tangents, reflective, modifiers, multiple
        )
    elif kind == leaves.METALLIC:
        tangents = _vectors(leaf.tangent)
        simple.append_metallic(
            lobes, rows, view, tables, block, normals, tangents, reflective, modifiers, multiple
        )
    elif kind == leaves.GLASS:
        simple.append_glass(
            lobes, rows, view, tables, block, normals, reflective, refractive, modifiers, multiple
        )
    elif kind == leaves.REFRACTION:
        simple.append_refraction(lobes, rows, view, block, normals, refractive, modifiers)
    else:
        raise ValueError(f"leaf kind {kind} has no lobes")


def _vectors(vectors: np.ndarray | None) -> np.ndarray:
    if vectors is None:
        return _NO_VECTOR
    vectors = np.ascontiguousarray(np.atleast_2d(vectors), np.float32)
    return vectors if vectors.flags.writeable else vectors.copy()


def _append_sums(lobes: Lobes, kind: int, rows: np.ndarray, weight: np.ndarray) -> None:
    """Leaves that are no lobes: what they add to the point's sums."""
    if kind == leaves.TRANSPARENT:
        lobes.transparency[rows] += np.maximum(weight, 0.0)
    elif kind == leaves.HOLDOUT:
        lobes.holdout[rows] += weight.mean(axis=1)
    else:
        lobes.emission[rows] += weight


@device
def _bump_shadowing(lobes, i, j, base, wo, sampled):
    """How much of direction wo a lobe with a bumped normal gets: nothing through the smooth surface, and a soft
    terminator for diffuse lobes (Conty Estevez, Lecocq, Stein 2019)."""
    ns = row3(lobes.normal, i)
    normal = load3(lobes.data, i, j, NORMAL)
    cos_so = dot(ns, wo)
    cos_sn = dot(ns, normal)
    is_diffuse = base <= TRANSLUCENT and base != VELVET  # to Cycles velvet is glossy here
    if cos_so * cos_sn * dot(normal, wo) < 0.0 and (is_diffuse or not sampled):
        return 0.0
    if not is_diffuse or not lobes.flags[i] & BUMP_CORRECTION:
        return 1.0
    cos_i = abs(cos_so)
    cos_d = abs(cos_sn)
    if cos_d >= 1.0 or cos_i >= 1.0:
        return 1.0
    if cos_i < 1e-6:
        return 0.0
    alpha2 = min(0.125 * (1.0 / (cos_d * cos_d) - 1.0), 1.0)
    return 2.0 / (1.0 + math.sqrt(1.0 + alpha2 * (1.0 / (cos_i * cos_i) - 1.0)))


@device
def _diffuse_value(data, i, j, base, wi, wo):
    """A diffuse lobe's BSDF * cos without its weight, and pdf."""
    normal = load3(data, i, j, NORMAL)
    cos_no = dot(normal, wo)
    if base == TRANSLUCENT:
        cos_no = -cos_no
    elif base == SHEEN:
        x = load3(data, i, j, TANGENT)
        a = np.float64(data[i, j, ALPHA_X])
        b = np.float64(data[i, j, ALPHA_Y])
        f = sheen.evaluate(a, b, dot(x, wo), dot(cross(normal, x), wo), cos_no)
        return (f, f, f), f
    elif base == VELVET:
        f, pdf = velvet.evaluate(np.float64(data[i, j, ALPHA_X]), normal, wi, wo)
        return (f, f, f), pdf
    if cos_no <= 0.0:
        return _BLACK, 0.0
    f = cos_no / math.pi
    if base == OREN_NAYAR:
        a = np.float64(data[i, j, ALPHA_X])
        b = np.float64(data[i, j, ALPHA_Y])
        multiple = load3(data, i, j, F0)
        return diffuse.evaluate(a, b, multiple, dot(normal, wi), cos_no, dot(wi, wo)), f
    return (f, f, f), f


@device
def value_of(lobes, i, j, wi, wo, sampled):
    """Lobe j of point i between two directions, weight and bump included -> (BSDF * |cos| rgb, pdf, transmitted).

    pdf: of choosing wo once the lobe is chosen; 0 also where bumps shut the lobe. sampled: wo was drawn from this very
    lobe, which alone ignores the bumped leak test.
    """
    kind = lobes.kind[i, j]
    base = kind & KIND_MASK
    transmitted = False
    if kind & SINGULAR_LOBE:
        return _BLACK, 0.0, transmitted
    if base <= TRANSLUCENT:
        f, pdf = _diffuse_value(lobes.data, i, j, base, wi, wo)
        transmitted = base == TRANSLUCENT
    else:
        f, pdf, transmitted = glossy.evaluate(kind, lobes.data, i, j, lobes.film_table, wi, wo)
    if not pdf > 0.0:
        return _BLACK, 0.0, transmitted
    shadow = 1.0
    if kind & BUMPED and not (sampled and transmitted):
        shadow = _bump_shadowing(lobes, i, j, base, wo, sampled)
        if shadow == 0.0 and not sampled:
            return _BLACK, 0.0, transmitted
    w = load3(lobes.data, i, j, WEIGHT)
    return (shadow * w[0] * f[0], shadow * w[1] * f[1], shadow * w[2] * f[2]), pdf, transmitted


@device
def _sum(lobes, i, wi, wo, sampled):
    """`evaluate`, with the lobe that wo was sampled from (-1: none)."""
    diffuse_sum = matt_sum = _BLACK
    glossy_sum = _BLACK
    transmission_sum = _BLACK
    pdf_sum = 0.0
    weight_sum = mean(row3(lobes.transparency, i))
    for j in range(np.int64(lobes.count[i])):
        sample_weight = np.float64(lobes.data[i, j, SAMPLE])
        weight_sum += sample_weight
        f, pdf, transmitted = value_of(lobes, i, np.int64(j), wi, wo, j == sampled)
        if not pdf > 0.0:
            continue
        pdf_sum += pdf * sample_weight
        if lobes.kind[i, j] & KIND_MASK <= TRANSLUCENT:
            diffuse_sum = combine(1.0, diffuse_sum, 1.0, f)
            if lobes.kind[i, j] & KIND_MASK <= OREN_NAYAR:
                matt_sum = combine(1.0, matt_sum, 1.0, f)
        elif transmitted:
            transmission_sum = combine(1.0, transmission_sum, 1.0, f)
        else:
            glossy_sum = combine(1.0, glossy_sum, 1.0, f)
    pdf = pdf_sum / weight_sum if weight_sum > 0.0 else 0.0
    return diffuse_sum, matt_sum, glossy_sum, transmission_sum, pdf


@uncounted
def evaluate(lobes, i, wi, wo):
    """All lobes of point i between two directions -> (diffuse rgb, matt rgb, glossy rgb, transmission rgb, pdf).

    Each rgb is a tuple, BSDF * |cos|; their sum, without matt, is the total. matt: the part of diffuse that Lambertian
    and Oren-Nayar lobes have; sheen, velvet and translucent ones count as diffuse too. pdf is that of `sample`, per
    solid angle, with the chance of choosing each lobe (transparency included). Singular lobes contribute nothing.
    """
    return _sum(lobes, i, wi, wo, np.int64(-1))


@device
def diffuse_direction(lobes, i, j, u1, u2):
    """A direction of the diffuse lobe j of point i, as `sample` draws it; a translucent one's lies behind."""
    base = lobes.kind[i, j] & KIND_MASK
    normal = normalized(load3(lobes.data, i, j, NORMAL), row3(lobes.geometric_normal, i))
    if base == TRANSLUCENT:
        return cosine_hemisphere((-normal[0], -normal[1], -normal[2]), u1, u2)
    if base == SHEEN:
        a = np.float64(lobes.data[i, j, ALPHA_X])
        b = np.float64(lobes.data[i, j, ALPHA_Y])
        x = load3(lobes.data, i, j, TANGENT)
        local = sheen.sample(a, b, u1, u2)
        return to_world(local[0], local[1], local[2], x, cross(normal, x), normal)
    if base == VELVET:
        return velvet.sample(normal, u1, u2)
    return cosine_hemisphere(normal, u1, u2)


@uncounted
def sample(lobes, i, wi, u_choose, u1, u2):
    """Choose a lobe of point i and a direction -> (wo, value rgb, pdf, label, alpha, eta).

    value / pdf is the throughput: for a lobe with an extent, value is the sum of all lobes and pdf that of
    `evaluate`; for LABEL_SINGULAR and LABEL_TRANSPARENT both are relative to a delta (only the ratio counts, the
    weight of multiple importance sampling is 1). LABEL_NONE: absorbed, pdf is 0. alpha: the sampled lobe's
    sqrt(alpha_x alpha_y) (1 diffuse, 0 singular); eta: relative index of refraction of a refracted direction,
    else 1.
    """
    straight = (-wi[0], -wi[1], -wi[2])
    transparency = row3(lobes.transparency, i)
    clear = mean(transparency)
    total = clear
    for j in range(np.int64(lobes.count[i])):
        total += np.float64(lobes.data[i, j, SAMPLE])
    if not total > 0.0:
        return straight, _BLACK, 0.0, LABEL_NONE, 1.0, 1.0
    left = u_choose * total
    if left < clear:
        return straight, transparency, clear / total, LABEL_TRANSPARENT | LABEL_TRANSMIT, 0.0, 1.0
    left -= clear
    chosen = -1
    sample_weight = 0.0
    for j in range(np.int64(lobes.count[i])):
        w = np.float64(lobes.data[i, j, SAMPLE])
        if w > 0.0:
            if chosen >= 0:
                left -= sample_weight
            chosen = j
            sample_weight = w
            if left < w:
                break
    if chosen < 0:
        return straight, _BLACK, 0.0, LABEL_NONE, 1.0, 1.0
    u = min(max(left / sample_weight, 0.0), 0.9999999999)

    kind = lobes.kind[i, chosen]
    base = kind & KIND_MASK
    ng = row3(lobes.geometric_normal, i)
    refracted = False
    alpha = 1.0
    eta = 1.0
    if base <= TRANSLUCENT:
        label = LABEL_DIFFUSE
        refracted = base == TRANSLUCENT
        wo = diffuse_direction(lobes, i, np.int64(chosen), u1, u2)
    else:
        label = LABEL_GLOSSY
        alpha = math.sqrt(
            np.float64(lobes.data[i, chosen, ALPHA_X]) * np.float64(lobes.data[i, chosen, ALPHA_Y])
        )
        wo, refracted, singular, f, chance = glossy.sample(
            kind, lobes.data, i, chosen, lobes.film_table, wi, u, u1, u2
        )
        normal = load3(lobes.data, i, chosen, NORMAL)
        if chance <= 0.0 or (dot(normal, wo) < 0.0) != refracted:
            return wo, _BLACK, 0.0, LABEL_NONE, alpha, 1.0
        if refracted:
            eta = np.float64(lobes.data[i, chosen, IOR])
        if singular:
            if (dot(ng, wo) < 0.0) != refracted:
                return wo, _BLACK, 0.0, LABEL_NONE, alpha, 1.0
            w = load3(lobes.data, i, chosen, WEIGHT)
            value = (w[0] * f[0], w[1] * f[1], w[2] * f[2])
            label = LABEL_SINGULAR | (LABEL_TRANSMIT if refracted else LABEL_REFLECT)
            return wo, value, chance * sample_weight / total, label, 0.0, eta
    if (dot(ng, wo) < 0.0) != refracted:
        return wo, _BLACK, 0.0, LABEL_NONE, alpha, 1.0
    d, _, g, t, pdf = _sum(lobes, i, wi, wo, chosen)
    if not pdf > 0.0:
        return wo, _BLACK, 0.0, LABEL_NONE, alpha, 1.0
    value = (d[0] + g[0] + t[0], d[1] + g[1] + t[1], d[2] + g[2] + t[2])
    label |= LABEL_TRANSMIT if refracted else LABEL_REFLECT
    return wo, value, pdf, label, alpha, eta
