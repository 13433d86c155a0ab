"""The files are what the contract says: CF, regular, whole, and readable by other tools."""

import json
import re

import netCDF4
import numpy as np
import pytest
import xarray as xr
from compliance_checker.runner import CheckSuite, ComplianceChecker

from pipeline.calibrate.calibration import calibrate
from pipeline.files.netcdf import (
    STATISTICS,
    VARIANTS,
    describe,
    read_dataset,
    variable_table,
    write_dataset,
)
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

pytestmark = pytest.mark.filterwarnings("ignore:The ioos_sos checker:DeprecationWarning")

KINDS = ("static", "draw")
FILES = ("block_model", "fields", "replicates", "statistics")
GLOBALS = {
    "Conventions",
    "title",
    "source",
    "history",
    "references",
    "config",
    "config_sha256",
    "git_revision",
    "root_seed",
    "format_version",
}


OF_REGIONS = ("regions/block_model", "regions/grade")


@pytest.fixture(params=[*(f"{kind}/{name}" for kind in KINDS for name in FILES), *OF_REGIONS])
def dataset(request, written):
    """Each file of both experiments, and what regions add, opened without any decoding."""
    kind, name = request.param.split("/")
    with netCDF4.Dataset(written(kind)[1] / f"{name}.nc") as opened:
        opened.set_auto_maskandscale(False)
        yield opened


# ---------------------------------------------------------------------------------------------
# CF


@pytest.fixture(scope="session")
def findings(tmp_path_factory):
    """findings(path): the CF checker's messages by weight, "high" being errors."""
    CheckSuite.load_all_available_checkers()
    folder = tmp_path_factory.mktemp("findings")

    def check(path):
        report = folder / f"{path.parent.name}-{path.stem}.json"
        ComplianceChecker.run_checker(
            str(path),
            ["cf:1.11"],
            verbose=0,
            criteria="normal",
            output_filename=str(report),
            output_format="json",
        )
        (result,) = json.loads(report.read_text()).values()
        return {
            weight: [
                message for check in result[f"{weight}_priorities"] for message in check["msgs"]
            ]
            for weight in ("high", "medium", "low")
        }

    return check


def test_fields_pass_the_cf_checker_without_any_finding(folder, findings):
    found = findings(folder / "fields.nc")
    assert found["high"] == found["medium"] == []


@pytest.mark.parametrize(
    "file",
    [
        *(f"{kind}/{name}" for kind in KINDS for name in ("block_model", "replicates")),
        "static/statistics",
        *OF_REGIONS,
        pytest.param("draw/statistics", marks=pytest.mark.slow),  # the checker takes 20 s
    ],
)
def test_no_file_has_an_error_in_the_cf_checker(written, findings, file):
    kind, name = file.split("/")
    assert findings(written(kind)[1] / f"{name}.nc")["high"] == []


def test_the_cf_checker_finds_a_broken_file(folder, findings, tmp_path):
    with xr.open_dataset(folder / "fields.nc", decode_times=False) as fields:
        fields = fields.load()
    fields["x"].attrs["units"] = "parsec per fortnight to the moon"
    fields.to_netcdf(tmp_path / "broken.nc")
    assert findings(tmp_path / "broken.nc")["high"]


def test_every_variable_has_a_long_name_and_units(dataset):
    for name, variable in dataset.variables.items():
        if name.endswith("_bnds"):
            assert variable.ncattrs() == []
            continue
        assert variable.long_name, name
        flag = "flag_values" in variable.ncattrs()
        assert flag or variable.dtype.kind == "S" or variable.units, name


def test_globals_say_where_the_file_comes_from(dataset):
    assert set(dataset.ncattrs()) >= GLOBALS
    assert dataset.Conventions == "CF-1.11"
    assert json.loads(dataset.config)["geometry"]["cell_size"] in (0.1, 0.05)
    assert re.fullmatch(r"[0-9a-f]{64}", dataset.config_sha256)
    assert dataset.root_seed == "2022"
    assert re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ block_model: pipeline ", dataset.history)


def test_history_has_a_line_for_each_rule(folder):
    with netCDF4.Dataset(folder / "statistics.nc") as statistics:
        rules = [line.split()[1] for line in statistics.history.splitlines()]
    assert rules == ["block_model:", "replicates:", "aggregate:"]


def test_no_group_bool_int64_or_unlimited_dimension(dataset):
    assert not dataset.groups
    assert not any(dim.isunlimited() for dim in dataset.dimensions.values())
    for name, variable in dataset.variables.items():
        assert variable.dtype in ("S1", "int8", "int32", "float32", "float64"), name


def test_coordinates_are_regular_float64_centers_with_bounds_and_no_fill(dataset):
    for axis in {"x", "y", "z"} & set(dataset.dimensions):
        variable = dataset[axis]
        bounds = dataset[variable.bounds]
        centers = variable[:]
        assert variable.dtype == bounds.dtype == np.float64
        assert (variable.units, variable.axis) == ("m", axis.upper())
        steps = np.diff(centers)
        assert np.all(steps > 0)
        np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
        np.testing.assert_allclose(bounds[:].mean(axis=1), centers)
        np.testing.assert_allclose(bounds[1:, 0], bounds[:-1, 1], rtol=1e-12)
        assert "_FillValue" not in variable.ncattrs() + bounds.ncattrs()
    for name in {"time", "replicate"} & set(dataset.variables):
        assert "_FillValue" not in dataset[name].ncattrs()
    if "z" in dataset.dimensions:
        assert dataset["z"].positive == "up"
        names = [dataset[axis].standard_name for axis in "xyz"]
        assert names == ["projection_x_coordinate", "projection_y_coordinate", "height"]


# ---------------------------------------------------------------------------------------------
# each file


def test_block_model_holds_flags_with_meanings(folder):
    with netCDF4.Dataset(folder / "block_model.nc") as model:
        assert set(model.variables) >= {"state", "zone", "bulk_density", "d50", "cell_id"}
        for name in ("state", "zone", "bulk_density", "d50", "cell_id"):
            assert model[name].dimensions == ("z", "y", "x")
        for name, meanings in (("state", "void granular outside"), ("zone", "stagnant movement")):
            flags = model[name]
            assert flags.dtype == flags.flag_values.dtype == np.int8
            assert flags.flag_meanings == meanings
            assert set(np.unique(flags[:])) <= set(flags.flag_values)


def test_fields_have_only_fields_on_z_y_x_and_time(folder):
    with netCDF4.Dataset(folder / "fields.nc") as fields:
        for name in (
            "vertical_stress_mean",
            "vertical_stress_std",
            "movement_zone_probability",
            "void_probability",
            "bulk_density_mean",
        ):
            variable = fields[name]
            assert variable.dimensions == ("time", "z", "y", "x")
            assert variable.dtype == np.float32
            assert variable._FillValue == np.float32(-9999)
            assert variable.cell_methods.startswith("realization: ")
        assert all(variable.ndim <= 4 for variable in fields.variables.values())
        assert not any(variable.dtype.kind == "S" for variable in fields.variables.values())
        assert "vertical_stress_std" in fields["vertical_stress_mean"].ancillary_variables
        assert fields["time"].units == "days since 2000-01-01"
        assert "nominal" in fields["time"].comment
        clock = "mass_drawn" if "mass_drawn" in fields.variables else "fill_height"
        assert fields[clock].dimensions == ("time",)
        assert int(fields["replicate_count"][...]) == 8


def test_replicates_and_statistics_have_the_dims_of_the_contract(folder):
    with netCDF4.Dataset(folder / "replicates.nc") as replicates:
        assert replicates["vertical_stress"].dimensions == ("replicate", "time", "load_cell")
        for name in ("base_vertical_stress", "base_vertical_stress_std", "weight_balance_error"):
            assert replicates[name].dimensions == ("replicate", "time")
        assert replicates["replicate"].standard_name == "realization"
        assert {"load_cell_x", "load_cell_y"} <= set(replicates.variables)
    with netCDF4.Dataset(folder / "statistics.nc") as statistics:
        for suffix in ("mean", "std", "se", "p05", "p50", "p95"):
            name = f"vertical_stress_{suffix}"
            assert statistics[name].dimensions == ("time", "load_cell")
            assert statistics[f"base_vertical_stress_{suffix}"].dimensions == ("time",)
        assert statistics["vertical_stress_mean"].ancillary_variables.split() == [
            "vertical_stress_std",
            "vertical_stress_se",
            "replicate_count",
        ]
        assert "replicate" not in statistics.dimensions


def test_base_std_is_between_places_in_replicates_and_between_replicates_in_statistics(folder):
    replicates = read_dataset(folder / "replicates.nc")
    statistics = read_dataset(folder / "statistics.nc")
    name = "base_vertical_stress_std"
    assert "from place to place" in replicates[name].long_name
    assert replicates[name].cell_methods == "area: standard_deviation"
    assert "over replicates" in statistics[name].long_name
    assert "realization: standard_deviation" in statistics[name].cell_methods
    over_replicates = replicates["base_vertical_stress"].values.std(axis=0, ddof=1)
    np.testing.assert_allclose(statistics[name], over_replicates, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(
        statistics[f"{name}_mean"], replicates[name].mean("replicate"), rtol=1e-12
    )
    places = statistics[f"{name}_mean"].values
    assert np.all(places[-1] > 1e3 * statistics[name].values[-1]) or "mass_drawn" in statistics


def test_statistics_of_counts_are_no_whole_numbers(written, tmp_path):
    experiment, folder = written("draw")
    replicates = read_dataset(folder / "replicates.nc")
    replicates["hang_ups"][:] = [0, 1, 0, 0, 2, 0, 0, 0]
    write_dataset(
        tmp_path / "statistics.nc",
        replicate_statistics(replicates),
        experiment,
        "aggregate",
        "Statistics",
        statistics=True,
    )
    statistics = read_dataset(tmp_path / "statistics.nc")
    assert float(statistics["hang_ups_mean"]) == 0.375
    assert float(statistics["hang_ups_std"]) == pytest.approx(replicates["hang_ups"].std(ddof=1))


def test_variants_are_described_as_such(written):
    folder = written("draw")[1]
    replicates = read_dataset(folder / "replicates.nc")
    plain, variant = (
        replicates[name].attrs for name in ("vertical_stress", "vertical_stress_as_declared")
    )
    assert variant["units"] == plain["units"]
    assert variant["long_name"].startswith(plain["long_name"])
    assert "as declared" in variant["long_name"]
    statistics = read_dataset(folder / "statistics.nc")["vertical_stress_as_declared_mean"]
    for name in statistics.ancillary_variables.split():
        assert name == "replicate_count" or "as_declared" in name


def test_values_come_back_as_they_were(written, tmp_path):
    experiment, folder = written("draw")
    replicates = read_dataset(folder / "replicates.nc")
    write_dataset(tmp_path / "again.nc", replicates.drop_attrs(), experiment, "replicates", "Again")
    again = read_dataset(tmp_path / "again.nc")
    for name in replicates.variables:
        np.testing.assert_array_equal(again[name], replicates[name], err_msg=name)


def test_rounding_of_lengths_is_said_in_the_file(written):
    with netCDF4.Dataset(written("static")[1] / "block_model.nc") as model:
        assert "width 0.52 m is 5.2 cells of 0.1 m" in model.lattice_notes


def test_kept_fields_are_on_replicate_time_z_y_x(written):
    with netCDF4.Dataset(written("static")[1] / "replicates.nc") as replicates:
        kept = replicates["replicate_vertical_stress"]
        assert kept.dimensions == ("replicate", "time", "z", "y", "x")
    with netCDF4.Dataset(written("draw")[1] / "replicates.nc") as replicates:
        assert "replicate_vertical_stress" not in replicates.variables


# ---------------------------------------------------------------------------------------------
# writing


@pytest.mark.parametrize("name", ["stress", "vertical_stress_p99", "std"])
def test_an_unknown_variable_cannot_be_written(column, tmp_path, name):
    dataset = xr.Dataset({name: ("time", [1.0])}, coords={"time": [0.0]})
    with pytest.raises(KeyError, match=f"{name} is not in variables.yaml"):
        write_dataset(tmp_path / "a.nc", dataset, column(), "rule", "Title")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("old", [False, True])
def test_a_write_that_fails_midway_leaves_the_old_file_or_none(column, tmp_path, monkeypatch, old):
    experiment, path = column(), tmp_path / "block_model.nc"
    model = build_block_model(experiment)
    if old:
        write_dataset(path, model, experiment, "block_model", "Old")
    before = path.read_bytes() if old else None

    def fail(self, target, **_):
        with open(target, "wb") as file:
            file.write(b"half a file")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(OSError, match="No space left"):
        write_dataset(path, model, experiment, "block_model", "New")
    assert [p.name for p in tmp_path.iterdir()] == (["block_model.nc"] if old else [])
    assert before is None or path.read_bytes() == before


def test_every_known_variable_has_the_metadata_that_cf_asks_for():
    for name in variable_table():
        entry = describe(name)
        assert entry["long_name"]
        numeric = "dtype" in entry and "flags" not in entry
        assert not numeric or entry["units"], name


def test_calibration_document_is_json(column, tmp_path):
    from pipeline.files.atomic import read_json, write_json

    experiment = column(calibrate=["E"])
    setup = make_setup(experiment)
    document = calibrate(experiment, setup, declared_parameters(experiment), ())
    write_json(tmp_path / "calibration.json", document)
    assert read_json(tmp_path / "calibration.json")["parameters_used"]["E"] == 0.9


def test_the_table_says_of_each_variable_in_which_file_and_on_what_it_is(written):
    """Both ways: nothing is written that the table has elsewhere, and most of it is written."""
    seen = set()
    for kind in ("static", "draw", "mine"):
        for file in FILES:
            for name, variable in read_dataset(written(kind)[1] / f"{file}.nc").variables.items():
                derived = file == "statistics" and name.rpartition("_")[2] in STATISTICS
                variant = any(suffix in str(name) for suffix in VARIANTS)
                if str(name).endswith("_bnds") or derived or variant:
                    continue
                dims = variable_table()[str(name)].get("in", {}).get(file)
                assert dims is not None, f"give {name} the file {file} in variables.yaml"
                assert dims.split() == [str(dim) for dim in variable.dims], name
                seen.add((name, file))
    told = {(n, file) for n, entry in variable_table().items() for file in entry["in"]}
    unseen = {one for one in told - seen if one[1] not in ("residual", "grade", "prediction")}
    # of the adjoint, beside a run, and where an experiment has regions
    regions = {("region", "block_model"), ("grade_NAME", "block_model")}
    assert unseen == {("load_cell_footprint", "replicates")} | regions
