"""The engine's error for input that cannot be rendered."""


class SceneError(ValueError):
    """Bad input, named: the message says which object, mesh, light or index is wrong and why."""
