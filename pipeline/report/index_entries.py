"""An experiment on the index page, and how it agrees with its data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pipeline.config.experiment import Experiment
from pipeline.report.page import Badge
from pipeline.report.results import Agreement, agreement
from pipeline.validate.validation import CALIBRATED, DECLARED

AGREES, DISAGREES = Badge("agrees", "good"), Badge("disagrees", "bad")
FITTED, NO_DATA = Badge("fitted", "note"), Badge("no data", "note")
OUTCOMES = (AGREES, FITTED, DISAGREES, NO_DATA)
RUNS = {CALIBRATED: "calibrated", DECLARED: "as declared"}


@dataclass(frozen=True)
class Entry:
    """One experiment on the index page; `link` is its report, relative to the page."""

    experiment: Experiment
    calibration: dict[str, Any]
    validation: dict[str, Any]
    link: str

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.experiment.name

    @property
    def label(self) -> str:
        """What its data are; empty without any."""
        return self.experiment.data_label if self.validation["readings"] else ""

    @property
    def published(self) -> dict[str, Any]:
        """What was published beside it, empty if nothing."""
        return self.validation["published"] or {}

    @property
    def is_calibrated(self) -> bool:
        """Whether any parameter was fitted."""
        return any(entry["calibrated"] for entry in self.calibration["parameters"].values())

    @property
    def size(self) -> float:
        """R_h·H, m²: hydraulic radius of the base times the height of the model."""
        radius = self.calibration["derived"]["hydraulic_radius"]["value"]
        return radius * self.experiment.geometry.height

    def agreement(self, run: str) -> Agreement | None:
        """Agreement of a run with the readings; None for a calibration that was not made."""
        if run == CALIBRATED and not self.is_calibrated:
            return None
        return agreement(self.validation, run)

    @property
    def is_fitted(self) -> bool:
        """Whether every value was used in the calibration."""
        return all(reading["used_in_calibration"] for reading in self.validation["readings"])

    def full_base(self) -> dict[str, Any] | None:
        """The reading of mean vertical stress on the whole base with the model full."""
        height = self.experiment.geometry.height
        for reading in self.validation["readings"]:
            whole = reading["load_cell"] is None and reading["fill_height"] in (None, height)
            if reading["quantity"] == "vertical_stress" and whole:
                return reading
        return None


def verdict_of(found: Agreement | None, is_fitted: bool) -> Badge | str:
    """One of `OUTCOMES` for a run; nothing for one that was not made."""
    if found is None:
        return ""
    if not found.agrees:
        return DISAGREES
    return FITTED if is_fitted else AGREES
