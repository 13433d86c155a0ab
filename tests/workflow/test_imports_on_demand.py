"""What the scripts of rules import: no more than they use."""

import os
import subprocess
import sys

import pytest

from pipeline.benchmark.workflow import imports_of

HEAVY = ("numba", "scipy", "dask", "matplotlib")
IMPORTED = {  # rule: the heavy packages that its script needs
    "block_model": (),
    "aggregate": (),
    "validate": (),
    "grade": (),
    "compare": (),
    "export": (),
    "report": ("matplotlib",),
    "study_report": ("matplotlib",),
    "index": ("matplotlib",),
}


@pytest.mark.parametrize("rule", IMPORTED)
def test_a_script_imports_only_what_it_uses(repository, rule):
    script = repository / "pipeline" / "workflow" / "scripts" / f"{rule}.py"
    found = _run(f"{imports_of(script)}\nimport sys; print(*{set(HEAVY)} & set(sys.modules))")
    assert set(found.split()) == set(IMPORTED[rule])


@pytest.mark.parametrize("without", ["", "1"])
def test_xarray_finds_no_dask_where_a_job_needs_none(without):
    code = (
        "import pipeline, sys, xarray as xr; xr.Dataset({'a': ('x', [1.0])}).sum(); "
        "print('dask.base' in sys.modules)"
    )
    assert _run(code, BLOCK_CAVE_WITHOUT_DASK=without).strip() == str(without == "")


def _run(code, **variables):
    command = [sys.executable, "-c", code]
    environment = os.environ | variables
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout
