"""Cases that the loop once failed."""

from dataclasses import replace

import pytest
from test_improved import assert_same_prediction, mixed_problem
from worlds import walled_world

from pipeline.loop.documents import effects_document, standard_deviations
from pipeline.loop.model import Point
from pipeline.loop.rounds import close

TRUTH = {"wall_friction": {"K": 0.5}}


@pytest.mark.parametrize("shift", [1.2, 3.0, -1.8, -3.0])
@pytest.mark.parametrize("name", ["power", "table"])
def test_E_min_is_written_out_however_far_it_moved(tmp_path, shift, name):
    world = mixed_problem(tmp_path / "w", ("E_min",))
    path = world.folder / "experiments" / "drawn.yaml"
    if name == "table":
        text = path.read_text()
        start = text.index("  E_min:")
        end = text.index("  R:", start)
        table = "  E_min: {type: table, height: [0.1, 0.3, 0.6], value: [0.2, 0.5, 0.8]}\n"
        path.write_text(text[:start] + table + text[end:])
    assert_same_prediction(world, Point((shift,)), tmp_path / "improved")


def test_misfit_with_no_candidate_left_is_unexplained(tmp_path):
    """Both candidates are in the model and the sum of squares still rejects."""
    study = {"candidates": ["wall_friction", "density_misdeclared"]}
    world = walled_world(tmp_path / "w", "abcd", truth=TRUTH, true_E=0.97, study=study)
    world.edit(
        lambda row: {"value": 5.0 * float(row["value"])} if row["experiment"] == "c" else None
    )
    problem = world.problem()
    outcome = close(problem.study, problem.model, problem.data)
    assert outcome.rounds[-1].gate.rejected


def test_no_hypothesis_takes_the_place_of_what_is_in_the_model(tmp_path):
    """With a surcharge on one column added, one for all of them would override it there."""
    study = {"candidates": ["surcharge"]}
    world = walled_world(tmp_path / "w", "abcd", true_E=0.97, study=study)
    world.edit(
        lambda row: {"value": 2.0 + float(row["value"])} if row["experiment"] == "b" else None
    )
    problem = world.problem()
    outcome = close(problem.study, problem.model, problem.data)
    assert [e.hypothesis.label for e in outcome.added] == ["surcharge [b]"]
    last = outcome.rounds[-1]
    for hypothesis in last.hypotheses:
        for term in hypothesis.terms:
            for there in last.fit.point.terms:
                same = (term.effect, term.parameter) == (there.effect, there.parameter)
                assert not (same and set(term.cases) & set(there.cases)), hypothesis.label


def test_an_addition_that_lost_a_term_is_documented_in_its_round(walls):
    problem = walls.problem()
    outcome = close(problem.study, problem.model, problem.data)
    (added,) = outcome.added
    hypothesis = added.hypothesis.without([])  # another object, as one without a term is
    lost = replace(outcome, added=(replace(added, hypothesis=hypothesis, log_evidence=0.0),))
    sd = standard_deviations(problem.model, problem.data, outcome.rounds[-1])
    documents = [effects_document(problem.model, one, sd) for one in (outcome, lost)]
    assert documents[0] == documents[1]
    assert documents[0][0]["round"] == 1
