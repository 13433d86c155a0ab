"""A study: the loop closed over several experiments, as ``workflow_configs/studies/*.yaml``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from pipeline.config.effects import unknown_effect
from pipeline.config.experiment import DataLabel, Parameter
from pipeline.config.fields import FileStem, FromFile, MassDrawn, Strict, Text
from pipeline.config.messages import Found, did_you_mean, quantity, whole

Scope = Literal["study", "material", "experiment", "load_cell"]


class HeldOutLoadCells(Strict):
    """Load cells that the study never calibrates on."""

    load_cells: Annotated[tuple[Text, ...], Field(min_length=1)]
    """Names of the load cells."""


class HeldOutTail(Strict):
    """The end of each draw, an extrapolation in mass drawn."""

    mass_drawn_above: MassDrawn
    """Mass drawn beyond which readings are held out, kg."""


def _kind_of_hold_out(value: Any) -> str:
    if isinstance(value, dict):
        return "load_cells" if "load_cells" in value else "mass_drawn_above"
    if isinstance(value, HeldOutLoadCells):
        return "load_cells"
    if isinstance(value, HeldOutTail):
        return "mass_drawn_above"
    return "experiments" if isinstance(value, list | tuple) else "leave_one_out"


HoldOut = Annotated[
    Annotated[Literal["leave_one_out"], Tag("leave_one_out")]
    | Annotated[tuple[FileStem, ...], Field(min_length=1), Tag("experiments")]
    | Annotated[HeldOutLoadCells, Tag("load_cells")]
    | Annotated[HeldOutTail, Tag("mass_drawn_above")],
    Discriminator(_kind_of_hold_out),
]

Candidates = Annotated[
    Annotated[Literal["all"], Tag("all")] | Annotated[tuple[Text, ...], Tag("names")],
    Discriminator(lambda value: "names" if isinstance(value, list | tuple) else "all"),
]


class Shared(Strict):
    """A parameter that the baseline calibrates."""

    name: Parameter
    """Which parameter."""
    shared_by: Literal["material", "study", "experiment"]
    """What shares one value of it."""


class Data(Strict):
    """Measured rows in place of the experiments' own."""

    file: Annotated[str, Field(pattern=r"\.(csv|nc)$")]
    """Table of values (.csv or .nc), relative to this file."""
    label: DataLabel
    """What the values are; shown wherever they are."""


def _experiments_differ(experiments) -> Iterator[Found]:
    for place, name in enumerate(experiments):
        if name in experiments[:place]:
            yield ("experiments", place), "named twice"


def _something_is_left(experiments, hold_out) -> Iterator[Found]:
    if hold_out == "leave_one_out" and len(experiments) < 2:
        yield ("hold_out",), "needs at least two experiments"
    if isinstance(hold_out, tuple):
        for place, name in enumerate(hold_out):
            if name not in experiments:
                hint = did_you_mean(name, experiments, "they are")
                yield ("hold_out", place), f"not one of the study's experiments{hint}"
        if set(experiments) <= set(hold_out):
            yield ("hold_out",), "holds out every experiment; leave at least one to calibrate on"


def _parameters_differ(parameters) -> Iterator[Found]:
    names = [parameter.name for parameter in parameters]
    for place, name in enumerate(names):
        if name in names[:place]:
            yield ("parameters", place, "name"), "named twice"
        if name == "s" and {"s.mean", "s.std"} & set(names):
            text = "s is s.mean and s.std; name either s or its parts"
            yield ("parameters", place, "name"), text


def _effects_exist(candidates, scopes) -> Iterator[Found]:
    for place, name in enumerate(() if candidates == "all" else candidates):
        if text := unknown_effect(name):
            yield ("candidates", place), text
    for name in scopes:
        if text := unknown_effect(name):
            yield ("scopes", name), text


class Study(FromFile):
    """One study; its name is the stem of its file."""

    title: str = ""
    """What the study is, in a line."""
    source: str = ""
    """Where its data come from."""
    experiments: Annotated[tuple[FileStem, ...], Field(min_length=1)]
    """Names of the experiments."""
    hold_out: HoldOut = "leave_one_out"
    """What is kept from the fit: leave_one_out, experiments, {load_cells} or {mass_drawn_above}."""
    parameters: tuple[Shared, ...] = ()
    """What the baseline calibrates; empty: everything stays as declared."""
    candidates: Candidates = "all"
    """The effects to try: all, or a list of names."""
    scopes: dict[str, Scope] = Field(default_factory=dict)
    """What shares one value of an effect, where it differs from the effect's default."""
    data: Data | None = None
    """Measured rows in place of the experiments' own."""
    alpha: quantity("a fraction in (0, 1)", slips=(0.01,), gt=0, lt=1) = 0.05
    """False-alarm rate of the lack-of-fit decision, in (0, 1)."""
    max_effects: whole("a whole number from 0 to 100", ge=0, le=100) = 3
    """Most effects that may be added."""

    checks = (_experiments_differ, _something_is_left, _parameters_differ, _effects_exist)

    @property
    def data_path(self) -> Path | None:
        """The study's own table of values, found from its file; None without one."""
        return None if self.data is None else self._path.parent / self.data.file
