"""What a scene and its settings require. The stages ask this before they compile, build, trace or store anything."""

from __future__ import annotations

from dataclasses import dataclass

from pointmr_engine.scene.settings import RenderSettings


@dataclass(frozen=True)
class Needs:
    """Decided once per render, after the node graphs are compiled; `render(...)` puts it into the frame's statistics.

    max_lobes: of any material. light_samples: something is worth sampling as a light. stray_light: a ray that a BSDF
    chose and that may not scatter again can still meet light. transparent_shadows: some surface lets shadow rays
    through. window: some graph reads window coordinates. lens: rays are spread over the camera's lens.
    surface_passes: passes that are made where a camera ray meets a surface.
    """

    max_lobes: int
    light_samples: bool
    stray_light: bool
    transparent_shadows: bool
    window: bool
    lens: bool
    surface_passes: tuple[str, ...]


def decide_needs(programs: list, lights, settings: RenderSettings, lens: bool) -> Needs:
    """The needs of a scene with these compiled materials (shading.program.Program) and lights (raytracing.lights)."""
    emissive = any(p.emissive for p in programs)
    met = len(lights.arrays.met_lamps) > 0
    return Needs(
        max_lobes=max((p.max_lobes for p in programs), default=1),
        light_samples=not lights.empty,
        stray_light=emissive or met or not lights.environment.black,
        transparent_shadows=any(not p.opaque for p in programs),
        window=any("window" in p.needs or "window" in p.transparency_needs for p in programs),
        lens=lens,
        surface_passes=tuple(p for p in settings.passes if p not in ("combined", "sample_count")),
    )
