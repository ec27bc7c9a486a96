"""PointMR: multi-resolution rendering for scenes whose detail outgrows the screen. Needs no Blender.

from pointmr_engine import Scene, Group, Mesh, Camera, RenderSettings, render
frame = render(Scene(Group("root", [mesh]), Camera(...)), RenderSettings(width=320, height=240))
"""

from __future__ import annotations

from pointmr_engine.image.frame import Frame
from pointmr_engine.render import render
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group, Instances, instance
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.material import Material, emission, principled
from pointmr_engine.scene.mesh import Attribute, Mesh
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import ForwardSettings, RaytraceSettings, RenderSettings
from pointmr_engine.scene.texture import Image
from pointmr_engine.scene.world import World, uniform_world

__all__ = [
    "Attribute",
    "Camera",
    "ForwardSettings",
    "Frame",
    "Group",
    "Image",
    "Instances",
    "Light",
    "Material",
    "Mesh",
    "RaytraceSettings",
    "RenderSettings",
    "Scene",
    "SceneError",
    "World",
    "emission",
    "instance",
    "principled",
    "render",
    "uniform_world",
]
