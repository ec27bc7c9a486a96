"""Measuring: our methods against each other and against Cycles, each in its own process."""
