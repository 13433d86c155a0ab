"""Runs Snakemake once for each list of arguments, each in a process of its own, two at a time.

Processes are forked from one that has imported all that Snakemake imports: most of a short run's
time is importing. Reads JSON from stdin, a list of argument lists; writes a list of
[exit status, output].
"""

import importlib
import json
import multiprocessing
import os
import sys
import tempfile
from contextlib import suppress

import snakemake.cli


def run(arguments: list[str]) -> tuple[int, str]:
    """Exit status and output (stdout and stderr together) of `snakemake ARGUMENTS`."""
    with tempfile.TemporaryFile("w+") as output:
        for descriptor in (1, 2):
            os.dup2(output.fileno(), descriptor)
        try:
            snakemake.cli.main(arguments)
            status = 0
        except SystemExit as end:
            status = end.code
        sys.stdout.flush()
        sys.stderr.flush()
        output.seek(0)
        return status, output.read()


def modules_of(arguments: list[str]) -> list[str]:
    """Names of the modules that a run has imported at its end."""
    run(arguments)
    return sorted(set(sys.modules) - {"__main__", "__mp_main__"})


if __name__ == "__main__":
    calls = json.load(sys.stdin)
    fork = multiprocessing.get_context("fork")
    with fork.Pool(1) as pool:
        names = pool.apply(modules_of, (calls[0],))
    for name in names:
        with suppress(ImportError):
            importlib.import_module(name)
    with fork.Pool(2, maxtasksperchild=1) as pool:
        results = pool.map(run, calls, chunksize=1)
    json.dump(results, sys.stdout)
