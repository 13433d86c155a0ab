"""Two tiny experiments through Snakemake: what runs, what runs again, and what does not."""

import re

import pytest

from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset

pytestmark = pytest.mark.workflow

RULES = {"block_model", "calibrate", "replicates", "aggregate", "validate"}
EXPERIMENTS = "workflow_configs/experiments"
FILES = {
    "block_model.nc",
    "calibration.json",
    "replicates.nc",
    "fields.nc",
    "statistics.nc",
    "base_stress.csv",
    "validation.json",
}

STATISTICS = "results/experiments/alpha/statistics.nc"


def of(experiment, rules=RULES):
    return {(experiment, rule) for rule in rules}


def test_the_whole_chain_makes_every_file_of_both_experiments(finished):
    for name in ("alpha", "beta"):
        made = {path.name for path in (finished.folder / "results/experiments" / name).iterdir()}
        assert made == FILES
    folder = finished.folder / "results/experiments/alpha"
    calibration = read_json(folder / "calibration.json")
    (target, _) = read_json(folder / "validation.json")["readings"]
    assert target["used_in_calibration"] is True
    assert target["calibrated"]["mean"] == pytest.approx(9.0, rel=1e-3)
    declared = read_dataset(folder / "replicates.nc")["base_vertical_stress_as_declared"]
    assert declared.values.mean() != pytest.approx(9.0, rel=0.01)
    assert calibration["messages"] == []


def test_rounding_is_warned_of_in_the_log(finished):
    log = finished.folder / "results/logs/experiments/beta/block_model.log"
    assert "WARNING" in log.read_text()
    assert "beta: width 0.52 m is 5.2 cells of 0.1 m" in log.read_text()


def test_a_second_run_has_nothing_to_do(finished):
    assert finished.pending() == set()


def test_a_changed_value_reruns_its_experiment_alone(done):
    done.edit(f"{EXPERIMENTS}/beta.yaml", lambda text: text.replace("E: 0.8", "E: 0.81"))
    assert done.pending() == of("beta")


def test_a_changed_measured_row_reruns_its_experiment_alone(done):
    done.edit(f"{EXPERIMENTS}/measured/table.csv", lambda text: text.replace("4.0,0.4", "4.1,0.4"))
    assert done.pending() == of("beta")


def test_comments_and_layout_rerun_nothing(done):
    done.edit(
        f"{EXPERIMENTS}/alpha.yaml",
        lambda text: "# a comment\n" + text.replace("E: 0.9", "E:    0.9"),
    )
    done.edit(f"{EXPERIMENTS}/measured/table.csv", lambda text: "# another\n" + text)
    done.edit("pipeline/lattice/spreading.py", lambda text: "# a comment\n" + text)
    assert done.pending() == set()


def test_an_added_experiment_runs_alone(done):
    beta = (done.folder / EXPERIMENTS / "beta.yaml").read_text()
    path = done.folder / EXPERIMENTS / "gamma.yaml"
    path.write_text(re.sub("(?m)^measured.*\n", "", beta))
    targets = [f"results/experiments/{name}/validation.json" for name in ("alpha", "gamma")]
    assert done.pending(*targets) == of("gamma", RULES - {"aggregate"})


def test_a_changed_kernel_reruns_all_that_computes_with_it(done):
    done.edit(
        "pipeline/lattice/spreading.py",
        lambda text: text.replace("S_LIMIT = 128.0", "S_LIMIT = 127.0"),
    )
    expected = RULES - {"block_model"}
    assert done.pending() == of("alpha", expected) | of("beta", expected)


def test_a_changed_variable_table_reruns_what_writes_netcdf(done):
    done.edit(
        "pipeline/files/variables.yaml", lambda text: text.replace("identity of", "number of")
    )
    assert done.pending() >= of("alpha", {"block_model", "replicates", "aggregate"})


def test_forcerun_runs_one_step_again_and_changes_no_number(done):
    path = done.folder / STATISTICS
    before, old = read_dataset(path), path.stat().st_mtime_ns
    assert done.pending(STATISTICS, "--forcerun", "aggregate") == {("alpha", "aggregate")}
    process = done.snakemake(STATISTICS, "--forcerun", "aggregate")
    assert process.returncode == 0, process.stdout
    assert path.stat().st_mtime_ns > old
    assert read_dataset(path).equals(before)


def test_stress_from_another_experiment_waits_for_its_calibration(done):
    done.edit(f"{EXPERIMENTS}/beta.yaml", lambda text: text.replace("E: 0.8, s: 2", "from: alpha"))
    process = done.snakemake("results/experiments/beta/calibration.json")
    assert process.returncode == 0, process.stdout
    used, source = (
        read_json(done.folder / f"results/experiments/{name}/calibration.json")["parameters_used"]
        for name in ("beta", "alpha")
    )
    assert (used["E"], used["s_std"]) == (source["E"], source["s_std"])
    done.edit(f"{EXPERIMENTS}/alpha.yaml", lambda text: text.replace("E: 0.9", "E: 0.91"))
    assert done.pending() == of("alpha") | of("beta", RULES - {"block_model"})


def test_own_files_outside_the_repository_and_a_trailing_slash(fresh, tmp_path):
    outside, results = tmp_path / "mine", tmp_path / "my results"
    (fresh.folder / EXPERIMENTS).rename(outside)
    process = fresh.snakemake(
        f"{results}/experiments/beta/block_model.nc",
        "--config",
        f"experiments_dir={outside}/",
        f"results_dir={results}/",
    )
    assert process.returncode == 0, process.stdout
    assert (results / "experiments/beta/block_model.nc").is_file()
    assert (results / "logs/experiments/beta/block_model.log").is_file()
    assert not (fresh.folder / "results").exists()


def test_lint_asks_for_nothing_but_environments(checkout):
    process = checkout.python("-m", "snakemake", "--lint")
    findings = set(re.findall(r"^    \* (.*?):?$", process.stdout, re.MULTILINE))
    assert findings <= {"Specify a conda environment or container for each rule."}, process.stdout


def test_a_failing_job_says_why_and_leaves_no_output(fresh):
    # the mask lets the file pass: only the job finds that no ground is left
    fresh.edit(
        f"{EXPERIMENTS}/beta.yaml",
        lambda text: text.replace(
            "cell_size: 0.1}", "cell_size: 0.1, mask: {type: file, path: pit.nc}}"
        ),
    )
    (fresh.folder / EXPERIMENTS / "pit.nc").write_text("not netCDF")
    target = "results/experiments/beta/block_model.nc"
    process = fresh.snakemake(target)
    assert process.returncode != 0
    assert "geometry.mask.path" in process.stdout
    assert "is not readable as netCDF" in process.stdout
    assert not (fresh.folder / target).exists()
    log = fresh.folder / "results/logs/experiments/beta/block_model.log"
    assert "is not readable as netCDF" in log.read_text()


def test_the_blind_benchmark_is_a_target_and_no_part_of_everything(fresh):
    asked = fresh.snakemake(
        "--dry-run", "blind_benchmark", "--config", "blind_worlds=3", "blind_seed=1"
    )
    assert asked.returncode == 0, asked.stdout
    assert "Blind benchmark: 3 worlds" in asked.stdout
    assert "block_model" not in asked.stdout
    assert "Blind benchmark" not in fresh.snakemake("--dry-run").stdout


def test_linear_algebra_gets_one_thread_in_a_job(fresh):
    fresh.edit(
        "pipeline/workflow/scripts/flow_law.py",
        lambda text: (
            "import os, sys\nprint({v for k, v in os.environ.items() "
            "if k.endswith('BLAS_NUM_THREADS')})\nsys.exit('stop')\n" + text
        ),
    )
    assert "{'1'}" in fresh.snakemake("results/flow_law/flow_law.json").stdout
