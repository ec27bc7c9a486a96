"""What a finished image leaves behind: nothing that waits for Python's collector of rings."""

import gc
import weakref

import pytest

from pointmr_engine import Camera, ForwardSettings, RaytraceSettings, RenderSettings, render, uniform_world
from pointmr_engine.forward.method import Image
from pointmr_engine.render import Cache
from tests.engine.small_scenes import from_above, lit_floor, quad

GREY = uniform_world((0.3, 0.3, 0.3))
CASES = {
    "static, simple": {"forward": ForwardSettings(shading="simple")},
    "static, full": {"forward": ForwardSettings(shading="full", shadows=True)},
    "dynamic": {"forward": ForwardSettings(sampling="dynamic")},
    "gaussian": {"forward": ForwardSettings(reconstruction="gaussian")},
    "raytrace": {"raytrace": RaytraceSettings()},
    "by alpha": {"raytrace": RaytraceSettings(visibility="alpha")},
    "through a lens": {"raytrace": RaytraceSettings()},
}


@pytest.mark.parametrize("case", CASES)
def test_finished_images_are_gone(case, monkeypatch):
    """Their points, fragments and paths are most of what a render takes, and animations make many."""
    values = CASES[case]
    scene = lit_floor(quad(1.0, 0.5), world=GREY)
    if case == "through a lens":
        scene.camera = from_above(fstop=0.5, focus_distance=4.0)
    assert isinstance(scene.camera, Camera)
    chosen = RenderSettings(24, 24, method=next(iter(values)), threads=1, **values)
    seen, begin = [], Image.__init__

    def noted(self, *arguments):
        seen.append(weakref.ref(self))
        begin(self, *arguments)

    monkeypatch.setattr(Image, "__init__", noted)
    cache = Cache()
    render(scene, chosen, cache=cache)  # kernels and their compilers have rings of their own
    gc.collect()
    gc.disable()
    try:
        for _ in range(2):
            render(scene, chosen, cache=cache)
        assert len(seen) >= 3 and all(image() is None for image in seen)
    finally:
        gc.enable()
