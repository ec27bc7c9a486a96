"""Every kind of glossy lobe behind one interface: microfacets, and the model of Ashikhmin and Shirley."""

from __future__ import annotations

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf import ashikhmin_shirley, microfacet
from pointmr_engine.shading.bsdf.layout import ASHIKHMIN_SHIRLEY, KIND_MASK


@device
def evaluate(kind, data, i, j, film_table, wi, wo):
    """Lobe j of point i between two directions, without its weight: (BSDF * |cos| rgb, pdf, transmitted)."""
    if kind & KIND_MASK == ASHIKHMIN_SHIRLEY:
        grey, pdf = ashikhmin_shirley.evaluate(kind, data, i, j, wi, wo)
        return (grey, grey, grey), pdf, False
    return microfacet.evaluate(kind, data, i, j, film_table, wi, wo)


@device
def sample(kind, data, i, j, film_table, wi, u, u1, u2):
    """A direction of lobe j, as of `microfacet.sample`: (wo, refracted, singular, f rgb, chance); chance 0: none."""
    if kind & KIND_MASK == ASHIKHMIN_SHIRLEY:
        return ashikhmin_shirley.sample(kind, data, i, j, wi, u1, u2), False, False, (1.0, 1.0, 1.0), 1.0
    return microfacet.sample(kind, data, i, j, film_table, wi, u, u1, u2)
