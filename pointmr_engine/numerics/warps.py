"""Maps from the unit square to disks, spheres, cones, triangles and rectangles, each uniform in its own measure.

All float64 and scalar. u1 and u2 lie in [0, 1); the maps keep neighbouring numbers neighbours, so stratified numbers
give stratified points.
"""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import uncounted

OPPOSITE = -0.9999  # cosine between corners of a spherical triangle below which they are nearly opposite


@uncounted
def concentric_disk(u1, u2):
    """(x, y) in the unit disk, uniform in area (Shirley and Chiu)."""
    a = 2.0 * u1 - 1.0
    b = 2.0 * u2 - 1.0
    if a == 0.0 and b == 0.0:
        return 0.0, 0.0
    if a * a > b * b:
        r = a
        phi = (math.pi / 4) * (b / a)
    else:
        r = b
        phi = math.pi / 2 - (math.pi / 4) * (a / b)
    return r * math.cos(phi), r * math.sin(phi)


@uncounted
def orthonormal_basis(x, y, z):
    """Two unit vectors (x1, y1, z1, x2, y2, z2) that complete a unit vector to a right-handed basis (Duff 2017)."""
    s = math.copysign(1.0, z)
    a = -1.0 / (s + z)
    b = x * y * a
    return 1.0 + s * x * x * a, s * b, -s * x, b, s + y * y * a, -y


@uncounted
def cosine_hemisphere(x, y, z, u1, u2):
    """Direction (x, y, z) around the unit normal, with density cos / pi, and its cosine."""
    dx, dy = concentric_disk(u1, u2)
    c = math.sqrt(max(0.0, 1.0 - dx * dx - dy * dy))
    ax, ay, az, bx, by, bz = orthonormal_basis(x, y, z)
    return dx * ax + dy * bx + c * x, dx * ay + dy * by + c * y, dx * az + dy * bz + c * z, c


@uncounted
def uniform_cone(x, y, z, one_minus_cos, u1, u2):
    """Direction (x, y, z) within a cone around the unit axis, uniform in solid angle, and 1 - cos of its angle to it.

    one_minus_cos: 1 - cos of the cone's half angle; 2 gives the whole sphere. The density is 1 / (2 pi one_minus_cos).
    """
    dx, dy = concentric_disk(u1, u2)
    h = one_minus_cos * min(1.0, dx * dx + dy * dy)  # area on the sphere is proportional to height
    s = math.sqrt(max(0.0, one_minus_cos * (2.0 - h)))
    ax, ay, az, bx, by, bz = orthonormal_basis(x, y, z)
    c = 1.0 - h
    dx *= s
    dy *= s
    return dx * ax + dy * bx + c * x, dx * ay + dy * by + c * y, dx * az + dy * bz + c * z, h


@uncounted
def one_minus_cos_of_sine(sine_squared):
    """1 - cos(a) from sin(a)^2, a <= pi/2, without cancellation."""
    return sine_squared / (1.0 + math.sqrt(max(0.0, 1.0 - sine_squared)))


@uncounted
def triangle_barycentrics(u1, u2):
    """Barycentric weights (of vertices 1 and 2) of a point uniform in area (Heitz 2019, low distortion)."""
    if u2 > u1:
        b = 0.5 * u1
        return b, u2 - b
    c = 0.5 * u2
    return u1 - c, c


@uncounted
def triangle_solid_angle(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Solid angle of the triangle of three unit vectors (van Oosterom and Strackee)."""
    triple = abs(ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx))
    ab = ax * bx + ay * by + az * bz
    ac = ax * cx + ay * cy + az * cz
    bc = bx * cx + by * cy + bz * cz
    return 2.0 * math.atan2(triple, 1.0 + ab + ac + bc)


@uncounted
def spherical_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, solid_angle, u1, u2):
    """Direction in the spherical triangle of unit vectors a, b, c, uniform in solid angle (Arvo 1995)."""
    ab = ax * bx + ay * by + az * bz
    ac = ax * cx + ay * cy + az * cz
    bc = bx * cx + by * cy + bz * cz
    # of corners that are nearly opposite, the arc from the third would hang on rounding: they become a and c
    if min(ab, bc) < OPPOSITE and min(ab, bc) < ac:
        if ab < bc:
            ax, ay, az, bx, by, bz, cx, cy, cz = bx, by, bz, cx, cy, cz, ax, ay, az
            ab, ac = bc, ab
        else:
            ax, ay, az, bx, by, bz, cx, cy, cz = cx, cy, cz, ax, ay, az, bx, by, bz
            ab, ac = ac, bc
    # angle at a, between the planes ab and ac
    px, py, pz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    qx, qy, qz = ay * cz - az * cy, az * cx - ax * cz, ax * cy - ay * cx
    rx, ry, rz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    sin_alpha = math.sqrt(rx * rx + ry * ry + rz * rz)
    cos_alpha = px * qx + py * qy + pz * qz
    scale = math.hypot(sin_alpha, cos_alpha)
    if scale == 0.0:
        return ax, ay, az
    sin_alpha /= scale
    cos_alpha /= scale
    # the corner on the side ac that cuts off the share u1 of the area
    part = u1 * solid_angle
    s = math.sin(part) * cos_alpha - math.cos(part) * sin_alpha
    t = math.cos(part) * cos_alpha + math.sin(part) * sin_alpha
    u = t - cos_alpha
    v = s + sin_alpha * ab
    below = (v * s + u * t) * sin_alpha
    q = 1.0
    if below != 0.0:
        q = min(1.0, max(-1.0, ((v * t - u * s) * cos_alpha - v) / below))
    ex, ey, ez = cx - ac * ax, cy - ac * ay, cz - ac * az
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    if length == 0.0:
        return ax, ay, az
    w = math.sqrt(max(0.0, 1.0 - q * q)) / length
    dx, dy, dz = q * ax + w * ex, q * ay + w * ey, q * az + w * ez
    # a point on the arc from b to it, uniform in the remaining area
    db = dx * bx + dy * by + dz * bz
    z = 1.0 - u2 * (1.0 - db)
    fx, fy, fz = dx - db * bx, dy - db * by, dz - db * bz
    length = math.sqrt(fx * fx + fy * fy + fz * fz)
    if length == 0.0:
        return bx, by, bz
    w = math.sqrt(max(0.0, 1.0 - z * z)) / length
    return z * bx + w * fx, z * by + w * fy, z * bz + w * fz


@uncounted
def rectangle_solid_angle(x0, x1, y0, y1, z):
    """Solid angle of the axis-parallel rectangle [x0, x1] x [y0, y1] in the plane at distance |z| from the origin."""
    h = abs(z)
    z2 = z * z
    a = math.atan2(x1 * y1, h * math.sqrt(x1 * x1 + y1 * y1 + z2))
    b = math.atan2(x0 * y1, h * math.sqrt(x0 * x0 + y1 * y1 + z2))
    c = math.atan2(x1 * y0, h * math.sqrt(x1 * x1 + y0 * y0 + z2))
    d = math.atan2(x0 * y0, h * math.sqrt(x0 * x0 + y0 * y0 + z2))
    return max(0.0, (a - b) - (c - d))


@uncounted
def spherical_rectangle(x0, x1, y0, y1, z, solid_angle, u1, u2):
    """Point (x, y) of the rectangle, uniform in the solid angle that it fills from the origin (Urena et al. 2013)."""
    h = abs(z)
    # normals of the planes through the origin and the four sides: cosines with the rectangle's plane
    n0 = -y0 / math.sqrt(h * h + y0 * y0)
    n2 = y1 / math.sqrt(h * h + y1 * y1)
    n3 = -x0 / math.sqrt(h * h + x0 * x0)
    # angles between neighbouring planes, as deviations from a right angle: keeps small rectangles exact
    g2 = math.asin(min(1.0, max(-1.0, -n2 * n3)))
    g3 = math.asin(min(1.0, max(-1.0, -n3 * n0)))
    a = u1 * solid_angle + g2 + g3
    s = math.sin(a)
    x = x0
    if s != 0.0:
        f = (math.cos(a) * n0 + n2) / s
        c = math.copysign(1.0, f) / math.sqrt(f * f + n0 * n0)
        if abs(c) < 1.0:
            x = min(x1, max(x0, c * h / math.sqrt(1.0 - c * c)))
        else:
            x = x1 if c > 0.0 else x0
    d2 = x * x + h * h
    h0 = y0 / math.sqrt(d2 + y0 * y0)
    h1 = y1 / math.sqrt(d2 + y1 * y1)
    v = h0 + u2 * (h1 - h0)
    v2 = v * v
    y = y1
    if v2 < 1.0:
        y = min(y1, max(y0, v * math.sqrt(d2 / (1.0 - v2))))
    return x, y
