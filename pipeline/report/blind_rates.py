"""How often the loop is right: the tables and the figure of the blind benchmark's rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from pipeline.report.blind_words import INTERVAL, KINDS, rate_cell, words_of
from pipeline.report.figures import BLUE, MUTED, Panel
from pipeline.report.page import MISSING, Badge, Data, Figure, Table, parts

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
                rate_cell(table, quantity, "rate", bar["rate"]) if is_rate else figure,
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
    return parts("{}\N{NO-BREAK SPACE}{}{}", sign, number, unit and f"\N{NO-BREAK SPACE}{unit}")


def _met(met: bool | None, broken: bool | None = None) -> Badge | str:
    if met is None:
        return MISSING
    if met:
        return Badge("met", "good")
    return Badge("missed for sure", "bad") if broken else Badge("missed", "warn")


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
    table = Table(name.replace(" ", "_"), f"{words}.", ["Truth", *map(words_of, said)], data)
    for truth, row in matrix.items():
        cells = [
            table.number(truth, column, row[column], 0) if column in row else "" for column in said
        ]
        table.rows.append([words_of(KINDS.get(truth, truth)), *cells])
    return table


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
        cells = [rate_cell(table, kind, words, rates[key]) for key, words in columns.items()]
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
        cells = [rate_cell(table, label, words, rates[key]) for key, words in columns.items()]
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
        table.rows.append([label, mean, rate_cell(table, label, "right", row["right"])])
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
        table.rows.append([words, rate_cell(table, words, "rate", of)])

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
                        words_of(group),
                        table.number(row, "worlds", found["worlds"], 0),
                        words,
                        reference,
                        *(
                            table.number(row, column, value, 3)
                            for column, value in zip(columns, values, strict=True)
                        ),
                        rate_cell(table, row, "made worse", ratios["made_worse"]),
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
        cells = [rate_cell(table, words, column, rates[key]) for key, column in columns.items()]
        exact = rate_cell(table, words, "two effects", rates["two"]["all"]["exact_set"])
        table.rows.append([words, *cells, exact])
    return table
