"""Comments on the keys of a YAML file, taken from the models: meaning, unit, range, default."""

import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import yaml
from pydantic import BaseModel

COLUMN, WIDTH = 34, 100  # of the comments beside the keys; of the lines

_KEY = re.compile(r"(?P<hash>#?)(?P<indent>(?:  )*)(?P<key>\w+):(?P<value>.*)")
_ITEM = re.compile(r"(?P<hash>#?)(?P<indent>(?:  )*)- (?P<item>\{.*\})")


def commented(text: str, model: type[BaseModel]) -> str:
    """A YAML file with a comment beside each key that says what may stand there.

    Parameters
    ----------
    text
        The file: one key on a line, nested by two spaces; items of lists as ``- {key: value}``,
        whose keys are explained above the first. A line that starts with ``#key`` or ``#  key`` is
        a key that is left out, and is explained alike.
    model
        What the file is checked against.

    Raises
    ------
    KeyError
        For a key that the model does not have.
    """
    lines: list[str] = []
    inside: list[str] = []  # keys that the line is nested in
    explained: list[str] = []  # the list whose items have been explained
    for line in text.splitlines():
        if found := _KEY.fullmatch(line):
            inside = [*inside[: len(found["indent"]) // 2], found["key"]]
            lines += _beside(line, meaning(model, inside))
        else:
            if (found := _ITEM.fullmatch(line)) and explained != inside:
                explained = inside
                lines += _above(found, model, inside)
            lines.append(line)
    return "\n".join(lines) + "\n"


def meaning(model: type[BaseModel], keys: Sequence[str]) -> str:
    """What the key at the end of ``keys`` means: its description, range, choices and default."""
    schema = schema_of(model)
    nodes = [schema]
    for key in keys:
        inner = [part for node in nodes for part in _parts(node, schema.get("$defs", {}))]
        nodes = [part["properties"][key] for part in inner if key in part.get("properties", {})]
        if not nodes:
            raise KeyError(".".join(keys))
    said = [*nodes, *(part for node in nodes for part in _parts(node, schema.get("$defs", {})))]
    text = next(part["description"] for part in said if "description" in part)
    text = text.replace("``", "").rstrip(".")
    ranges = dict.fromkeys(range_of(part) for part in said if part.get("type") != "object")
    choices = dict.fromkeys(str(choice) for part in said for choice in choices_of(part))
    notes = [one for one in ranges if one and not re.search(r"[\[(]0, 1", text)]
    if choices and not all(choice in text for choice in choices):
        several = any(part.get("type") == "array" for part in said)
        notes.append(f"{'any' if several else 'one'} of {', '.join(choices)}")
    if nodes[0].get("default") not in (None, "", [], {}):
        notes.append(f"default {json.dumps(nodes[0]['default'])}".replace('"', ""))
    return "; ".join([text, *notes])


@cache
def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a model."""
    return model.model_json_schema()


def _parts(node: Mapping[str, Any], defined: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """A part of a JSON schema and all that a value there, or an entry of a list there, may be."""
    if "$ref" in node:
        yield from _parts(defined[node["$ref"].rpartition("/")[2]], defined)
    else:
        yield node
    inner = [node["items"]] if isinstance(node.get("items"), Mapping) else []
    for key in ("anyOf", "oneOf", "prefixItems"):
        inner += node.get(key, [])
    for one in inner:
        yield from _parts(one, defined)


def choices_of(part: Mapping[str, Any]) -> list:
    """Values that a part of a JSON schema lists."""
    return [part["const"]] if "const" in part else part.get("enum", [])


def range_of(part: Mapping[str, Any]) -> str:
    """Bounds of a part of a JSON schema in words; empty without."""
    words = {
        "minimum": "from {:.10g}",
        "exclusiveMinimum": "above {:.10g}",
        "maximum": "to {:.10g}",
        "exclusiveMaximum": "to below {:.10g}",
    }
    return " ".join(word.format(part[key]) for key, word in words.items() if key in part)


def _beside(line: str, text: str) -> list[str]:
    """The line with the comment beside it; what does not fit stands below."""
    column = max(COLUMN, len(line) + 2)
    first, *others = textwrap.wrap(text, WIDTH - column - 2)
    return [f"{line:<{column}}# {first}", *(f"{'':<{column}}# {other}" for other in others)]


def _above(found: re.Match, model: type[BaseModel], inside: Sequence[str]) -> Iterator[str]:
    for key in yaml.safe_load(found["item"]):
        text = f"{key}: {meaning(model, [*inside, key])}"
        head = f"{found['indent']}# "
        yield from textwrap.wrap(text, WIDTH, initial_indent=head, subsequent_indent=head + "  ")
