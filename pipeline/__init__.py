"""Vertical stress in block-cave columns: simulate, calibrate, and find the missing physics."""

import os
import sys

__version__ = "0.1.0"

# A job of the workflow that uses no Dask cluster sets this. Xarray imports all of Dask, where it
# finds it, at the first array that it touches, which takes longer than many a job's work.
if os.environ.get("BLOCK_CAVE_WITHOUT_DASK"):
    sys.modules["dask"] = None
