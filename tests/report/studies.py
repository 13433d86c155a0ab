"""Pages of made-up studies."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.study import Study
from pipeline.files.atomic import write_json
from pipeline.report.study import write_study_report

EXPERIMENTS = ("narrow", "wide", "tall")
FRICTION = "wall_friction"
RULE = {"channel": "E", "feature": "walls"}
WORDS = "the share of load that is shed, 1 − E, rises at the walls"


@dataclass(frozen=True)
class MadeStudy:
    """A study's documents and its page, all in `folder`."""

    found: dict[str, Any]
    folder: Path

    @property
    def html(self) -> str:
        """The page."""
        return (self.folder / "report.html").read_text("utf-8")

    @property
    def rows(self) -> list[dict[str, str]]:
        """The data beside the page."""
        with open(self.folder / "report_data.csv", encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))


def error(rms: float | None = 0.1, n: int = 3) -> dict[str, Any]:
    """Errors as the loop writes them."""
    return {"rms_kpa": rms, "rms_log": rms and rms / 3, "mean_absolute_kpa": rms, "n": n}


def candidate(name: str, key: str | None = None, **changes) -> dict[str, Any]:
    """A candidate that can be tested, changed key by key."""
    return {
        "name": name,
        "kind": "physics",
        "scope": "material",
        "scope_key": key,
        "probability": 0.25,
        "score": 3.25,
        "surviving_fraction": 0.375,
        "minimal_detectable": 0.125,
        "unit": "1",
        "nearest_mimic": "density_misdeclared [sand]",
        "mimic_distance": 2.5,
        "alike": ["local_rule E walls", "local_rule E floor", "tilt [a]", "tilt [b]"],
        "testable": True,
        "why": "",
    } | changes


def untestable(name: str, key: str | None, why: str, **changes) -> dict[str, Any]:
    """A candidate of which these readings say nothing."""
    nothing = {
        "score": 0.0,
        "surviving_fraction": 0.0,
        "minimal_detectable": None,
        "nearest_mimic": None,
        "mimic_distance": None,
        "alike": [],
    }
    return candidate(name, key, **(nothing | {"testable": False, "why": why} | changes))


def added(name: str, number: int = 1, key: str | None = None, **changes) -> dict[str, Any]:
    """An effect that was added."""
    return {
        "name": name,
        "kind": "physics",
        "scope": "material",
        "scope_key": key,
        "parameters": {
            "K": {"value": 0.5, "interval_90": [0.4, 0.6], "at_bound": False, "unit": "1"}
        },
        "options": {},
        "probability": 0.97,
        "round": number,
    } | changes


def a_rule(number: int) -> dict[str, Any]:
    """A local rule that was added."""
    value = {"value": 0.3, "interval_90": [0.1, 0.5], "at_bound": False, "unit": "1"}
    amplitude = {"amplitude": value}
    return added(
        "local_rule", number, kind="rule", scope="study", parameters=amplitude, options=RULE
    )


def gate(number: int, rejected: bool) -> dict[str, Any]:
    """The test of a round."""
    return {
        "round": number,
        "statistic": 8.5 if rejected else 1.5,
        "p_value": 0.0007 if rejected else 0.6,
        "alpha": 0.05 * 0.5 ** (number - 1),
        "rejected": rejected,
        "largest": FRICTION,
        "threshold": 2.75,
        "sum_of_squares": 120.5,
        "sum_of_squares_p_value": 0.0005,
        "degrees_of_freedom_beyond": 4,
        "noise_factors": {"scatter": 1.0, "shared": 1.0, "independent": 1.0},
    }


def evidence(**by_name: float) -> dict[str, Any]:
    """Posterior of a round."""
    best = [
        {"label": name, "log_evidence": 9.5, "probability": p, "refitted": p > 0.1}
        for name, p in by_name.items()
    ]
    none = 1.0 - sum(by_name.values())
    return {"by_name": by_name, "none": none, "set_90": list(by_name)[:1], "best": best}


def case(verdict: str) -> dict[str, Any]:
    """What differs from verdict to verdict."""
    both = [added(FRICTION, 1, "sand"), added(FRICTION, 1, "ore")]
    found = evidence(wall_friction=0.97, density_misdeclared=0.02)
    split = evidence(surcharge=0.5, density_misdeclared=0.45)
    rule = {**RULE, "words": WORDS, "amplitude": 0.3, "at_bound": False}
    rule |= {"probability": 0.95, "added": True}
    match verdict:
        case "effect":
            changes = {"effects_added": both, "evidence": [found, None]}
        case "ambiguous":
            changes = {
                "candidate_set": ["surcharge", "density_misdeclared"],
                "evidence": [split],
            }
        case "unknown_effect":
            changes = {
                "effects_added": [a_rule(1)],
                "local_rules": [rule],
                "evidence": [evidence(local_rule=0.95), None],
            }
        case "unexplained":
            changes = {"evidence": [evidence(tilt=0.1)]}
        case _:
            changes = {"evidence": [None]}
    rejected = [one is not None for one in changes["evidence"]]
    return changes | {"gate": [gate(n, r) for n, r in enumerate(rejected, start=1)]}


def closed_loop(verdict: str = "effect") -> dict[str, Any]:
    """closed_loop.json of a study that came to this verdict."""
    candidates = [
        candidate(FRICTION),
        candidate(FRICTION, "sand", alike=[]),
        candidate("surcharge", scope="study", unit="kPa"),
        candidate("density_misdeclared", "sand", kind="input"),
        untestable("compaction", "sand", "calibration explains all of it"),
        untestable("arching", None, "no reading answers to it", scope="study"),
        untestable("cohesion", "sand", "no reading answers to it", unit="kPa"),
        untestable("cohesion", "ore", "no reading answers to it", unit="kPa"),
    ]
    parameter = {"name": "E", "key": "sand", "unit": "1", "start": 0.9}
    before = {"E [sand]": parameter | {"value": 0.8, "interval_90": [0.78, 0.82]}}
    after = {"E [sand]": parameter | {"value": 0.95, "interval_90": None}}
    worse, better = {"before": error()}, {"after": error(0.02)}
    return {
        "study": "made_up",
        "title": "A made-up study",
        "schema_version": "1.0",
        "verdict": verdict,
        "effects_added": [],
        "candidate_set": [],
        "candidates": candidates,
        "candidates_left": candidates,
        "local_rules": [],
        "error": {
            "calibration": worse | better,
            "held_out": worse | better | {"ratio": 0.2, "ratio_interval_90": [0.1, 0.4]},
            "recalibrated_only": {"calibration": error(0.09), "held_out": error(0.095)},
            "gaussian_process": {"calibration": error(0.01), "held_out": error(0.11)},
        },
        "parameters": {"before": before, "after": after},
        "next_measurement": [{"what": "weigh the bed", "where": "sand", "expected_gain": 0.05}],
        "noise_floor": {
            "floor_rms_log": 0.07,
            "estimated_from_the_data": False,
            "with_noise_1_5_times_declared": {
                "statistic": 5.6,
                "threshold": 2.75,
                "rejected": True,
            },
        },
        "held_out_is": "each experiment in turn, by a loop without it",
        "folds": [
            {
                "name": name,
                "verdict": "effect",
                "added": [f"{FRICTION} [sand]"],
                "not_predictable": [],
                "error": {"before": error(0.15, 1), "after": error(0.03, 1)},
            }
            for name in EXPERIMENTS
        ],
        "sharing": [
            {
                "name": FRICTION,
                "scope": "study",
                "parameters": {"K": {"value": 0.55, "unit": "1"}},
                "unknowns": 2,
                "readings": 3,
                "calibration": error(0.05),
                "held_out": error(0.06),
            }
        ],
        "degrees_of_freedom": {"readings": 3, "calibrated": 1, "amplitudes": 2},
        "untestable_parameters": [],
        "replicate_count": {"simulated": 480},
        "seeds": dict.fromkeys(EXPERIMENTS, 2022),
        "versions": {"pipeline": "0.1.0"},
        "data_labels": ["measured"],
        "settings": {"alpha": 0.05, "max_effects": 3, "data": None, "candidates": "all"},
        **case(verdict),
    }


def residuals(**changes) -> xr.Dataset:
    """residual.nc of one reading for each experiment; variables of text as bytes."""
    simulated = np.array([0.5, 0.7, 0.6])
    measured = np.array([0.45, 0.75, 0.61])
    content = {
        "measured": measured,
        "measured_uncertainty": 0.05 * measured,
        "simulated": simulated,
        "standardized_residual": np.array([-2.1, 1.4, 0.3]),
        "whitened_residual": np.array([-2.1, 1.4, 0.3]),
        "experiment": list(EXPERIMENTS),
        "load_cell": [""] * 3,
        "quantity": ["vertical_stress"] * 3,
        "fill_height": np.array([0.5, 0.5, 0.5]),
        "mass_drawn": np.zeros(3),
    } | changes
    encoded = {
        name: [value.encode() for value in values] if isinstance(values, list) else values
        for name, values in content.items()
    }
    return xr.Dataset({name: ("reading", np.array(v)) for name, v in encoded.items()})


def predictions() -> list[dict[str, Any]]:
    """Rows of predictions.json."""
    place = {"load_cell": None, "fill_height": None, "mass_drawn": None}
    values = {"measured": 0.45, "before": 0.6, "after": 0.47}
    return [
        {"experiment": name, "quantity": "vertical_stress", **place, **values}
        for name in EXPERIMENTS
    ]


def make_study(
    folder: Path,
    found: dict[str, Any],
    residual: xr.Dataset | None = None,
    rows: list[dict[str, Any]] | None = None,
    is_run: bool = True,
    **settings,
) -> MadeStudy:
    """The page of a study from its documents; `is_run`: so was the improved model."""
    content = {
        "attribution": {},
        "closed_loop": found,
        "predictions": {"rows": predictions() if rows is None else rows},
    }
    if is_run:
        errors = {"bias": 0.01, "mean_absolute_error": 0.04, "rmse": 0.05, "n": 1}
        content["improved"] = {
            "experiments": {
                name: {"before": errors, "after": errors, "file": f"improved/{name}.yaml"}
                for name in EXPERIMENTS
            }
        }
    paths = {name: folder / f"{name}.json" for name in content}
    for name, path in paths.items():
        write_json(path, content[name])
    paths["residual"] = folder / "residual.nc"
    (residuals() if residual is None else residual).to_netcdf(paths["residual"], engine="netcdf4")
    settings = {"title": "A made-up study", "source": "A source"} | settings
    study = Study.model_validate({"experiments": EXPERIMENTS, **settings})
    study = study.at(folder.parent / "made_up.yaml")
    write_study_report(study, paths, folder / "report.html", folder / "report_data.csv")
    return MadeStudy(found, folder)
