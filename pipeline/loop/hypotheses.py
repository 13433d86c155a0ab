"""What may be missing: effects of the catalogue by what shares their value, and local rules."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.config.effects import NOT_MEASURED
from pipeline.config.study import Study
from pipeline.effects import Parameter, effects, lacking
from pipeline.effects.local_rule import CHANNELS
from pipeline.effects.local_rule import EFFECT as LOCAL_RULE
from pipeline.loop.model import Model, Term

PRIOR = {"none": 0.2, "physics": 0.3, "input": 0.07, "sensor": 0.08, "rule": 0.05}
# part of an effect's prior for all its keys at once, where there are several
TOGETHER = {"physics": 0.5, "input": 0.2, "sensor": 0.0}


@dataclass(frozen=True)
class Hypothesis:
    """An effect with one amplitude for each of its terms, or one of its keys alone.

    `key` is None where it holds for the whole study: with one value, or with one for each material.
    """

    name: str
    kind: str
    scope: str
    key: str | None
    terms: tuple[Term, ...]
    prior: float

    @property
    def label(self) -> str:
        """Name, options and key in one word."""
        options = "".join(f" {choice}" for _, choice in self.terms[0].options)
        parameters = dict.fromkeys(term.parameter for term in self.terms)
        if len(parameters) < len(effects()[self.name].parameters):
            options += "".join(f" {parameter}" for parameter in parameters)
        return f"{self.name}{options}" + (f" [{self.key}]" if self.key is not None else "")

    def without(self, terms: Sequence[Term]) -> Hypothesis:
        """The same with fewer terms; of the one key that is left, if it is one."""
        left = tuple(term for term in self.terms if term not in terms)
        keys = {term.key for term in left}
        return replace(self, terms=left, key=keys.pop() if len(keys) == 1 else self.key)


def catalogue(study: Study, model: Model, use: Sequence[int]) -> list[Hypothesis]:
    """Hypotheses of the effects that the study tries; `use` are the rows that may speak for them.

    An effect that an experiment declares already is part of the model there, and no candidate; a
    load cell's is, for its other load cells.
    """
    names = effects() if study.candidates == "all" else study.candidates
    found: list[Hypothesis] = []
    for name in sorted(set(names)):
        effect = effects()[name]
        if effect.kind == "rule" or not effect.moves_mean:
            continue
        scope = study.scopes.get(name, effect.scope)
        groups = _groups(study, model, name, scope, use)
        parts = _parts(effect.parameters)
        for part in parts:
            for key, terms, weight in _choices(name, effect.kind, scope, groups, part):
                weight /= len(parts)
                found.append(Hypothesis(name, effect.kind, scope, key, terms, weight))
    return _with_priors(found)


def untried(study: Study, model: Model, use: Sequence[int]) -> dict[str, str]:
    """Effects that the study names and no reading can be asked about, with the reason."""
    names = effects() if study.candidates == "all" else study.candidates
    why = {}
    for name in sorted(set(names)):
        effect = effects()[name]
        if effect.kind == "rule":
            continue
        if not effect.moves_mean:
            why[name] = "it changes the scatter from packing to packing alone, no mean reading"
        elif not _groups(study, model, name, study.scopes.get(name, effect.scope), use):
            why[name] = _why_not(study, model, name)
    return why


def _why_not(study: Study, model: Model, name: str) -> str:
    effect, experiments = effects()[name], [case.experiment for case in model.cases]
    if all(name in one.effects for one in experiments):
        return "the experiments declare it: it is part of the model"
    if effect.scope == "load_cell":
        return "no load cell has read these values"
    missing = {key for one in experiments for key in lacking(effect, one, effect.neutral)}
    return (
        f"it needs {', '.join(sorted(missing))}" if missing else "no reading is of its experiments"
    )


def rules(study: Study, model: Model) -> list[Hypothesis]:
    """Every local rule, on every channel, for the whole study."""
    if study.candidates != "all" and "local_rule" not in study.candidates:
        return []
    cases = tuple(
        i for i, case in enumerate(model.cases) if "local_rule" not in case.experiment.effects
    )
    draws = tuple(i for i in cases if model.cases[i].experiment.is_draw)
    found = []
    for channel in CHANNELS:
        where = draws if channel == "R" else cases
        for feature in LOCAL_RULE.options["feature"] if where else ():
            options = (("channel", channel), ("feature", feature))
            term = Term("local_rule", "amplitude", "study", None, where, options)
            found.append(Hypothesis("local_rule", "rule", "study", None, (term,), 1.0))
    return _with_priors(found)


def _parts(parameters: Sequence[Parameter]) -> list[tuple[Parameter, ...]]:
    """Each parameter alone, and all together."""
    alone = [(parameter,) for parameter in parameters]
    return alone if len(alone) == 1 else [*alone, tuple(parameters)]


def _choices(name: str, kind: str, scope: str, groups: dict, parameters: Sequence[Parameter]):
    """(key, terms, weight): each key alone and, but for sensors, all together.

    Together each material has its own value, while all experiments share one.
    """
    single = [
        tuple(Term(name, p.name, scope, key, tuple(cases)) for p in parameters)
        for key, cases in groups.items()
    ]
    both = TOGETHER[kind]
    if len(single) < 2 or not both:
        yield from ((k, t, 1.0 / len(single)) for k, t in zip(groups, single, strict=True))
        return
    for key, terms in zip(groups, single, strict=True):
        yield key, terms, (1.0 - both) / len(single)
    together = tuple(term for terms in single for term in terms)
    if scope == "experiment":
        cases = tuple(sorted(case for members in groups.values() for case in members))
        together = tuple(Term(name, p.name, "study", None, cases) for p in parameters)
    yield None, together, both


def terms_of(hypotheses: Sequence[Hypothesis]) -> list[Term]:
    """All their terms, each once."""
    return list(dict.fromkeys(term for hypothesis in hypotheses for term in hypothesis.terms))


def _groups(study, model, name, scope, use) -> dict[str | None, list[int]]:
    """Cases that share one value of an effect, by key."""
    effect = effects()[name]
    groups: dict[str | None, list[int]] = {}
    with_rows = {int(model.case_of[i]) for i in use}
    for i, case in enumerate(model.cases):
        experiment = case.experiment
        declared = experiment.effects.get(name)
        if lacking(effect, experiment, effect.neutral):
            continue
        if effect.scope == "load_cell":
            label = study.data.label if study.data else experiment.data_label
            if label in NOT_MEASURED:
                continue
            cells = dict.fromkeys(model.rows[j].load_cell for j in use if model.case_of[j] == i)
            for cell in filter(None, cells):
                if cell not in (declared or {}):
                    groups.setdefault(cell, []).append(i)
            continue
        if declared is not None:
            continue
        key = {"material": experiment.material.name, "experiment": experiment.name}.get(scope)
        groups.setdefault(key, []).append(i)
    return {k: members for k, members in groups.items() if with_rows & set(members)}


def _with_priors(found: list[Hypothesis]) -> list[Hypothesis]:
    """The kind's prior mass in equal parts to its names, then by the weights given."""
    names = {kind: {h.name for h in found if h.kind == kind} for kind in PRIOR}
    each = Counter(h.name for h in found if h.kind == "rule")
    return [
        Hypothesis(
            h.name,
            h.kind,
            h.scope,
            h.key,
            h.terms,
            PRIOR[h.kind] / len(names[h.kind]) * h.prior / each.get(h.name, 1),
        )
        for h in found
    ]
