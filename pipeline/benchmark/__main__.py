"""`python -m pipeline.benchmark`: the kernels' speed and memory, each beside a yardstick.

A figure is a ratio taken in one run: what is measured and its yardstick run in turn, and the
median of the paired ratios is what counts. Nothing here fails for being slow: a target is met or
missed, and both are said. `docs/speed.md` tells how to read it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any, NamedTuple

from pipeline.benchmark.figures import Figure, describe_machine
from pipeline.benchmark.kernels import (
    flow_figures,
    laboratory_figures,
    published_figures,
    reference_figures,
    static_figures,
)
from pipeline.benchmark.replicates import memory_figures, replicates_figures, scaling_figures
from pipeline.benchmark.table import as_table
from pipeline.benchmark.workflow import workflow_figures

TESTED = 37  # side of a lattice of 50 000 cells


class Sizes(NamedTuple):
    """Sides of the cubic lattices, in cells, how often each figure is taken, and of how many
    replicates those of processes and Dask are."""

    static: tuple[int, ...]
    flow: tuple[int, ...]
    reference: int
    plane: int
    memory: int
    scaling: tuple[int, ...]
    repeats: int
    replicates: int = 400


WORKFLOW_REPEATS = 2
QUICK = Sizes((37, 100), (64, 100), 12, 60, 144, (46, 67, 100, 144), 5)
FULL = Sizes((37, 100, 300), (64, 300), 12, 60, 215, (46, 67, 100, 144, 215, 300, 464), 7, 10_000)


def run_benchmark(sizes: Sizes) -> dict[str, Any]:
    """Machine, figures and what was left out, as JSON-able data."""
    start = time.perf_counter()
    machine = describe_machine()
    repeats, skipped = sizes.repeats, []
    figures: list[Figure] = []
    for side in sizes.static:
        figures += static_figures(side, repeats)
    figures += reference_figures(sizes.reference, min(repeats, 3))
    figures += published_figures(sizes.plane, repeats)
    for side in sizes.flow:
        figures += flow_figures(side, repeats)
    figures += laboratory_figures(repeats)
    figures += replicates_figures(TESTED, sizes.replicates, min(repeats, 3))
    memory, of_static = memory_figures(sizes.memory, min(repeats, 2))
    figures += memory
    figures += scaling_figures(sizes.scaling, min(repeats, 3), of_static, skipped)
    lattices = sizes._asdict()
    return _document(machine, figures, start, lattices=lattices, skipped=skipped)


def run_workflow_benchmark(repeats: int) -> dict[str, Any]:
    """The same of whole runs of the workflow."""
    start = time.perf_counter()
    machine = describe_machine()
    return _document(machine, list(workflow_figures(repeats)), start, skipped=[])


def _document(machine, figures: list[Figure], start: float, **more: Any) -> dict[str, Any]:
    return {
        "machine": machine,
        **more,
        "figures": [figure.document() for figure in figures],
        "seconds": time.perf_counter() - start,
    }


def main(arguments: list[str]) -> int:
    """The command line; always 0, since a missed target is a result."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.benchmark", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print data instead of a table")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="small lattices, under a minute")
    size.add_argument(
        "--workflow", action="store_true", help="whole runs of the workflow instead; some minutes"
    )
    asked = parser.parse_args(arguments)
    if asked.workflow:
        document = run_workflow_benchmark(WORKFLOW_REPEATS)
    else:
        document = run_benchmark(QUICK if asked.quick else FULL)
    print(json.dumps(document, indent=2) if asked.json else as_table(document))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
