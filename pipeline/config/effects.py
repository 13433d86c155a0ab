"""The `effects:` block of an experiment, checked against the catalogue.

The catalogue is imported only where a block names an effect.
"""

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pkgutil import iter_modules
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from pipeline.config.messages import Found, InconsistentError, did_you_mean, one_of, read_number

if TYPE_CHECKING:
    from pipeline.effects import Effect, Parameter

NOT_MEASURED = ("simulated (DEM)", "published simulation")
"""Labels of values that no load cell has read."""


def known_effects() -> tuple[str, ...]:
    """Names of the effects that exist: the public modules of the package ``pipeline.effects``."""
    package = find_spec("pipeline.effects")
    if package is None:
        return ()
    modules = iter_modules(package.submodule_search_locations)
    return tuple(sorted(module.name for module in modules if not module.name.startswith("_")))


def unknown_effect(name: str) -> str | None:
    """What to say of an effect's name; None when the effect exists."""
    known = known_effects()
    if name in known:
        return None
    if not known:
        return "unknown effect; no effects exist in this version, leave it out"
    return "unknown effect" + did_you_mean(name, known, "known effects:")


def effects_fit(effects, geometry, material, walls, load_cells, data_label) -> Iterator[Found]:
    """What is wrong with sound effects in this experiment: an input or a load cell it lacks."""
    if not effects:
        return
    from pipeline.effects import effects as catalogue
    from pipeline.effects import lacking

    inputs = SimpleNamespace(geometry=geometry, material=material, walls=walls)
    for name, given in effects.items():
        effect = catalogue()[name]
        if effect.scope != "load_cell":
            for key in lacking(effect, inputs, effect.neutral | given):
                yield ("effects", name), f"needs {key}, which is not given here"
            continue
        if given and data_label in NOT_MEASURED:
            text = f"belongs to a load cell, and these values are {data_label}; leave it out"
            yield ("effects", name), text
        cells = [cell.name for cell in load_cells]
        for cell in given:
            if cell not in cells:
                hint = did_you_mean(cell, cells, "load cells:") or "; load_cells is empty"
                yield ("effects", name, cell), f"no such load cell{hint}"


def _checked(block: Any) -> Any:
    """The block with whole numbers as floats; InconsistentError with all that is wrong in it."""
    if not isinstance(block, Mapping):
        return block  # pydantic says what a mapping is for
    found: list[Found] = []
    checked = {name: _checked_effect(name, given, found) for name, given in block.items()}
    if found:
        raise InconsistentError(found)
    return checked


def _checked_effect(name: Any, given: Any, found: list[Found]) -> Any:
    if text := unknown_effect(name):
        found.append(((name,), text))
        return given
    from pipeline.effects import effects

    effect = effects()[name]
    if not isinstance(given, Mapping):
        keys = "load cells" if effect.scope == "load_cell" else ", ".join(effect.neutral)
        found.append(((name,), f"expected a mapping with keys among {keys}"))
        return given
    if effect.scope != "load_cell":
        return _checked_values(effect, given, (name,), found)
    checked = {}
    for cell, values in given.items():
        if isinstance(values, Mapping):
            checked[cell] = _checked_values(effect, values, (name, cell), found)
        elif cell in effect.neutral:
            text = f"belongs to a load cell; write its name, then {{{cell}: ...}}"
            found.append(((name, cell), text))
        else:
            keys = ", ".join(effect.neutral)
            found.append(((name, cell), f"expected a mapping with keys among {keys}"))
    return checked


def _checked_values(
    effect: "Effect", given: Mapping, where: tuple, found: list[Found]
) -> dict[str, Any]:
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    checked = {}
    for key, value in given.items():
        checked[key] = value
        try:
            if key in parameters:
                checked[key] = _checked_number(parameters[key], value)
            elif key in effect.options:
                _check_option(effect.options[key], value)
            else:
                hint = did_you_mean(key, effect.neutral, "known parameters:")
                raise ValueError(f"unknown parameter{hint}")
        except ValueError as error:
            found.append(((*where, key), str(error)))
    return checked


def _checked_number(parameter: "Parameter", value: Any) -> float:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    expected = f"a number from {parameter.low:g} to {parameter.high:g}{unit} ({parameter.words})"
    number = read_number(value, expected)
    if not parameter.low <= number <= parameter.high:
        raise ValueError(f"expected {expected}")
    return number


def _check_option(choices: tuple, value: Any) -> None:
    if not any(type(value) is type(choice) and value == choice for choice in choices):
        raise ValueError(one_of(value, [str(choice).lower() for choice in choices]))


_VALUE = {"type": ["number", "string", "boolean"]}
_VALUES = {"type": "object", "additionalProperties": _VALUE}
_SCHEMA = {
    "type": "object",
    "additionalProperties": {
        "type": "object",
        "additionalProperties": {"anyOf": [_VALUE, _VALUES]},
    },
}

EffectBlock = Annotated[
    dict[str, dict[str, Any]], BeforeValidator(_checked), WithJsonSchema(_SCHEMA)
]
"""Effect → parameter or option → value; of a load cell's effects: effect → load cell → those."""
