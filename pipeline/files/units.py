"""Units at the edge of the pipeline: in column names, and from what mines write to ours."""

from __future__ import annotations

SUFFIX = {
    "kPa": "_kpa",
    "kg m-3": "_kg_m3",
    "m": "_m",
    "kg": "_kg",
    "1": "",
    "%": "_pct",
    "kg/t": "_kg_t",
    "g/t": "_g_t",
    "ppm": "_ppm",
}
"""What a UDUNITS unit becomes at the end of the name of a column or of a VTK array."""

FACTORS = {
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048},
    "density": {"kg/m3": 1.0, "t/m3": 1e3, "g/cm3": 1e3},
    "stress": {"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3, "bar": 100.0},
    "mass": {"kg": 1.0, "t": 1e3, "kt": 1e6, "Mt": 1e9},
}
"""Factors to m, kg m-3, kPa and kg, by quantity and unit."""

KPA_IN_MPA = 1e-3
KG_IN_T = 1e-3


def with_unit(name: str, unit: str) -> str:
    """`vertical_stress_mean` in kPa → `vertical_stress_mean_kpa`."""
    return name + SUFFIX[unit]
