"""Runs Snakemake once for each list of arguments, two at a time, importing it only once.

Reads JSON from stdin, a list of argument lists; writes a list of [exit status, output].
"""

import json
import multiprocessing
import os
import sys
import tempfile

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


if __name__ == "__main__":
    # the pool's processes end after one run, as Snakemake's do
    with multiprocessing.get_context("fork").Pool(2, maxtasksperchild=1) as pool:
        results = pool.map(run, json.load(sys.stdin), chunksize=1)
    json.dump(results, sys.stdout)
