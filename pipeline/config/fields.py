"""What every file's model is made of: frozen models without unknown keys, and its quantities."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from pipeline.config.messages import NAME_PATTERN, Found, InconsistentError, quantity, run_checks

_MM, _PERCENT, _G_CM3 = (0.001,), (0.01,), (1000.0, 0.001)

Length = quantity("a length in m, from 1e-6 to 10000", slips=_MM, ge=1e-6, le=1e4)
Height = quantity("a height in m, from 0 to 10000", slips=_MM, ge=0, le=1e4)
Position = quantity("a position in m, from 0 to 10000", slips=_MM, ge=0, le=1e4)
MineCoordinate = quantity("a mine coordinate in m, from -1e8 to 1e8", ge=-1e8, le=1e8)
Mass = quantity("a mass in kg, above 0", gt=0)
MassDrawn = quantity("a mass in kg, 0 or more", ge=0)
Density = quantity("a density in kg m-3, from 100 to 10000", slips=_G_CM3, ge=100, le=1e4)
FrictionAngle = quantity("an angle in degrees, from 0 to below 90", ge=0, lt=90)
Transmission = quantity("a fraction in (0, 1]", slips=_PERCENT, gt=0, le=1)
Fraction = quantity("a fraction in [0, 1]", slips=_PERCENT, ge=0, le=1)
Stress_kPa = quantity("a stress in kPa, 0 or more", ge=0)
Number = quantity("a number")
Text = Annotated[str, Field(min_length=1)]
FileStem = Annotated[str, Field(pattern=NAME_PATTERN)]


def _two_sizes(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("expected two lengths in m, smallest and largest: [2.36e-3, 4.7e-3]")
    return value


ParticleSize = Annotated[tuple[Length, Length], BeforeValidator(_two_sizes)]


def size_order(particle_size) -> Iterator[Found]:
    """The check of a model with the key ``particle_size``."""
    if particle_size and particle_size[0] > particle_size[1]:
        yield ("particle_size",), "expected the smallest size first, then the largest"


def increasing(key: str, values) -> Iterator[Found]:
    """The check of a model with such a list under ``key``."""
    for place in range(1, len(values)):
        if values[place] <= values[place - 1]:
            yield (key, place), f"expected more than the one before it ({values[place - 1]:g})"


class Strict(BaseModel):
    """A frozen model without unknown keys; ``checks`` are its conditions across keys."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        defer_build=True,
    )
    checks: ClassVar[tuple[Callable[..., Iterator[Found]], ...]] = ()

    @model_validator(mode="after")
    def _is_consistent(self):
        values = {name: getattr(self, name) for name in type(self).model_fields}
        if found := tuple(run_checks(self.checks, values)):
            raise InconsistentError(found)
        return self


class FromFile(Strict):
    """What a YAML file of its own holds; its name is the file's stem."""

    _path: Path = PrivateAttr(Path("unnamed.yaml"))

    def at(self, path: Path) -> Self:
        """The same as what the file ``path`` holds."""
        placed = self.model_copy()
        placed._path = Path(path)
        return placed

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    @property
    def name(self) -> str:
        """Stem of the file."""
        return self._path.stem
