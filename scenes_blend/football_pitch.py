"""A football pitch: mown grass, chalk lines, goals."""

from __future__ import annotations

import numpy as np
from parts import add, grid_faces, material, mesh
from plants import tube


def pitch() -> None:
    def build(n):
        at = n("SeparateXYZ", n("TexCoord").outputs["Object"])
        stripe = n.math(
            "GREATER_THAN",
            n.math("FRACT", n.math("DIVIDE", n.math("ADD", at.outputs["X"], 57.75), 10.5)),
            0.5,
        )
        other = n.math(
            "GREATER_THAN", n.math("FRACT", n.math("DIVIDE", n.math("ADD", at.outputs["Y"], 51.0), 17.0)), 0.5
        )
        fine = n("TexNoise", vector=n("TexCoord").outputs["Object"], scale=1.4, detail=6, roughness=0.7)
        tone = n.math(
            "ADD",
            n.math("MULTIPLY", stripe, 0.30),
            n.math("MULTIPLY_ADD", other, 0.10, n.math("MULTIPLY", fine, 0.6)),
        )
        return {"base_color": n.ramp(tone, (0.22, (0.030, 0.105, 0.018)), (0.75, (0.075, 0.20, 0.034)))}

    grass = material("Grass", build, roughness=0.85, specular_ior_level=0.2)
    x, y = np.meshgrid([-58.5, 58.5], [-39.5, 39.5])
    p = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    add("Pitch", mesh("Pitch", p, grid_faces(2, 2), [grass], smooth=False))
    points, faces = [], []

    def stroke(path, closed=False):
        path = np.asarray(path, float)
        ahead = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
        side = np.stack([-ahead[:, 1], ahead[:, 0]], 1) / np.linalg.norm(ahead, axis=1)[:, None] * 0.07
        first = sum(map(len, points))
        points.append(
            np.concatenate(
                [np.c_[path + side, np.full(len(path), 0.012)], np.c_[path - side, np.full(len(path), 0.012)]]
            )
        )
        faces.append(grid_faces(2, len(path), wrap=closed)[:, ::-1] + first)

    def line(*ends):
        for a, b in zip(ends[:-1], ends[1:], strict=True):
            a, b = np.array(a, float), np.array(b, float)
            d = 0.07 * (b - a) / np.linalg.norm(b - a)
            stroke([a - d, b + d])

    def arc(x, y, r, start, stop):
        a = np.linspace(start, stop, 64)
        stroke(np.stack([x + r * np.cos(a), y + r * np.sin(a)], 1))

    line((-52.5, -34), (52.5, -34), (52.5, 34), (-52.5, 34), (-52.5, -34))
    line((0, -34), (0, 34))
    arc(0, 0, 9.15, 0, 2 * np.pi)
    arc(0, 0, 0.12, 0, 2 * np.pi)
    for s in (-1, 1):
        line((52.5 * s, -20.16), (36 * s, -20.16), (36 * s, 20.16), (52.5 * s, 20.16))
        line((52.5 * s, -9.16), (47 * s, -9.16), (47 * s, 9.16), (52.5 * s, 9.16))
        arc(41.5 * s, 0, 0.12, 0, 2 * np.pi)
        half = np.arccos(5.5 / 9.15)
        turn = np.pi if s > 0 else 0
        arc(41.5 * s, 0, 9.15, turn - half, turn + half)
    chalk = material("Chalk", base_color=(0.8, 0.8, 0.8), roughness=0.9)
    add("Lines", mesh("Lines", np.concatenate(points), np.concatenate(faces), [chalk], smooth=False))
    posts, net = (
        material("Posts", base_color=(0.85, 0.85, 0.85), roughness=0.3),
        material("Net", base_color=(0.7, 0.7, 0.7)),
    )
    for s in (-1, 1):
        g = 52.5 * s
        frame = [(g, -3.66, 0), (g, -3.66, 2.44), (g, 3.66, 2.44), (g, 3.66, 0)]
        pieces = [
            tube(np.array([a, b], float), np.full(2, 0.06), 10)
            for a, b in zip(frame[:-1], frame[1:], strict=True)
        ]
        back = g + 1.9 * s
        for w in np.linspace(-3.66, 3.66, 30):
            pieces.append(
                tube(np.array([(g, w, 2.44), (g + 0.9 * s, w, 2.35), (back, w, 0)]), np.full(3, 0.012), 3)
            )
        for f in np.linspace(0.1, 1.0, 11):
            pieces.append(
                tube(
                    np.array(
                        [
                            (g + s * (0.9 + f), -3.66, 2.35 * (1 - f)),
                            (g + s * (0.9 + f), 3.66, 2.35 * (1 - f)),
                        ]
                    ),
                    np.full(2, 0.012),
                    3,
                )
            )
        p = np.concatenate([q for q, _ in pieces])
        first = np.cumsum([0] + [len(q) for q, _ in pieces])
        f = np.concatenate([q + n for (_, q), n in zip(pieces, first[:-1], strict=True)])
        index = np.concatenate([np.full(len(q), int(i > 2)) for i, (_, q) in enumerate(pieces)])
        add(f"Goal {s}", mesh(f"Goal {s}", p, f, [posts, net], material_index=index))
