"""What a study's closed loop knows of an experiment: parameters and the effects it added."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.load import is_held_out
from pipeline.config.measured import MeasuredRow
from pipeline.config.messages import ConfigError
from pipeline.config.study import Study
from pipeline.effects import lacking
from pipeline.loop.documents import noise_from, point_from
from pipeline.loop.fit import box, covariance_given
from pipeline.loop.model import Case, Model, Point, Term, declared_of, limits
from pipeline.loop.problem import make_problem
from pipeline.predict.knowledge import Knowledge, Unknown, drawn_slope


def from_study(
    experiment: Experiment,
    study: Study,
    experiments: Mapping[str, Experiment],
    last_round: xr.Dataset,
) -> Knowledge:
    """What a study says of an experiment, one of its own or another one of the same material.

    The posterior is that of the loop's last fit, parameters and amplitudes jointly: normal, from
    its sensitivities, its noise and its weak priors.

    Parameters
    ----------
    experiments : those of the study, this one, and all that their `stress: {from: NAME}` name
    last_round : the arrays of the loop's last round, `rounds/round_N.nc`

    Raises
    ------
    ConfigError
        If an effect needs an input that the experiment does not declare.
    """
    model = make_problem(study, experiments).model
    point = point_from(json.loads(last_round.attrs["point"]))
    remarks = ()
    names = [case.experiment.name for case in model.cases]
    if experiment.name in names:
        case = names.index(experiment.name)
        view, places = model, tuple(range(len(model.coordinates)))
    else:
        case, remarks = len(names), (_beyond(experiment, study),)
        view = _with_case(model, experiment, declared_of(experiments, experiment.name))
        labels = [coordinate.label for coordinate in model.coordinates]
        places = tuple(
            labels.index(one.label) if one.label in labels else -1 for one in view.coordinates
        )
        terms = tuple(_reaching(term, experiment, case) for term in point.terms)
        point = replace(point, terms=terms)
    _check_inputs(experiment, study, point, case)
    fitted = list(zip(model.coordinates, point.coordinates, strict=True))
    count = len(fitted)
    _, priors, _, _ = box(model, point)
    unknowns = (
        *(
            Unknown.parameter(c.name, c.label, u, prior)
            for (c, u), prior in zip(fitted, priors[:count], strict=True)
        ),
        *(
            Unknown.amplitude(t.label, t.described.unit, a, *limits(t), prior)
            for t, a, prior in zip(point.terms, point.amplitudes, priors[count:], strict=True)
        ),
    )
    slopes = [drawn_slope(c.name, u) for c, u in fitted] + [1.0] * len(point.terms)
    white = noise_from(last_round).whitened(last_round["parameter_sensitivity"].values)
    covariance = covariance_given(white / slopes, np.array([one.prior for one in unknowns]))

    def at(drawn: np.ndarray):
        coordinates = [
            u if x == one.best else c.scale.forward(one.value(x))
            for x, one, (c, u) in zip(drawn[:count], unknowns[:count], fitted, strict=True)
        ]
        own = [
            coordinates[place] if place >= 0 else one.start
            for place, one in zip(places, view.coordinates, strict=True)
        ]
        return view.at(point.moved(own, drawn[count:]), case)

    found = Knowledge(f"study {study.name}", unknowns, covariance, at, remarks)
    return found.relevant()


def was_studied(study: Study, name: str, row: MeasuredRow) -> bool:
    """Whether the study's fit saw a measured row of an experiment."""
    if name not in study.experiments:
        return False
    return study.hold_out == "leave_one_out" or not is_held_out(study, name, row)


def _with_case(model: Model, experiment: Experiment, declared) -> Model:
    """The study's model with one more experiment, of which nothing is measured."""
    mass = 0.0 if experiment.is_draw else None
    somewhere = MeasuredRow(
        quantity="vertical_stress",
        load_cell=None,
        fill_height=None,
        mass_drawn=mass,
        value=math.nan,
        std=math.nan,
        std_shared=math.nan,
        count=None,
        line=0,
    )
    case = Case(experiment, (somewhere,), declared)
    return Model((*model.cases, case), model.shared, model.execution)


def _reaching(term: Term, experiment: Experiment, case: int) -> Term:
    """The term, acting on one more case where its scope says that it does."""
    same_material = term.scope == "material" and term.key == experiment.material.name
    if term.scope != "study" and not same_material:
        return term
    return replace(term, cases=(*term.cases, case))


def _beyond(experiment: Experiment, study: Study) -> str:
    return (
        f"{experiment.name} is none of the experiments of study {study.name}. It gets what the "
        "study shares by material or by study; parameters and effects of single experiments and "
        "of sensors stay there."
    )


def _check_inputs(experiment: Experiment, study: Study, point: Point, case: int) -> None:
    from pipeline.effects import effects

    found = []
    for term in point.terms:
        effect = effects()[term.effect]
        if case in term.cases:
            found += [
                f"prediction.study = {study.name}: it found {term.effect}, which needs {key}; "
                "give it in this file"
                for key in lacking(effect, experiment, effect.neutral | dict(term.options))
            ]
    if found:
        raise ConfigError((experiment.path, text) for text in found)
