"""Every message about a user's file: where, what, the allowed range, and what to do."""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, create_model

Location = tuple[str | int, ...]
Found = tuple[Location, str]  # where in the file, and what is wrong there

NAME_PATTERN = r"^[A-Za-z0-9_-]+$"


class ConfigError(ValueError):
    """All that is wrong with the user's files; ``problems`` holds (path, text) in reading order.

    The text has one line per file (relative to the working directory when below it), then one
    indented line per problem.
    """

    def __init__(self, problems: Iterable[tuple[Path, str]]):
        self.problems = tuple(dict.fromkeys((Path(path), text) for path, text in problems))
        lines: list[str] = []
        for path in dict.fromkeys(path for path, _ in self.problems):
            lines.append(shown_path(path))
            lines += [f"  {text}" for at, text in self.problems if at == path]
        super().__init__("\n".join(lines))

    def __reduce__(self):
        return type(self), (self.problems,)


class InconsistentError(ValueError):
    """Raised inside a model's validation: several problems, located relative to that model."""

    def __init__(self, found: Iterable[Found]):
        self.found = tuple(found)
        super().__init__("; ".join(text for _, text in self.found))


# ---------------------------------------------------------------------------------------------
# pieces of text


def shown_path(path: Path) -> str:
    """Path as a message shows it: relative to the working directory when it lies below."""
    absolute = Path(path).absolute()
    working = Path.cwd()
    return str(absolute.relative_to(working) if absolute.is_relative_to(working) else path)


def shown(value: Any) -> str:
    """A user's value as a message shows it: YAML spelling, on one line, at most 40 characters."""
    if value is None:
        text = "(empty)"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = " ".join(value.split()) or '""'
    elif isinstance(value, list | tuple):
        text = f"[{', '.join(map(shown, value[:9]))}{', ...' * (len(value) > 9)}]"
    elif isinstance(value, int) and abs(value) >= 10**20:
        text = "a number of more than 20 digits"
    else:
        text = str(value)
    return text if len(text) <= 40 else text[:37] + "..."


def did_you_mean(word: Any, known: Iterable[str], otherwise: str) -> str:
    """'; did you mean NEAREST?', or '; OTHERWISE a, b, c' when nothing known is near."""
    known = list(known)
    folded = {name.lower(): name for name in reversed(known)}
    near = difflib.get_close_matches(str(word).strip().lower(), folded, n=1, cutoff=0.6)
    if near:
        return f"; did you mean {folded[near[0]]}?"
    return f"; {otherwise} {', '.join(known)}" if known else ""


def one_of(word: Any, known: list[str]) -> str:
    """'expected one of a, b, c', with the nearest one when the word is close to it."""
    near = did_you_mean(word, known, "") if isinstance(word, str) else ""
    return f"expected one of {', '.join(known)}" + (near if near.endswith("?") else "")


def dotted(location: Location) -> str:
    """('draw', 0, 'mass') → 'draw[0].mass'."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


# ---------------------------------------------------------------------------------------------
# numbers


def read_number(value: Any, expected: str) -> float:
    """The finite number that a YAML value is; ValueError with the remedy for anything else."""
    if isinstance(value, str):
        found = re.match(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)$", value, re.S)
        if not found:
            raise ValueError(f"expected {expected}")
        number, rest = found.groups()
        if not rest:
            raise ValueError(f"expected {expected}; write {number} without quotes")
        if re.fullmatch(r",\d+", rest):
            raise ValueError(f"expected {expected}; did you mean {number}.{rest[1:]}?")
        raise ValueError(f"expected {expected}; write the bare number {number}, without unit")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"expected {expected}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"expected {expected}; it must be finite")
    return number


_UNIT = re.compile(r"^an? [a-z ]+ in (kg m-3|degrees|[A-Za-z]+)\b")


def _inside(number: float, gt=-math.inf, ge=-math.inf, lt=math.inf, le=math.inf) -> bool:
    return gt < number < lt and ge <= number <= le


def quantity(expected: str, *, slips: tuple[float, ...] = (), **bounds: float) -> Any:
    """A float field with bounds (gt, ge, lt, le) whose message says what is ``expected``.

    A unit that it names ("a length in m, ...") goes into the JSON schema as ``unit``. ``slips`` are
    factors of usual mistakes of unit (0.01 for percent); the first one that brings
    the value inside the bounds is offered.
    """

    def check(value: Any) -> float:
        number = read_number(value, expected)
        if _inside(number, **bounds):
            return number
        meant = [number * factor for factor in slips if _inside(number * factor, **bounds)]
        hint = f"; did you mean {meant[0]:.6g}?" if meant else ""
        raise ValueError(f"expected {expected}{hint}")

    unit = _UNIT.search(expected)
    extra = {"unit": unit[1]} if unit else None
    return Annotated[float, Field(**bounds, json_schema_extra=extra), BeforeValidator(check)]


def whole(expected: str, *, ge: int, le: int) -> Any:
    """An int field with bounds whose message says what is ``expected``."""

    def check(value: Any) -> int:
        number = read_number(value, expected)
        if not number.is_integer() or not ge <= int(value) <= le:
            raise ValueError(f"expected {expected}")
        return int(value)

    return Annotated[int, Field(ge=ge, le=le), BeforeValidator(check)]


# ---------------------------------------------------------------------------------------------
# checks across keys


def run_checks(checks: Iterable[Callable], values: Mapping[str, Any]) -> Iterator[Found]:
    """Run the checks whose keys are all in ``values``; a check's parameters are its keys."""
    for check in checks:
        keys = list(signature(check).parameters)
        if all(key in values for key in keys):
            yield from check(*(values[key] for key in keys))


# ---------------------------------------------------------------------------------------------
# from pydantic's errors to our words


def problems(model: type[BaseModel], error: ValidationError, raw: Mapping) -> list[str]:
    """One text per problem of ``raw``: those of single keys, then those across the sound keys."""
    found = [problem for detail in error.errors() for problem in _translate(model, detail, raw)]
    if not any(
        isinstance(_cause(detail), InconsistentError) and not detail["loc"]
        for detail in error.errors()
    ):
        sound = _sound_values(model, raw, bad={location[0] for location, _ in found if location})
        found += run_checks(getattr(model, "checks", ()), sound)
    return list(dict.fromkeys(_line(location, text, raw) for location, text in found))


def _cause(detail: Mapping) -> Exception | None:
    return detail.get("ctx", {}).get("error")


def _sound_values(model: type[BaseModel], raw: Mapping, bad: set) -> dict[str, Any]:
    values = {}
    for name, field in model.model_fields.items():
        key = field.alias or name
        if key in bad:
            continue
        if key in raw:
            single = create_model(name, **{name: (field.annotation, field)})
            values[name] = getattr(single.model_validate({key: raw[key]}), name)
        elif not field.is_required():
            values[name] = field.get_default(call_default_factory=True)
    return values


def _line(location: Location, text: str, raw: Any) -> str:
    value = raw
    for part in location:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return f"{dotted(location)}: {text}"
    if not location:
        return text
    nested = isinstance(value, list) and any(isinstance(item, list | dict) for item in value)
    if nested or isinstance(value, Mapping) or text.startswith("unknown key"):
        return f"{dotted(location)}: {text}"
    return f"{dotted(location)} = {shown(value)}: {text}"


def _translate(model: type[BaseModel], detail: Mapping, raw: Any) -> Iterator[Found]:
    kind, models = detail["type"], _models_at(model, detail["loc"])
    location = _in_file(detail["loc"], raw, keep_last=kind == "missing")
    keys = list(
        dict.fromkeys(
            field.alias or name for owner in models for name, field in owner.model_fields.items()
        )
    )
    match kind:
        case "value_error" if isinstance(_cause(detail), InconsistentError):
            for inner, text in _cause(detail).found:
                yield location + inner, text
        case "value_error":
            yield location, str(_cause(detail))
        case "missing":
            yield location, f"missing ({_description(model, detail['loc'])})"
        case "extra_forbidden":
            siblings = _models_at(model, detail["loc"][:-1])
            known = [f.alias or n for owner in siblings for n, f in owner.model_fields.items()]
            yield location, "unknown key" + did_you_mean(location[-1], known, "known keys:")
        case "invalid_key":
            yield location, "unknown key; keys are text"
        case "literal_error":
            known = re.findall(r"'([^']*)'", detail["ctx"]["expected"])
            if len(known) == 1:
                yield location, f"expected {_description(model, detail['loc'])}"
            else:
                yield location, one_of(detail["input"], known)
        case "union_tag_invalid":
            known = re.findall(r"'([^']*)'", detail["ctx"]["expected_tags"])
            yield (*location, "type"), one_of(detail["ctx"]["tag"], known)
        case "union_tag_not_found" | "model_type" | "model_attributes_type" | "dict_type":
            if isinstance(detail["input"], Mapping):
                yield (*location, "type"), f"missing; expected one of {', '.join(_tags(models))}"
            elif keys:
                yield location, f"expected a mapping with keys among {', '.join(keys)}"
            else:
                yield location, f"expected a mapping: {_description(model, detail['loc'])}"
        case "string_type" | "string_too_short":
            quotes = "; put it in quotes" if isinstance(detail["input"], int | float) else ""
            yield location, f"expected text{quotes}"
        case "string_pattern_mismatch" if detail["ctx"]["pattern"] == NAME_PATTERN:
            yield location, "expected letters, digits, _ and -"
        case "list_type" | "tuple_type":
            remedy = "write [] when there is none" if detail["input"] is None else "put it in [ ]"
            yield location, f"expected a list; {remedy}"
        case "too_short":
            if not detail["input"]:  # otherwise an entry was bad, and is reported itself
                yield location, "expected a list with at least one entry"
        case "bool_type":
            yield location, "expected true or false"
        case "none_required":
            yield location, "expected nothing here; leave it out"
        case "recursion_loop":
            yield location, "refers to itself; write the value out"
        case _:
            yield location, f"expected {_description(model, detail['loc'])}"


def _in_file(location: Location, raw: Any, keep_last: bool) -> Location:
    """Drop from pydantic's location the tags of unions, which are no keys of the file."""
    kept: list[str | int] = []
    for position, part in enumerate(location):
        last = position == len(location) - 1
        try:
            raw = raw[part]
        except (KeyError, IndexError, TypeError):
            if not (keep_last and last):
                continue
        kept.append(part)
    return tuple(kept)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _tags(models: Iterable[type[BaseModel]]) -> list[str]:
    kinds = (model.model_fields["type"].annotation for model in models)
    return [tag for kind in kinds if get_origin(kind) is Literal for tag in get_args(kind)]


def _models_at(model: type[BaseModel], location: Location) -> list[type[BaseModel]]:
    """The models whose keys may stand at ``location``: one, or those of a union."""
    models = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [
            field
            for owner in models
            for name, field in owner.model_fields.items()
            if part in (name, field.alias)
        ]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        else:
            models = [
                owner for owner in models if "type" in owner.model_fields and part in _tags([owner])
            ] or models
    return models


def _description(model: type[BaseModel], location: Location) -> str:
    for cut in range(len(location), 0, -1):
        key = location[cut - 1]
        for owner in _models_at(model, location[: cut - 1]):
            for name, field in owner.model_fields.items():
                if key in (name, field.alias) and field.description:
                    text = field.description.replace("``", "").rstrip(".")
                    return text[0].lower() + text[1:] if text[1:2].islower() else text
    return "another value"
