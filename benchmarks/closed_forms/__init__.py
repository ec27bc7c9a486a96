"""Scenes whose exact image is known by formula: independent judges of every method.

`python -m benchmarks.closed_forms` renders them and prints the errors. The formulas share no code with the engine.
"""
