"""The page of the blind benchmark: how often the loop is right about what it could not know."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from pipeline.blind.attacks import ATTACKS
from pipeline.files.atomic import write_text
from pipeline.report.blind_rates import (
    alarm_table,
    answer_table,
    bar_table,
    confusion_tables,
    held_out_table,
    named_table,
    peer_table,
    reliability_figure,
    reliability_table,
)
from pipeline.report.blind_words import GENERATORS, INTERVAL, KINDS, claims_of, rate_cell, words_of
from pipeline.report.figures import panel_style
from pipeline.report.page import MISSING, Badge, Data, Link, Table, parts, render

FULL_EDITION = 400  # worlds from which the bars are meant
REMARKS = {  # by attack: what was mended in the method for it, and what was not
    "noise_everywhere": "The parts of the noise are estimated from the data.",
    "noise_shared": "Likewise.",
    "noise_of_one_cell": "Not mended: all load cells have one factor of the noise.",
    "mimics_alike": "Mended: a value for each material came with both where one had it; a key now "
    "stays only with evidence of its own.",
    "mimics_cancelling": "Not mended: where little is left of both together, little can be found.",
    "held_out_only": "Not mended: no calibration reading shows it. The held-out error does.",
    "gain_beside_physics": "Mended: a fault of many times its usual size lost to another that fits "
    "worse; priors of amplitudes now have heavy tails.",
    "stuck_beside_physics": "Not mended: the catalogue has no load cell that is not to be trusted "
    "at all. Taking its readings out of the study helps.",
    "wrong_angle": "Not mended: calibration follows most of it.",
    "exchanged_files": "Not mended: that files are exchanged is no hypothesis of the loop.",
}


def write_blind_report(scores: Mapping[str, Any], page: str | Path, data: str | Path) -> None:
    """Write the benchmark's page and the data that it shows.

    Parameters
    ----------
    scores : content of `scores.json`; the page stands beside it and beside `worlds/`
    page, data : the HTML page and the CSV with the columns of `page.COLUMNS`
    """
    numbers = Data()
    with panel_style():
        html = blind_page(scores, numbers, [Path(data).name, "scores.json", "log.jsonl"])
    write_text(data, numbers.to_csv())
    write_text(page, html)


def blind_page(scores: Mapping[str, Any], data: Data, file_names: Iterable[str]) -> str:
    """HTML of the page; `file_names` are linked at its bottom, the first has its data."""
    names = list(file_names)
    return render(
        "blind.html.j2",
        verdict=verdict(scores, data),
        small=small_edition(scores, data),
        bars=bar_table(scores, data),
        confusion=confusion_tables(scores, data),
        alarms=alarm_table(scores, data),
        named=named_table(scores, data),
        reliability=reliability_figure(scores["reliability"], data),
        probabilities=reliability_table(scores, data),
        answers=answer_table(scores, data),
        held_out=held_out_table(scores, data),
        peers=peer_table(scores, data),
        attacks=attack_tables(scores, data),
        missed=missed_table(scores, data),
        again=again_table(scores, data),
        remeasured=remeasured_table(scores, data),
        worlds=world_table(scores, data),
        provenance=provenance_table(scores, data),
        files=names,
        numbers=names[0],
        versions=", ".join(f"{name} {version}" for name, version in scores["versions"].items()),
        commit=scores["commit"],
    )


# ---------------------------------------------------------------------------------------------
# the head


def verdict(scores: Mapping[str, Any], data: Data) -> list[Markup]:
    """How many bars are met, and which are broken for sure."""
    bars = [bar for bar in scores["bars"] if bar["bar"] is not None]
    tested = [bar for bar in bars if bar["met"] is not None]
    sentences = [
        parts(
            "<strong>{} of {} bars are met</strong> that {} worlds have a figure for; {} have none "
            "yet.",
            data.number("verdict", "", "bars met", sum(bar["met"] for bar in tested)),
            data.number("verdict", "", "bars with a figure", len(tested)),
            data.number("verdict", "", "worlds", scores["worlds"]),
            data.number("verdict", "", "bars without", len(bars) - len(tested)),
        )
    ]
    if scores["broken"]:
        broken = "; ".join(scores["broken"])
        sentences.append(parts("Beyond the bar with 95 % certainty: {}.", broken))
    else:
        sentences.append(Markup("No rate is beyond its bar with 95 % certainty."))
    if not scores["seed_is_the_commits"]:
        sentences.append(
            Markup(
                "<strong>Tuning worlds</strong>: their seed was given, and is not that of the "
                "commit under test. These figures score nothing."
            )
        )
    return sentences


def small_edition(scores: Mapping[str, Any], data: Data) -> Markup | None:
    """That there are too few worlds for the bars; None in a full edition."""
    if scores["worlds"] >= FULL_EDITION:
        return None
    return parts(
        "A <strong>small edition</strong>: {} worlds, where the bars are meant for {} or more. "
        "Rates have wide intervals, and many rows stand on a few worlds or none.",
        data.number("edition", "", "worlds", scores["worlds"]),
        data.number("edition", "", "worlds of a full edition", FULL_EDITION),
    )


# ---------------------------------------------------------------------------------------------
# worlds that were missed, and attacks


def missed_table(scores: Mapping[str, Any], data: Data) -> Table | None:
    """What stood against the truth in each world with strong effects that was missed."""
    table = Table(
        "missed",
        "Every world whose effects all move the readings by δ ≥ 5 and are not what the loop says. "
        "Probability: of the true effect in the first round, where the gate rejected. Distance: "
        "how many standard deviations the readings differ from those that the nearest mimic "
        "makes; below three the two cannot be told apart for sure by any method.",
        [
            "World",
            "Kind",
            "Data from",
            "Truth",
            "δ",
            "Said",
            "Probability",
            "Nearest mimic",
            "Distance",
        ],
        data,
    )
    for one in scores["missed"]:
        name = one["world"]
        for place, effect in enumerate(one["effects"], start=1):
            numbers = [
                table.number(name, f"{key} {place}", effect[key], digits)
                for key, digits in (("delta", 1), ("probability", 2), ("mimic_distance", 1))
            ]
            table.rows.append(
                [
                    Link(name, f"worlds/{name}/closed_loop.json"),
                    KINDS[one["kind"]],
                    GENERATORS[one["generator"]],
                    claims_of([(effect["name"], effect["scope_key"])]),
                    numbers[0],
                    words_of(one["said"]),
                    numbers[1],
                    words_of(effect["nearest_mimic"] or MISSING),
                    numbers[2],
                ]
            )
    return table if table.rows else None


def attack_tables(scores: Mapping[str, Any], data: Data) -> list[Table]:
    """Worlds written to fool the loop: by kind, and each; [] where none was asked for."""
    if not scores["attacks"]:
        return []
    kinds = Table(
        "attacks",
        f"Worlds that were written to fool the loop; they count in no other table. {INTERVAL} "
        "Held-out ratio: error after over before, against noise-free truth.",
        [
            "Attack",
            "What a user would accept",
            "Ended so",
            "What is not there named",
            "Gate rejects",
            "What it said, and in how many",
            "Held-out ratio, median",
            "Made worse",
            "Mended, or not",
        ],
        data,
    )
    each = Table(
        "attack_worlds",
        "Each of these worlds. δ together: how far all effects move the readings.",
        [
            "World",
            "Attack",
            "Truth",
            "Also wrong",
            "δ together",
            "Verdict",
            "Named",
            "90 % set",
            "Error: before",
            "Error: after",
            "Accepted",
        ],
        data,
    )
    for name, found in scores["attacks"].items():
        said = Markup("; ").join(
            parts("{} ({})", words, kinds.number(name, f"said: {words}", count, 0))
            for words, count in found["said"].items()
        )
        kinds.rows.append(
            [
                ATTACKS[name].words,
                ATTACKS[name].wanted,
                rate_cell(kinds, name, "ended well", found["ends_well"]),
                rate_cell(kinds, name, "fooled", found["fooled"]),
                rate_cell(kinds, name, "gate rejects", found["gate_rejected"]),
                said,
                kinds.number(name, "held-out ratio", found["held_out_ratio"], 3),
                rate_cell(kinds, name, "made worse", found["made_worse"]),
                REMARKS.get(name, MISSING),
            ]
        )
        for one in found["each"]:
            world = one["world"]
            errors = (one["held_out"].get(when, {}) for when in ("before", "after"))
            each.rows.append(
                [
                    Link(world, f"worlds/{world}/closed_loop.json"),
                    words_of(name),
                    Link(claims_of(one["true"]) or "nothing", f"sealed/{world}.json"),
                    _details(one["details"]) or MISSING,
                    each.number(world, "joint delta", one["joint_delta"], 1),
                    words_of(one["verdict"]),
                    claims_of(one["named"]) or MISSING,
                    ", ".join(one["candidate_set"]) or MISSING,
                    *(
                        each.number(world, f"error {when}", error.get("rms_log"), 3)
                        for when, error in zip(("before", "after"), errors, strict=True)
                    ),
                    _ending(one),
                ]
            )
    return [kinds, each]


def _ending(one: Mapping[str, Any]) -> Badge:
    """Whether a user would accept how the loop ended, and what is wrong with it if not."""
    if one["ends_well"]:
        return Badge("yes", "good")
    return Badge("fooled", "bad") if one["fooled"] else Badge("no", "warn")


def _details(details: Mapping[str, Any]) -> str:
    """What is wrong in a world, in words and figures."""

    def value(of: float | str | Sequence[str]) -> str:
        if isinstance(of, float):
            return f"{of:.3g}"
        return of if isinstance(of, str) else " and ".join(of)

    return ", ".join(f"{words_of(key)}: {value(of)}" for key, of in details.items())


# ---------------------------------------------------------------------------------------------
# one more measurement


def again_table(scores: Mapping[str, Any], data: Data) -> Table:
    """How often one more measurement leaves exactly the truth standing."""
    choices = {"recommended": "The recommended one", "random": "One chosen at random"}
    table = Table(
        "measured_once_more",
        "Worlds where the loop left names open, resolved by one more measurement: exactly the true "
        f"effect is named, or is all that is left of the set. {INTERVAL}",
        ["Worlds", *choices.values()],
        data,
    )
    words, rates = "one effect, undecided", scores["remeasured"]
    cells = [rate_cell(table, words, head, rates[choice]) for choice, head in choices.items()]
    table.rows.append([words, *cells])
    return table


def remeasured_table(scores: Mapping[str, Any], data: Data) -> Table | None:
    """What was measured in each of these worlds; None without any."""
    rows = [
        [one["world"], choice, one[choice]["what"], one[choice]["where"], one[choice]["resolved"]]
        for one in scores["remeasured"]["each"]
        for choice in ("recommended", "random")
        if choice in one
    ]
    table = Table(
        "measurements",
        "Each measurement that was made.",
        ["World", "Choice", "What", "Where", "Resolved"],
        data,
    )
    for name, choice, what, where, resolved in rows:
        link = Link(name, f"worlds/{name}/then_{choice}/measurement.json")
        badge = Badge("resolved", "good") if resolved else "no"
        table.rows.append([link, choice, what, where, badge])
    return table if rows else None


# ---------------------------------------------------------------------------------------------
# every world, and what it ran with


def world_table(scores: Mapping[str, Any], data: Data) -> Table:
    """Every world with its truth, what the loop said, and its held-out errors."""
    table = Table(
        "worlds",
        "Every world. Errors: held out, rms of logarithms against the noise-free truth.",
        [
            "World",
            "Kind",
            "Data from",
            "Truth",
            "δ",
            "Verdict",
            "Named",
            "90 % set",
            "Error: before",
            "Error: after",
        ],
        data,
    )
    for one in scores["each"]:
        name = one["world"]
        errors = (one["held_out"].get(when, {}) for when in ("before", "after"))
        table.rows.append(
            [
                Link(name, f"worlds/{name}/closed_loop.json"),
                KINDS[one["kind"]],
                GENERATORS[one["generator"]],
                Link(claims_of(one["true"]) or "nothing", f"sealed/{name}.json"),
                [
                    table.number(name, f"delta {place}", value, 1)
                    for place, value in enumerate(one["deltas"], start=1)
                ],
                words_of(one["verdict"]),
                claims_of(one["named"]) or MISSING,
                ", ".join(one["candidate_set"]) or MISSING,
                *(
                    table.number(name, f"error {when}", error.get("rms_log"), 3)
                    for when, error in zip(("before", "after"), errors, strict=True)
                ),
            ]
        )
    return table


def provenance_table(scores: Mapping[str, Any], data: Data) -> Table:
    """What was run, when and from which seed."""
    table = Table("provenance", "What the benchmark ran with.", ["Setting", "Value"], data)
    is_own = scores["seed_is_the_commits"]
    table.rows += [
        ["commit under test", scores["commit"]],
        ["date", scores["date"]],
        [
            "seed of the worlds",
            [str(scores["seed"]), "(derived from the commit)" if is_own else "(given)"],
        ],
    ]
    counts = {"worlds": scores["worlds"]}
    counts |= {f"worlds: {KINDS[kind]}": count for kind, count in scores["kinds"].items()}
    counts |= {
        f"worlds: data from {GENERATORS[name]}": count
        for name, count in scores["generators"].items()
    }
    for name, count in counts.items():
        table.rows.append([name, [table.number(name, "value", count, 0)]])
    for key, value in (scores["seconds"] or {}).items():
        name = f"processor seconds of the loop on one world, {key}"
        table.rows.append([name, [table.number(name, "value", value, 1)]])
    return table
