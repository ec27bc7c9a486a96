"""All closed forms."""

from __future__ import annotations

from benchmarks.closed_forms import (
    bounces,
    curved_mirror,
    defocus,
    patches,
    patterns,
    penumbra,
    rough_mirror,
    sky,
)
from benchmarks.closed_forms.stage import Case

MODULES = (penumbra, defocus, curved_mirror, rough_mirror, patches, patterns, sky, bounces)


def all_cases() -> list[Case]:
    """Every case, in the order of the table."""
    return [case for module in MODULES for case in module.cases()]
