"""What tests of the extension share."""

import pytest


@pytest.fixture(scope="module")
def engine():
    """PointMR registered in Blender, for a module's tests."""
    import blender_addon  # its modules have asked for bpy, without which they are skipped

    blender_addon.register()
    yield
    blender_addon.unregister()
