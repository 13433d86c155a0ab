"""A prediction through Snakemake: its files and page, what runs again, and a study that is not."""

import re

import numpy as np
import pytest

from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset

pytestmark = pytest.mark.workflow

ALPHA = "workflow_configs/experiments/alpha.yaml"
PAGE = "results/experiments/alpha/prediction.html"


def test_a_prediction_is_made_and_only_what_it_hangs_on_runs_again(done):
    done.edit(ALPHA, lambda text: text + "prediction: {samples: 40}\n")
    process = done.snakemake(PAGE)
    assert process.returncode == 0, process.stdout
    assert not re.search(r": (block model|calibration|replicates)\b", process.stdout)
    folder = done.folder / "results" / "experiments" / "alpha"
    dataset = read_dataset(folder / "prediction.nc")
    document = read_json(folder / "prediction.json")
    plain = read_dataset(folder / "replicates.nc")["vertical_stress"].values
    best = dataset["vertical_stress_packing_only"].values
    assert np.array_equal(best[: len(plain)], plain)
    assert [one["label"] for one in document["unknowns"]] == ["E", "s.std"]
    assert [one["used_in_calibration"] for one in document["readings"]] == [True, True]
    page = (done.folder / PAGE).read_text("utf-8")
    assert "posterior: calibration of alpha" in page
    assert "used in the fit" in page
    for name in ("prediction.nc", "prediction.json", "prediction_data.csv"):
        assert f'href="{name}"' in page
        assert (folder / name).is_file()
    numbers = set(re.findall(r'<data value="([^"]*)">', page))
    assert numbers <= set(re.split(r"[,\n]", (folder / "prediction_data.csv").read_text("utf-8")))
    panels = re.findall(r'<svg class="panel"[^>]*>', page)
    assert panels
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', panel) for panel in panels)
    done.edit(ALPHA, lambda text: text.replace("samples: 40", "samples: 60"))
    shown = done.snakemake("--dry-run", PAGE).stdout
    assert "alpha: prediction" in shown
    assert not re.search(r": (block model|calibration|replicates)\b", shown)
    report = done.snakemake("--dry-run", "results/experiments/alpha/report.html").stdout
    assert "alpha: page of the prediction" in report


def test_a_study_that_is_not_there_is_named(fresh):
    fresh.edit(ALPHA, lambda text: text + "prediction: {study: walls}\n")
    process = fresh.snakemake("--dry-run", PAGE, "--config", "studies_dir=workflow_configs")
    assert process.returncode != 0
    experiments = "experiments_dir=workflow_configs/../workflow_configs/experiments"
    process = fresh.snakemake("--dry-run", PAGE, "--config", experiments)
    assert process.returncode != 0
    assert "prediction.study = walls: no such study; this run has none" in process.stdout
