"""Predictions: on plain packings to the bit, shares against closed forms, honest coverage."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from pipeline.calibrate.calibration import SCALES, calibrate
from pipeline.effects import Active
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import random_stream
from pipeline.montecarlo.workers import Execution
from pipeline.observe import simulated_rows
from pipeline.parameters import declared_parameters
from pipeline.predict.knowledge import AMPLITUDE, PARAMETER, Knowledge, Unknown, from_calibration
from pipeline.predict.prediction import SOURCES, predict, variance_shares, with_effects
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

ERRORS = 4.0  # standard errors that a share may be off: 6e-5 for each normal one


def of(experiment, document, rows=(), **given):
    """Prediction of an experiment from one calibration."""
    known = from_calibration([experiment], {experiment.name: document})
    return predict(experiment, build_block_model(experiment), known, rows, **given)


def sd_of(dataset, name):
    return dataset[name].values.std(axis=0, ddof=1)


@pytest.mark.parametrize("kind", ["static", "draw"])
def test_without_posterior_variance_it_is_the_plain_replicates_to_the_bit(
    kind, predicted, drawn, posterior
):
    samples = {"prediction": {"samples": 20}}
    experiment = predicted(**samples) if kind == "static" else drawn("drawn", **samples)
    fitted = {"E": (SCALES["E"].forward(0.9), 0.0)}
    dataset, document = of(experiment, posterior(experiment, fitted))
    setup = make_setup(experiment, build_block_model(experiment))
    plain, _ = run_replicates(setup, declared_parameters(experiment), 20)
    assert np.array_equal(dataset["vertical_stress"].values, plain["vertical_stress"].values)
    assert document["simulated_replicates"] == 20
    share = dataset["vertical_stress_variance_share"].values
    assert np.all(share[SOURCES.index("packing")] == 1.0)
    assert np.all(share[1:] == 0.0)


def test_with_uniform_packing_all_of_it_is_calibration(predicted, posterior):
    experiment = predicted(stress={"s": {"mean": 4, "std": 0.0}})
    fitted = {"E": (SCALES["E"].forward(0.9), 0.1)}
    dataset, _ = of(experiment, posterior(experiment, fitted))
    share = dataset["vertical_stress_variance_share"].values
    assert share[SOURCES.index("calibration")] == pytest.approx(1.0, abs=1e-9)
    assert share[SOURCES.index("packing")] == pytest.approx(0.0, abs=1e-9)
    assert share[SOURCES.index("interaction")] == pytest.approx(0.0, abs=1e-9)
    assert sd_of(dataset, "vertical_stress").min() > 0.1


def test_the_mean_over_the_base_has_no_scatter_of_packing(predicted, posterior):
    experiment = predicted()
    dataset, _ = of(experiment, posterior(experiment, {"E": (SCALES["E"].forward(0.9), 0.1)}))
    share = dataset["base_vertical_stress_variance_share"].values[:, 0]
    assert share[SOURCES.index("packing")] < 1e-9
    assert share[SOURCES.index("calibration")] == pytest.approx(1.0, abs=1e-9)
    assert dataset["vertical_stress_variance_share"].values[0].min() > 0.1


def linear(correlation):
    """Unknowns of a toy: a parameter and an amplitude, sd 2 and 3."""
    covariance = np.array([[4.0, 6.0 * correlation], [6.0 * correlation, 9.0]])
    unknowns = tuple(
        Unknown(label, kind, "1", 0.0, -1e6, 1e6, float, 1e6, False)
        for label, kind in (("a", PARAMETER), ("b", AMPLITUDE))
    )
    return Knowledge("a toy", unknowns, covariance, lambda u: u)


@pytest.mark.parametrize("correlation", [0.0, -0.8])
def test_shares_of_a_linear_model_are_the_closed_form(correlation):
    """Y = P + a + b: what a implies of b belongs to calibration, the rest of b to the effect."""
    known, n = linear(correlation), 4000
    stream = [random_stream(7, "toy", 100, i) for i in range(n)]
    packing = np.array([random.normal(0.0, 1.5, 2) for random in stream]).ravel()
    drawn, implied = (
        np.repeat(np.array(x), 2, axis=0) for x in zip(*map(known.sample, stream), strict=True)
    )
    calibration = packing + implied.sum(axis=1)
    variance, share, error = variance_shares(packing, calibration, packing + drawn.sum(axis=1))
    parts = np.array([1.5**2, (2 + 3 * correlation) ** 2, 9 * (1 - correlation**2)])
    expected = np.append(parts / parts.sum(), 0.0)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.all(np.abs(share - expected) < ERRORS * error + 1e-12)
    assert np.all(error < 0.05)
    assert variance == pytest.approx(parts.sum(), rel=ERRORS * math.sqrt(2 / n))


def test_the_jackknife_error_is_the_scatter_of_shares():
    """Over 400 repetitions its mean square is theirs, within 4 of its standard errors (20 %)."""
    random = np.random.default_rng(3)
    packing = random.normal(size=(200, 400))
    parameter, effect = np.repeat(random.normal(size=(2, 100, 400)), 2, axis=1)
    steps = packing, packing + 0.7 * parameter, packing + 0.7 * parameter + 0.4 * effect
    _, share, error = variance_shares(*(1.0 + step for step in steps))
    share, error = share[:3], error[:3]
    ratio = np.sqrt((error**2).mean(axis=1)) / share.std(axis=1)
    assert np.all(np.abs(ratio - 1.0) < 0.2)


def test_packings_that_change_with_the_parameters_bias_nothing():
    """As those of a flow do: nothing in common with the packing at the best values."""
    random = np.random.default_rng(5)
    at_best, other = random.normal(size=(2, 4000))
    parameter = np.repeat(random.normal(size=2000), 2)
    _, share, error = variance_shares(at_best, other + parameter, other + parameter)
    assert np.all(np.abs(share - [0.5, 0.5, 0.0, 0.0]) < ERRORS * error + 1e-12)
    assert error.max() < 0.04


def test_a_scatter_that_grows_with_the_parameter_is_the_interaction():
    """Y = (1 + b) P, with b = ±1/2: E Var(Y | b) = 1 + 1/4 against 1 at the best value."""
    random = np.random.default_rng(6)
    packing = random.normal(size=8000)
    factor = 1.0 + np.repeat(random.choice([-0.5, 0.5], 4000), 2)
    _, share, error = variance_shares(packing, factor * packing, factor * packing)
    assert np.all(np.abs(share - [0.8, 0.0, 0.0, 0.2]) < ERRORS * error + 1e-12)
    assert error.max() < 0.03


@pytest.mark.parametrize(("name", "sd"), [("E", 0.02), ("s.std", 0.2)])
def test_no_sample_leaves_its_range_and_the_spread_is_the_posteriors(
    name, sd, predicted, posterior
):
    """E = 0.9 as it is, with the sd that 0.2 in ln(1 − E) is; the sd of s as its logarithm."""
    experiment = predicted(prediction={"samples": 400})
    u = SCALES[name].forward(declared_parameters(experiment).value(name))
    dataset, _ = of(experiment, posterior(experiment, {name: (u, 0.2)}))
    values = dataset[{"E": "sampled_E", "s.std": "sampled_s_std"}[name]].values
    assert SCALES[name].low <= values.min() < values.max() <= SCALES[name].high
    drawn = values if name == "E" else np.log(values)
    best = 0.9 if name == "E" else u
    assert len(set(values)) == 200  # two packings each
    assert drawn.mean() == pytest.approx(best, abs=ERRORS * sd / math.sqrt(200))
    assert drawn.std() == pytest.approx(sd, rel=ERRORS / math.sqrt(400))


def test_near_1_E_stays_where_the_readings_have_it(predicted, reading):
    """A load of all the weight says E = 1, give or take what the readings' sd is in E.

    The fit ends at its range's end, where log(1 − E) is next to flat: its sd is thousands.
    """
    experiment = predicted(calibrate=["E"], prediction={"samples": 200})
    model = build_block_model(experiment)
    setup = make_setup(experiment, model)
    weight = 1600 * 9.81 * 1.0 / 1000 * 1.01
    rows = [reading(weight, 0.5, count=None)]
    calibration = calibrate(experiment, setup, declared_parameters(experiment), rows)
    assert calibration["posterior"]["covariance"][0][0] > 100.0**2
    dataset, document = of(experiment, calibration, rows)
    slope = weight * (10 - 1) / 2  # of the base's stress by E at 1, ten layers
    off = 1.0 - dataset["sampled_E"].values
    assert 0.0 < off.min() < off.max() < 5 * 0.5 / slope
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.5 / slope, rel=0.25)
    assert "do not bound E" in document["remarks"][0]
    (unknown,) = document["unknowns"]
    assert unknown["at_bound"]
    assert unknown["identified"]


def test_what_no_reading_tells_of_is_drawn_from_its_prior_and_said_so(predicted, posterior):
    experiment = predicted(prediction={"samples": 200})
    low, high = SCALES["s.std"].bounds
    fitted = {"E": (SCALES["E"].forward(0.9), 0.1), "s.std": (math.log(3), high - low)}
    dataset, document = of(experiment, posterior(experiment, fitted))
    (remark,) = document["remarks"]
    assert remark.startswith("The data tell next to nothing of s.std")
    assert [one["identified"] for one in document["unknowns"]] == [True, False]
    assert np.log(dataset["sampled_s_std"].values).std() > 0.2 * (high - low)


def test_a_posterior_that_fills_its_range_is_cut_off_at_its_ends(drawn, posterior):
    experiment = drawn("drawn", prediction={"samples": 100})
    dataset, document = of(experiment, posterior(experiment, {"R": (0.02, 0.3)}))
    values = dataset["sampled_R"].values
    assert values.min() >= 0.0
    assert 0.1 < values.mean() < 0.4
    assert (values > 0.5).any()
    assert [one["label"] for one in document["unknowns"]] == ["R"]


def test_an_impossible_posterior_is_said_so(predicted):
    unknown = Unknown("E", PARAMETER, "1", 0.0, -1e-9, 1e-9, float, 1.0, False)
    known = Knowledge("study x", (unknown,), np.eye(1), lambda u: u)
    with pytest.raises(ValueError, match="study x: no sample of E within"):
        known.sample(random_stream(1, "a", 0, 0))


def test_what_a_source_knows_is_carried_along(predicted, posterior):
    """E of the source moves this experiment's; what this one gives itself does not move."""
    source = predicted("source")
    fitted = {"E": (SCALES["E"].forward(0.9), 0.1), "s.std": (math.log(3), 0.3)}
    calibrated = posterior(source, fitted)
    own = predicted(stress={"from": "source", "E": None, "s": {"mean": 4, "std": 2}})
    taken = declared_parameters(own, {"source": declared_parameters(source)})
    documents = {own.name: posterior(own, {}, taken), "source": calibrated}
    known = from_calibration([own, source], documents)
    assert [one.label for one in known.unknowns] == ["E (source)"]
    assert known.source == "calibration of source"
    assert known.at(known.best)[0] == taken
    dataset, _ = predict(own, build_block_model(own), known)
    assert dataset["sampled_E"].values.std() > 0.005
    assert np.all(dataset["sampled_s_std"].values == 2.0)


def gains(experiment, sd, correlation=0.0):
    """An unknown E, and an unknown gain of load cell C1, 1.2 at best; `sd` of ln(1 − E) and it."""
    parameters = declared_parameters(experiment)
    sd = sd[0] * (1 - parameters.E), sd[1]
    across = correlation * sd[0] * sd[1]
    unknowns = (
        Unknown("E", PARAMETER, "1", parameters.E, 1e-4, 1 - 1e-7, float, 1.0, False),
        Unknown.amplitude("sensor_gain.gain [C1]", "1", 1.2, 0.1, 10.0, 10.0),
    )

    def at(x):
        effects = (Active("sensor_gain", {"gain": float(x[1])}, "C1"),)
        return parameters.with_values({"E": x[0]}), effects

    covariance = np.array([[sd[0] ** 2, across], [across, sd[1] ** 2]])
    return Knowledge("study x", unknowns, covariance, at)


def test_an_effect_of_a_load_cell_widens_that_one_alone(predicted):
    experiment = predicted(prediction={"samples": 200})
    known = gains(experiment, (0.05, 0.1))
    dataset, document = predict(experiment, build_block_model(experiment), known)
    effect = dataset["vertical_stress_variance_share"].values[SOURCES.index("effect"), 0]
    assert effect[0] > 0.2
    assert effect[1] == 0.0
    assert document["simulated_replicates"] == 600
    whole, best = (
        dataset[name].values[:, 0, 0]
        for name in ("vertical_stress", "vertical_stress_effects_implied")
    )
    gain = dataset["sampled_amplitude"].values[:, 0]
    assert whole == pytest.approx(best * gain / 1.2, rel=1e-12)


def test_effects_that_change_the_height_are_filled_anew(predicted):
    experiment = predicted(filling={"levels": [0.5]})
    setup = make_setup(experiment, build_block_model(experiment))
    active = (Active("fill_height_misdeclared", {"factor": 1.1}),)
    made = make_setup(experiment, build_block_model(experiment), effects=active)
    moved = with_effects(setup, active)
    assert moved.true_levels == made.true_levels
    assert moved.lattice == made.lattice
    assert with_effects(moved, ()).lattice == setup.lattice
    assert with_effects(setup, ()) is setup


@pytest.mark.parametrize(("workers", "chunk"), [(1, 7), (2, None), (2, 60)])
def test_whoever_computes_in_whatever_portions_it_is_the_same(
    workers, chunk, predicted, reading, tmp_path
):
    experiment = predicted()
    rows = (reading(9.0, 0.5, "C1"),)
    model, known = build_block_model(experiment), gains(experiment, (0.1, 0.1), -0.5)
    plain, document = predict(experiment, model, known, rows)
    execution = Execution(workers, chunk=chunk)
    checkpoints = Checkpoints(tmp_path / "kept", "code")
    other, said = predict(
        experiment, model, known, rows, execution=execution, checkpoints=checkpoints
    )
    assert plain.equals(other)
    assert document == said


def test_more_samples_keep_the_first(predicted, monkeypatch, tmp_path):
    """The first samples are the same, and are taken from where an earlier run kept them."""
    monkeypatch.setattr("pipeline.montecarlo.checkpoints.WRITING", math.inf)
    few, more = (predicted(prediction={"samples": n}) for n in (30, 50))
    model, known = build_block_model(few), gains(few, (0.1, 0.1))
    checkpoints = [Checkpoints(tmp_path / "kept", "code") for _ in range(2)]
    first, _ = predict(few, model, known, checkpoints=checkpoints[0])
    kept = sorted(tmp_path.rglob("*_0-30.npz"))
    assert len(kept) == 3
    second, _ = predict(more, model, known, checkpoints=checkpoints[1])
    assert np.array_equal(second["vertical_stress"].values[:30], first["vertical_stress"].values)


def test_the_band_of_a_reading_holds_its_errors_and_as_much_packing_as_it_has(
    predicted, posterior, reading
):
    """With n packings, 1 / √n of the scatter; none where the sd holds it; instrument's besides."""
    experiment = predicted(prediction={"samples": 3000})
    rows = [reading(9.0, 1e-6, "C1", count=n) for n in (1, 4, None)]
    rows.append(reading(9.0, 0.5, "C1", count=None))
    rows.append(reading(9.0, 1e-6, "C1", count=None, std_shared=0.5, quantity="vertical_stress"))
    dataset, document = of(experiment, posterior(experiment, {}), rows)
    scatter = sd_of(dataset, "vertical_stress")[0, 0]
    width = [(one["p95"] - one["p05"]) / 3.2897 for one in document["readings"]]
    expected = [scatter, scatter / 2, 0.0, 0.5, 0.5]
    assert width == pytest.approx(expected, rel=0.06, abs=1e-5)


def test_new_readings_lie_in_the_band_as_often_as_it_says(predicted, reading):
    """60 laboratories measure, calibrate and predict two new readings each of another packing.

    Of 120 readings at 90 %, the count lies between these bounds but for 1 in 500 (binomial); the
    seeds are fixed.
    """
    truth, instrument = 0.93, 0.3
    inside = []
    for lab in range(60):
        experiment = predicted(f"lab{lab}", calibrate=["E"], seed=lab, prediction={"samples": 120})
        model = build_block_model(experiment)
        setup = make_setup(experiment, model)
        true = replace(declared_parameters(experiment), E=truth)

        def measure(number, cells, setup=setup, true=true, experiment=experiment):
            stream = random_stream(2026, experiment.name, 100, number)
            stress = simulate(setup, true, stream).vertical_stress[-1]
            errors = stream.normal(0.0, instrument, len(cells))
            at = [int(cell[1]) - 1 for cell in cells]
            return [
                reading(float(value), instrument, cell)
                for cell, value in zip(cells, stress[at] + errors, strict=True)
            ]

        known_rows = [row for number in range(2) for row in measure(number, ["C1", "C2"])[:1]]
        calibration = calibrate(experiment, setup, declared_parameters(experiment), known_rows)
        new = measure(2, ["C1"]) + measure(3, ["C2"])
        _, document = of(experiment, calibration, new)
        inside += [one["within_90"] for one in document["readings"]]
    low, high = binom.interval(0.998, len(inside), 0.9)
    assert low <= sum(inside) <= high, sum(inside)


def test_the_file_has_what_was_drawn_with_units(predicted, tmp_path):
    experiment = predicted()
    dataset, _ = predict(experiment, build_block_model(experiment), gains(experiment, (0.1, 0.1)))
    path = tmp_path / "prediction.nc"
    write_dataset(path, dataset, experiment, "predict", "Prediction")
    found = read_dataset(path)
    assert found["vertical_stress"].dims == ("sample", "time", "load_cell")
    assert found["vertical_stress_variance_share"].dims == ("source", "time", "load_cell")
    assert found["vertical_stress_percentile"].dims == ("level", "percentile", "time", "load_cell")
    assert found["percentile"].values.tolist() == [5, 10, 50, 90, 95]
    assert [name.decode() for name in found["source_name"].values] == list(SOURCES)
    units = {name: found[name].attrs["units"] for name in ("vertical_stress", "sampled_E")}
    assert units == {"vertical_stress": "kPa", "sampled_E": "1"}
    assert found["amplitude_name"].values.tolist() == [b"sensor_gain.gain [C1]"]
    whole = found["vertical_stress"].values
    assert found["vertical_stress_percentile"].values[-1] == pytest.approx(
        np.percentile(whole, [5, 10, 50, 90, 95], axis=0)
    )
    assert simulated_rows(experiment, found.rename(sample="replicate"), []).shape == (60, 0)
