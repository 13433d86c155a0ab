"""Pages beside those of experiments and studies: predictions, blind benchmark, catalogue, index."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from comparisons import MadeComparison
from pages import Made
from studies import MadeStudy

from pipeline.blind.scored import Scored
from pipeline.blind.scores import score
from pipeline.calibrate.calibration import SCALES
from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.effects import Active, effects
from pipeline.files.atomic import read_json, write_json, write_text
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.parameters import declared_parameters
from pipeline.predict.knowledge import Knowledge, Unknown
from pipeline.predict.prediction import predict
from pipeline.report.blind import write_blind_report
from pipeline.report.catalogue import write_catalogue
from pipeline.report.index import write_index
from pipeline.report.prediction import write_prediction_report

FIGURE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 4 3"><path d="M0 0H4V3"/></svg>'


def make_prediction(
    experiment: Experiment, rows: Sequence[MeasuredRow], cell: str, folder: Path
) -> Path:
    """Page of a prediction with E, a sd of s of which nothing is known, and a gain of one cell.

    The first of the rows was used in the fit.
    """
    declared = declared_parameters(experiment)
    names, gain = ("E", "s.std"), "sensor_gain.gain"
    unknowns = (
        *(Unknown.parameter(n, n, SCALES[n].forward(declared.value(n))) for n in names),
        Unknown.amplitude(f"{gain} [{cell}]", "1", 1.1, 0.1, 10.0, 10.0),
    )

    def at(x):
        parameters = declared.with_values({"E": x[0], "s.std": math.exp(x[1])})
        return parameters, (Active("sensor_gain", {"gain": float(x[2])}, cell),)

    covariance = np.diag([0.01, unknowns[1].prior, 0.1]) ** 2
    known = Knowledge("study walls", unknowns, covariance, at)
    dataset, document = predict(
        experiment, build_block_model(experiment), known, rows, lambda row: row is rows[0]
    )
    samples, numbers = folder / "prediction.nc", folder / "prediction.json"
    write_dataset(samples, dataset, experiment, "predict", "Prediction")
    write_json(numbers, document)
    page = folder / "prediction.html"
    write_prediction_report(
        experiment, read_dataset(samples), read_json(numbers), page, folder / "prediction_data.csv"
    )
    return page


def truth(world: str, kind: str, *names: str, **more) -> dict:
    """A sealed truth with one held-out reading; `names` are the effects that are there."""
    hidden = [
        {"name": name, "scope_key": "gravel", "parameters": {}, "delta": 9.0} for name in names
    ]
    place = {"experiment": "static_7", "load_cell": "C1", "fill_height": 1.6, "mass_drawn": None}
    rows = [place | {"held_out": True, "stress": 10.0, "measured": 11.0}]
    about = {"world": world, "kind": kind, "generator": "lattice"}
    return about | {"effects": hidden, "rows": rows} | more


def said(verdict: str, *names: str, left: Sequence[str] = ()) -> dict:
    """A `closed_loop.json` that added these effects, to gravel."""
    added = [{"name": name, "scope_key": "gravel", "probability": 0.95} for name in names]
    candidates = [
        {
            "name": "wall_friction",
            "scope_key": "gravel",
            "probability": 0.04,
            "nearest_mimic": "density_misdeclared [gravel]",
            "mimic_distance": 2.5,
        }
    ]
    return {
        "verdict": verdict,
        "effects_added": added,
        "candidate_set": list(left),
        "gate": [{"round": 1, "rejected": verdict != "no_effect_detectable"}],
        "local_rules": [],
        "candidates": candidates,
    }


def worlds() -> list[Scored]:
    """Worlds with every outcome that has a place of its own on the page."""
    place = {"experiment": "static_7", "load_cell": "C1", "fill_height": None, "mass_drawn": None}
    errors = {"before": 13.0, "after": 10.5, "recalibrated_only": 12.0, "gaussian_process": 11.0}
    rows = [place | {"quantity": "vertical_stress"} | errors]
    fooling = {
        "details": {"load_cell": "C1", "factor": 1.5},
        "joint_delta": 8.5,
        "held_out_rms_log": 0.1,
        "right": {"verdicts": ["unexplained"], "must_name": [], "may_name": []},
    }
    words = {"measurement": {"what": "repeat the experiment", "where": "static_5"}}
    again = {
        choice: words | {"shows": [name, "gravel"]}
        for choice, name in (("recommended", "arching"), ("random", "tilt"))
    }
    right = said("effect", "wall_friction")
    return [
        Scored(truth("world_0000", "null_plain"), said("no_effect_detectable"), rows, seconds=9.0),
        Scored(truth("world_0001", "one", "wall_friction"), right, rows,
               {"raw_correlation": [("wall_friction", "gravel")]}),
        Scored(truth("world_0002", "one", "wall_friction"), said("effect", "tilt"), rows),
        Scored(truth("world_0003", "two", "wall_friction", "arching"), right, rows),
        Scored(truth("world_0004", "one", "arching"),
               said("ambiguous", left=("arching", "tilt")), rows,
               again=again),
        Scored(truth("world_8000", "attack_exchanged_files", attack=fooling), right, rows),
    ]  # fmt: skip


def make_blind(folder: Path) -> Path:
    """Page of a blind benchmark."""
    about = {
        "commit": "0123456789abcdef",
        "date": "2026-11-25",
        "seed": 7,
        "seed_is_the_commits": False,
        "worlds": 5,
        "kinds": {"null_plain": 1, "one": 3, "two": 1},
        "generators": {"lattice": 5},
        "versions": {"pipeline": "1.0", "numpy": np.__version__},
    }
    scores = about | score(worlds())
    write_json(folder / "scores.json", scores)
    write_blind_report(scores, folder / "report.html", folder / "report_data.csv")
    return folder / "report.html"


def make_catalogue(folder: Path) -> Path:
    """Page of all effects, with pictures of noise."""
    names, rng = list(effects()), np.random.default_rng(1)
    data = {"z": ("z", 0.05 + 0.1 * np.arange(6)), "effect": ("effect", np.array(names, "S"))}
    for case, width in (("column", 3), ("pillar", 6)):
        x = f"{case}_x"
        change = rng.normal(0, 0.1, (len(names), 6, width))
        data[x] = (x, 0.05 + 0.1 * np.arange(width))
        data[f"{case}_change"] = (("effect", "z", x), change)
        data[f"{case}_base_change"] = ("effect", change[:, 0].mean(axis=1))
    pictures = xr.Dataset(data, attrs={"replicate_count": 10})
    write_catalogue(pictures, folder / "index.html", folder / "index.json")
    return folder / "index.html"


def make_index(
    folder: Path,
    experiments: Sequence[Made],
    study: MadeStudy,
    comparison: MadeComparison,
    blind: Path,
) -> Path:
    """The index of these."""
    law = folder / "flow_law" / "flow_law.svg"
    write_text(law, FIGURE)
    write_index(
        [made.experiment for made in experiments],
        *(
            [made.folder / name for made in experiments]
            for name in ("calibration.json", "validation.json", "report.html")
        ),
        law,
        folder / "index.html",
        folder / "index.json",
        {"study": study.folder / "closed_loop.json"},
        [comparison.folder / "comparison.json"],
        blind.with_name("scores.json"),
    )
    return folder / "index.html"
