"""What these readings can tell, before the residual is looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.loop.gate import Gate, Projected
from pipeline.loop.hypotheses import Hypothesis

POWER = 1.28  # standard normal quantile of 90 %
LEAST_SURVIVING = 1e-4
ALIKE = 0.95  # cosine from which two hypotheses are one class


@dataclass(frozen=True)
class Entry:
    """What the readings can say of a hypothesis.

    `minimal_detectable` is the amplitude found nine times in ten, in the parameter's unit (of the
    first amplitude, all being as large in their scales); `mimic_distance` how many standard
    deviations a usual amplitude lies from what its nearest mimic can explain.
    """

    hypothesis: Hypothesis
    score: float
    surviving_fraction: float
    minimal_detectable: float | None
    nearest_mimic: str | None
    mimic_distance: float | None
    alike: tuple[str, ...]
    testable: bool
    why: str


def certificate(seen: Projected, gate: Gate, hypotheses: Sequence[Hypothesis]) -> list[Entry]:
    """One entry for each hypothesis; untestable ones are named, never dropped."""
    directions = {h.label: _direction(seen, h) for h in hypotheses}
    sizes = {label: float(np.linalg.norm(d)) for label, d in directions.items()}
    names = {h.label: h.name for h in hypotheses}
    labels = [label for label in sizes if sizes[label] > 1e-6]
    unit = np.array([directions[label] / sizes[label] for label in labels])
    cosines = unit @ unit.T if labels else np.zeros((0, 0))
    scores = dict(zip(gate.labels, zip(gate.scores, gate.inflation, strict=True), strict=True))
    entries = []
    for h in hypotheses:
        if h.label not in labels:
            why = "no reading answers to it" if not sizes[h.label] else "nothing of it is left"
            entries.append(Entry(h, 0.0, 0.0, None, None, None, (), False, why))
            continue
        size, place = sizes[h.label], labels.index(h.label)
        others = [i for i, label in enumerate(labels) if names[label] != h.name]
        mimic = distance = None
        if others:
            nearest = max(others, key=lambda i, at=place: abs(cosines[at, i]))
            mimic = labels[nearest]
            distance = size * math.sqrt(max(0.0, 1.0 - cosines[place, nearest] ** 2))
        alike = tuple(labels[i] for i in others if abs(cosines[place, i]) > ALIKE)
        score, inflation = scores.get(h.label, (0.0, 1.0))
        described = h.terms[0].described
        detectable = (gate.threshold + POWER) * math.sqrt(inflation) / size * described.scale
        room = max(described.high - described.neutral, described.neutral - described.low)
        surviving = seen.survives(h)
        why = ""
        if surviving < LEAST_SURVIVING:
            why = "calibration explains all of it"
        elif detectable > room:
            unit = "" if described.unit == "1" else f" {described.unit}"
            why = f"only amplitudes beyond {room:g}{unit} would show"
        entries.append(
            Entry(
                h,
                float(score),
                surviving,
                detectable if math.isfinite(detectable) else None,
                mimic,
                distance,
                alike,
                not why,
                why,
            )
        )
    return entries


def _direction(seen: Projected, hypothesis: Hypothesis) -> np.ndarray:
    """Whitened change (m) by a usual amplitude of all its terms."""
    return seen.of(hypothesis) @ np.array([t.described.scale for t in hypothesis.terms])
