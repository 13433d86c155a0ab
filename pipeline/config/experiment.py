"""An experiment: a granular model in a box, at rest or drawn, and what was measured in it.

The models are the contract of ``workflow_configs/experiments/*.yaml``. Lengths m, densities
kg m-3, angles degrees, masses kg, stresses kPa; x and y run from a corner of the base, z is height
above it.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from pipeline.config.effects import EffectBlock, effects_fit
from pipeline.config.fields import (
    Density,
    FileStem,
    FrictionAngle,
    FromFile,
    Length,
    Mass,
    MassDrawn,
    Number,
    ParticleSize,
    Position,
    Stress_kPa,
    Strict,
    Text,
    increasing,
    size_order,
)
from pipeline.config.geometry import DrawbellMask, FileMask, Geometry
from pipeline.config.messages import (
    NAME_PATTERN,
    Found,
    Location,
    did_you_mean,
    quantity,
    whole,
)
from pipeline.config.regions import Region, grades_fit, regions_fit, units_of
from pipeline.config.stress import Flow, Stress

MAX_STEPS = 1e5
"""More readings, or more increments of one draw line, are taken for a mistake of unit."""

DataLabel = Literal["measured", "simulated (DEM)", "published simulation", "synthetic"]
Parameter = Literal["E", "s", "s.mean", "s.std", "E_min", "R", "exponent", "bulking"]

DRAW_PARAMETERS = ("E_min", "R", "exponent", "bulking")
"""Parameters that act only while material is drawn."""


# ---------------------------------------------------------------------------------------------
# material, walls, filling


def _density_order(bulk_density, particle_density) -> Iterator[Found]:
    if bulk_density > particle_density:
        text = (
            f"expected at most particle_density ({particle_density:g} kg m-3); are they exchanged?"
        )
        yield ("bulk_density",), text


class Material(Strict):
    """The granular material."""

    name: Text
    """Name; experiments with the same one share its parameters in a study."""
    bulk_density: Density
    """Bulk density of the bed, kg m-3."""
    particle_density: Density
    """Density of the particles, kg m-3."""
    particle_size: ParticleSize | None = None
    """Smallest and largest particle size, m."""
    internal_friction_angle: FrictionAngle | None = None
    """Internal friction angle, degrees."""

    checks = (_density_order, size_order)


class Walls(Strict):
    """The walls of the box."""

    friction_angle: FrictionAngle
    """Friction angle between material and walls, degrees."""


class Filling(Strict):
    """The filling of a static experiment."""

    levels: Annotated[tuple[Length, ...], Field(min_length=1)]
    """Fill heights at which the load cells are read too, increasing, m."""

    checks = (lambda levels: increasing("levels", levels),)


# ---------------------------------------------------------------------------------------------
# the base and the draw


class BaseArea(Strict):
    """A rectangle of the base."""

    name: Annotated[str, Field(pattern=NAME_PATTERN)]
    """Name, unique among its kind."""
    x: Position
    """Center along x, m."""
    y: Position
    """Center along y, m."""
    width: Length
    """Extent along x, m."""
    length: Length
    """Extent along y, m."""


class Drawpoint(BaseArea):
    """An opening in the base."""


class LoadCell(BaseArea):
    """An area of the base over which vertical stress is averaged."""


def _increment_fits(mass, increment) -> Iterator[Found]:
    if increment > mass:
        yield ("increment",), f"expected at most the line's mass ({mass:g} kg)"
    elif mass / MAX_STEPS > increment:
        text = f"expected at least {mass / MAX_STEPS:g} kg, for at most {MAX_STEPS:g} increments"
        yield ("increment",), text


def _no_repeats(drawpoints) -> Iterator[Found]:
    for place, name in enumerate(drawpoints):
        if name in drawpoints[:place]:
            yield ("drawpoints", place), "named twice in this line"


class DrawLine(Strict):
    """Drawpoints drawn in turn, one increment at a time, up to the line's mass."""

    drawpoints: Annotated[tuple[Text, ...], Field(min_length=1)]
    """Names of the drawpoints."""
    mass: Mass
    """Mass drawn from them together, kg."""
    increment: Mass
    """Mass drawn at a time, kg."""

    checks = (_increment_fits, _no_repeats)


def _one_way_of_reading(every, at_mass_drawn) -> Iterator[Found]:
    if (every is None) == (at_mass_drawn is None):
        yield (), "expected exactly one of every, at_mass_drawn"


class Readings(Strict):
    """When the load cells are read during draw; one reading before draw is always taken."""

    every: Mass | None = None
    """Mass drawn between two readings, kg."""
    at_mass_drawn: Annotated[tuple[MassDrawn, ...], Field(min_length=1)] | None = None
    """In place of ``every``: masses drawn at which to read, increasing, kg."""

    checks = (
        _one_way_of_reading,
        lambda at_mass_drawn: increasing("at_mass_drawn", at_mass_drawn or ()),
    )


class StopAt(Strict):
    """When to stop before all replicates have run.

    It is looked at after ``at_least`` replicates, and each time that their number has doubled.
    """

    standard_error: quantity("a stress in kPa, above 0", gt=0)
    """Largest standard error of a load cell's mean vertical stress, at any reading, kPa."""
    at_least: whole("a whole number from 2 to 1000000", ge=2, le=10**6) = 20
    """Number of replicates to run in any case."""


def _samples_are_pairs(samples) -> Iterator[Found]:
    if samples % 2:
        yield ("samples",), "expected an even number: what is drawn is simulated on two packings"


class Prediction(Strict):
    """A prediction whose bands hold what is not known of the parameters and effects.

    It takes the experiment's own calibration and that of ``stress.from``, or a study.
    """

    samples: whole("a whole number from 20 to 100000", ge=20, le=10**5) = 200
    """Number of samples, even: two packings for each draw of the parameters and effects."""
    study: FileStem | None = None
    """In place of the calibration: the study whose parameters and added effects are taken."""

    checks = (_samples_are_pairs,)


class PublishedFact(Strict):
    """What was published of σ_v/σ_v0 in some load cells during draw, to be checked by sign."""

    change: Literal["rises", "falls", "rises_then_falls", "falls_in_order"]
    """rises: above 1 at its highest; falls: below 1 at its end; falls_in_order: below 0.8 first in
    the first cell, then in the next."""
    load_cells: Annotated[tuple[Text, ...], Field(min_length=1)]
    """Load cells of which it was published."""
    source: str = ""
    """Where it was published."""


class Published(Strict):
    """Numbers published beside this experiment, shown next to ours and used for nothing."""

    vertical_stress_mean: Stress_kPa | None = None
    """Simulated mean vertical stress on the base, kPa."""
    vertical_stress_std: Stress_kPa | None = None
    """Simulated standard deviation of the vertical stress, kPa."""
    measured_mean: Stress_kPa | None = None
    """Measured mean vertical stress as published, kPa."""
    measured_std: Stress_kPa | None = None
    """Measured standard deviation as published, kPa."""
    measured_std_between: Literal["places", "repeats"] | None = None
    """What that scatter is between: places on one base, or repeats of the test."""
    mean_absolute_error: Stress_kPa | None = None
    """Published mean of |experiment - simulation|, kPa."""
    test: whole("a whole number, 1 or more", ge=1, le=10**6) | None = None
    """Number of the test in the source."""
    ratio_range: tuple[Number, Number] | None = None
    """Smallest and largest published σ_v/σ_v0."""
    facts: tuple[PublishedFact, ...] = ()
    """What is known of load cells whose curves were published as pictures only."""
    note: str = ""
    """What a reader should know of these numbers."""
    source: str = ""
    """Where they were published."""


# ---------------------------------------------------------------------------------------------
# checks across the experiment


def _particles_fit(geometry, material) -> Iterator[Found]:
    least = min(geometry.width, geometry.length, geometry.height)
    for place, size in enumerate(material.particle_size or ()):
        if size > least / 2:
            hint = f"; did you mean {size / 1000:.6g}?" if size / 1000 <= least / 2 else ""
            text = f"expected a length in m, at most half the smallest side ({least / 2:g} m){hint}"
            yield ("material", "particle_size", place), text


def _levels_fit(geometry, filling) -> Iterator[Found]:
    for place, level in enumerate(filling.levels if filling else ()):
        if level > geometry.height * (1 + 1e-9):
            text = f"expected at most geometry.height ({geometry.height:g} m)"
            yield ("filling", "levels", place), text


def _attenuation_fits(geometry, stress) -> Iterator[Found]:
    length = stress.attenuation_length
    if length is not None and length <= geometry.cell_size:
        text = (
            f"expected more than geometry.cell_size ({geometry.cell_size:g} m), as E = 1 - "
            "cell_size / attenuation_length is above 0"
        )
        yield ("stress", "attenuation_length"), text


def _areas_fit(key: str, areas, geometry) -> Iterator[Found]:
    names = [area.name for area in areas]
    for place, area in enumerate(areas):
        if (first := names.index(area.name)) < place:
            yield (key, place, "name"), f"{key}[{first}] has this name; give each its own"
        for center, side in (("x", "width"), ("y", "length")):
            middle, extent = getattr(area, center), getattr(area, side)
            limit = getattr(geometry, side)
            low, high = middle - extent / 2, middle + extent / 2
            if low < -1e-9 * limit or high > limit * (1 + 1e-9):
                text = (
                    f"{area.name} covers {low:g} to {high:g} m, "
                    f"outside the base (0 to {limit:g} m along {center})"
                )
                yield (key, place, center), text


def _drawpoints_fit(geometry, drawpoints) -> Iterator[Found]:
    yield from _areas_fit("drawpoints", drawpoints, geometry)


def _load_cells_fit(geometry, load_cells) -> Iterator[Found]:
    yield from _areas_fit("load_cells", load_cells, geometry)


def _facts_name_load_cells(published, load_cells) -> Iterator[Found]:
    names = [cell.name for cell in load_cells]
    for place, fact in enumerate(published.facts if published else ()):
        for rank, name in enumerate(fact.load_cells):
            if name not in names:
                text = "no such load cell" + did_you_mean(name, names, "declared load cells:")
                yield ("published", "facts", place, "load_cells", rank), text


def _lines_name_drawpoints(draw, drawpoints) -> Iterator[Found]:
    known = [drawpoint.name for drawpoint in drawpoints]
    for line, place, name in (
        (line, place, name)
        for line, entry in enumerate(draw)
        for place, name in enumerate(entry.drawpoints)
    ):
        if name not in known:
            hint = did_you_mean(name, known, "known drawpoints:") or "; drawpoints is empty"
            yield ("draw", line, "drawpoints", place), f"unknown drawpoint{hint}"


def _bed_holds_the_draw(geometry, material, regions, draw) -> Iterator[Found]:
    densest = max([material.bulk_density, *(one.bulk_density or 0.0 for one in regions)])
    bed = densest * geometry.width * geometry.length * geometry.height
    drawn = math.fsum(line.mass for line in draw)
    if drawn > bed:
        yield ("draw",), f"the lines draw {drawn:g} kg together, the model holds {bed:.6g} kg"


def _draw_is_complete(draw, stress, flow, readings) -> Iterator[Found]:
    if not draw:
        if readings is not None:
            yield ("readings",), "needs draw lines; leave it out of a static experiment"
        return
    if readings is None:
        yield ("readings",), "missing; a draw experiment needs every or at_mass_drawn"
    if stress.from_ is None:
        if flow is None:
            yield ("flow",), "missing; a draw experiment needs exponent and bulking"
        if stress.R is None:
            yield ("stress", "R"), "missing; a draw experiment needs a fraction in [0, 1]"
        if stress.E_min is None:
            yield ("stress", "E_min"), "missing; a draw experiment needs a table or power form"


def _drawbells_have_drawpoints(geometry, drawpoints) -> Iterator[Found]:
    if isinstance(geometry.mask, DrawbellMask) and not drawpoints:
        yield ("geometry", "mask"), "drawbells need drawpoints; none is given"


def _draw_starts_full(draw, filling) -> Iterator[Found]:
    if draw and filling:
        text = (
            "a draw experiment is read with the model full; "
            "put fill levels into a static experiment of their own"
        )
        yield ("filling",), text


def _readings_end_with_the_draw(draw, readings) -> Iterator[Found]:
    total = math.fsum(line.mass for line in draw)
    if not draw or readings is None:
        return
    limit = total * (1 + 1e-9)
    if readings.every is not None and readings.every > limit:
        yield ("readings", "every"), f"expected at most the mass of all draw lines ({total:g} kg)"
    if readings.every is not None and readings.every < total / MAX_STEPS:
        text = f"expected at least {total / MAX_STEPS:g} kg, for at most {MAX_STEPS:g} readings"
        yield ("readings", "every"), text
    for place, mass in enumerate(readings.at_mass_drawn or ()):
        if mass > limit:
            text = f"expected at most the mass of all draw lines ({total:g} kg)"
            yield ("readings", "at_mass_drawn", place), text


def _calibrate_is_possible(calibrate, draw) -> Iterator[Found]:
    for place, name in enumerate(calibrate):
        if name in calibrate[:place]:
            yield ("calibrate", place), "named twice"
        if name == "s" and {"s.mean", "s.std"} & set(calibrate):
            yield ("calibrate", place), "s is s.mean and s.std; name either s or its parts"
        if name in DRAW_PARAMETERS and not draw:
            yield ("calibrate", place), "acts only during draw, and this experiment has no draw"


def _stop_comes_before_the_end(replicates, stop_at) -> Iterator[Found]:
    if stop_at is not None and stop_at.at_least > replicates:
        text = f"expected at most the number of replicates ({replicates})"
        yield ("stop_at", "at_least"), text


def _assumed_keys_exist(assumed) -> Iterator[Found]:
    keys = [field.alias or name for name, field in Experiment.model_fields.items()]
    for place, entry in enumerate(assumed):
        first, *rest = entry.split(".")
        if first not in keys:
            yield ("assumed", place), "no such key" + did_you_mean(first, keys, "known keys:")
        elif not all(rest):
            yield ("assumed", place), "expected keys joined by single dots, such as stress.E"


class Experiment(FromFile):
    """One experiment; its name is the stem of its file."""

    title: str = ""
    """What the experiment is, in a line."""
    source: str = ""
    """Where its values come from."""
    geometry: Geometry
    """Box and lattice: width, length, height, cell_size in m."""
    material: Material
    """The granular material."""
    regions: tuple[Region, ...] = Field((), exclude_if=lambda regions: not regions)
    """Parts of the ground with materials and grades of their own; later ones override."""
    walls: Walls | None = None
    """The walls of the box."""
    filling: Filling | None = None
    """Fill heights of a static experiment."""
    stress: Stress
    """How cells hand their load down."""
    flow: Flow | None = None
    """How voids climb; needed for draw."""
    drawpoints: tuple[Drawpoint, ...] = ()
    """Openings in the base."""
    draw: tuple[DrawLine, ...] = ()
    """What is drawn, in order; empty: a static experiment."""
    readings: Readings | None = None
    """When to read during draw."""
    load_cells: tuple[LoadCell, ...] = ()
    """Base areas over which vertical stress is averaged."""
    calibrate: tuple[Parameter, ...] = ()
    """Parameters that the experiment's own calibration fits to its measured rows."""
    effects: EffectBlock = Field(default_factory=dict)
    """Declared effects: name to parameters; those of a load cell: name to load cell to them."""
    replicates: whole("a whole number from 1 to 1000000", ge=1, le=10**6) = 10
    """Number of replicates; with ``stop_at``, at most so many."""
    stop_at: StopAt | None = None
    """Precision at which fewer replicates are enough."""
    prediction: Prediction | None = Field(None, exclude=True)
    """Prediction with its uncertainty, on a page of its own; without it none is made."""
    seed: whole("a whole number from 0 to 2^63 - 1", ge=0, le=2**63 - 1) = 0
    """Root of all random numbers of this experiment."""
    measured: Annotated[str, Field(pattern=r"\.(csv|nc)$")] | None = None
    """Table of measured values (.csv or .nc), relative to this file."""
    data_label: DataLabel = "measured"
    """What the values in ``measured`` are; shown wherever they are."""
    assumed: tuple[Text, ...] = ()
    """Dotted keys whose values are our assumption, not the source's."""
    published: Published | None = None
    """Numbers published beside this experiment."""
    keep_fields: bool = Field(False, strict=True)
    """Whether to write the fields of every replicate (true or false)."""

    checks = (
        _particles_fit,
        regions_fit,
        grades_fit,
        _levels_fit,
        _attenuation_fits,
        _drawpoints_fit,
        _load_cells_fit,
        _facts_name_load_cells,
        _lines_name_drawpoints,
        _bed_holds_the_draw,
        _draw_is_complete,
        _drawbells_have_drawpoints,
        _draw_starts_full,
        _readings_end_with_the_draw,
        _calibrate_is_possible,
        effects_fit,
        _stop_comes_before_the_end,
        _assumed_keys_exist,
    )

    @property
    def is_draw(self) -> bool:
        """Whether material is drawn."""
        return bool(self.draw)

    @property
    def mass_scheduled(self) -> float:
        """Mass that all draw lines draw together, kg; 0 in a static experiment."""
        return math.fsum(line.mass for line in self.draw)

    @property
    def E(self) -> float | None:
        """E as given or as 1 - cell_size / attenuation_length; None when taken ``from`` another."""
        if self.stress.attenuation_length is not None:
            return 1 - self.geometry.cell_size / self.stress.attenuation_length
        return self.stress.E

    @property
    def grade_units(self) -> dict[str, str]:
        """Unit of each grade that the regions have, by the name of the mineral or metal."""
        return units_of(self.regions)

    @property
    def has_grade_curves(self) -> bool:
        """Whether what is drawn has a grade or a dilution."""
        return self.is_draw and any(one.grade or one.waste for one in self.regions)

    @property
    def measured_path(self) -> Path | None:
        """The measured table, found from the experiment's file; None without one."""
        return None if self.measured is None else self._path.parent / self.measured

    @property
    def files(self) -> dict[Location, Path]:
        """Files of the mask and of the regions, found from the experiment's, by their keys."""
        mask = self.geometry.mask
        named = {("geometry", "mask"): mask if isinstance(mask, FileMask) else None}
        for place, region in enumerate(self.regions):
            named |= {("regions", place, key): getattr(region, key) for key in ("mask", "column")}
        return {
            (*location, "path"): self._path.parent / one.path
            for location, one in named.items()
            if one is not None
        }
