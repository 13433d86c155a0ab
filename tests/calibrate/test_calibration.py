"""Calibration finds what the data hold, says what they don't, and its intervals cover."""

import math

import numpy as np
import pytest
from scipy.stats import binom, chi2

from pipeline.benchmark.workflow import TESTS
from pipeline.calibrate.calibration import SCALES, Z90, calibrate
from pipeline.config.load import check_measured
from pipeline.config.measured import MeasuredRow
from pipeline.lattice.closed_form import closed_form_stress
from pipeline.lattice.grid import GRAVITY
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import CALIBRATION_FLOW, CALIBRATION_PACKING
from pipeline.observe import row_covariance, simulated_rows
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.setup import make_setup

FAR_STARTS = [
    ("castro_2006", 0.999999, 0.01),
    ("castro_2006", 0.001, 900.0),
    ("castro_2020", 0.999999, 900.0),
    ("castro_2020", 0.001, 0.01),
]


def row(quantity="vertical_stress", value=8.0, std=0.5, **changes):
    defaults = dict.fromkeys(("load_cell", "fill_height", "mass_drawn", "count"))
    given = defaults | {"std_shared": 0.0, "line": 1} | changes
    return MeasuredRow(quantity=quantity, value=value, std=std, **given)


def setup_of(experiment, rows=()):
    return make_setup(experiment, rows=rows)


def fit(experiment, rows):
    return calibrate(experiment, setup_of(experiment, rows), declared_parameters(experiment), rows)


def simulated(experiment, rows, parameters, count, **purposes):
    """Rows (replicate, row), on streams apart from those of the calibration unless asked."""
    setup = setup_of(experiment, rows)
    dataset, _ = run_replicates(setup, parameters, count, fields=False, **purposes)
    return simulated_rows(experiment, dataset, rows)


@pytest.fixture(scope="module")
def calibrated(published):
    """calibrated(name): experiment, rows and calibration of one of Tests 1-9; done once."""
    done = {}

    def get(name):
        if name not in done:
            experiment = published(name)
            rows = check_measured(experiment)
            done[name] = experiment, rows, fit(experiment, rows)
        return done[name]

    return get


# ---------------------------------------------------------------------------------------------
# Tests 1-9


@pytest.mark.parametrize("name", TESTS)
def test_measured_means_and_scatter_are_met_on_fresh_streams(calibrated, name):
    experiment, rows, calibration = calibrated(name)
    used = Parameters.from_document(calibration["parameters_used"])
    means = simulated(experiment, rows, used, 20).mean(axis=0)
    for measured, value in zip(rows, means, strict=True):
        if measured.quantity == "vertical_stress":
            assert value == pytest.approx(measured.value, rel=0.01)
        elif name != "orellana_2012":  # out of reach there
            assert value == pytest.approx(measured.value, rel=0.05)


@pytest.mark.parametrize(("name", "E", "s_std"), FAR_STARTS)
def test_far_starts_end_at_the_same_values(published, calibrated, name, E, s_std):
    _, rows, near = calibrated(name)
    far = fit(published(name, stress={"E": E, "s": {"std": s_std}}), rows)
    assert far["parameters"]["E"]["start"] == E
    assert far["parameters"]["s.std"]["start"] == s_std
    for parameter in ("E", "s.std"):
        value, expected = (c["parameters"][parameter]["value"] for c in (far, near))
        assert value == pytest.approx(expected, rel=1e-4), parameter
    assert near["messages"] == far["messages"] == []


def test_orellana_scatter_is_said_to_be_out_of_reach_with_its_ceiling(calibrated):
    _, _, calibration = calibrated("orellana_2012")
    mean, scatter = calibration["targets"]
    assert mean["reached"] is True
    assert scatter["reached"] is False
    assert scatter["ceiling"] / 8.4 == pytest.approx(0.80, abs=0.02)
    (message,) = [text for text in calibration["messages"] if "out of reach" in text]
    assert "vertical_stress_spatial_std 6.98 is out of reach of s.std: the ceiling is" in message
    assert "of the mean (measured: 0.83)" in message


def test_janssen_K_is_hydraulic_radius_over_attenuation_length_and_wall_friction(calibrated):
    experiment, _, calibration = calibrated("castro_2020")
    E = calibration["parameters"]["E"]
    derived = calibration["derived"]
    length = 0.02 / (1 - E["value"])
    assert derived["attenuation_length"]["value"] == pytest.approx(length)
    radius = 0.70 * 0.23 / (2 * (0.70 + 0.23))  # the declared walls, not the lattice's
    assert derived["hydraulic_radius"]["value"] == experiment.geometry.hydraulic_radius == radius
    friction = math.tan(math.radians(25))
    assert derived["janssen_K"]["value"] == pytest.approx(radius / (length * friction))
    ends = sorted(radius * (1 - end) / (0.02 * friction) for end in E["interval_90"])
    assert derived["janssen_K"]["interval_90"] == pytest.approx(ends)


def test_without_wall_friction_no_K_is_derived(calibrated):
    assert "janssen_K" not in calibrated("castro_2006")[2]["derived"]


# ---------------------------------------------------------------------------------------------
# what the data cannot tell


def test_a_mean_above_hydrostatic_is_out_of_reach_and_E_ends_at_its_bound(column):
    experiment = column(calibrate=["E"])
    calibration = fit(experiment, (row(value=17.0),))
    hydrostatic = 1600 * GRAVITY * 1.0 / 1000
    (target,) = calibration["targets"]
    assert target["reached"] is False
    assert target["ceiling"] == pytest.approx(hydrostatic, rel=1e-3)
    entry = calibration["parameters"]["E"]
    assert entry["at_bound"] is True
    assert entry["value"] > 0.9999
    text = "; ".join(calibration["messages"])
    assert "measured vertical_stress 17 is out of reach of E: the ceiling is 15.7" in text
    assert "E = 1 lies at the end of its range: not a fit" in text


def test_a_mean_below_one_cell_is_out_of_reach_with_its_floor(column):
    calibration = fit(column(calibrate=["E"]), (row(value=0.5),))
    (target,) = calibration["targets"]
    assert target["floor"] == pytest.approx(1600 * GRAVITY * 0.1 / 1000, rel=1e-3)
    assert calibration["parameters"]["E"]["at_bound"] is True


def test_a_parameter_without_data_keeps_its_start_and_says_so(column):
    calibration = fit(column(calibrate=["E", "s"]), (row(value=8.0),))
    entry = calibration["parameters"]["s.std"]
    assert (entry["value"], entry["calibrated"], entry["interval_90"]) == (3.0, False, None)
    assert calibration["messages"] == [
        "s.std keeps its start: no measured vertical_stress_spatial_std to fit it to"
    ]


@pytest.mark.parametrize(("mass", "blind"), [(0.0, ["R"]), (8.0, ["E", "R"])])
def test_what_no_row_tells_of_is_as_open_as_its_range(drawn, mass, blind):
    """R moves nothing before draw; during it one reading tells of E and R together, not apart."""
    experiment = drawn(calibrate=["E", "R"])
    calibration = fit(experiment, (row(load_cell="beside", mass_drawn=mass, value=6.0),))
    posterior = calibration["posterior"]
    sd = dict(zip(posterior["parameters"], np.sqrt(np.diag(posterior["covariance"])), strict=True))
    assert sd["R"] > 0.5
    said = [text.partition(":")[0] for text in calibration["messages"] if "tells of it" in text]
    assert said == blind
    assert calibration["parameters"]["R"]["interval_open"]


def test_without_rows_nothing_is_fitted(column):
    calibration = fit(column(calibrate=["E", "s"]), ())
    assert calibration["parameters_used"] == calibration["declared"]
    assert calibration["targets"] == []
    assert len(calibration["messages"]) == 2


def test_without_calibrate_rows_fit_nothing(column):
    calibration = fit(column(), (row(),))
    assert calibration["parameters_used"] == calibration["declared"]
    assert calibration["messages"] == []


def test_fill_levels_are_fitted_together(column):
    levels = (0.3, 0.6, 1.0)
    truth = [closed_form_stress(1600, GRAVITY, 0.1, 0.8, h / 0.1) / 1000 for h in levels]
    rows = tuple(row(value=v, fill_height=h) for v, h in zip(truth, levels, strict=True))
    calibration = fit(column(calibrate=["E"]), rows)
    assert calibration["parameters"]["E"]["value"] == pytest.approx(0.8, rel=1e-6)
    assert [target["reached"] for target in calibration["targets"]] == [None] * 3


# ---------------------------------------------------------------------------------------------
# uncertainty


def half_width(calibration, name):
    """Of the 90 % interval, in the coordinate that the parameter is searched in."""
    low, high = calibration["parameters"][name]["interval_90"]
    return abs(SCALES[name].forward(high) - SCALES[name].forward(low)) / 2


def test_row_covariance_by_hand():
    rows = [
        row(std=1.0, std_shared=2.0, load_cell="a"),
        row(std=1.0, std_shared=3.0, load_cell="a", count=4),
        row(std=1.0, std_shared=3.0, load_cell="b", count=9),
    ]
    scatter = np.array([[9.0, 9, 9], [9, 36, 12], [9, 12, 36]])
    expected = [[1 + 4, 6, 0], [6, 1 + 9 + 36 / 4, 12 / 6], [0, 12 / 6, 1 + 9 + 36 / 9]]
    np.testing.assert_allclose(row_covariance(rows, scatter), expected)


LOAD_CELLS = [
    {"name": "a", "x": 0.1, "y": 0.2, "width": 0.2, "length": 0.4},
    {"name": "b", "x": 0.4, "y": 0.2, "width": 0.2, "length": 0.4},
]


@pytest.mark.parametrize("count", [1, 4])
def test_count_adds_the_replicates_scatter_over_n_to_the_interval(column, count):
    experiment = column(calibrate=["E"], load_cells=LOAD_CELLS)
    alone, several = (
        fit(experiment, (row(load_cell="a", std=0.2, count=n),)) for n in (None, count)
    )
    used = Parameters.from_document(alone["parameters_used"])
    streams = (CALIBRATION_PACKING, CALIBRATION_FLOW)
    replicates = simulated(experiment, (row(load_cell="a"),), used, 20, purposes=streams)
    scatter = replicates.var(ddof=1)
    expected = (0.2**2 + scatter / count + scatter / 20) / (0.2**2 + scatter / 20)
    ratio = (half_width(several, "E") / half_width(alone, "E")) ** 2
    assert ratio == pytest.approx(expected, rel=1e-6)


def test_a_shared_error_widens_the_interval_and_does_not_average_out(column):
    def interval(shared, cells):
        rows = tuple(
            row(value=v, std=0.4, std_shared=shared, load_cell=cell, fill_height=h)
            for (v, h), cell in zip(((7.0, 0.6), (9.0, 1.0)), cells, strict=True)
        )
        return half_width(fit(column(calibrate=["E"], load_cells=LOAD_CELLS), rows), "E")

    none = interval(0.0, "aa")
    assert interval(1.0, "ab") > 1.5 * none
    assert interval(1.0, "aa") > 1.2 * interval(1.0, "ab")  # one load cell: all errors alike


WORLDS = 40
ERROR_RATE = 1e-2  # of each bound below for a fresh seed; the seeds are fixed


def assert_intervals_cover(worlds, name, truth):
    """As many 90 % intervals hold the truth as a binomial bound asks for."""
    intervals = np.array([world["parameters"][name]["interval_90"] for world in worlds])
    inside = np.sum((intervals[:, 0] <= truth) & (truth <= intervals[:, 1]))
    least = binom.ppf(ERROR_RATE, WORLDS, 0.9)
    assert inside >= least, f"{name}: {inside} of {WORLDS} cover"


def assert_widths_fit_errors(worlds, name, truth):
    """Errors over their claimed standard deviations have the sum of squares of chi²."""
    forward = SCALES[name].forward
    errors = [forward(world["parameters"][name]["value"]) - forward(truth) for world in worlds]
    claimed = [half_width(world, name) / Z90 for world in worlds]
    squares = np.sum(np.divide(errors, claimed) ** 2)
    low, high = chi2.ppf([ERROR_RATE / 2, 1 - ERROR_RATE / 2], WORLDS)
    assert low < squares < high, f"{name}: {squares:.1f}, expected {low:.1f} to {high:.1f}"


@pytest.fixture
def short_scan(monkeypatch):
    """Fits start from the truth here, so the search for a start can be short."""
    monkeypatch.setattr("pipeline.calibrate.calibration.SCAN", 2)


@pytest.mark.usefixtures("short_scan")
def test_intervals_cover_known_E_and_s(column):
    quantities = ("vertical_stress", "vertical_stress_spatial_std")
    blank = tuple(row(quantity) for quantity in quantities)
    known = column()
    truth = simulated(known, blank, declared_parameters(known), 2000).mean(axis=0)
    std = np.array([0.3, 0.15])
    values = np.random.default_rng(2022).normal(truth, std, (WORLDS, 2))
    worlds = [
        fit(
            column(calibrate=["E", "s"], seed=seed),
            tuple(map(row, quantities, values[seed], std)),
        )
        for seed in range(WORLDS)
    ]
    for name, true in (("E", 0.9), ("s.std", 3.0)):
        assert_intervals_cover(worlds, name, true)
        assert_widths_fit_errors(worlds, name, true)


@pytest.mark.usefixtures("short_scan")
def test_intervals_cover_known_E_from_load_cells_in_one_packing(column):
    # the worlds' packings come from streams that no calibration uses
    known = column(load_cells=LOAD_CELLS)
    blank = tuple(row(load_cell=cell) for cell in "ab")
    packings = simulated(known, blank, declared_parameters(known), WORLDS)
    values = packings + np.random.default_rng(2022).normal(0, 0.3, packings.shape)
    worlds = [
        fit(
            column(calibrate=["E"], load_cells=LOAD_CELLS, seed=seed),
            tuple(
                row(value=value, std=0.3, count=1, load_cell=cell)
                for cell, value in zip("ab", values[seed], strict=True)
            ),
        )
        for seed in range(WORLDS)
    ]
    assert_intervals_cover(worlds, "E", 0.9)
