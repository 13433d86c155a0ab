"""Random streams: one for each experiment, purpose and replicate, whatever runs where."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache

import numpy as np

from pipeline.config.experiment import Experiment

# What a stream is for; a new purpose takes a new number, and none is ever changed.
(
    PACKING,
    FLOW,
    CALIBRATION_PACKING,
    CALIBRATION_FLOW,
    LOOP_PACKING,
    LOOP_FLOW,
    LOOP_NULL,
    LOOP_BOOTSTRAP,
    PREDICTION_UNKNOWNS,
    PREDICTION_READINGS,
) = range(10)


def random_stream(seed: int, experiment: str, purpose: int, replicate: int) -> np.random.Generator:
    """Generator for one replicate of one experiment and purpose.

    It depends on nothing else: adding an experiment, a replicate or a worker changes nobody's
    numbers. The experiment enters by its name (64 bits of its SHA-256).
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(_number(experiment), purpose, replicate))
    return np.random.Generator(np.random.PCG64(sequence))


def replicate_streams(
    experiment: Experiment, replicate: int, purposes: Sequence[int] = (PACKING, FLOW)
) -> list[np.random.Generator]:
    """The streams that `simulate` takes for a replicate of an experiment: packing and flow."""
    return [random_stream(experiment.seed, experiment.name, one, replicate) for one in purposes]


@cache
def _number(experiment: str) -> int:
    return int.from_bytes(hashlib.sha256(experiment.encode()).digest()[:8], "little")
