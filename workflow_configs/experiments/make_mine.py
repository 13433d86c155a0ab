"""Write the mine-scale experiments `mine_panel` and `mine_block`, one layout and two strategies.

    python make_mine.py                                            # the files beside this one
    python make_mine.py --cell-size 0.7 --periods 1 --replicates 1 --folder DIR   # 28 million cells

x runs along the production drifts, y across them. The base is the floor of the undercut. What
belongs to a cell size follows it: the movement zone keeps its length c / (1 - E_min), E follows by
`from`; s and the flow exponent have no such rule and stay as they are (assumed).
"""

import argparse
import shutil
from collections.abc import Iterator
from pathlib import Path

DRIFT_SPACING, DRAWBELL_SPACING = 32, 20  # m
ROWS, COLUMNS = 5, 10  # of drawbells, across and along the production drifts
HEIGHT = 300  # m of broken ore
DRIFT_WIDTH = 4  # m, of production drifts and drawpoints
APART = 12  # m between the two drawpoints of a drawbell
BULK_DENSITY = 1900  # kg m-3
ZONE_LENGTH, ZONE_HEIGHT = 4.6, 120  # c / (1 - E_min), m, in a movement zone of that height, m
FRONT = 4  # columns of drawbells that panel caving draws at a time
VISITS = 100  # of each drawpoint
PERIODS, REPLICATES = 5, 6
LABORATORY = ("castro_2006_1452.yaml", "measured/castro_2006_1452.csv")  # E is carried from it
CELL_SIZE, CELLS_DRAWN = 2.0, 100_000
ASSUMED = ("stress.s", "stress.R", "stress.E_min", "flow", "geometry", "material")
ASSUMED += ("drawpoints", "load_cells", "draw")

HEAD = """\
# Written by make_mine.py, beside this file: change that one.
title: {title}
source: >-
  Layout: drawbells every 20 m along production drifts 32 m apart, found best for El Teniente's New
  Mine Level by Castro, Vargas & de la Huerta 2012, J. South. Afr. Inst. Min. Metall. 112, 871-876
  (there with troughs of 18 m; 16 m here, on whole cells). E: Test 1 of Gómez & Castro 2022, IJRMMS
  154, 105124, by its length. R, s, bulking and the shape of E_min as in their draw box. All else is
  an example: no mine was measured, so that nothing is calibrated or validated here.
geometry: {{width: {width}, length: {length}, height: {height}, cell_size: {cell_size:g}}}
material:
  name: broken_ore
  bulk_density: {density}
  particle_density: 2700
  particle_size: [0.1, 2.0]
stress:
  from: castro_2006_1452                  # E at equal base stress of this column, see docs/mine.md
  s: {{mean: 4, std: 3}}
  R: 0.29
  E_min: {{type: power, at_height: {zone_height}, value: {E_min:.4g}}}   # {zone_length} m there
flow: {{exponent: 3, bulking: 0.25}}
# Two drawpoints to a drawbell: 1-01S and 1-01N in row 1, column 1, south and north in it.
drawpoints:
"""


def drawpoints(column: int | None = None) -> Iterator[tuple[str, float, float]]:
    """Name and center (m) of the drawpoints, of all or of one column of drawbells."""
    for row in range(ROWS):
        for i in range(COLUMNS) if column is None else [column]:
            for side, offset in (("S", -APART / 2), ("N", APART / 2)):
                y = DRIFT_SPACING * (row + 0.5) + offset
                yield f"{row + 1}-{i + 1:02d}{side}", DRAWBELL_SPACING * (i + 0.5), y


def pillars() -> Iterator[tuple[str, float, float]]:
    """Name and center (m) of the pillars between neighboring drawbells of a row."""
    for row in range(ROWS):
        for i in range(1, COLUMNS):
            yield f"P{row + 1}-{i:02d}", DRAWBELL_SPACING * i, DRIFT_SPACING * (row + 0.5)


def panel_caving() -> Iterator[tuple[list[str], int]]:
    """Drawpoints and visits to each of them, line by line: a front that moves along x."""
    for last in range(COLUMNS + FRONT - 1):
        front = range(max(0, last - FRONT + 1), min(last, COLUMNS - 1) + 1)
        yield [name for i in front for name, _, _ in drawpoints(i)], VISITS // FRONT


def block_caving() -> Iterator[tuple[list[str], int]]:
    """Drawpoints and visits to each of them: all in turn, from the beginning to the end."""
    yield [name for name, _, _ in drawpoints()], VISITS


STRATEGIES = {
    "mine_panel": ("Mine-scale example, panel caving by a front of drawbells", panel_caving),
    "mine_block": ("Mine-scale example, block caving of all drawbells evenly", block_caving),
}


def experiment(name: str, cell_size: float, cells_drawn: int, periods: int, replicates: int) -> str:
    """YAML of one strategy on cells of `cell_size` m, of which so many are drawn in all."""
    title, strategy = STRATEGIES[name]
    total = cells_drawn * BULK_DENSITY * cell_size**3
    visit = total / (VISITS * len(list(drawpoints())))
    lines = [
        HEAD.format(
            title=title,
            width=COLUMNS * DRAWBELL_SPACING,
            length=ROWS * DRIFT_SPACING,
            height=HEIGHT,
            cell_size=cell_size,
            density=BULK_DENSITY,
            E_min=max(0.0, 1 - cell_size / ZONE_LENGTH),
            zone_height=ZONE_HEIGHT,
            zone_length=ZONE_LENGTH,
        )
    ]
    side = f"width: {DRIFT_WIDTH}, length: {DRIFT_WIDTH}"
    lines += [f"  - {{name: {n}, x: {x:g}, y: {y:g}, {side}}}\n" for n, x, y in drawpoints()]
    lines.append("draw:\n")
    for points, visits in strategy():
        mass = visits * len(points) * visit
        amounts = f"mass: {mass:.9g}, increment: {visit:.9g}"
        lines.append(f"  - {{drawpoints: [{', '.join(points)}], {amounts}}}\n")
    lines.append(f"readings: {{every: {total / periods:.9g}}}\n")
    lines.append("# Pillars of the extraction level, between production drifts and drawbells.\n")
    lines.append("load_cells:\n")
    width, length = DRAWBELL_SPACING - DRIFT_WIDTH, DRIFT_SPACING - DRIFT_WIDTH
    side = f"width: {width}, length: {length}"
    lines += [f"  - {{name: {n}, x: {x:g}, y: {y:g}, {side}}}\n" for n, x, y in pillars()]
    lines.append(f"calibrate: []\nreplicates: {replicates}\nseed: 2022\n")
    lines.append(f"assumed: [{', '.join(ASSUMED)}]\n")
    return "".join(lines)


def main() -> None:
    """Write both files, in another folder with the laboratory test whose E they take."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cell-size", type=float, default=CELL_SIZE, help="m")
    parser.add_argument("--cells-drawn", type=int, default=CELLS_DRAWN, help="by both strategies")
    parser.add_argument("--periods", type=int, default=PERIODS, help="readings during draw")
    parser.add_argument("--replicates", type=int, default=REPLICATES)
    here = Path(__file__).resolve().parent
    parser.add_argument("--folder", type=Path, default=here)
    asked = parser.parse_args()
    if asked.folder.resolve() != here:
        (asked.folder / "measured").mkdir(parents=True, exist_ok=True)
        for file in LABORATORY:
            shutil.copyfile(here / file, asked.folder / file)
    for name in STRATEGIES:
        text = experiment(name, asked.cell_size, asked.cells_drawn, asked.periods, asked.replicates)
        (asked.folder / f"{name}.yaml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
