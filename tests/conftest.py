"""Settings of all tests."""

from hypothesis import settings

# a kernel's first call compiles it, and machines are noisy: speed is measured in benchmarks/
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
