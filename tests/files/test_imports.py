"""A mine's files become experiments that load and run, with every number where it belongs."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from specs import MINE_ORIGIN

from pipeline.__main__ import main
from pipeline.config.load import check_measured, load_experiment, resolved
from pipeline.files.export import export
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model, lattice_of
from pipeline.montecarlo.replicates import run_experiment
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup, visits

FILES = Path(__file__).parent / "mine_files"


@pytest.fixture
def imported(tmp_path):
    """imported(kind, *arguments, settings=...): the experiment that an import makes."""

    def run(kind, *arguments, settings=None, name="cave"):
        given = [kind, *map(str, arguments), "--name", name, "--into", str(tmp_path)]
        if settings is not None:
            (tmp_path / "settings.yml").write_text(settings)
            given += ["--settings", str(tmp_path / "settings.yml")]
        assert main(["import", *given]) == 0
        return load_experiment(tmp_path / f"{name}.yaml")

    return run


def ground_of(experiment):
    return build_block_model(experiment)["state"].values == 1


# ---------------------------------------------------------------------------------------------
# regions

ROCKS = """\
X,Y,Z,DX,DY,DZ,SG,rock,zone,Au (g/t)
5,5,10,10,10,10,2.6,ore one,1,1.5
15,5,10,10,10,10,2.6,ore two,2,0.5
5,5,20,10,10,10,2.6,waste,3,0.0
15,5,20,10,10,10,2.6,ore one,1,2.5
"""
BY_ROCK = """\
regions:
  - name: ore
    column: rock
    values: [ore one, ore two]
    grade: {Au: {column: Au (g/t), unit: g/t}}
  - {name: cap, column: zone, values: [3], waste: true, bulk_density: 1900}
material: {bulk_density: 2100}
cell_size: 5
"""


def test_columns_of_a_block_model_become_regions_and_grades(imported, tmp_path):
    (tmp_path / "blocks.csv").write_text(ROCKS)
    experiment = imported("blocks", tmp_path / "blocks.csv", settings=BY_ROCK)
    model = build_block_model(experiment)
    blocks = {"region": [[1, 1], [2, 1]], "grade_Au": [[1.5, 0.5], [0.0, 2.5]]}
    blocks["bulk_density"] = [[2100, 2100], [1900, 2100]]
    for name, expected in blocks.items():
        cells = np.repeat(np.repeat(expected, 2, 0), 2, 1)[:, None, :].repeat(2, 1)
        np.testing.assert_array_equal(model[name], cells, err_msg=name)
    assert experiment.grade_units == {"Au": "g/t"}
    assert sorted(path.name for path in tmp_path.rglob("*.nc")) == ["cave.nc"]
    assert (tmp_path / "blocks" / "cave.nc").is_file()


# ---------------------------------------------------------------------------------------------
# block models


def test_a_plain_block_model_becomes_a_box_that_stands_in_the_mine(imported, capsys):
    experiment = imported("blocks", FILES / "blocks.csv")
    geometry = experiment.geometry
    assert (geometry.width, geometry.length, geometry.height) == (30, 20, 20)
    assert geometry.cell_size == 10
    assert geometry.origin.model_dump() == {
        "easting": 5000.0,
        "northing": 2000.0,
        "elevation": 100.0,
    }
    assert geometry.mask is None
    assert experiment.material.bulk_density == pytest.approx(2650)
    assert (
        "densities from 2600 to 2700 kg/m3: the model takes their mean" in capsys.readouterr().out
    )
    assert {"stress", "material.particle_density"} <= set(experiment.assumed)


def test_vulcan_blocks_that_are_air_are_outside_the_ground(imported):
    settings = "columns: {ground: rock}\nground_values: [ore]\n"
    experiment = imported("blocks", FILES / "vulcan.csv", settings=settings)
    assert experiment.geometry.width == 20  # the column of air at the east is outside the box
    assert experiment.material.bulk_density == 2700
    assert ground_of(experiment).all()


def test_air_between_ground_becomes_a_mask(imported, tmp_path):
    text = (FILES / "vulcan.csv").read_text()
    text = text.replace("5005.0,2015.0,115.0,10.0,10.0,10.0,1000.0,2.7,ore",
                        "5005.0,2015.0,115.0,10.0,10.0,10.0,1000.0,-99.0,air")  # fmt: skip
    (tmp_path / "blocks.csv").write_text(text)
    settings = "columns: {ground: rock}\nground_values: [ore]\n"
    experiment = imported("blocks", tmp_path / "blocks.csv", settings=settings)
    expected = np.ones((2, 2, 2), dtype=bool)
    expected[1, 1, 0] = False
    np.testing.assert_array_equal(ground_of(experiment), expected)


def test_leapfrog_blocks_in_any_order_without_sizes(imported):
    experiment = imported("blocks", FILES / "leapfrog.csv")
    assert lattice_of(experiment).shape == (2, 2, 3)
    assert experiment.geometry.origin.elevation == 100
    assert experiment.material.bulk_density == 2700


def test_missing_blocks_can_be_outside(imported, tmp_path):
    lines = (FILES / "blocks.csv").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("5015,2005,115", "5025,2015,115"))]
    (tmp_path / "blocks.csv").write_text("\n".join(kept))
    experiment = imported("blocks", tmp_path / "blocks.csv", "--gaps", "outside")
    expected = np.ones((2, 2, 3), dtype=bool)
    expected[1, 0, 1] = expected[1, 1, 2] = False
    np.testing.assert_array_equal(ground_of(experiment), expected)


@pytest.mark.parametrize("degrees", [12.34, -0.5, 44, 90 + 30])
def test_a_rotated_grid_turned_back_as_the_error_says_is_imported(
    imported, tmp_path, capsys, degrees
):
    """Gaps included: the recipe's two formulas, applied to the columns as they stand there."""
    columns, rows = np.array([5000.0, 2000.0]), np.random.default_rng(5)
    plan = np.argwhere(rows.random((40, 30)) > 0.1) * 10.0
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, y = (plan @ turn.T + columns).round(3).T
    path = tmp_path / "blocks.csv"

    def write(x, y):
        lines = [
            f"{a:.3f},{b:.3f},{z},10,10,10,2.6" for z in (5, 15) for a, b in zip(x, y, strict=True)
        ]
        path.write_text("\n".join(["X,Y,Z,DX,DY,DZ,SG", *lines]) + "\n")

    write(x, y)
    assert main(["import", "blocks", str(path), "--name", "cave", "--into", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    rotation = (degrees + 45) % 90 - 45
    way = "counterclockwise" if rotation > 0 else "clockwise"
    assert f"the grid is rotated by {abs(rotation):.1f}° {way} in plan" in said
    formulas = re.findall(r"[xy]' = ([^,\n]+)", said)
    assert len(formulas) == 2
    write(*(eval(f.replace(" (", " * ("), {"x": x, "y": y}) for f in formulas))
    geometry = imported("blocks", path, "--gaps", "outside", name="turned").geometry
    sides = (geometry.width, geometry.length)
    assert sides == ((300, 400) if degrees > 90 else (400, 300))
    assert geometry.cell_size == 10


def test_blocks_that_are_no_cubes_are_divided_into_cells(imported, tmp_path):
    rows = ["xc,yc,zc,xl,yl,zl,sg"]
    for x, y, z in np.ndindex(2, 2, 2):
        if (x, y, z) != (1, 1, 1):
            rows.append(f"{20 * x},{10 * y},{15 * z},20,10,15,2.5")
    (tmp_path / "blocks.csv").write_text("\n".join(rows))
    experiment = imported("blocks", tmp_path / "blocks.csv", "--gaps", "outside")
    assert experiment.geometry.cell_size == 5
    ground = ground_of(experiment)
    assert ground.shape == (6, 4, 8)
    expected = np.ones_like(ground)
    expected[3:, 2:, 4:] = False
    np.testing.assert_array_equal(ground, expected)


def test_feet_and_a_column_map(imported, tmp_path):
    text = (FILES / "blocks.csv").read_text().replace("X,Y,Z,DX,DY,DZ,SG", "a,b,c,d,e,f,rock_g")
    (tmp_path / "blocks.csv").write_text(text)
    settings = (
        "columns: {x: a, y: b, z: c, dx: d, dy: e, dz: f, density: rock_g}\n"
        "units: {length: ft, density: g/cm3}\n"
        "cell_size: 1.524\n"
    )
    experiment = imported("blocks", tmp_path / "blocks.csv", settings=settings)
    assert experiment.geometry.width == pytest.approx(30 * 0.3048)
    assert experiment.geometry.origin.easting == pytest.approx(5000 * 0.3048)
    assert lattice_of(experiment).shape == (4, 4, 6)


def test_what_the_settings_say_is_not_assumed(imported):
    settings = (
        "material: {name: ore, bulk_density: 1900, particle_density: 2800}\n"
        "stress: {E: 0.8, s: {mean: 2, std: 0.5}}\n"
    )
    experiment = imported("blocks", FILES / "blocks.csv", settings=settings)
    assert experiment.assumed == ()
    assert (experiment.E, experiment.stress.s.std) == (0.8, 0.5)
    assert experiment.material.bulk_density == 1900


@pytest.mark.parametrize("kind", ["static", "mine"])
@pytest.mark.parametrize("flavor", ["block_model", "vulcan"])
def test_an_exported_block_model_comes_back_as_it_was(imported, written, tmp_path, kind, flavor):
    experiment, folder = written(kind)
    file = export(folder, flavor, tmp_path / "blocks.csv")
    settings = "columns: {density: bulk_density_kg_m3}\ngaps: outside\n"
    again = imported("blocks", file, settings=settings)
    np.testing.assert_array_equal(ground_of(again), ground_of(experiment))
    assert again.geometry.cell_size == experiment.geometry.cell_size
    assert again.material.bulk_density == pytest.approx(
        build_block_model(experiment)["bulk_density"].values[ground_of(experiment)].mean()
    )
    origin = {"easting": 0, "northing": 0, "elevation": 0} if kind == "static" else MINE_ORIGIN
    assert again.geometry.origin.model_dump() == pytest.approx(origin, abs=1e-6)


def test_files_that_are_there_are_not_replaced_unasked(imported, tmp_path, capsys):
    imported("blocks", FILES / "blocks.csv")
    before = (tmp_path / "cave.yaml").read_bytes()
    again = ["import", "blocks", str(FILES / "leapfrog.csv"), "--name", "cave"]
    assert main([*again, "--into", str(tmp_path)]) == 1
    assert "is there already; choose another name, or --overwrite" in capsys.readouterr().err
    assert (tmp_path / "cave.yaml").read_bytes() == before
    assert main([*again, "--into", str(tmp_path), "--overwrite"]) == 0
    assert (tmp_path / "cave.yaml").read_bytes() != before


# ---------------------------------------------------------------------------------------------
# MassFlow


def massflow(**changes):
    files = {
        "blocks": "mine_blocks.csv",
        "drawpoints": "drawpoints.csv",
        "schedule": "schedule.csv",
    } | changes
    return [part for key, file in files.items() for part in (f"--{key}", FILES / file)]


def test_massflow_keeps_densities_names_and_places(imported):
    experiment = imported("massflow", *massflow())
    assert experiment.material.bulk_density == pytest.approx(2600 * 0.95)
    assert experiment.material.particle_density == 2600
    assert experiment.material.internal_friction_angle == 42
    assert experiment.flow.bulking == pytest.approx(0.95 / 0.76 - 1)
    places = {point.name: (point.x, point.y) for point in experiment.drawpoints}
    assert places == {"DP1S": (5.5, 6.0), "DP1N": (24.5, 12.25)}


def test_both_variants_of_mine_blocks_say_the_same(imported):
    one = imported("massflow", *massflow(), name="commas")
    other = imported("massflow", *massflow(blocks="mine_blocks_tabs.txt"), name="tabs")
    assert one.geometry == other.geometry
    assert one.material == other.material


def test_each_drawpoint_gives_in_each_period_what_the_schedule_says(imported):
    experiment = imported("massflow", *massflow())
    ends = experiment.readings.at_mass_drawn
    assert ends == pytest.approx((5.2e6, 10.4e6))  # nothing is drawn in the third period
    drawn, before = np.zeros((2, 2)), 0.0
    for point, until in visits(experiment):
        period = int(before >= ends[0] * (1 - 1e-9))
        drawn[point, period] += until - before
        before = until
    np.testing.assert_allclose(drawn, [[2.6e6, 1.3e6], [2.6e6, 3.9e6]], rtol=1e-9)


def test_blocks_below_the_drawpoints_are_cut_off(imported, tmp_path):
    text = (FILES / "drawpoints.csv").read_text().replace("100.4", "111").replace(" 101", " 110")
    (tmp_path / "drawpoints.csv").write_text(text)
    files = massflow(drawpoints=tmp_path / "drawpoints.csv", schedule=FILES / "schedule.csv")
    settings = "base: 110\nmaterial: {bulk_density: 2470}\n"
    experiment = imported("massflow", *files, settings=settings)
    assert experiment.geometry.height == 10
    assert experiment.geometry.origin.elevation == 110


def test_names_that_look_like_numbers_stay_names(imported, tmp_path):
    for file in ("drawpoints.csv", "schedule.csv"):
        text = (FILES / file).read_text().replace("DP1S", "12E04").replace("DP1N", "007")
        (tmp_path / file).write_text(text)
    files = massflow(drawpoints=tmp_path / "drawpoints.csv", schedule=tmp_path / "schedule.csv")
    experiment = imported("massflow", *files)
    assert [point.name for point in experiment.drawpoints] == ["12E04", "007"]


def test_an_imported_experiment_runs_and_its_results_stand_in_the_mine(imported, tmp_path):
    experiment = imported("massflow", *massflow())
    model = build_block_model(experiment)
    declared = declared_parameters(experiment)
    replicates, fields = run_experiment(make_setup(experiment, model), declared, declared)
    for name, data in (("block_model", model), ("replicates", replicates), ("fields", fields)):
        write_dataset(tmp_path / f"{name}.nc", data, experiment, name, name)
    assert read_dataset(tmp_path / "fields.nc").attrs["origin_elevation"] == 100.0
    text = export(tmp_path, "csv", tmp_path / "a.csv").read_text().splitlines()
    header = text[0].split(",")
    last = dict(zip(header, text[-1].split(","), strict=True))
    assert (last["name"], last["easting_m"], last["northing_m"]) == ("DP1N", "5024.5", "2012.25")
    assert float(last["mean_mpa"]) > 0
    assert float(last["drawn_from_here_t"]) == pytest.approx(6500, rel=0.4)  # in cells of 2470 t


# ---------------------------------------------------------------------------------------------
# measured stress


@pytest.fixture
def cave(tmp_path):
    """The experiment to measure in, in a folder of its own."""
    shutil.copy(FILES / "cave.yaml", tmp_path)
    return tmp_path / "cave.yaml"


def measured_rows(cave, *arguments):
    assert main(["import", "measured", *map(str, arguments), "--experiment", str(cave)]) == 0
    cave.write_text(cave.read_text() + "measured: measured/cave.csv\n")
    return check_measured(load_experiment(cave))


SCHEDULE = ("--schedule", FILES / "schedule.csv", "--start", "2025-01-01")


def test_dates_become_masses_and_mpa_become_kpa(cave, capsys):
    rows = measured_rows(cave, FILES / "stress.csv", *SCHEDULE)
    assert "measured: measured/cave.csv" in capsys.readouterr().out
    found = [(row.load_cell, row.mass_drawn, row.value, row.std, row.count) for row in rows]
    expected = [
        ("P1", 0.0, 300.0, 20.0, 1),  # before the schedule starts
        ("P1", 2.6e6, 340.0, 20.0, 1),  # 15 of the 30 days of the first period
        ("P1", 10.4e6, 280.0, 20.0, 1),  # the second period's end
        ("P2", 2.6e6, 250.0, 20.0, 1),
    ]
    assert [(cell, count) for cell, *_, count in found] == [(c, n) for c, *_, n in expected]
    np.testing.assert_allclose(
        [row[1:4] for row in found], [row[1:4] for row in expected], rtol=1e-9
    )


def test_a_change_of_stress_is_added_to_the_stress_before_draw(cave):
    rows = measured_rows(cave, FILES / "stress_change.csv", *SCHEDULE)
    np.testing.assert_allclose([row.value for row in rows], [300, 340, 280])
    assert {row.std_shared for row in rows} == {50.0}


def test_tonnes_drawn_by_date_take_the_place_of_a_schedule(cave):
    rows = measured_rows(cave, FILES / "stress.csv", "--drawn", FILES / "drawn.csv")
    np.testing.assert_allclose([r.mass_drawn for r in rows], [0, 2.6e6, 10.4e6, 2.6e6], rtol=1e-9)


# ---------------------------------------------------------------------------------------------
# what is there stays as it was


def test_without_an_origin_nothing_of_it_is_said(column, written):
    assert "origin" not in resolved(column())["geometry"]
    assert not [
        key for key in read_dataset(written("draw")[1] / "fields.nc").attrs if "origin" in key
    ]


def test_an_origin_moves_nothing_in_the_model(column):
    placed = column(geometry={"origin": MINE_ORIGIN})
    assert build_block_model(placed).identical(build_block_model(column()))
