"""What holds for every effect that is found, whatever it does."""

from copy import deepcopy
from dataclasses import fields, replace
from itertools import combinations

import numpy as np
import pytest
from runs import assert_same, block, example, run

from pipeline.effects import Active, Reading, declared_effects, effects
from pipeline.simulate.setup import load_cells

ALL = sorted(effects())
STAGES = ("geometry", "packing", "state", "readings")


@pytest.fixture(scope="session")
def bare(filling, pillar):
    """Readings of the two experiments without effects."""
    return {made.name: run(made) for made in (filling(), pillar())}


@pytest.mark.parametrize("name", ALL)
def test_description_is_complete_and_its_values_lie_within_bounds(name):
    effect = effects()[name]
    for text in (effect.description, effect.equation, effect.source, effect.moves):
        assert text.strip() == text != ""
    assert effect.scope in ("study", "material", "experiment", "load_cell")
    assert (effect.scope == "load_cell") == (effect.readings is not None)
    assert any(getattr(effect, stage) for stage in STAGES)
    assert set(effect.example) <= set(effect.neutral)
    for parameter in effect.parameters:
        value = effect.example.get(parameter.name, parameter.neutral)
        assert parameter.low <= parameter.neutral <= parameter.high
        assert parameter.low <= value <= parameter.high
        assert parameter.scale > 0
        assert parameter.unit
        assert parameter.words
        assert parameter.sign * (value - parameter.neutral) >= 0
        assert parameter.sign == 0 or parameter.neutral in (parameter.low, parameter.high)
    assert not Active(name, effect.neutral | dict(effect.example)).is_neutral


@pytest.mark.parametrize("name", ALL)
def test_neutral_values_change_no_bit(name, experiment, bare):
    off = replace(example(name, experiment), values=effects()[name].neutral)
    declared = experiment.model_copy(update={"effects": block([off])})
    assert_same(run(declared, declared_effects(declared))[0], bare[experiment.name][0])


@pytest.mark.parametrize("name", ALL)
def test_values_close_to_neutral_change_little(name, experiment, bare):
    if effects()[name].geometry and experiment.is_draw:
        pytest.skip("one more level, however thin, gives climbing voids one more step")
    effect, on = effects()[name], example(name, experiment)
    slight = {p.name: p.neutral + 1e-7 * (on.values[p.name] - p.neutral) for p in effect.parameters}
    (readings,) = run(experiment, [replace(on, values=dict(on.values) | slight)])
    np.testing.assert_allclose(
        readings.vertical_stress, bare[experiment.name][0].vertical_stress, rtol=1e-5
    )


@pytest.mark.parametrize("name", ALL)
def test_weight_balance_closes(name, experiment):
    (readings,) = run(experiment, [example(name, experiment)])
    assert readings.weight_balance_error.max() < 1e-6


@pytest.mark.parametrize("reach", ["level", "face"])
def test_weight_balance_closes_with_all_effects_at_once(experiment, reach):
    active = [example(name, experiment) for name in ALL]
    active = [
        replace(one, values=dict(one.values) | {"reach": reach}) if "reach" in one.values else one
        for one in active
    ]
    (readings,) = run(experiment, active)
    assert readings.weight_balance_error.max() < 1e-6
    assert np.isfinite(readings.vertical_stress).all()


def test_the_order_in_a_config_does_not_matter(experiment):
    for pair in combinations([example(name, experiment) for name in ALL], 2):
        one, other = (
            run(experiment, declared_effects(experiment.model_copy(update={"effects": block(p)})))
            for p in (pair, pair[::-1])
        )
        assert_same(one[0], other[0])


@pytest.mark.parametrize("name", ALL)
def test_what_an_effect_is_given_stays_as_it_was(name, experiment, monkeypatch):
    def carefully(action, subject, values):
        before = deepcopy(subject)
        result = action(subject, values)
        for part in fields(subject):
            if isinstance(getattr(subject, part.name), np.ndarray):
                kept, now = getattr(before, part.name), getattr(subject, part.name)
                np.testing.assert_array_equal(now, kept, err_msg=part.name)
        return result

    def apply(active, stage, subject):
        for one in active:
            if action := getattr(one.effect, stage):
                subject = carefully(action, subject, one.values)
        return subject

    monkeypatch.setattr("pipeline.simulate.ground.apply", apply)
    on = example(name, experiment)
    run(experiment, [on])
    if on.effect.readings:
        carefully(on.effect.readings, Reading(np.ones((3, 2)), 0, np.arange(3.0)), on.values)


@pytest.mark.parametrize("name", ALL)
def test_what_an_effect_draws_does_not_depend_on_the_others(name, filling):
    """Turning on an effect that does nothing here leaves another's random numbers alone."""
    experiment = filling(material={"particle_size": [0.01, 0.01]})
    on = example(name, experiment)
    silent = example("segregation", experiment)  # particles of one size
    if name != "segregation":
        assert_same(run(experiment, [on])[0], run(experiment, [on, silent])[0])


def test_effects_act_by_order_then_name(experiment):
    active = [example(name, experiment) for name in ALL]
    declared = experiment.model_copy(update={"effects": block(active[::-1])})
    found = [(one.effect.order, one.name) for one in declared_effects(declared)]
    assert found == sorted(found)
    assert {one.load_cell for one in declared_effects(declared)} == {
        None,
        load_cells(experiment)[0].name,
    }
