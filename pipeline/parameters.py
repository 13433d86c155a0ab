"""The parameters of the stress and flow model, with declared and calibrated values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.config.stress import EMinPower, EMinTable


@dataclass(frozen=True)
class Parameters:
    """One value for each parameter of a run.

    Attributes
    ----------
    E : transmission fraction of stagnant ground, in (0, 1]; belongs to `cell_size` (m)
    s_mean, s_std : spreading exponent s ~ N(s_mean, s_std²), for each cell
    R : relaxation, in [0, 1]
    E_min : law of the transmission fraction in the movement zone against zone height, or None
    E_min_shift : shift of log(1 − E_min), 0 as declared
    exponent, bulking : flow exponent n and bulking q, or None in a static experiment
    """

    cell_size: float
    E: float
    s_mean: float
    s_std: float
    R: float = 1.0
    E_min: EMinTable | EMinPower | None = None
    E_min_shift: float = 0.0
    exponent: float | None = None
    bulking: float | None = None

    @property
    def attenuation_length(self) -> float:
        """ℓ = c / (1 − E), m; infinite for E = 1."""
        return math.inf if self.E == 1.0 else self.cell_size / (1.0 - self.E)

    def shed_in_zone(self, height: np.ndarray) -> np.ndarray:
        """1 − E_min for movement zones of the given heights (m), never above 1.

        Without a law the movement zone transmits like stagnant ground. The table is linear
        between its heights and constant beyond them; shifted, it never sheds less than 1 − E. The
        power law is Janssen's length of a zone whose hydraulic radius grows as height^exponent:
        1 − E_min(h) =
        (1 − E_min(h0)) (h / h0)^(−exponent), but never less than 1 − E.
        """
        height = np.asarray(height, dtype=np.float64)
        if self.E_min is None:
            return np.full(height.shape, 1.0 - self.E)
        factor = math.exp(self.E_min_shift)
        if isinstance(self.E_min, EMinTable):
            shed = factor * (1.0 - np.interp(height, self.E_min.height, self.E_min.value))
            least = (
                1.0 - self.E if self.E_min_shift else 0.0
            )  # a table as declared is taken as it is
            return np.clip(shed, least, 1.0)
        law = self.E_min
        relative = np.maximum(height, self.cell_size) / law.at_height
        shed = factor * (1.0 - law.value) * relative**-law.exponent
        return np.clip(shed, 1.0 - self.E, 1.0)

    def with_values(self, values: Mapping[str, float]) -> Parameters:
        """The same with calibrated values by their names in `FIELDS`."""
        return replace(self, **{FIELDS[name]: float(value) for name, value in values.items()})

    def value(self, name: str) -> float:
        """Value of the parameter with this name in `FIELDS`."""
        return getattr(self, FIELDS[name])

    def to_document(self) -> dict[str, Any]:
        """As JSON-able data."""
        law = self.E_min.model_dump(mode="json") if self.E_min else None
        return asdict(replace(self, E_min=None)) | {"E_min": law}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Parameters:
        """Back from `to_document`."""
        law = document["E_min"]
        if law is not None:
            law = (EMinTable if law["type"] == "table" else EMinPower).model_validate(law)
        return cls(**{**document, "E_min": law})


# name in an experiment's `calibrate` → attribute; `s` is the spread of s, its mean stays
FIELDS = {
    "E": "E",
    "s": "s_std",
    "s.std": "s_std",
    "s.mean": "s_mean",
    "E_min": "E_min_shift",
    "R": "R",
    "exponent": "exponent",
    "bulking": "bulking",
}


def declared_parameters(
    experiment: Experiment, sources: Mapping[str, Parameters] | None = None
) -> Parameters:
    """Parameters as the experiment's file gives them.

    `sources` holds the calibrated parameters of the experiment that `stress: {from: NAME}`
    refers to; its E is carried to this lattice at equal base stress of this column.

    Raises
    ------
    KeyError
        If `from` names an experiment that `sources` lacks.
    """
    stress, geometry, flow = experiment.stress, experiment.geometry, experiment.flow
    own = {
        "R": stress.R,
        "E_min": stress.E_min,
        "s_mean": stress.s.mean if stress.s else None,
        "s_std": stress.s.std if stress.s else None,
        "exponent": flow.exponent if flow else None,
        "bulking": flow.bulking if flow else None,
    }
    given = {name: value for name, value in own.items() if value is not None}
    if stress.from_ is None:
        return Parameters(cell_size=geometry.cell_size, E=experiment.E, **given)
    source = (sources or {})[stress.from_]
    E = carry_transmission(source.E, source.cell_size, geometry.cell_size, geometry.height)
    if stress.E_min is not None:
        given["E_min_shift"] = 0.0
    return replace(source, cell_size=geometry.cell_size, E=E, **given)


def carry_transmission(E: float, from_cell: float, to_cell: float, height: float) -> float:
    """E for cells of `to_cell` that gives the base stress of E on cells of `from_cell`, m.

    Solves c' (1 − E'ⁿ')/(1 − E') = c (1 − Eⁿ)/(1 − E) for a column of `height` m.
    """
    from scipy.optimize import brentq

    if from_cell == to_cell or E == 1.0:
        return E

    def column(cell: float, transmission: float) -> float:
        if transmission == 1.0:
            return height
        levels = height / cell
        return cell * -math.expm1(levels * math.log(transmission)) / (1.0 - transmission)

    wanted = column(from_cell, E)
    if wanted <= to_cell:
        raise ValueError(
            f"E = {E:g} on {from_cell:g} m cells carries {wanted:g} m of column: "
            f"less than one cell of {to_cell:g} m"
        )
    return float(brentq(lambda e: column(to_cell, e) - wanted, 1e-12, 1.0, xtol=1e-15))
