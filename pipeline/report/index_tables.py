"""Tables of the index page: experiments, studies, comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.compare.comparison import SIDES
from pipeline.report.index_entries import RUNS, Entry, verdict_of
from pipeline.report.page import Badge, Data, Link, Table, decimals_of
from pipeline.report.study_words import VERDICTS, names_added, predicts_worse
from pipeline.validate.validation import CALIBRATED, DECLARED


def static_table(entries: Sequence[Entry], data: Data) -> Table:
    """Static experiments: stress on the whole base with the model full."""
    stress = "Mean stress on the full base (kPa)"
    table = Table(
        "static",
        "Static experiments. Stress on the whole base with the model full; the verdict counts "
        "every value of the experiment.",
        [
            "Experiment",
            "Data",
            "Values",
            *(f"{stress}: {name}" for name in ("data", *RUNS.values(), "published sim.")),
            *_run_columns("Largest error (sd)"),
            *_run_columns("Verdict"),
            "Published mean reproduced",
        ],
        data,
    )
    for entry in entries:
        reading = entry.full_base() or {}
        shown = [reading.get("measured")]
        shown += [reading.get(run, {}).get("mean") for run in RUNS]
        if DECLARED not in reading:
            shown[1], shown[2] = None, shown[1]
        published = entry.published.get("vertical_stress_mean")
        places = decimals_of(next((v for v in (*shown, published) if v is not None), 0.0))
        _add_row(table, entry, [*shown, published], places)
        reproduced = entry.published.get("mean_reproduced")
        words = {True: Badge("yes", "good"), False: Badge("no", "bad")}
        table.rows[-1].append(words.get(reproduced, ""))
    return table.without_empty_columns()


def draw_table(entries: Sequence[Entry], data: Data) -> Table:
    """Draw experiments: mean absolute error of vertical stress."""
    error = "Mean absolute error of vertical stress (kPa)"
    table = Table(
        "draw",
        "Draw experiments. Mean absolute error over all readings of vertical stress; the verdict "
        "counts every value of the experiment. Published errors are quoted: their readings are "
        "not public.",
        [
            "Experiment",
            "Data",
            "Values",
            *(f"{error}: {name}" for name in (*RUNS.values(), "published")),
            *_run_columns("Largest error (sd)"),
            *_run_columns("Verdict"),
            "Published signs that hold",
        ],
        data,
    )
    for entry in entries:
        overall = entry.validation["overall"]
        errors = [
            overall.get(run, {}).get("vertical_stress", {}).get("mean_absolute_error")
            for run in RUNS
        ]
        if DECLARED not in overall:
            errors.reverse()
        _add_row(table, entry, [*errors, entry.published.get("mean_absolute_error")], 2)
        facts = entry.published.get("facts") or []
        held = table.number(entry.name, "signs that hold", sum(fact["holds"] for fact in facts))
        of = table.number(entry.name, "published signs", len(facts))
        table.rows[-1].append([held, "of", of] if facts else "")
    return table.without_empty_columns()


def study_table(studies: Sequence[Mapping[str, Any]], data: Data) -> Table:
    """Studies: what was found and added, and the held-out error before and after."""
    kpa, logs = "Held-out error, rms (kPa)", "Held-out error, rms of logarithms"
    table = Table(
        "studies",
        "Studies close the loop: they find what the model lacks, add it, and compare the error "
        "before and after on data that had no part in the fit.",
        [
            "Study",
            "Title",
            "Data",
            "Verdict",
            "Added",
            f"{kpa}: before",
            f"{kpa}: after",
            f"{logs}: before",
            f"{logs}: after",
            "Values",
        ],
        data,
    )
    for found in studies:
        before, after = (found["error"]["held_out"][when] for when in ("before", "after"))
        numbers = [(one[key], None) for key in ("rms_kpa", "rms_log") for one in (before, after)]
        numbers.append((after["n"], 0))
        worse = [Badge("predicts worse", "bad")] if predicts_worse(found) else []
        cells = zip(table.columns[5:], numbers, strict=True)
        table.rows.append(
            [
                Link(found["study"], found["link"]),
                found["title"],
                ", ".join(found["data_labels"]),
                VERDICTS[found["verdict"]],
                [", ".join(names_added(found)) or "nothing", *worse],
                *(table.number(found["study"], column, *number) for column, number in cells),
            ]
        )
    return table.without_empty_columns()


def comparison_table(comparisons: Sequence[Mapping[str, Any]], data: Data) -> Table:
    """Comparisons of two experiments: the threshold, and the base's peak and time above it."""
    table = Table(
        "comparisons",
        "Two draw experiments beside each other, simulated: mean stress on the whole base, its "
        "peak among the readings and the share of time (as mass drawn) above a threshold.",
        [
            "Comparison",
            "Title",
            "Experiments",
            "Threshold (MPa)",
            *(f"{head}: {side}" for head in ("Peak (MPa)", "Above (%)") for side in SIDES),
        ],
        data,
    )
    for found in comparisons:
        name, base = found["comparison"], found["base"]
        numbers = [(found["threshold_mpa"], None)]
        numbers += [(base[side]["peak_mpa"], None) for side in SIDES]
        numbers += [(100 * base[side]["share_above"], 1) for side in SIDES]
        cells = zip(table.columns[3:], numbers, strict=True)
        table.rows.append(
            [
                Link(name, found["link"]),
                found["title"],
                " and ".join(one["experiment"] for one in found["experiments"]),
                *(table.number(name, column, *number) for column, number in cells),
            ]
        )
    return table


def _run_columns(head: str) -> list[str]:
    return [f"{head}: {words}" for words in RUNS.values()]


def _add_row(table: Table, entry: Entry, values: Sequence[float | None], places: int) -> None:
    """Add an experiment: link, data, number of values, `values`, largest errors, verdicts."""
    found = [entry.agreement(run) for run in RUNS]
    numbers = [(len(entry.validation["readings"]), 0)]
    numbers += [(value, places) for value in values]
    numbers += [(a and a.worst, 2) for a in found]
    cells = zip(table.columns[2:], numbers, strict=False)
    verdicts = [
        verdict_of(a, entry.is_fitted and run == CALIBRATED)
        for run, a in zip(RUNS, found, strict=True)
    ]
    table.rows.append(
        [
            Link(entry.name, entry.link),
            entry.label or "none",
            *(table.number(entry.name, column, *number) for column, number in cells),
            *verdicts,
        ]
    )


def transmission_table(entries: Sequence[Entry], data: Data) -> Table:
    """E as declared and as calibrated, with what it means for the column."""
    table = Table(
        "transmission",
        "The share E of its load that a cell at rest passes on belongs to its cell size; "
        "ℓ = c / (1 − E) is the length over which load is shed, and K the stress ratio that "
        "Janssen's law asks for with this ℓ.",
        [
            "Experiment",
            "Cell size c (m)",
            "R_h·H (m²)",
            "Wall friction angle (°)",
            "E: as declared",
            "E: calibrated",
            "E, 90 % interval: from",
            "E, 90 % interval: to",
            "ℓ (m)",
            "K",
        ],
        data,
    )
    for entry in entries:
        E, derived = entry.calibration["parameters"]["E"], entry.calibration["derived"]
        walls = entry.experiment.walls
        numbers = (
            entry.experiment.geometry.cell_size,
            entry.size,
            walls and walls.friction_angle,
            E["start"],
            E["value"] if E["calibrated"] else None,
            *(E["interval_90"] or (None, None)),
            derived["attenuation_length"]["value"],
            derived.get("janssen_K", {}).get("value"),
        )
        table.add_numbers(entry.name, [(number, None) for number in numbers])
        table.rows[-1][0] = Link(entry.name, entry.link)
    return table.without_empty_columns()
