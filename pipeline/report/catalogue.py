"""The catalogue page of effects: what each is, where it acts, and what it does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from pipeline.effects import Effect, effects
from pipeline.files.atomic import write_json, write_text
from pipeline.report.figures import Panel, panel_style, section_size
from pipeline.report.page import Data, Figure, Table, render

CASES = {"column": "A static column", "pillar": "A pillar between two movement zones"}
CHANGE_COLORS = "RdBu_r"
STAGES = {
    "geometry": "the filling",
    "packing": "cells before draw",
    "state": "the lattice at a reading",
    "readings": "the sensors",
}


def write_catalogue(pictures: xr.Dataset, page: str | Path, numbers: str | Path) -> None:
    """Write the catalogue of effects and a JSON file with its numbers.

    `pictures` is what `pipeline.sensitivity.pictures.effect_pictures` returned.
    """
    data = Data()
    names = [bytes(name).decode() for name in pictures["effect"].values]
    with panel_style():
        entries = [
            {
                "name": name,
                "effect": effect,
                "stages": [words for stage, words in STAGES.items() if getattr(effect, stage)],
                "parameters": _parameters(name, effect, data),
                "options": {key: list(map(str, some)) for key, some in effect.options.items()},
                "example": ", ".join(f"{key} = {value}" for key, value in effect.example.items()),
                "figure": _figure(name, effect, pictures.isel(effect=names.index(name)), data),
            }
            for name, effect in effects().items()
            if name in names
        ]
        html = render(
            "catalogue.html.j2",
            entries=entries,
            count=pictures.attrs["replicate_count"],
            numbers=Path(numbers).name,
        )
    write_json(numbers, {"schema_version": "1.0", "data": data.to_records()})
    write_text(page, html)


def _parameters(name: str, effect: Effect, data: Data) -> Table:
    table = Table(
        f"parameters_{name}",
        "Parameters",
        ("Parameter", "Unit", "Neutral", "Range: from", "Range: to", "Prior scale", "Side", "What"),
        data,
    )
    sides = {1: "above neutral", -1: "below neutral", 0: "both"}
    for p in effect.parameters:
        values = (("neutral", p.neutral), ("from", p.low), ("to", p.high), ("scale", p.scale))
        cells = [table.number(p.name, column, value, unit=p.unit) for column, value in values]
        table.rows.append([p.name, p.unit, *cells, sides[p.sign], p.words])
    return table


def _figure(name: str, effect: Effect, pictures: xr.Dataset, data: Data) -> Figure | None:
    """Relative change of mean stress, section by section; None for a sensor's effect."""
    if effect.scope == "load_cell":
        return None
    panels = []
    for case, title in CASES.items():
        change = 100.0 * pictures[f"{case}_change"].values
        x, z = pictures[f"{case}_x"].values, pictures["z"].values
        largest = float(np.nanmax(np.abs(change))) or 1.0
        base = 100.0 * float(pictures[f"{case}_base_change"])
        panel = Panel(
            data,
            name,
            f"{title}: base stress {base:+.1f} %",
            "x (m)",
            "height z (m)",
            f"{title}: change of mean vertical stress by {name}, up to {largest:.3g} %; "
            f"the mean base stress changes by {base:+.1f} %.",
            section_size(x[-1] + x[0], z[-1] + z[0], (2.2, 2.0)),
            bar=True,
        )
        scale = "change of stress (%)", -largest, largest, CHANGE_COLORS
        panel.image(x, z, change, *scale, f"pictures.nc: {case}_change of {name}")
        panels.append(panel)
    caption = f"{effect.moves.capitalize()}. n = {pictures.attrs['replicate_count']} replicates."
    return Figure(name, "What it does", caption, panels)
