"""The page of the blind benchmark: how often the loop is right about what it could not know."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from pipeline.blind.attacks import ATTACKS
from pipeline.files.atomic import write_text
from pipeline.report.figures import BLUE, MUTED, Panel, panel_style
from pipeline.report.page import MISSING, Badge, Data, Figure, Link, Table, parts, render

FULL_EDITION = 400  # worlds from which the bars are meant
KINDS = {
    "null_plain": "nothing missing",
    "null_heavy_tails": "nothing missing, heavy tails",
    "null_understated_noise": "nothing missing, noise understated",
    "one": "one effect",
    "two": "two effects",
    "outside": "outside the catalogue",
    "sensor_or_input": "sensor or input",
}
GENERATORS = {"lattice": "the lattice", "independent": "independent"}
PREDICTIONS = {
    "after": "after the loop",
    "recalibrated_only": "recalibrated only",
    "gaussian_process": "Gaussian process",
}
AGAINST = {"rms_log": "noise-free truth", "rms_log_readings": "readings"}
PEERS = {
    "raw_correlation": "raw-residual correlation",
    "forward_selection": "BIC forward selection",
    "forward_selection_whitened": "BIC forward selection, covariance known",
    "thresholded_least_squares": "sequentially thresholded least squares",
    "thresholded_least_squares_whitened": (
        "sequentially thresholded least squares, covariance known"
    ),
}
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
INTERVAL = "In brackets: of how many, and the exact 95 % interval."


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


def bar_table(scores: Mapping[str, Any], data: Data) -> Table:
    """Each quantity with its figure, bar and stretch."""
    table = Table(
        "bars",
        "What the loop is to reach. A false-alarm bar counts as met until its one-sided 95 % lower "
        f"bound lies above it. {INTERVAL}",
        ["Quantity", "Figure", "Bar", "Stretch", "Bar met", "Stretch met"],
        data,
    )
    for bar in scores["bars"]:
        quantity, is_rate = bar["quantity"], bar["rate"] is not None
        figure = table.number(quantity, "figure", bar["figure"])
        table.rows.append(
            [
                quantity,
                _rate(table, quantity, "rate", bar["rate"]) if is_rate else figure,
                *(_limit(table, bar, name) for name in ("bar", "stretch")),
                _met(bar["met"], bar["broken"]),
                _met(bar["met_stretch"]),
            ]
        )
    return table


def _limit(table: Table, bar: Mapping[str, Any], name: str) -> Markup | str:
    """The bar or the stretch; a dash for a figure that stands beside another."""
    if bar[name] is None:
        return MISSING
    sign = "≥" if bar["stretch"] > bar["bar"] else "≤"
    factor, unit = (1.0, "") if bar["rate"] is None else (100.0, "%")
    number = table.number(bar["quantity"], name, factor * bar[name], unit=unit)
    return parts("{} {}{}", sign, number, f" {unit}" if unit else "")


def _met(met: bool | None, broken: bool | None = None) -> Badge | str:
    if met is None:
        return MISSING
    if met:
        return Badge("met", "good")
    return Badge("missed for sure", "bad") if broken else Badge("missed", "warn")


def _rate(table: Table, row: str, column: str, of: Mapping[str, Any]) -> Markup | str:
    """A rate in percent with its count and interval, recorded; a dash where it is of nothing."""
    if not of["of"]:
        return MISSING
    percent = [
        table.number(row, f"{column}{words}", 100.0 * of[name], 1, "%")
        for words, name in (("", "rate"), (", from", "low"), (", to", "high"))
    ]
    count, total = (
        table.number(row, f"{column}{words}", of[name], 0)
        for words, name in ((", count", "count"), (", of", "of"))
    )
    return parts("{} % ({} of {}; {} to {})", percent[0], count, total, *percent[1:])


# ---------------------------------------------------------------------------------------------
# what the loop said


def confusion_tables(scores: Mapping[str, Any], data: Data) -> list[Table]:
    """Truth against verdict, over all worlds and by how far the weakest effect moves readings."""
    tables = [_confusion("confusion", "All worlds", scores["confusion"], data)]
    for label, matrix in scores["confusion_by_delta"].items():
        if matrix:
            words = f"Worlds whose weakest effect has δ {_delta_words(label)}"
            tables.append(_confusion(f"confusion {label}", words, matrix, data))
    return tables


def _confusion(name: str, words: str, matrix: Mapping[str, Mapping[str, int]], data) -> Table:
    said = sorted({column for row in matrix.values() for column in row})
    table = Table(name.replace(" ", "_"), f"{words}.", ["Truth", *map(_words, said)], data)
    for truth, row in matrix.items():
        cells = [
            table.number(truth, column, row[column], 0) if column in row else "" for column in said
        ]
        table.rows.append([_words(KINDS.get(truth, truth)), *cells])
    return table


def _words(name: str) -> str:
    return name.replace("_", " ")


def _delta_words(label: str) -> str:
    if label[0] in "<>":
        return f"{'below' if label[0] == '<' else 'of at least'} {label[1:]}"
    low, high = label.split("-")
    return f"from {low} to {high}"


def alarm_table(scores: Mapping[str, Any], data: Data) -> Table:
    """False alarms by kind of null."""
    columns = {
        "any_claim": "Anything claimed missing",
        "named_effect": "An effect named",
        "gate_rejected": "Gate rejects",
    }
    table = Table(
        "false_alarms",
        f"False alarms in worlds where nothing is missing. {INTERVAL}",
        ["Worlds", *columns.values()],
        data,
    )
    for kind, rates in scores["false_alarms"].items():
        cells = [_rate(table, kind, words, rates[key]) for key, words in columns.items()]
        table.rows.append([KINDS[kind], *cells])
    return table


def named_table(scores: Mapping[str, Any], data: Data) -> Table:
    """Of worlds with one effect: how often it is named and right, by how far it moves readings."""
    columns = {
        "named": "An effect named",
        "right_of_named": "Right, of those named",
        "found_and_right": "Found and right",
    }
    table = Table(
        "named_by_delta",
        "Worlds with one effect of the catalogue, by how far it moves the readings (δ, in standard "
        f"deviations, beyond what calibration can follow). {INTERVAL}",
        ["δ", *columns.values()],
        data,
    )
    for label, rates in scores["named_first_by_delta"].items():
        cells = [_rate(table, label, words, rates[key]) for key, words in columns.items()]
        table.rows.append([_delta_words(label), *cells])
    return table


def reliability_figure(reliability: Sequence[Mapping[str, Any]], data: Data) -> Figure | None:
    """How often effects are right that were added at a probability; None if none was added."""
    rows = [row for row in reliability if row["right"]["of"]]
    if not rows:
        return None
    panel = Panel(
        data,
        "reliability",
        "",
        "probability when added (–)",
        "share right (–)",
        "Share of the added effects that are there, over their probability.",
        (2.7, 2.7),
    )
    low = min(0.5, *(row["right"]["low"] for row in rows))
    panel.curve("as sure as right", [low, 1.0], [low, 1.0], color=MUTED, dash="dashed")
    x = [row["mean_probability"] for row in rows]
    right, lows, highs = ([row["right"][key] for row in rows] for key in ("rate", "low", "high"))
    panel.points("added effects", x, right, lows, highs, BLUE)
    caption = parts(
        "Effects of the catalogue that the loop added (n = {}), by their probability then, over "
        "all but the hard nulls; bars: exact 95 % intervals.",
        data.number("reliability", "", "added effects", sum(row["right"]["of"] for row in rows)),
    )
    return Figure("reliability", "Are the probabilities right?", caption, [panel])


def reliability_table(scores: Mapping[str, Any], data: Data) -> Table:
    """The same in numbers."""
    table = Table(
        "reliability_numbers",
        f"Added effects by their probability. {INTERVAL}",
        ["Probability", "Mean probability", "Right"],
        data,
    )
    for row in scores["reliability"]:
        label = row["probability"]
        mean = table.number(label, "mean probability", row["mean_probability"], 3)
        table.rows.append([label, mean, _rate(table, label, "right", row["right"])])
    return table


def answer_table(scores: Mapping[str, Any], data: Data) -> Table:
    """Sets, two effects, and what no catalogue holds."""
    table = Table(
        "answers",
        f"Sets of names, worlds with two effects, and worlds outside the catalogue. {INTERVAL}",
        ["What", "Figure"],
        data,
    )

    def add(words: str, of: Mapping[str, Any]) -> None:
        table.rows.append([words, _rate(table, words, "rate", of)])

    sets = scores["sets"]
    add("one effect: the 90 % set or the name holds it", sets["coverage"])
    size = table.number("sets", "mean size", sets["mean_size"], 2)
    table.rows.append(["one effect: mean size of that set", size])
    for group, suffix in (("all", ""), ("both_at_least_5", ", both with δ ≥ 5")):
        for key, words in (
            ("exact_set", "exactly these named"),
            ("one_right_none_wrong", "one right, none wrong"),
            ("wrong_term", "a wrong one among those named"),
        ):
            add(f"two effects{suffix}: {words}", scores["two"][group][key])
    for group, suffix in (("all", ""), ("at_least_5", ", δ ≥ 5")):
        for key, words in (
            ("not_named_as_catalogue", "not named as a catalogue effect"),
            ("unknown_effect", "verdict unknown effect"),
            ("right_rule", "right rule"),
        ):
            add(f"outside the catalogue{suffix}: {words}", scores["outside"][group][key])
    return table


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
                    _claims([(effect["name"], effect["scope_key"])]),
                    numbers[0],
                    _words(one["said"]),
                    numbers[1],
                    _words(effect["nearest_mimic"] or MISSING),
                    numbers[2],
                ]
            )
    return table if table.rows else None


def held_out_table(scores: Mapping[str, Any], data: Data) -> Table:
    """Ratio of held-out errors after to before, by group of worlds, prediction and reference."""
    table = Table(
        "held_out_ratios",
        "Held-out error (rms of logarithms) over that of the calibrated baseline: its median over "
        "worlds, its quartiles, and the share of worlds in which it is over 1.05. Noise-free truth "
        "is the mean stress over many packings.",
        [
            "Worlds",
            "n",
            "Prediction",
            "Against",
            "Ratio: median",
            "Ratio: lower quartile",
            "Ratio: upper quartile",
            "Made worse",
        ],
        data,
    )
    for group, found in scores["held_out"].items():
        for prediction, words in PREDICTIONS.items():
            for measure, reference in AGAINST.items():
                ratios = found.get(f"{prediction}_{measure}")
                if ratios is None:
                    continue
                row = f"{group}, {words}, {reference}"
                values = (ratios["median_ratio"], *ratios["quartiles"])
                columns = ("median", "lower quartile", "upper quartile")
                table.rows.append(
                    [
                        _words(group),
                        table.number(row, "worlds", found["worlds"], 0),
                        words,
                        reference,
                        *(
                            table.number(row, column, value, 3)
                            for column, value in zip(columns, values, strict=True)
                        ),
                        _rate(table, row, "made worse", ratios["made_worse"]),
                    ]
                )
    return table


def peer_table(scores: Mapping[str, Any], data: Data) -> Table:
    """The same questions to other methods that name effects; the loop on top."""
    named = {bar["quantity"]: bar["rate"] for bar in scores["bars"]}
    loop = {
        "claims_on_plain_nulls": scores["false_alarms"]["null_plain"]["named_effect"],
        "right_of_named": named["right, of those where an effect is named first"],
        "found_and_right_at_least_5": named["found and right, of worlds with delta of at least 5"],
        "two": scores["two"],
    }
    columns = {
        "claims_on_plain_nulls": "Names an effect where nothing is missing",
        "right_of_named": "Right, of those where one is named",
        "found_and_right_at_least_5": "Found and right, δ ≥ 5",
    }
    table = Table(
        "peers",
        "Other methods on the same residual and the same derivatives, with the noise as declared. "
        f"The Gaussian process names nothing: it stands among the held-out errors. {INTERVAL}",
        ["Method", *columns.values(), "Two effects: exactly these"],
        data,
    )
    for name, rates in {"the loop": loop, **scores["peers"]}.items():
        words = PEERS.get(name, name)
        cells = [_rate(table, words, column, rates[key]) for key, column in columns.items()]
        exact = _rate(table, words, "two effects", rates["two"]["all"]["exact_set"])
        table.rows.append([words, *cells, exact])
    return table


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
                _rate(kinds, name, "ended well", found["ends_well"]),
                _rate(kinds, name, "fooled", found["fooled"]),
                _rate(kinds, name, "gate rejects", found["gate_rejected"]),
                said,
                kinds.number(name, "held-out ratio", found["held_out_ratio"], 3),
                _rate(kinds, name, "made worse", found["made_worse"]),
                REMARKS.get(name, MISSING),
            ]
        )
        for one in found["each"]:
            world = one["world"]
            errors = (one["held_out"].get(when, {}) for when in ("before", "after"))
            each.rows.append(
                [
                    Link(world, f"worlds/{world}/closed_loop.json"),
                    _words(name),
                    Link(_claims(one["true"]) or "nothing", f"sealed/{world}.json"),
                    _details(one["details"]) or MISSING,
                    each.number(world, "joint delta", one["joint_delta"], 1),
                    _words(one["verdict"]),
                    _claims(one["named"]) or MISSING,
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

    return ", ".join(f"{_words(key)}: {value(of)}" for key, of in details.items())


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
    cells = [_rate(table, words, head, rates[choice]) for choice, head in choices.items()]
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
                Link(_claims(one["true"]) or "nothing", f"sealed/{name}.json"),
                [
                    table.number(name, f"delta {place}", value, 1)
                    for place, value in enumerate(one["deltas"], start=1)
                ],
                _words(one["verdict"]),
                _claims(one["named"]) or MISSING,
                ", ".join(one["candidate_set"]) or MISSING,
                *(
                    table.number(name, f"error {when}", error.get("rms_log"), 3)
                    for when, error in zip(("before", "after"), errors, strict=True)
                ),
            ]
        )
    return table


def _claims(claims: Sequence[Sequence[str | None]]) -> str:
    return ", ".join(f"{name} ({key})" if key else name for name, key in claims)


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
