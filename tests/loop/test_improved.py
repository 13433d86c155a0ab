"""The improved model as files: what they run is what the loop predicted."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
import yaml
from worlds import mixed_world, walled_world

from pipeline.config.load import load_experiment, load_experiments
from pipeline.effects import declared_effects
from pipeline.lattice.block_model import build_block_model, lattice_of
from pipeline.loop.improved import improved_documents
from pipeline.loop.model import Point, Term
from pipeline.montecarlo.streams import LOOP_FLOW, LOOP_PACKING
from pipeline.observe import RowReader, only_measured
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

BOTH = (0, 1)
TERMS = {
    Term("wall_friction", "K", "material", "gravel", (1,)): 0.4,
    Term("surcharge", "stress", "study", None, BOTH): 0.3,
    Term("density_misdeclared", "factor", "experiment", "drawn", (0,)): 1.2,
    Term("tilt", "angle_x", "experiment", "filled", (1,)): 3.0,
    Term("arching", "transfer", "study", None, BOTH): 0.5,
    Term("sensor_gain", "gain", "load_cell", "west", (1,)): 0.9,
    Term("sensor_offset", "offset", "load_cell", "above", (0,)): 0.2,
    Term("sensor_gain", "gain", "load_cell", "above", (0,)): 1.1,
    Term(
        "local_rule",
        "amplitude",
        "study",
        None,
        BOTH,
        (("channel", "E"), ("feature", "lower_third")),
    ): 0.3,
}

STREAMS = LOOP_PACKING, LOOP_FLOW


def mixed_problem(folder, parameters=("E", "s", "R")):
    """A draw and a static column, in which the same effects can act."""
    shared = [{"name": name, "shared_by": "material"} for name in parameters]
    return mixed_world(folder, study={"parameters": shared})


def point_of(model, *moves) -> Point:
    """A point with all terms, its coordinates moved."""
    coordinates = [c.start + move for c, move in zip(model.coordinates, moves, strict=True)]
    terms = [t for t in TERMS if t.effect != "wall_friction"]
    return Point(tuple(coordinates)).with_terms(terms, [TERMS[t] for t in terms])


def written(world, model, point, folder):
    """Experiments of the files that the loop writes at a point."""
    folder.mkdir()
    for name, text in improved_documents(world.study, model, point, folder).items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return load_experiments(folder)


def plain_mean(experiment, model, case):
    """Mean rows of a plain simulation of a file, on the loop's streams."""
    rows = model.cases[case].rows
    setup = make_setup(experiment, build_block_model(experiment), rows)
    setup = only_measured(setup, rows)
    reader = RowReader(setup, rows)
    parameters = declared_parameters(experiment)
    values = [
        reader.values(
            simulate(
                setup,
                parameters,
                *(model.stream(one, case, k) for one in STREAMS),
            )
        )
        for k in range(model.common(case))
    ]
    sensed = replace(setup, effects=())  # what is simulated has passed the sensors already
    return model._expected(case, reader.sensed(np.array(values), sensed))


def assert_same_prediction(world, point, folder):
    problem = world.problem()
    model = problem.model
    files = written(world, model, point, folder)
    expected = model.mean(point)
    for case, subject in enumerate(model.cases):
        found = plain_mean(files[subject.experiment.name], model, case)
        np.testing.assert_allclose(found, expected[model.slices[case]], rtol=1e-9, atol=1e-9)


def test_files_run_as_the_loop_predicted(tmp_path):
    world = mixed_problem(tmp_path / "w")
    model = world.problem().model
    assert_same_prediction(world, point_of(model, -0.3, 0.2, 0.1), tmp_path / "improved")


@pytest.mark.parametrize("shift", [0.3, -0.4])
def test_E_min_is_written_out_with_its_shift(tmp_path, shift):
    world = mixed_problem(tmp_path / "w", ("E_min",))
    model = world.problem().model
    assert [c.name for c in model.coordinates] == ["E_min"]
    assert_same_prediction(world, Point((shift,)), tmp_path / "improved")


def test_flow_parameters_are_written_out(tmp_path):
    world = mixed_problem(tmp_path / "w", ("exponent", "bulking"))
    model = world.problem().model
    point = Point(tuple(c.start + 0.2 for c in model.coordinates))
    assert_same_prediction(world, point, tmp_path / "improved")


def test_files_hold_the_effects_where_they_act(tmp_path):
    world = mixed_problem(tmp_path / "w")
    model = world.problem().model
    files = written(world, model, point_of(model, 0.0, 0.0, 0.0), tmp_path / "improved")
    assert files["filled"].effects["sensor_gain"] == {"west": {"gain": 0.9}}
    assert files["drawn"].effects["sensor_gain"] == {"above": {"gain": 1.1}}
    assert files["drawn"].effects["sensor_offset"]["above"]["offset"] == 0.2
    assert "density_misdeclared" not in files["filled"].effects
    assert files["drawn"].effects["density_misdeclared"] == {"factor": 1.2}
    assert files["filled"].effects["tilt"]["angle_x"] == 3.0
    assert files["filled"].effects["local_rule"]["feature"] == "lower_third"
    for case, subject in enumerate(model.cases):
        active = model.at(point_of(model, 0.0, 0.0, 0.0), case)[1]
        assert declared_effects(files[subject.experiment.name]) == active


def test_nothing_is_calibrated_again_and_the_readings_stay(tmp_path):
    world = walled_world(tmp_path / "w")
    problem = world.problem()
    point = problem.model.start.with_terms([Term("wall_friction", "K", "study", None, (0,))], [0.4])
    files = written(world, problem.model, point, tmp_path / "improved")
    for name, experiment in files.items():
        original = world.experiments[name]
        assert experiment.calibrate == ()
        assert experiment.measured_path.resolve() == original.measured_path.resolve()
        assert experiment.data_label == original.data_label
        assert experiment.seed == original.seed
    assert files["a"].effects == {"wall_friction": {"K": 0.4, "reach": "level", "cap": False}}
    assert files["b"].effects == {}


def test_a_neutral_term_is_not_written(tmp_path):
    world = walled_world(tmp_path / "w")
    model = world.problem().model
    term = Term("surcharge", "stress", "study", None, (0, 1, 2, 3, 4))
    texts = improved_documents(
        world.study, model, model.start.with_terms([term], [0.0]), tmp_path / "improved"
    )
    for name, text in texts.items():
        document = yaml.safe_load(text)
        assert document.get("effects", {}) == {}
        assert text.startswith("# Written by the closed loop of study tiny")
        assert document["stress"]["E"] == world.experiments[name].stress.E


def test_files_that_an_experiment_names_are_found_from_where_it_is_written(tmp_path):
    """Its mask and those of its regions, wherever they lie."""
    world = walled_world(tmp_path / "w", names="ab", study={"hold_out": ["a"]})
    folder = world.folder / "experiments"
    lattice = lattice_of(world.experiments["b"])
    everywhere = np.ones(lattice.shape, dtype=np.int8)
    axes = {axis: (axis, lattice.centers(axis)) for axis in "zyx"}
    (folder / "ground").mkdir()
    xr.Dataset({"ground": (("z", "y", "x"), everywhere)}, axes).to_netcdf(
        folder / "ground" / "b.nc"
    )
    file = folder / "b.yaml"
    document = yaml.safe_load(file.read_text("utf-8"))
    document["geometry"]["mask"] = {"type": "file", "path": "ground/b.nc", "variable": "ground"}
    column = {"path": "ground/b.nc", "name": "ground", "values": [1]}
    document["regions"] = [
        {"name": "all", "box": {"z": [0, 1]}},
        {"name": "ground", "mask": "ground/b.nc"},
        {"name": "blocks", "column": column},
    ]
    file.write_text(yaml.safe_dump(document), "utf-8")
    problem = world.problem()
    files = written(world, problem.model, problem.model.start, tmp_path / "improved")
    found = build_block_model(files["b"])
    assert found.equals(build_block_model(world.experiments["b"]))
    assert [file.resolve() for file in files["b"].files.values()] == [
        folder / "ground" / "b.nc"
    ] * 3


def test_data_of_the_study_s_own_go_with_the_files(tmp_path):
    world = walled_world(tmp_path / "w", study={"data": {"file": "own.csv", "label": "synthetic"}})
    table = (world.folder / "experiments" / "measured.csv").read_text()
    (world.folder / "studies" / "own.csv").write_text(table)
    problem = world.problem()
    files = written(world, problem.model, problem.model.start, tmp_path / "improved")
    for experiment in files.values():
        own = world.folder / "studies" / "own.csv"
        assert experiment.measured_path.resolve() == own.resolve()
        assert experiment.data_label == "synthetic"
        assert load_experiment(experiment.path).measured is not None
