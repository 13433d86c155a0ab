"""Generalized least squares: parameters and amplitudes at once, with weak priors."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pipeline.loop.covariance import Noise, noise
from pipeline.loop.data import Data
from pipeline.loop.model import Model, Point, limits

MOST_STEPS = 80
FIRST_DAMPING, MOST_DAMPING = 1.0, 1e3  # in units of an unknown's usual change
CLOSE, ROUGHLY = 3e-5, 0.01  # drop of χ² that a step must promise
FAR = 0.3  # of an unknown's scale: from there on the slopes of another point do not serve
MOVED = 1.0  # likewise for the covariance
PART = 0.25  # of an amplitude that is a usual change of it, where that exceeds its scale
OF_SCATTER = ("s.mean", "s.std")  # what a rough covariance, which knows little of it, would mislead
REFRESHES = 2  # times that the covariance follows the fit
AMPLITUDE_PRIOR = 100.0  # sd of an amplitude's prior in a fit, in its scale: too wide to shrink it


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes
    ----------
    point : where it stands
    reference : point at which the covariance and the offset were simulated
    offset : (row) what the many replicates add to the mean of the common ones, at the reference
    expected : (row) what every row should be, at the point
    residual : (n) y − expected, of the rows of the data
    slopes : (row, unknown) derivatives of `expected` by coordinates and amplitudes
    cost : χ² with the priors' part
    """

    point: Point
    reference: Point
    offset: np.ndarray
    expected: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    cost: float


def calibrated(
    model: Model,
    data: Data,
    start: Point,
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0),
    settled: bool = False,
) -> tuple[Fit, Noise]:
    """Fit from `start`, then again with the covariance of what was found, until it stays.

    `settled`: `start` is near the end already.
    """
    point, slopes = start, None
    if not settled:
        rough = noise(model, start, data, rough=True).scaled(factors)
        found = fit(model, data, rough, start, close=ROUGHLY, held=OF_SCATTER)
        point, slopes = found.point, found.slopes
    for _ in range(REFRESHES):
        reference = point
        here = noise(model, reference, data).scaled(factors)
        found = fit(model, data, here, reference, reference, slopes)
        point, slopes = found.point, found.slopes
        if not _is_far(model, found.point, reference, MOVED):
            break
    return found, here


def fit(
    model: Model,
    data: Data,
    noise: Noise,
    start: Point,
    reference: Point | None = None,
    slopes: np.ndarray | None = None,
    close: float = CLOSE,
    held: Collection[str] = (),
) -> Fit:
    """Levenberg and Marquardt's least squares on common random numbers, bounds kept.

    The mean of the few common replicates is corrected by what the many say at `reference`; the
    flow stays that of `reference`, but for parameters of the flow itself. `slopes` are
    derivatives at or near `start`; they are taken as long as they serve. Coordinates whose names
    are `held` stay. It ends when a step promises less than `close` of χ².
    """
    offset = np.zeros(len(model.rows)) if reference is None else offset_at(model, reference)
    flow_at = None if _fits_flow(model) else reference or start
    center, sd, low, high = box(model, start)
    for place, coordinate in enumerate(model.coordinates):
        if coordinate.name in held:
            low[place] = high[place] = start.coordinates[place]

    def system(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        expected = model.mean(_at(start, x), flow_at) + offset
        misfit = noise.whitened(data.y - expected[data.use])
        both = np.concatenate([misfit, (center - x) / sd])
        return expected, both, float(both @ both)

    x = np.clip([*start.coordinates, *start.amplitudes], low, high)
    if slopes is None:
        slopes = _slopes(model, _at(start, x))
    sloped, damping = _at(start, x), 0.0
    expected, misfit, cost = system(x)
    size = _sizes(model, start)
    for _ in range(MOST_STEPS):
        whole = np.vstack([noise.whitened(slopes[data.use]), np.diag(1.0 / sd)])
        free = _step(whole, misfit, x, low, high, 0.0 * size)
        left = cost - float(np.sum((misfit - whole @ free) ** 2))
        if left < close or damping > MOST_DAMPING:
            break
        step = _step(whole, misfit, x, low, high, damping / size)
        promised = cost - float(np.sum((misfit - whole @ step) ** 2))
        tried = np.clip(x + step, low, high)
        result = system(tried)
        kept = (cost - result[2]) / max(promised, 1e-12)
        if kept > 0.1:
            slopes = _bent(slopes, (tried - x) / size, result[0] - expected, size)
            x, (expected, misfit, cost) = tried, result
        if kept < 0.25 or _is_far(model, _at(start, x), sloped, FAR):
            if _at(start, x) != sloped:  # the slopes do not serve this far
                slopes, sloped = _slopes(model, _at(start, x)), _at(start, x)
            if kept < 0.1:
                damping = max(4.0 * damping, FIRST_DAMPING)
        else:
            damping = 0.3 * damping
    residual = data.y - expected[data.use]
    point = _at(start, x)
    return Fit(point, reference or start, offset, expected, residual, slopes, cost)


def _sizes(model: Model, point: Point) -> np.ndarray:
    """Usual changes of all unknowns; of an amplitude of many scales, a part of it."""
    sizes = [c.size for c in model.coordinates]
    for term, amplitude in zip(point.terms, point.amplitudes, strict=True):
        p = term.described
        sizes.append(max(p.scale, PART * abs(amplitude - p.neutral)))
    return np.array(sizes)


def _is_far(model: Model, one: Point, other: Point, far: float) -> bool:
    """Whether two points differ by more than `far` of an unknown's scale."""
    moved = np.subtract(
        [*one.coordinates, *one.amplitudes], [*other.coordinates, *other.amplitudes]
    )
    return bool(np.any(np.abs(moved) > far * _sizes(model, one)))


def offset_at(model: Model, point: Point) -> np.ndarray:
    """What all replicates of `Model.scatter` say beyond the few common ones, (row)."""
    offset = -model.mean(point)
    for case in model.active:
        offset[model.slices[case]] += model.scatter_mean(point, case)
    return offset


def _fits_flow(model: Model) -> bool:
    return any(c.name in ("exponent", "bulking") for c in model.coordinates)


def _slopes(model: Model, point: Point) -> np.ndarray:
    return np.column_stack(model.jacobian(point, point.terms))


def _bent(slopes: np.ndarray, moved: np.ndarray, change: np.ndarray, size: np.ndarray):
    """Slopes (row, unknown) that explain the last change of the rows (Broyden 1965).

    `moved` (unknown) led to it, in units of `size`.
    """
    length = float(moved @ moved)
    if length < 1e-12:
        return slopes
    missing = np.nan_to_num(change - (slopes * size) @ moved)
    return slopes + np.outer(missing / length, moved) / size


def _at(start: Point, x: np.ndarray) -> Point:
    count = len(start.coordinates)
    return start.moved(x[:count], x[count:])


def box(model: Model, point: Point) -> tuple[np.ndarray, ...]:
    """Prior's center and sd, and bounds, of all unknowns."""
    terms = [term.described for term in point.terms]
    ends = [limits(term) for term in point.terms]
    center = np.array([*(c.start for c in model.coordinates), *(p.neutral for p in terms)])
    sd = np.array([*model.prior_sd, *(AMPLITUDE_PRIOR * p.scale for p in terms)])
    low = np.array([*(c.low for c in model.coordinates), *(end[0] for end in ends)])
    high = np.array([*(c.high for c in model.coordinates), *(end[1] for end in ends)])
    return center, sd, low, high


def posterior_covariance(model: Model, data: Data, found: Fit, noise: Noise) -> np.ndarray:
    """Covariance (unknown, unknown) of a fit's coordinates and amplitudes, with their priors."""
    _, sd, _, _ = box(model, found.point)
    return covariance_given(noise.whitened(found.slopes[data.use]), sd)


def covariance_given(white: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Covariance (unknown, unknown) from whitened slopes (n, unknown) and the priors' sd (unknown).

    Taken in units of the priors: what no reading tells of keeps its prior, however far the
    others' scales are from its own.
    """
    _, told, directions = np.linalg.svd(white * sd)
    left = np.ones(len(sd))
    left[: len(told)] /= 1.0 + told**2
    return np.outer(sd, sd) * (directions.T @ (left[:, None] * directions))


def _step(whole, misfit, x, low, high, damping) -> np.ndarray:
    """Damped least-squares step; unknowns that it would push out of their bounds stay."""
    whole = np.vstack([whole, np.diag(damping)])
    misfit = np.concatenate([misfit, np.zeros(len(x))])
    free = np.ones(len(x), dtype=bool)
    step = np.zeros(len(x))
    for _ in range(len(x) + 1):
        step[:] = 0.0
        if free.any():
            step[free] = np.linalg.lstsq(whole[:, free], misfit, rcond=None)[0]
        stuck = free & (((x <= low) & (step < 0)) | ((x >= high) & (step > 0)))
        if not stuck.any():
            break
        free &= ~stuck
    return np.clip(x + step, low, high) - x
