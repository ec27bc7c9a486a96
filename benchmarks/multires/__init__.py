"""Method "raytrace" beside its rivals: error against time, growth with the scene, and stability along a camera path."""
