"""A comparison of two draw experiments, as ``workflow_configs/comparisons/*.yaml``."""

from collections.abc import Iterator, Mapping

from pipeline.config.experiment import BaseArea, Experiment
from pipeline.config.fields import FileStem, FromFile
from pipeline.config.measured import reading_masses
from pipeline.config.messages import Found, did_you_mean, quantity

NEAR = 1e-9  # relative difference up to which two lengths or masses are one


def _two_that_differ(experiments) -> Iterator[Found]:
    if len(experiments) != 2:
        yield ("experiments",), f"expected two experiments, these are {len(experiments)}"
    elif experiments[0] == experiments[1]:
        yield ("experiments", 1), "named twice; name the other one to compare with"


class Comparison(FromFile):
    """Two draw experiments with the same load cells and readings; its name is its file's stem."""

    title: str = ""
    """What is compared, in a line."""
    experiments: tuple[FileStem, ...]
    """Names of the two experiments; differences are the second less the first."""
    threshold_mpa: quantity(
        "a stress in MPa, above 0 and at most 100", slips=(1e-3, 1e-6), gt=0, le=100
    )
    """Stress of which the share of time above it is given, MPa."""

    checks = (_two_that_differ,)


def comparison_problems(
    comparison: Comparison,
    experiments: Mapping[str, Experiment],
    rows_of: Mapping[str, tuple],
) -> Iterator[str]:
    """Why two experiments cannot be compared; nothing where they can.

    `rows_of` are the measured rows of the experiments by name, which add readings.
    """
    known = []
    for place, name in enumerate(comparison.experiments):
        where = f"experiments[{place}] = {name}: "
        if name not in experiments:
            hint = did_you_mean(name, experiments, "known experiments:")
            yield f"{where}no such experiment{hint}"
        elif not experiments[name].is_draw:
            yield f"{where}a static experiment; expected one with draw"
        else:
            known.append(experiments[name])
            if len(reading_masses(known[-1], rows_of.get(name, ()))) < 2:
                yield f"{where}read only before draw; expected readings during draw too"
    if len(known) < 2:
        return
    first, second = known
    if text := _difference_of_load_cells(first, second):
        yield f"experiments[1] = {second.name}: {text}; expected the load cells of {first.name}"
    masses = [reading_masses(one, rows_of.get(one.name, ())) for one in known]
    if text := _difference_of_readings(*masses):
        yield (
            f"experiments[1] = {second.name}: {text} in {first.name}; expected the same masses "
            "drawn at the readings"
        )


def _difference_of_load_cells(first: Experiment, second: Experiment) -> str | None:
    names = [[cell.name for cell in one.load_cells] for one in (first, second)]
    if not all(names) and any(names):
        return f"it has {len(names[1])} load cells, {first.name} has {len(names[0])}"
    for name in names[0]:
        if name not in names[1]:
            return f"it lacks load cell {name}"
    for name in names[1]:
        if name not in names[0]:
            return f"its load cell {name} is not in {first.name}"
    if names[0] != names[1]:
        return "its load cells stand in another order"
    for a, b in zip(first.load_cells, second.load_cells, strict=True):
        if text := _difference_of_areas(a, b):
            return text
    return None


def _difference_of_areas(first: BaseArea, second: BaseArea) -> str | None:
    for key in ("x", "y", "width", "length"):
        here, there = getattr(second, key), getattr(first, key)
        if not _near(here, there):
            return f"load cell {second.name} has {key} = {here:g} m, not {there:g} m"
    return None


def _difference_of_readings(first: tuple[float, ...], second: tuple[float, ...]) -> str | None:
    for place, (there, here) in enumerate(zip(first, second, strict=False)):
        if not _near(here, there):
            return f"reading {place} is at {here:.6g} kg, {there:.6g} kg"
    if len(first) != len(second):
        return f"it has {len(second)} readings with the one before draw, {len(first)}"
    return None


def _near(a: float, b: float) -> bool:
    return abs(a - b) <= NEAR * max(abs(a), abs(b))
