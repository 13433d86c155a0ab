"""What a study's readings can show, and what they showed: certificate, test, attribution."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from pipeline.effects import effects
from pipeline.report.page import Badge, Data, Table, decimals_of, parts
from pipeline.report.study_words import AT_BOUND, label_of, listed, unit_words

FEW = 3  # look-alikes that stand unfolded


def certificate_tables(found: Mapping[str, Any], data: Data) -> list[Table]:
    """Every candidate: what would show of it, or why nothing would."""
    columns = [
        "Candidate",
        "Kind",
        "Surviving fraction",
        "Minimal detectable: amplitude",
        "Minimal detectable: unit",
        "Nearest mimic: name",
        "Nearest mimic: distance (sd)",
        "Look-alikes",
    ]
    testable = Table(
        "testable",
        "Candidates that these readings can test. Surviving fraction: part of the candidate's "
        "signal that calibration cannot explain. Minimal detectable: the amplitude that the test "
        "finds nine times in ten. Distance: how far an amplitude of usual size lies from what the "
        "nearest mimic can do. Look-alikes: what these readings see as the same.",
        columns,
        data,
    )
    untestable = Table(
        "untestable",
        "Candidates that these readings cannot test, and why. They are neither found nor excluded.",
        ["Candidate", "Why", *columns[1:]],
        data,
    )
    for entry in found["candidates"]:
        if entry["testable"]:
            testable.rows.append(_certificate_row(testable, [entry]))
    for entries in _alike(e for e in found["candidates"] if not e["testable"]):
        name, *cells = _certificate_row(untestable, entries)
        untestable.rows.append([name, entries[0]["why"], *cells])
    return [table.without_empty_columns() for table in (testable, untestable) if table.rows]


def _alike(entries: Iterable[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Entries in groups that differ in nothing but what they belong to."""
    groups: dict[str, list] = {}
    own = {"scope", "scope_key", "label", "probability", "score"}
    for entry in entries:
        key = repr([(name, value) for name, value in entry.items() if name not in own])
        groups.setdefault(key, []).append(entry)
    return list(groups.values())


def _certificate_row(table: Table, entries: Sequence[Mapping[str, Any]]) -> list[Any]:
    one = entries[0]
    name = listed(dict.fromkeys(map(label_of, entries)))
    detectable = one["minimal_detectable"]
    return [
        name,
        one["kind"],
        table.number(name, "surviving fraction", one["surviving_fraction"], 3),
        table.number(name, "minimal detectable amplitude", detectable, unit=one["unit"]),
        "" if detectable is None else unit_words(one["unit"]),
        one["nearest_mimic"] or "",
        table.number(name, "distance to the nearest mimic", one["mimic_distance"], 2, "sd"),
        _look_alikes(table, name, one["alike"]),
    ]


def _look_alikes(table: Table, name: str, labels: Sequence[str]) -> str | Markup:
    if len(labels) <= FEW:
        return listed(labels)
    return parts(
        "<details><summary>{} others</summary>{}</details>",
        table.number(name, "look-alikes", len(labels)),
        listed(labels),
    )


def gate_table(found: Mapping[str, Any], data: Data) -> Table:
    """The lack-of-fit test, round by round."""
    table = Table(
        "gate",
        "One test of all that could be missing in each round: the largest standardized score of "
        "all candidates and local rules against what chance gives, and the sum of squares of the "
        "whitened residual. α halves from round to round. Variance factors: what each part of the "
        "noise was multiplied with, estimated where enough degrees of freedom lie beyond all "
        "candidates.",
        [
            "Round",
            "Largest score: of",
            "Largest score: value",
            "Largest score: threshold",
            "Sum of squares: value",
            "Sum of squares: p",
            "Both: p",
            "Both: α",
            "Outcome",
            "Degrees of freedom beyond",
            "Variance factors: packing",
            "Variance factors: shared",
            "Variance factors: independent",
        ],
        data,
    )
    for gate in found["gate"]:
        row = f"round {gate['round']}"

        def cell(column, value, decimals=None, row=row):
            return table.number(row, column, value, decimals)

        factors = gate["noise_factors"]
        table.rows.append(
            [
                cell("round", gate["round"]),
                gate["largest"],
                cell("largest score", gate["statistic"], 2),
                cell("threshold", gate["threshold"], 2),
                cell("sum of squares", gate["sum_of_squares"], decimals_of(gate["sum_of_squares"])),
                cell("p of the sum of squares", gate["sum_of_squares_p_value"]),
                cell("p", gate["p_value"]),
                cell("alpha", gate["alpha"]),
                Badge("something is missing", "warn")
                if gate["rejected"]
                else Badge("nothing detectable", "good"),
                cell("degrees of freedom beyond", gate["degrees_of_freedom_beyond"]),
                *(cell(name, factors[name], 2) for name in ("scatter", "shared", "independent")),
            ]
        )
    return table


def noise_sentences(noise: Mapping[str, Any], data: Data) -> list[Markup]:
    """The noise that the test took, and how much hangs on it."""
    sentences = [
        parts(
            "Noise floor: a right model would be off by {} in the logarithm of a reading (rms). {}",
            data.number("noise", "", "noise floor, rms of logarithms", noise["floor_rms_log"]),
            "The parts of the noise were estimated from the data."
            if noise["estimated_from_the_data"]
            else "Too few degrees of freedom remain to estimate it: it is as declared.",
        )
    ]
    if other := noise.get("with_noise_1_5_times_declared"):
        sentences.append(
            parts(
                "With {} times the declared noise the largest score would be {} against a "
                "threshold of {}: the model would {} be rejected.",
                data.number("noise", "", "times the declared noise", 1.5, 1),
                data.number("noise", "larger noise", "largest score", other["statistic"], 2),
                data.number("noise", "larger noise", "threshold", other["threshold"], 2),
                "still" if other["rejected"] else "not",
            )
        )
    return sentences


def outcome_table(found: Mapping[str, Any], data: Data) -> Table:
    """What became of each name, none left out."""
    rounds = len(found["gate"])
    asked = [n for n, evidence in enumerate(found["evidence"], start=1) if evidence]
    last = f"Largest score: round {rounds}"
    table = Table(
        "outcomes",
        "Every name that was considered: the largest score of its hypotheses (local rules: in "
        "the table of the test), its probability, and what became of it. Sensor faults and "
        "mis-declared inputs compete with physics, each group with one prior mass.",
        [
            "Name",
            "Kind",
            "Hypotheses",
            "Largest score: round 1",
            *([last] if rounds > 1 else []),
            *(f"Probability: round {n}" for n in asked),
            "Outcome",
        ],
        data,
    )
    lists = [found["candidates"], *([found["candidates_left"]] if rounds > 1 else [])]
    probabilities = [found["evidence"][n - 1]["by_name"] for n in asked]
    names = [name for by_name in probabilities for name in by_name]
    names += [entry["name"] for entry in found["candidates"]]
    for name in dict.fromkeys(names):
        own = [[e for e in entries if e["name"] == name] for entries in lists]
        scores = [max((e["score"] for e in entries), default=None) for entries in own]
        kind = own[0][0]["kind"] if own[0] else effects()[name].kind
        values = [(len(own[0]) or None, 0), *((score, 2) for score in scores)]
        values += [(by_name.get(name), 3) for by_name in probabilities]
        cells = zip(table.columns[2:-1], values, strict=True)
        table.rows.append(
            [
                name,
                kind,
                *(table.number(name, column, *value) for column, value in cells),
                _outcome(name, own[0], found),
            ]
        )
    return table.without_empty_columns()


def _outcome(name: str, entries: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> Badge:
    for entry in found["effects_added"]:
        if entry["name"] == name:
            return Badge(f"added in round {entry['round']}", "good")
    if name in found["candidate_set"]:
        return Badge("still open", "warn")
    if entries and not any(entry["testable"] for entry in entries):
        return Badge("not testable here")
    return Badge("lost" if any(found["evidence"]) else "no sign of it")


def hypothesis_tables(found: Mapping[str, Any], data: Data) -> list[Table]:
    """The best hypotheses of each round that asked."""
    tables = []
    for number, evidence in enumerate(found["evidence"], start=1):
        if evidence is None:
            continue
        table = Table(
            f"hypotheses_{number}",
            f"Round {number}: the best hypotheses, with their evidence against the model as it "
            "was. Those worth it were refitted; the others have the closed form of a linear model.",
            ["Hypothesis", "Log evidence", "Probability", "Evidence from"],
            data,
        )
        for one in evidence["best"]:
            numbers = (("log evidence", one["log_evidence"], 2),
                       ("probability", one["probability"], 3))  # fmt: skip
            table.rows.append(
                [
                    one["label"],
                    *(table.number(one["label"], *number) for number in numbers),
                    "refit" if one["refitted"] else "closed form",
                ]
            )
        tables.append(table)
    return tables


def rule_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """Local rules that were added or came near it, in words; None without any."""
    if not found["local_rules"]:
        return None
    table = Table(
        "rules",
        "Local rules that were added or came near it. Amplitude: change of the logarithm of the "
        "quantity where the rule acts in full.",
        ["Rule", "Amplitude", "Probability", "Outcome"],
        data,
    )
    for rule in found["local_rules"]:
        table.rows.append(
            [
                rule["words"] + (f" ({AT_BOUND})" if rule["at_bound"] else ""),
                table.number(rule["words"], "amplitude", rule["amplitude"]),
                table.number(rule["words"], "probability", rule["probability"], 3),
                Badge("added", "good") if rule["added"] else "lost",
            ]
        )
    return table


def mimic_table(found: Mapping[str, Any], data: Data) -> Table | None:
    """What looks like the effects that were added or are still open; None without any."""
    names = {entry["name"] for entry in found["effects_added"]} | {*found["candidate_set"]}
    entries = [e for e in found["candidates"] if e["name"] in names and e["nearest_mimic"]]
    if not entries:
        return None
    table = Table(
        "mimics",
        "What these readings can hardly tell from what was added or is open: a distance below "
        "about two standard deviations is no evidence for one against the other.",
        ["Candidate", "Nearest mimic", "Distance (sd)", "Look-alikes"],
        data,
    )
    for entry in entries:
        name = label_of(entry)
        table.rows.append(
            [
                name,
                entry["nearest_mimic"],
                table.number(name, "distance", entry["mimic_distance"], 2, "sd"),
                _look_alikes(table, name, entry["alike"]),
            ]
        )
    return table.without_empty_columns()
