"""`python -m pipeline.stages EXPERIMENT.yaml`: one replicate of a draw experiment, stage by stage.

For experiments as large as a mine: what each stage takes, and the most memory. Nothing is kept.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.benchmark.figures import describe_machine
from pipeline.benchmark.lattices import cube
from pipeline.calibrate.calibration import calibrate
from pipeline.config.experiment import Experiment
from pipeline.config.load import check_measured, load_experiment, load_experiments, sources
from pipeline.config.messages import ConfigError
from pipeline.effects import as_filled
from pipeline.files.netcdf import write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.fields import FieldSums
from pipeline.montecarlo.parts import stack
from pipeline.montecarlo.replicates import replicates_dataset
from pipeline.montecarlo.streams import replicate_streams
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.flow import FlowRecord, Snapshot
from pipeline.simulate.replicate import record_flow, simulate
from pipeline.simulate.setup import make_setup

STAGES = (
    "block model",
    "setup",
    "flow",
    "s",
    "sweep",
    "reading",
    "output",
)


@dataclass
class Stopwatch:
    """Seconds of each stage; one runs at a time, and a stage may come again."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    stage: str | None = None
    since: float = 0.0

    def enter(self, stage: str | None) -> None:
        """End the stage that runs, and begin another (None: none)."""
        now = time.perf_counter()
        if self.stage is not None:
            self.seconds[self.stage] += now - self.since
        self.stage, self.since = stage, now


@dataclass(frozen=True)
class _TimedFlow(FlowRecord):
    """A recorded flow; the sweep's stage begins where a replicate takes the next snapshot."""

    watch: Stopwatch

    def __iter__(self) -> Iterator[Snapshot]:
        for snapshot in self.snapshots:
            self.watch.enter("sweep")
            yield snapshot


def time_stages(experiment: Experiment, parameters: Parameters) -> dict[str, Any]:
    """Seconds of the stages of the first replicate of a draw experiment, and what they did.

    Its numbers are those of the rule `replicates`. The flow is recorded before the stresses: its
    snapshots are held, 8 bytes for each cell and reading.

    - sweep: cells and new s put into place, the sweep, and the base read by load cells
    - reading: the fields of all cells added to their sums
    - output: sums to means, and `replicates.nc` and `fields.nc` written
    """
    watch = Stopwatch()
    watch.enter("block model")
    model = build_block_model(as_filled(experiment))
    watch.enter("setup")
    setup = make_setup(experiment, model, check_measured(experiment))
    del model

    watch.enter("flow")
    flow = record_flow(setup, parameters, *replicate_streams(experiment, 0))
    watch.enter("reading")
    sums = FieldSums.empty(setup)

    def observe(*state):
        watch.enter("reading")
        sums.observe_first(*state)
        watch.enter("sweep")

    watch.enter("s")
    timed = _TimedFlow(flow.snapshots, flow.totals, watch)
    packing, _ = replicate_streams(experiment, 0)
    readings = simulate(setup, parameters, packing, timed, observe)
    watch.enter("output")
    del flow, timed
    sums.count = 1
    with tempfile.TemporaryDirectory() as folder:
        for name, dataset in (
            ("replicates", replicates_dataset(setup, stack([readings]))),
            ("fields", sums.finalise()),
        ):
            path = Path(folder) / f"{name}.nc"
            write_dataset(path, dataset, experiment, "stages", name.capitalize())
    watch.enter(None)
    return {
        "experiment": experiment.name,
        "shape": list(setup.lattice.shape),
        "cells": setup.code.size,
        "cell_size_m": setup.lattice.cell_size,
        "drawpoints": len(experiment.drawpoints),
        "readings": setup.times,
        "cells_drawn": len(readings.drawn_cell),
        "weight_balance_error": float(readings.weight_balance_error.max()),
        "seconds": watch.seconds,
        "total_seconds": sum(watch.seconds.values()),
        "peak_memory_bytes": _peak_memory(),
    }


def _peak_memory() -> int:
    """Most resident memory of this process so far, bytes."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def parameters_of(experiment: Experiment, experiments: Mapping[str, Experiment]) -> Parameters:
    """Those of a run: as declared, and taken from a source that is calibrated for it."""
    known: dict[str, Parameters] = {}
    for source in reversed(sources(experiment, experiments)[1:]):
        rows = check_measured(source)
        setup = make_setup(source, rows=rows)
        document = calibrate(source, setup, declared_parameters(source, known), rows)
        known[source.name] = Parameters.from_document(document["parameters_used"])
    return declared_parameters(experiment, known)


def as_table(document: Mapping[str, Any]) -> str:
    """The document for people."""
    machine, total = document["machine"], document["total_seconds"]
    shape = " × ".join(map(str, document["shape"]))
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, "
        f"load at the start {machine['load_average'][0]:.2f}",
        f"{document['experiment']}: {shape} = {document['cells']} cells of "
        f"{document['cell_size_m']:g} m, {document['drawpoints']} drawpoints, "
        f"{document['readings']} readings, {document['cells_drawn']} cells drawn",
        "",
        f"{'stage':<26}{'seconds':>9}{'share':>8}",
    ]
    lines += [
        f"{stage:<26}{seconds:>9.2f}{seconds / total:>8.0%}"
        for stage, seconds in document["seconds"].items()
    ]
    return "\n".join(
        [
            *lines,
            f"{'together':<26}{total:>9.2f}",
            "",
            f"most resident memory {document['peak_memory_bytes'] / 1e9:.1f} GB; weight balance "
            f"within {document['weight_balance_error']:.1g}",
        ]
    )


def main(arguments: list[str]) -> int:
    """The command line; 1 where the file is no draw experiment that can run."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.stages", description=__doc__)
    parser.add_argument("experiment", type=Path, help="the experiment's file (.yaml)")
    parser.add_argument("--json", action="store_true", help="print data instead of a table")
    asked = parser.parse_args(arguments)
    try:
        experiment = load_experiment(asked.experiment)
        experiments = load_experiments(asked.experiment.parent)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1
    if not experiment.is_draw:
        print(f"{asked.experiment}: a static experiment; expected draw lines", file=sys.stderr)
        return 1
    machine = describe_machine()
    small = cube(8, drawn=True)
    time_stages(small, declared_parameters(small))  # compiles, so that no stage below does
    parameters = parameters_of(experiment, experiments)
    document = {"machine": machine} | time_stages(experiment, parameters)
    print(json.dumps(document, indent=2) if asked.json else as_table(document))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
