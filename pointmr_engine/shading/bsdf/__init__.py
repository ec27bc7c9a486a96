"""Scattering models behind `shading.lobes`: one file per model, scalar numba functions over plain tuples."""
