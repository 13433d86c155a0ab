"""Reference pages in Markdown, from what the code itself goes by: models, variables, effects."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pipeline.config.commented import choices_of, range_of, schema_of
from pipeline.config.comparison import Comparison
from pipeline.config.experiment import Experiment
from pipeline.config.imports import ImportSettings
from pipeline.config.measured import COLUMNS, QUANTITIES, REQUIRED_COLUMNS
from pipeline.config.study import Study
from pipeline.effects import Effect, effects
from pipeline.files.atomic import write_text
from pipeline.files.netcdf import STATISTICS, VARIANTS, variable_table
from pipeline.montecarlo.statistics import SKIPPED

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
WRITTEN = "Written by `python -m pipeline reference`; do not edit."
KINDS = {
    "Experiment": (Experiment, "a file in `workflow_configs/experiments/`, or a folder of yours"),
    "Study": (Study, "a file in `workflow_configs/studies/`, or a folder of yours"),
    "Comparison": (Comparison, "a file in `workflow_configs/comparisons/`, or a folder of yours"),
    "Import settings": (ImportSettings, "a file given to `python -m pipeline import --settings`"),
}
SCOPES = {
    "study": "the whole study",
    "material": "the experiments of one material",
    "experiment": "one experiment",
    "load_cell": "one load cell",
}
STAGES = {
    "geometry": "the filling (its height)",
    "packing": "the cells before draw",
    "state": "the lattice at a reading",
    "readings": "the sensors",
}
CLASSES = {
    "physics": "physics that the model lacks",
    "input": "an input that was declared wrong",
    "sensor": "a sensor at fault",
    "rule": "a rule that no other effect stands for",
}
NONE = "–"


def pages() -> dict[str, str]:
    """Text of each reference page by its file's name."""
    return {
        "config.md": _config_page(),
        "variables.md": _variables_page(),
        "effects.md": _effects_page(),
    }


def write_pages(folder: Path = FOLDER) -> list[Path]:
    """Write the pages into ``folder``; returns where they are."""
    for name, text in pages().items():
        write_text(folder / name, text)
    return [folder / name for name in pages()]


def stale_lines(folder: Path = FOLDER) -> list[str]:
    """Unified diff from the pages in ``folder`` to what the code says; [] in step."""
    lines: list[str] = []
    for name, text in pages().items():
        path = folder / name
        old = path.read_text("utf-8") if path.is_file() else ""
        lines += difflib.unified_diff(
            old.splitlines(), text.splitlines(), name, f"{name} (code)", lineterm=""
        )
    return lines


# ---------------------------------------------------------------------------------------------
# keys of files


def _config_page() -> str:
    lines = [
        "# Keys of the files that you write",
        "",
        WRITTEN,
        "",
        "A key inside another is written with a dot (`geometry.width`), one in each entry of a "
        "list with `[]` (`drawpoints[].x`). Where a mapping has a `type`, keys that belong to one "
        "of them say so. An unknown key is an error. What is `required` is so within its mapping, "
        "which may be left out itself. The `effects` "
        "block is in [effects.md](effects.md), the settings of `snakemake --config` in "
        "[config/README.md](../../config/README.md).",
    ]
    shown: dict[str, str] = {}
    for name, (model, where) in KINDS.items():
        lines += ["", f"## {name}", "", f"{_plain(model.__doc__)} It is {where}.", ""]
        header = ("key", "what may stand there", "unit", "default", "meaning")
        lines += _table(header, _key_rows(model, shown, name))
    lines += ["", "## Measured values", ""]
    lines += [
        "The columns of the table that `measured` or `data.file` names: a CSV with one row for "
        "each reading, or a netCDF file with variables of these names. Lines that start with `#` "
        "are comments.",
        "",
    ]
    rows = [
        (_code(name), "required" if name in REQUIRED_COLUMNS else "may be left out", words)
        for name, words in COLUMNS.items()
    ]
    lines += _table(("column", "", "meaning"), rows)
    lines += ["", *_table(("quantity", "unit"), ((_code(q), u) for q, u in QUANTITIES.items()))]
    return "\n".join(lines) + "\n"


Part = tuple[Mapping[str, Any], bool]  # of a JSON schema, and whether it is an entry of a list


def _key_rows(
    model: type[BaseModel], shown: dict[str, str], name: str
) -> Iterator[tuple[str, ...]]:
    """Rows of all keys of a file; ``shown`` (title of a mapping: where) are not repeated."""
    schema = schema_of(model)
    yield from _rows_of(schema, schema.get("$defs", {}), "", "", shown, name)


def _rows_of(node, defined, prefix, kind, shown, name) -> Iterator[tuple[str, ...]]:
    for key, value in node["properties"].items():
        if key == "type" and kind:
            continue  # said beside the key that holds the mapping
        parts = list(_parts(value, defined))
        text = next(p["description"] for p in (value, *(p for p, _ in parts)) if "description" in p)
        unit = next((part["unit"] for part, _ in parts if "unit" in part), NONE)
        required = key in node.get("required", ())
        default = "required" if required else _shown(value.get("default"))
        mappings = [(part, listed) for part, listed in parts if "properties" in part]
        known = [part["title"] for part, _ in mappings if part["title"] in shown]
        of = f" (`type: {kind}`)" if kind else ""
        as_there = f" As in {shown[known[0]]}." if known else ""
        yield _code(prefix + key), _what(parts), unit, default, _plain(text) + of + as_there
        for part, listed in mappings:
            if part["title"] in shown:
                continue
            shown[part["title"]] = f"{name}, `{prefix}{key}`"
            type_ = part["properties"].get("type", {}).get("const", "")
            inner = f"{prefix}{key}{'[]' * listed}."
            yield from _rows_of(part, defined, inner, type_, shown, name)


def _parts(
    node: Mapping[str, Any], defined: Mapping[str, Any], listed: bool = False
) -> Iterator[Part]:
    """What may stand at a place of a JSON schema: each kind of value, and each kind of entry."""
    if "$ref" in node:
        yield from _parts(defined[node["$ref"].rpartition("/")[2]], defined, listed)
        return
    if "type" in node or choices_of(node):
        yield node, listed
    for key in ("anyOf", "oneOf"):
        for one in node.get(key, ()):
            yield from _parts(one, defined, listed)
    for one in node.get("prefixItems", [node["items"]] if "items" in node else []):
        yield from _parts(one, defined, True)


def _what(parts: Sequence[Part]) -> str:
    """What may stand at a key, in words."""
    single = _words(part for part, listed in parts if not listed)
    entries = _words(part for part, listed in parts if listed)
    lists = any(part.get("type") == "array" for part, _ in parts)
    said = [*([single] if single else []), *([f"list of {entries}"] if lists else [])]
    return ", or ".join(said)


def _words(parts: Iterable[Mapping[str, Any]]) -> str:
    words: list[str] = []
    for part in parts:
        match part.get("type"):
            case _ if choices_of(part):
                words += [_code(str(choice)) for choice in choices_of(part)]
            case "object":
                type_ = part.get("properties", {}).get("type", {}).get("const")
                words.append(f"mapping with `type: {type_}`" if type_ else "mapping")
            case "number":
                words.append(f"number {range_of(part)}".strip())
            case "integer":
                words.append(f"whole number {range_of(part)}".strip())
            case "boolean":
                words += [_code("true"), _code("false")]
            case "string":
                words.append("text")
    return " or ".join(dict.fromkeys(words))


def _shown(default: Any) -> str:
    if default in (None, "", [], {}):
        return NONE
    return NONE if isinstance(default, dict) else _code(json.dumps(default).strip('"'))


# ---------------------------------------------------------------------------------------------
# variables of netCDF files


def _variables_page() -> str:
    files: dict[str, list[tuple[str, ...]]] = {}
    for name, entry in variable_table().items():
        for file, dims in entry["in"].items():
            files.setdefault(file, []).append(_variable_row(name, entry, dims))
    order = ("block_model", "replicates", "statistics", "fields", "residual")
    lines = [
        "# Variables of the netCDF files",
        "",
        WRITTEN,
        "",
        "A file holds those of its variables that apply: `mass_drawn` in draw experiments, "
        "`fill_height` in static ones, load cells where some are declared. Files follow CF-1.11; "
        "`x`, `y` and `z` have bounds (`x_bnds`, ...). Text is stored as characters. Where a value "
        "is missing, it is the fill value.",
    ]
    for file in (*order, *sorted(files.keys() - set(order))):
        where = "studies/NAME" if file == "residual" else "experiments/NAME"
        lines += ["", f"## `{where}/{file}.nc`", ""]
        header = ("variable", "on", "unit", "type", "fill value", "meaning")
        lines += _table(header, files[file])
        if file == "statistics":
            lines += ["", *_statistics()]
        if file == "replicates":
            lines += ["", *_variants()]
    return "\n".join(lines) + "\n"


def _variable_row(name: str, entry: Mapping[str, Any], dims: str) -> tuple[str, ...]:
    meaning = entry["long_name"]
    if "flags" in entry:
        meaning += ": " + ", ".join(f"{value} {word}" for value, word in enumerate(entry["flags"]))
    if "comment" in entry:
        meaning += f" ({entry['comment']})"
    fill = _code(f"{entry['fill']:g}") if "fill" in entry else NONE
    on = "(" + ", ".join(dims.split()) + ")" if dims else "one value"
    return (_code(name), on, entry.get("units", NONE), entry.get("dtype", "text"), fill, meaning)


def _statistics() -> list[str]:
    reduced = [
        _code(name)
        for name, entry in variable_table().items()
        if "replicate" in (dims := entry["in"].get("replicates", "").split())
        and not SKIPPED & set(dims)
        and name != "replicate"
    ]
    return [
        f"And over the replicates, on what dims are left, as float64: for each NAME of "
        f"{', '.join(reduced)} and of their variants",
        "",
        *_table(("variable", "is the"), ((f"`NAME_{s}`", w) for s, (w, _) in STATISTICS.items())),
    ]


def _variants() -> list[str]:
    return [
        "Readings of the same replicates with other parameters, beside those of the same name:",
        "",
        *_table(("variable", "is NAME"), ((f"`NAME{s}`", w) for s, w in VARIANTS.items())),
    ]


# ---------------------------------------------------------------------------------------------
# effects


def _effects_page() -> str:
    lines = [
        "# Effects",
        "",
        WRITTEN,
        "",
        "What an experiment's `effects:` block may name, and what a study tries. With its "
        "parameters neutral an effect changes no bit. `results/effects/index.html` shows what each "
        "does; [add_an_effect.md](../add_an_effect.md) how to write one. A *prior scale* is "
        "an amplitude beyond a few of which a study would be surprised.",
        "",
        ", ".join(f"[{name}](#{name})" for name in effects()),
    ]
    for name, effect in effects().items():
        lines += ["", f"## {name}", "", *_effect(effect)]
    return "\n".join(lines) + "\n"


def _effect(effect: Effect) -> Iterator[str]:
    yield from (_plain(effect.description), "", _code(effect.equation), "")
    sides = {1: "above neutral", -1: "below neutral", 0: "either"}
    rows = [
        (
            _code(p.name),
            p.unit,
            f"{p.neutral:g}",
            f"{p.low:g} to {p.high:g}",
            sides[p.sign],
            f"{p.scale:g}",
            p.words,
        )
        for p in effect.parameters
    ]
    header = ("parameter", "unit", "neutral", "range", "side", "prior scale", "meaning")
    yield from _table(header, rows)
    yield ""
    if effect.options:
        choices = (
            f"`{name}`: " + " or ".join(_code(str(c).lower()) for c in some) + " (the first)"
            for name, some in effect.options.items()
        )
        yield f"* Options, with their default: {'; '.join(choices)}"
    yield f"* Acts on {', '.join(w for s, w in STAGES.items() if getattr(effect, s))}"
    yield f"* One value for {SCOPES[effect.scope]}, unless a study's `scopes` say otherwise"
    if needed := effect.needs(effect.neutral):
        yield f"* Needs {', '.join(map(_code, needed))}"
    yield f"* A larger value {effect.moves.rstrip('.')}"
    yield f"* To find it means: {CLASSES[effect.kind]}"
    if not effect.moves_mean:
        yield "* It moves no mean reading, so that means cannot show it"
    yield f"* Source: {effect.source}"


# ---------------------------------------------------------------------------------------------
# Markdown


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    for cells in (header, ["---"] * len(header), *rows):
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _code(text: str) -> str:
    return f"`{text}`"


def _plain(text: str) -> str:
    """A docstring on one line, its double backticks single."""
    return " ".join(text.replace("``", "`").split())
