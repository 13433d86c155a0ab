"""One blind world: what the loop said of it against the truth, opened now.

Nothing here touches the loop or the generator: the inputs are `closed_loop.json`, the held-out
predictions beside it, and the sealed truth.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.files.atomic import read_json

NULLS = ("null_plain", "null_heavy_tails", "null_understated_noise")
SINGLE = ("one", "sensor_or_input")
NO_CLAIM = "no_effect_detectable"
LOCAL_RULE = "local_rule"
PREDICTIONS = ("after", "recalibrated_only", "gaussian_process")
STRONG = 5.0  # δ from which an effect is to be found
CHOICES = ("recommended", "random")  # of one more measurement

Claim = tuple[str, str | None]  # name of an effect, and what it belongs to


class SealBrokenError(ValueError):
    """A truth is not the one whose hash was published."""


@dataclass(frozen=True)
class Scored:
    """One world: the truth, the content of `closed_loop.json`, and what else was measured of it.

    `predictions` are rows of the held-out predictions, each with experiment, load_cell,
    fill_height, mass_drawn, quantity, and before, after, recalibrated_only, gaussian_process in
    kPa. `peers` holds the claims of other methods by their names, in order; `seconds` the
    processor time that the loop took; `again` what one more measurement brought where it left
    names open (None: it did not), see `remeasured.outcomes`.
    """

    truth: Mapping[str, Any]
    result: Mapping[str, Any]
    predictions: Sequence[Mapping[str, Any]] = ()
    peers: Mapping[str, Sequence[Claim]] = field(default_factory=dict)
    seconds: float | None = None
    again: Mapping[str, Mapping[str, Any]] | None = None

    @property
    def kind(self) -> str:
        """Kind of the truth."""
        return self.truth["kind"]

    @property
    def true(self) -> list[Claim]:
        """The effects that are there."""
        return [(one["name"], one["scope_key"]) for one in self.truth["effects"]]

    @property
    def delta(self) -> float | None:
        """How far its weakest effect moves the readings; None without an effect."""
        return min((one["delta"] for one in self.truth["effects"]), default=None)

    @property
    def named(self) -> list[Claim]:
        """The catalogue's effects that the loop added, in order."""
        return [
            (one["name"], one["scope_key"])
            for one in self.result["effects_added"]
            if one["name"] != LOCAL_RULE
        ]

    @property
    def is_attack(self) -> bool:
        """Whether the world was written to fool the loop."""
        return "attack" in self.truth

    @property
    def added(self) -> list[Claim]:
        """All that the loop added, rules included, in order."""
        return [(one["name"], one["scope_key"]) for one in self.result["effects_added"]]

    @property
    def is_fooled(self) -> bool:
        """Whether the loop added to an attacked world what its truth does not accept."""
        right = self.truth["attack"]["right"]
        accepted = (*right["must_name"], *right["may_name"])
        return not all(any(_fits(one, name) for name in accepted) for one in self.added)

    @property
    def ends_well(self) -> bool:
        """Whether the loop's answer to an attack is one of those that its truth accepts."""
        right = self.truth["attack"]["right"]
        verdicts = right["verdicts"] or [self.result["verdict"]]
        return (
            not self.is_fooled
            and self.result["verdict"] in verdicts
            and all(any(_fits(one, name) for one in self.added) for name in right["must_name"])
        )

    @property
    def claims(self) -> bool:
        """Whether the loop says that anything is missing."""
        return self.result["verdict"] != NO_CLAIM

    @property
    def first_is_right(self) -> bool:
        """Whether it names an effect, and the first one is there, where it says."""
        return bool(self.named) and self.named[0] in self.true

    @property
    def rule_is_right(self) -> bool:
        """Whether its most probable rule is on what is wrong, and says where in some word."""
        rules = self.result["local_rules"]
        if self.result["verdict"] != "unknown_effect" or not rules:
            return False
        rule = max(rules, key=lambda one: one["probability"])
        (effect,) = self.truth["effects"]
        text = f"{rule['feature']} {rule['words']}".replace("_", " ").lower()
        on_it = effect["channel"] in (None, rule["channel"])
        return on_it and any(word in text for word in effect["place"])

    @property
    def is_missed(self) -> bool:
        """Whether effects that all move the readings by `STRONG` are not what the loop says.

        That is another effect than the one that is there, or none; not exactly the two that are;
        for what is outside the catalogue, any effect of the catalogue, or not the right rule.
        """
        if self.delta is None or self.delta < STRONG:
            return False
        if self.kind == "outside":
            return bool(self.named) or not self.rule_is_right
        if self.kind == "two":
            return set(self.named) != set(self.true)
        return not self.first_is_right

    @property
    def said(self) -> str:
        """What the loop added, in order, or else its verdict, with the names left open."""
        if self.added:
            return ", ".join(f"{name} ({key})" if key else name for name, key in self.added)
        names = ", ".join(self.result["candidate_set"])
        return f"{self.result['verdict']}: {names}" if names else self.result["verdict"]

    @property
    def candidate_names(self) -> set[str]:
        """Names that the loop leaves open, those that it added included."""
        return {name for name, _ in self.named} | set(self.result["candidate_set"])


def _fits(claim: Claim, wanted: Sequence[str | None]) -> bool:
    """Whether a claim is the wanted one, whose name may have a `*` for any letters."""
    return fnmatchcase(claim[0], wanted[0]) and claim[1] == wanted[1]


def open_world(
    sealed: Path,
    digest: str,
    closed_loop: Path,
    predictions: Path | None = None,
    **measured: Any,
) -> Scored:
    """A world's results with its truth; `measured` are `peers`, `seconds`, `again` of `Scored`.

    Raises SealBrokenError if the truth's SHA-256 is not the published `digest`.
    """
    content = Path(sealed).read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise SealBrokenError(f"{sealed}: its SHA-256 is not the one that was published")
    rows = read_json(predictions)["rows"] if predictions is not None else ()
    return Scored(json.loads(content), read_json(closed_loop), rows, **measured)


def is_resolved(world: Scored, choice: str) -> bool:
    """Whether one more measurement leaves exactly the truth standing.

    What stands is what a direct measurement shows by itself, or corrects so that the loop finds
    nothing missing after it; or else the effects that the loop names after it, each with what it
    belongs to, and those that it leaves in the 90 % set, each with the most probable of what it
    may belong to. A set of one name counts where there were several before. That must be the true
    effects, none less and none more. Where nothing was missing nothing may be claimed, and outside
    the catalogue the right rule must be named.
    """
    outcome = world.again.get(choice)
    if outcome is None:
        return False
    if outcome["shows"]:
        return world.true == [tuple(outcome["shows"])]
    after = Scored(world.truth, outcome["result"])
    if outcome["corrects"] and not after.claims:
        return world.true == [tuple(outcome["corrects"])]
    if world.kind in NULLS:
        return not after.claims
    if world.kind == "outside":
        return after.rule_is_right
    now, before = (len(result["candidate_set"]) for result in (after.result, world.result))
    if now and not 1 == now < before:
        return False
    likely = {one["name"]: one["scope_key"] for one in after.result["candidates_left"][::-1]}
    left = {(name, likely.get(name)) for name in after.result["candidate_set"]}
    return {*after.named, *left} == set(world.true)


def held_out_errors(world: Scored) -> dict[str, dict[str, float]]:
    """RMS errors of each prediction: log against the truth and the readings, and in kPa.

    The truth is the mean stress of the ground over many packings, free of noise and of what is
    wrong with sensors. {} without predictions.
    """
    truth = {
        (row["experiment"], row["load_cell"], row["fill_height"], row["mass_drawn"]): row
        for row in world.truth["rows"]
    }
    full = {}
    for row in world.truth["rows"]:
        if row["fill_height"] is not None:
            highest = full.get(row["experiment"], 0.0)
            full[row["experiment"]] = max(highest, row["fill_height"])
    pairs = []
    for row in world.predictions:
        height, mass = row["fill_height"], row["mass_drawn"]
        if row["experiment"] in full:
            height, mass = full[row["experiment"]] if height is None else height, None
        else:
            height, mass = None, mass or 0.0
        pairs.append((row, truth[(row["experiment"], row["load_cell"], height, mass)]))
    if not pairs:
        return {}
    free, read = (np.array([row[key] for _, row in pairs]) for key in ("stress", "measured"))
    errors = {}
    for name in ("before", *PREDICTIONS):
        values = [row.get(name) for row, _ in pairs]
        if any(value is None for value in values):
            continue
        predicted = np.array(values, dtype=float)
        errors[name] = {
            "rms_log": _rms(np.log(predicted / free)),
            "rms_kpa": _rms(predicted - free),
            "rms_log_readings": _rms(np.log(predicted / read)),
            "rms_kpa_readings": _rms(predicted - read),
        }
    return errors


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
