"""The scene: everything that an image depends on, apart from the settings."""

from __future__ import annotations

from dataclasses import dataclass, field

from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group, unique_groups
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.world import World


@dataclass
class Scene:
    """Root group in world space (metres, right-handed, z up), camera, lamps and world."""

    root: Group
    camera: Camera | None = None
    lights: list[Light] = field(default_factory=list)
    world: World = field(default_factory=World)

    def validate(self) -> list[str]:
        """Raise SceneError for what cannot be rendered (cycle, no camera, malformed mesh); return warnings."""
        if self.camera is None:
            raise SceneError("the scene has no camera")
        warnings = []
        for group in unique_groups(self.root):
            for mesh in group.meshes:
                warnings += mesh.validate()
        return warnings
