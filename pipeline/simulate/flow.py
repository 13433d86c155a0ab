"""The flow of a draw experiment, from reading to reading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pipeline.lattice.flow import (
    DRAWN_CELLS,
    HANG_UPS,
    climb_chances,
    draw_to,
    draw_visits,
    new_flow_state,
    zone_geometry,
)
from pipeline.parameters import Parameters
from pipeline.simulate.setup import Setup


class Snapshot(NamedTuple):
    """What the flow has made of the lattice at a reading; arrays as in `flow.FlowState`.

    `moved` marks the places whose cell has moved since the reading before; `heights` and `widths`
    (label) are the movement zones', m; `mass` was drawn so far, kg.
    """

    code: np.ndarray
    cell_id: np.ndarray
    zone: np.ndarray
    zone_root: np.ndarray
    moved: np.ndarray
    heights: np.ndarray
    widths: np.ndarray
    mass: float


@dataclass(frozen=True)
class FlowRecord:
    """The flow of one replicate, kept to be simulated again under other stresses.

    `totals` are the fields of `Readings` that the flow alone decides.
    """

    snapshots: tuple[Snapshot, ...]
    totals: Mapping[str, Any]

    def __iter__(self) -> Iterator[Snapshot]:
        return iter(self.snapshots)

    @property
    def nbytes(self) -> int:
        """Bytes that its arrays take."""
        return sum(getattr(part, "nbytes", 0) for snapshot in self.snapshots for part in snapshot)


class Flow:
    """Follows the draw schedule; iterating it gives a `Snapshot` of views at each reading.

    A drawpoint with no granular cell left leaves the rest of its visit undrawn: what is missing
    adds to `drawpoint_shortfall` (drawpoint) in kg, and the schedule goes on.
    """

    def __init__(
        self,
        setup: Setup,
        parameters: Parameters,
        cell_weight: np.ndarray,
        flow: np.random.Generator,
    ):
        self._setup, self._parameters = setup, parameters
        self._cell_weight, self._stream = cell_weight, flow
        self._state = new_flow_state(setup.code, setup.openings)
        self._shortfall = np.zeros(len(setup.experiment.drawpoints))

    def __iter__(self) -> Iterator[Snapshot]:
        setup, state, weight = self._setup, self._state, self._cell_weight
        arguments = climb_chances(self._parameters.exponent), self._parameters.bulking, self._stream
        drawpoints, ends = setup.visits
        done, missing = 0, 0.0
        for target in setup.masses:
            here = int(np.searchsorted(ends, target))  # the visit during which it is read
            visited = drawpoints[done:here], ends[done:here]
            missing = draw_visits(state, weight, *visited, missing, self._shortfall, *arguments)
            if here < len(ends):
                draw_to(state, weight, int(drawpoints[here]), target - missing, *arguments)
            done = here
            yield self._snapshot()
            state.moved[:] = False
        if setup.to_the_end:
            visited = drawpoints[done:], ends[done:]
            draw_visits(state, weight, *visited, missing, self._shortfall, *arguments)

    def _snapshot(self) -> Snapshot:
        state = self._state
        drawn = state.counters[DRAWN_CELLS]
        return Snapshot(
            state.code,
            state.cell_id,
            state.zone,
            state.zone_root,
            state.moved,
            *zone_geometry(state, self._setup.lattice.cell_size),
            float(state.drawn_mass[drawn - 1]) if drawn else 0.0,
        )

    @property
    def totals(self) -> dict[str, Any]:
        """As in `FlowRecord`, so far."""
        state = self._state
        drawn = state.counters[DRAWN_CELLS]
        return {
            "drawpoint_shortfall": self._shortfall,
            "hang_ups": int(state.counters[HANG_UPS]),
            "drawn_cell": state.drawn_cell[:drawn].copy(),
            "drawn_drawpoint": state.drawn_drawpoint[:drawn].copy(),
            "drawn_mass": state.drawn_mass[:drawn].copy(),
        }
