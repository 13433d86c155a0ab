"""Words and cells that the tables of the blind benchmark share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from pipeline.report.page import MISSING, Table, parts

KINDS = {
    "null_plain": "nothing missing",
    "null_heavy_tails": "nothing missing, heavy tails",
    "null_understated_noise": "nothing missing, noise understated",
    "one": "one effect",
    "two": "two effects",
    "outside": "outside the catalogue",
    "sensor_or_input": "sensor or input",
}
GENERATORS = {"lattice": "the lattice", "independent": "independent"}
INTERVAL = "In brackets: of how many, and the exact 95 % interval."


def words_of(name: str) -> str:
    """A name without its underscores."""
    return name.replace("_", " ")


def claims_of(claims: Sequence[Sequence[str | None]]) -> str:
    """Effects in words, each with what it belongs to."""
    return ", ".join(f"{name} ({key})" if key else name for name, key in claims)


def rate_cell(table: Table, row: str, column: str, of: Mapping[str, Any]) -> Markup | str:
    """A rate in percent with its count and interval, recorded; a dash where it is of nothing."""
    if not of["of"]:
        return MISSING
    percent = [
        table.number(row, f"{column}{words}", 100.0 * of[name], 1, "%")
        for words, name in (("", "rate"), (", from", "low"), (", to", "high"))
    ]
    count, total = (
        table.number(row, f"{column}{words}", of[name], 0)
        for words, name in ((", count", "count"), (", of", "of"))
    )
    return parts("{} % ({} of {}; {} to {})", percent[0], count, total, *percent[1:])
