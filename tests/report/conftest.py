"""Pages of tiny experiments."""

from pathlib import Path

import pytest
from comparisons import MadeComparison, make_comparison
from other_pages import make_blind, make_catalogue, make_index, make_prediction
from pages import Made, row
from pages import make_page as make_page_in
from studies import MadeStudy, closed_loop, make_study


@pytest.fixture(scope="session")
def make_page(tmp_path_factory):
    """make_page(experiment, rows=()): results and page of an experiment."""

    def make(experiment, rows=()) -> Made:
        folder = tmp_path_factory.mktemp("results") / "experiments" / experiment.name
        return make_page_in(experiment, rows, folder)

    return make


@pytest.fixture(scope="session")
def static(column, make_page) -> Made:
    """A calibrated static experiment with published numbers and several fill levels."""
    experiment = column(
        filling={"levels": [0.4, 0.7]},
        walls={"friction_angle": 25},
        calibrate=["E", "s"],
        measured="table.csv",
        assumed=["stress.s"],
        source="A source",
        published={"vertical_stress_mean": 9.5, "vertical_stress_std": 3.0, "source": "Table 1"},
    )
    rows = (row(), row("vertical_stress_spatial_std", 2.0, 0.2), row(value=5.0, fill_height=0.4))
    return make_page(experiment, rows)


@pytest.fixture(scope="session")
def draw(drawn, make_page) -> Made:
    """A draw experiment with readings of one load cell and of the movement zone."""
    experiment = drawn(
        measured="table.csv",
        data_label="simulated (DEM)",
        assumed=["drawpoints", "load_cells"],
        published={"mean_absolute_error": 1.53, "source": "a paper"},
    )
    rows = (
        *(row(load_cell="beside", mass_drawn=m, value=9.0 + m / 10, count=1) for m in (0, 4, 8)),
        row("vertical_stress_ratio", 0.6, 0.05, load_cell="above", mass_drawn=8.0),
        row("movement_zone_height", 0.5, 0.05, mass_drawn=4.0),
    )
    return make_page(experiment, rows)


@pytest.fixture(scope="session")
def regions(drawn, make_page) -> Made:
    """A draw experiment of ore under a waste cap, with two grades."""
    grade = {"Cu": {"value": 0.7, "unit": "%"}, "Au": {"value": 0.2, "unit": "g/t"}}
    experiment = drawn(
        "regions",
        material={"name": "tuff <b>"},
        regions=[
            {"name": "ore", "box": {"z": [0, 0.8]}, "grade": grade},
            {"name": "cap", "box": {"z": [0.4, 0.8]}, "bulk_density": 1300, "waste": True},
        ],
        draw=[{"drawpoints": ["west"], "mass": 120.0, "increment": 1.0}],
        readings={"every": 40.0},
        measured="table.csv",
        assumed=["regions"],
    )
    return make_page(experiment, (row(load_cell="beside", mass_drawn=0.0),))


@pytest.fixture(scope="session")
def study(tmp_path_factory) -> MadeStudy:
    """A study that found an effect."""
    return make_study(tmp_path_factory.mktemp("study"), closed_loop())


@pytest.fixture(scope="session")
def comparison(drawn, tmp_path_factory) -> MadeComparison:
    """Two draws of the same layout."""
    pair = drawn("west_first", assumed=["flow", "draw"]), drawn("west_second")
    return make_comparison(*pair, tmp_path_factory.mktemp("comparison"), title="Two strategies")


@pytest.fixture(scope="session")
def pillars(drawn, make_page) -> Made:
    """A draw experiment with as many load cells as a mine has pillars."""
    side = {"width": 0.04, "length": 0.04}
    cells = [
        {"name": f"P{row}-{i}", "x": 0.05 + 0.1 * i, "y": 0.1 + 0.15 * row, **side}
        for row in range(3)
        for i in range(6)
    ]
    return make_page(
        drawn("pillars_of_lower_level", load_cells=cells, assumed=["load_cells"], replicates=3)
    )


@pytest.fixture(scope="session")
def prediction(drawn, tmp_path_factory) -> Path:
    """A prediction of a draw, held against readings of a load cell and of the base."""
    experiment = drawn(
        title="A draw", prediction={"samples": 20}, measured="table.csv", data_label="measured"
    )
    readings = ((0.0, "beside", 9.0), (4.0, "beside", 6.0), (8.0, "above", 4.0), (8.0, None, 9.0))
    rows = [row(value=v, load_cell=c, mass_drawn=m, count=1) for m, c, v in readings]
    return make_prediction(experiment, rows, "beside", tmp_path_factory.mktemp("prediction"))


@pytest.fixture(scope="session")
def still(column, tmp_path_factory) -> Path:
    """A prediction of a column at one reading, with many load cells."""
    cells = [
        {"name": f"C{i}", "x": 0.05 * i, "y": 0.2, "width": 0.05, "length": 0.05}
        for i in range(1, 10)
    ]
    experiment = column("still", load_cells=cells, prediction={"samples": 20}, measured="table.csv")
    rows = [row(load_cell=f"C{i}", value=8.0 + i, count=1) for i in (1, 2)]
    return make_prediction(experiment, rows, "C1", tmp_path_factory.mktemp("still"))


@pytest.fixture(scope="session")
def blind(tmp_path_factory) -> Path:
    """Page of a blind benchmark with every outcome that has a place on it."""
    return make_blind(tmp_path_factory.mktemp("blind_benchmark"))


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory) -> Path:
    """Page of all effects."""
    return make_catalogue(tmp_path_factory.mktemp("effects"))


@pytest.fixture(scope="session")
def index(tmp_path_factory, static, draw, pillars, study, comparison, blind) -> Path:
    """The index of an experiment, two draws, a study, a comparison and a blind benchmark."""
    made = [static, draw, pillars]
    return make_index(tmp_path_factory.mktemp("index"), made, study, comparison, blind)
