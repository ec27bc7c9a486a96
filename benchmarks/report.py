"""Tables of results in Markdown, and the command that wrote them."""

from __future__ import annotations

import math
import sys

COLUMNS = (
    ("scene", "scene", ""),
    ("method", "label", ""),
    ("relMSE", "rel_mse", ".2e"),
    ("of it noise", "noise", ".2e"),
    ("reference's noise", "reference_noise", ".2e"),
    ("bias", "bias", ".2e"),
    ("+-", "bias_error", ".1e"),
    ("FLIP", "flip", ".4f"),
    ("alpha error", "alpha", ".4f"),
    ("render s", "render_s", ".3f"),
    ("before s", "before_s", ".3f"),
    ("total s", "total_s", ".3f"),
    ("peak MB", "peak_mb", ".0f"),
)


def cell(value, pattern: str) -> str:
    """A value as a table shows it; a dash for what is not known."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return format(value, pattern) if pattern else str(value)


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def table(results: list[dict]) -> str:
    """All rows of the judge's results; failures are told below the table."""
    rows, failures = [], []
    for result in results:
        for row in result["rows"]:
            if "failure" in row:
                failures.append(f"- {result['scene']}, {row['label']}: {row['failure']}")
                continue
            values = row | {"scene": result["scene"]}
            rows.append([cell(values.get(key), pattern) for _, key, pattern in COLUMNS])
    text = markdown([c[0] for c in COLUMNS], rows) if rows else ""
    return "\n".join([text, *failures]).strip()


def command(module: str, argv: list[str] | None = None) -> str:
    """How a benchmark was started, for its page; argv None: by this process's own words."""
    typed = sys.argv[1:] if argv is None else argv
    return " ".join([f"python -m {module}", *(f'"{t}"' if " " in t else t for t in typed)])
