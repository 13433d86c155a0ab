"""From the blocks of a table to a regular grid, or to a report of why they are none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pipeline.config.messages import ConfigError
from pipeline.files.mine.block_table import BlockTable
from pipeline.files.mine.tables import some_of

OFF_GRID = 0.01
"""Distance from the grid, in blocks, beyond which a block is off it."""
ROTATED = 0.02
"""Angle in degrees beyond which a grid counts as rotated."""
MOST = 0.8
"""Share of blocks that have to agree on an angle for a grid to count as rotated."""
_SAMPLE = 2000  # blocks whose neighbors tell the rotation


@dataclass(frozen=True)
class BlockGrid:
    """A regular grid of blocks.

    Attributes
    ----------
    corner : easting, northing and elevation of its lowest corner, m
    size : extents of a block along x, y and z, m
    ground : (z, y, x) bool, blocks that are there and ground
    density : (z, y, x) kg m-3, NaN where no ground; None where the table has none
    notes : what was left out, for the user
    kept : (z, y, x) columns that regions name, NaN or an empty text where there is no ground
    """

    corner: tuple[float, float, float]
    size: tuple[float, float, float]
    ground: np.ndarray
    density: np.ndarray | None
    notes: tuple[str, ...]
    kept: dict[str, np.ndarray]


def regular_grid(blocks: BlockTable, gaps: str = "refuse", base: float | None = None) -> BlockGrid:
    """The regular grid that the ground's blocks make.

    Parameters
    ----------
    blocks : as read
    gaps : "refuse" blocks missing from the box around the ground, or take them for "outside";
        those with ground on all sides are refused in any case
    base : elevation in m; blocks with their centers below it are left out

    Raises
    ------
    ConfigError
        If the grid is rotated, irregular, has blocks of several sizes, twice the same one, or
        gaps: with the lines, the spacing found, the angle, and the number of missing blocks.
    """
    centers, names = blocks.centers, blocks.columns
    keep = blocks.ground.copy()
    notes = []
    if not keep.all():
        notes.append(f"{int((~keep).sum())} blocks that are not ground left out")
    if base is not None:
        below = keep & (centers[:, 2] < base)
        keep &= ~below
        notes.append(f"{int(below.sum())} blocks below the base at {base:g} m left out")
    if not keep.any():
        _refuse(blocks, [f"no ground block lies above {base:g} m; give a lower base"])
    _refuse_rotated(blocks, centers[keep])
    size = np.array([_extent(blocks, keep, axis) for axis in range(3)])
    index = np.empty((len(centers), 3), dtype=np.int64)
    wrong: list[str] = []
    off_grid = np.zeros(len(centers), dtype=bool)
    corner = np.empty(3)
    for axis in range(3):
        index[:, axis], corner[axis], off = _place(centers[:, axis], keep, size[axis])
        outlying = keep & (np.abs(off) > OFF_GRID * size[axis])
        off_grid |= outlying
        wrong += some_of(
            [
                f"line {blocks.table.lines[row]}, {names[axis]} = {centers[row, axis]:.10g}: off "
                f"the grid by {off[row]:.3g} m; expected {centers[row, axis] - off[row]:.10g} at "
                f"the blocks' spacing of {size[axis]:.6g} m"
                for row in np.nonzero(outlying)[0]
            ]
        )
    if wrong:
        _refuse(blocks, [*_mostly_off(off_grid, keep, size), *wrong])
    shape = tuple(int(n) for n in index[keep].max(axis=0) + 1)
    _refuse_repeated(blocks, keep, index, shape)
    x, y, z = index[keep].T
    ground = np.zeros(shape[::-1], dtype=bool)
    ground[z, y, x] = True
    declared = np.zeros_like(ground)  # blocks of the table inside the box, ground or not
    inside = ((index >= 0) & (index < shape)).all(axis=1)
    declared[tuple(index[inside].T[::-1])] = True
    notes += _gaps(blocks, ground, declared, gaps, corner, size)
    density = None
    if blocks.density is not None:
        density = np.full(ground.shape, np.nan)
        density[z, y, x] = blocks.density[keep]
    kept = {}
    for name, values in blocks.kept.items():
        empty = "" if values.dtype.kind == "U" else np.nan
        kept[name] = np.full(ground.shape, empty, values.dtype)
        kept[name][z, y, x] = values[keep]
    if base is not None and abs(corner[2] - base) > OFF_GRID * size[2]:
        notes.append(f"the base is the blocks' lower side at {corner[2]:.10g} m")
    corner, size = tuple(corner.tolist()), tuple(size.tolist())
    return BlockGrid(corner, size, ground, density, tuple(notes), kept)


# ---------------------------------------------------------------------------------------------
# what a grid has


def _extent(blocks: BlockTable, keep: np.ndarray, axis: int) -> float:
    """Extent of the blocks along an axis: as the table says, or the spacing of their centers."""
    name = "xyz"[axis]
    if blocks.sizes is not None:
        sizes = np.round(blocks.sizes[:, axis], 6)
        values, counts = np.unique(sizes[keep], return_counts=True)
        usual = values[np.argmax(counts)]
        wrong = [
            f"line {blocks.table.lines[row]}: {sizes[row]:.10g} m along {name}, expected "
            f"{usual:.10g} m as most blocks; reblock a sub-blocked model to one size"
            for row in np.nonzero(keep & (np.abs(sizes - usual) > OFF_GRID * usual))[0]
        ]
        if wrong:
            _refuse(blocks, some_of(wrong))
        return float(usual)
    centers = np.unique(np.round(blocks.centers[:, axis], 4))
    if len(centers) < 2:
        _refuse(
            blocks,
            [
                f"all blocks have {blocks.columns[axis]} = {centers[0]:.10g}, and no column says "
                f"how large they are; name the columns of their sizes with columns.d{name}"
            ],
        )
    spacing, span = float(np.median(np.diff(centers))), float(centers[-1] - centers[0])
    over_all = span / round(span / spacing)  # free of the rounding of a single center
    return over_all if abs(over_all - spacing) < 1e-3 * spacing else spacing


def _place(
    values: np.ndarray, keep: np.ndarray, spacing: float
) -> tuple[np.ndarray, float, np.ndarray]:
    """Index of each center along an axis from the lowest kept one, the grid's lower side, and
    how far each center is off (m)."""
    first = values[keep][0]
    phase = np.mod((values[keep] - first) / spacing, 1.0)
    bins = np.round(phase * 100).astype(int) % 100
    usual = np.bincount(bins).argmax()
    near = phase[bins == usual]
    near = np.where(near > 0.5, near - 1.0, near) if usual == 0 else near
    start = first + float(np.median(near)) * spacing
    index = np.round((values - start) / spacing).astype(np.int64)
    off = values - (start + index * spacing)
    lowest = index[keep].min()
    corner = start + (lowest - 0.5) * spacing
    return index - lowest, float(np.round(corner, 6)), off


def _mostly_off(off_grid: np.ndarray, keep: np.ndarray, size: np.ndarray) -> list[str]:
    """What to say where it is not some blocks that are off the grid, but there is no grid."""
    count = int(off_grid.sum())
    if count <= keep.sum() / 4:
        return []
    return [
        f"irregular: {count} of {int(keep.sum())} blocks are off any grid of "
        f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m along x, y and z (its spacing varies, or "
        "it dips); resample the model to blocks of one size in rows along x, y and z"
    ]


def _gaps(blocks, ground, declared, gaps, corner, size) -> list[str]:
    """Notes on the places of the box without a block; an error where they are none to leave."""
    missing = ~declared
    if not missing.any():
        return []
    nz, ny, nx = ground.shape
    grid = f"{nx} x {ny} x {nz} blocks of {size[0]:g} x {size[1]:g} x {size[2]:g} m"
    enclosed = missing & _enclosed(ground)
    if enclosed.any():
        _refuse(
            blocks,
            [
                f"{int(enclosed.sum())} of {ground.size} blocks are missing with ground on all "
                f"sides, the first at {_center(enclosed, corner, size)} (grid: {grid}); add them"
            ],
        )
    if gaps == "refuse":
        _refuse(
            blocks,
            [
                f"{int(missing.sum())} of {ground.size} blocks are missing, the first at "
                f"{_center(missing, corner, size)} (grid: {grid}); add them, or say "
                "gaps: outside where a missing block is no ground"
            ],
        )
    return [f"{int(missing.sum())} places of the grid without a block taken as outside the ground"]


def _enclosed(ground: np.ndarray) -> np.ndarray:
    """Places with ground somewhere on each of their six sides."""
    enclosed = np.ones_like(ground)
    for axis in range(3):
        enclosed &= np.logical_or.accumulate(ground, axis)
        enclosed &= np.flip(np.logical_or.accumulate(np.flip(ground, axis), axis), axis)
    return enclosed


def _center(places: np.ndarray, corner: np.ndarray, size: np.ndarray) -> str:
    first = np.argwhere(places)[0][::-1]
    return "({})".format(", ".join(f"{c:.10g}" for c in corner + (first + 0.5) * size))


# ---------------------------------------------------------------------------------------------
# what a grid must not have


def _refuse(blocks: BlockTable, problems) -> None:
    raise ConfigError((blocks.table.path, text) for text in problems)


def _refuse_repeated(blocks, keep, index, shape) -> None:
    rows = np.nonzero(keep)[0]
    flat = np.ravel_multi_index(tuple(index[rows].T), shape)
    order = np.argsort(flat, kind="stable")
    again = np.nonzero(np.diff(flat[order]) == 0)[0]
    lines, centers = blocks.table.lines, blocks.centers
    wrong = []
    for k in again:
        first, second = rows[order[k]], rows[order[k + 1]]
        place = ", ".join(f"{c:.10g}" for c in centers[first])
        wrong.append(
            f"line {lines[second]}: the block ({place}) of line {lines[first]} again; keep one"
        )
    if wrong:
        _refuse(blocks, some_of(wrong))


def _refuse_rotated(blocks: BlockTable, centers: np.ndarray) -> None:
    """Refuse a grid whose blocks' nearest neighbors in plan lie along other axes than x and y.

    The error names the angle and turns the blocks back by it, about the center of the first one.
    """
    plan = np.unique(np.round(centers[:, :2], 4), axis=0)
    if len(plan) < 3:
        return
    rotation, distance, share = _rotation(plan)
    if abs(rotation) <= ROTATED or share < MOST:
        return
    way, back = ("clockwise", "counterclockwise")[:: -1 if rotation > 0 else 1]
    plus, minus = ("+", "-") if rotation > 0 else ("-", "+")
    x, y = centers[0, :2].round(3)
    c, s = np.cos(np.radians(rotation)), np.sin(np.radians(abs(rotation)))
    formula = (
        f"x' = {x:.10g} + {c:.8f} (x - {x:.10g}) {plus} {s:.8f} (y - {y:.10g}), "
        f"y' = {y:.10g} {minus} {s:.8f} (x - {x:.10g}) + {c:.8f} (y - {y:.10g})"
    )
    _refuse(
        blocks,
        [
            f"the grid is rotated by {abs(rotation):.1f}° {way} in plan (nearest blocks "
            f"{distance:.4g} m apart); export the model unrotated, in its own axes, so that its "
            "blocks' sides lie along x and y",
            f"or turn it {back}, and drawpoints and load cells with it: {formula}",
        ],
    )


def _rotation(plan: np.ndarray) -> tuple[float, float, float]:
    """How a set of points (point, 2) is turned, if it is a grid.

    Returns
    -------
    rotation : degrees from x to the nearest axis of the grid, in (-45, 45], counterclockwise > 0
    distance : between nearest points, m
    share : of the points whose nearest neighbor lies within 1° of the grid's axes
    """
    sample = plan[:: max(1, len(plan) // _SAMPLE)]
    _, neighbors = cKDTree(plan).query(sample, k=2)
    toward = plan[neighbors[:, 1]] - sample
    angle = np.degrees(np.arctan2(toward[:, 1], toward[:, 0]))
    mean = np.exp(4j * np.radians(angle)).mean()
    center = np.degrees(np.angle(mean)) / 4
    off = (angle - center + 45) % 90 - 45
    middle = float(np.median(off))
    distance = float(np.median(np.hypot(*toward.T)))
    return center + middle, distance, float(np.mean(np.abs(off - middle) < 1.0))
