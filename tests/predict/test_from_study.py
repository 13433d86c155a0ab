"""What a study knows: the loop's own posterior, and what of it reaches another experiment."""

import json

import numpy as np
import pytest
import xarray as xr
from worlds import mixed_world

from pipeline.loop.covariance import COMPONENTS, noise
from pipeline.loop.documents import point_document
from pipeline.loop.fit import Fit, offset_at, posterior_covariance
from pipeline.loop.model import Term
from pipeline.predict.from_study import from_study, was_studied
from pipeline.predict.knowledge import drawn_slope


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    """A study of a draw and a column with one effect, its fit, and that as its round's file."""
    shared = [{"name": name, "shared_by": "material"} for name in ("E", "R")]
    folder = tmp_path_factory.mktemp("studied") / "w"
    world = mixed_world(folder, study={"parameters": shared})
    problem = world.problem()
    model, data = problem.model, problem.data
    point = model.start.with_terms([Term("surcharge", "stress", "study", None, (0, 1))], [0.3])
    slopes = np.column_stack(model.jacobian(point, point.terms))
    expected = model.mean(point)
    residual = data.y - expected[data.use]
    found = Fit(point, point, offset_at(model, point), expected, residual, slopes, 0.0)
    here = noise(model, point, data).scaled((1e-4,) * 3)
    parts = zip(COMPONENTS, here.parts, strict=True)
    last = xr.Dataset(
        {
            "parameter_sensitivity": (("reading", "unknown"), slopes[data.use]),
            **{f"covariance_{n}": (("reading", "other_reading"), part) for n, part in parts},
        },
        attrs={
            "point": json.dumps(point_document(point)),
            "noise_factors": json.dumps(list(here.factors)),
        },
    )
    return world, model, point, last, posterior_covariance(model, data, found, here)


def test_the_posterior_is_the_loops_own(studied):
    world, model, point, last, covariance = studied
    experiments = world.experiments
    for case, name in enumerate(world.study.experiments):
        known = from_study(experiments[name], world.study, experiments, last)
        labels = [one.label for one in known.unknowns]
        every = [*(c.label for c in model.coordinates), *(t.label for t in point.terms)]
        places = [every.index(label) for label in labels]
        pairs = zip(model.coordinates, point.coordinates, strict=True)
        slopes = [drawn_slope(c.name, u) for c, u in pairs]
        slopes = np.array([*slopes, 1.0])[places]
        expected = covariance[np.ix_(places, places)] * np.outer(slopes, slopes)
        assert known.covariance == pytest.approx(expected, rel=1e-2)
        assert known.untold == ()
        assert known.at(known.best) == model.at(point, case)
        assert ("R [gravel]" in labels) == experiments[name].is_draw
        assert "surcharge.stress" in labels


def test_another_experiment_of_the_material_gets_what_is_shared(studied, column):
    world, _, _, last, _ = studied
    material = next(iter(world.experiments.values())).material.model_dump()
    other = column("elsewhere", material=material)
    experiments = world.experiments | {"elsewhere": other}
    known = from_study(other, world.study, experiments, last)
    assert [one.label for one in known.unknowns] == ["E [gravel]", "surcharge.stress"]
    _, active = known.at(known.best)
    assert [(one.name, one.values["stress"]) for one in active] == [("surcharge", 0.3)]
    assert "none of the experiments of study" in known.remarks[0]


def test_what_no_reading_tells_of_keeps_its_prior(studied):
    world, model, _, last, _ = studied
    experiments = world.experiments
    name = next(name for name in world.study.experiments if experiments[name].is_draw)
    blind = last.copy()
    place = [c.label for c in model.coordinates].index("R [gravel]")
    slopes = last["parameter_sensitivity"].values.copy()
    slopes[:, place] = 0.0
    blind["parameter_sensitivity"] = last["parameter_sensitivity"].dims, slopes
    known = from_study(experiments[name], world.study, experiments, blind)
    at = [one.label for one in known.unknowns].index("R [gravel]")
    assert known.covariance[at, at] == pytest.approx(model.prior_sd[place] ** 2, rel=1e-9)
    assert [one.label for one in known.untold] == ["R [gravel]"]


def test_what_is_held_out_was_not_fitted(studied):
    world, *_ = studied
    rows = world.measured()
    assert not was_studied(world.study, "elsewhere", rows[0])
