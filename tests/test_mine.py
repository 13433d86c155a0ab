"""The mine-scale experiments: what they assume, what they share, what is conserved."""

import runpy
import sys

import numpy as np
import pytest

from pipeline.config.load import load_experiments
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.parameters import Parameters, carry_transmission, declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup, visits

NAMES = ("mine_panel", "mine_block")
LABORATORY = Parameters(cell_size=0.1, E=0.9955, s_mean=8.0, s_std=7.0)


@pytest.fixture(scope="module")
def written(repository, tmp_path_factory):
    """written(...): experiments that the generator writes with these arguments."""
    script = repository / "workflow_configs" / "experiments" / "make_mine.py"

    def write(*arguments):
        folder = tmp_path_factory.mktemp("mine")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", [str(script), *arguments, "--folder", str(folder)])
            runpy.run_path(str(script), run_name="__main__")
        return folder

    return write


@pytest.fixture(scope="module")
def mines(repository):
    experiments = load_experiments(repository / "workflow_configs" / "experiments")
    return [experiments[name] for name in NAMES]


def test_the_files_are_those_of_the_generator(written, repository):
    folder = written()
    for name in NAMES:
        file = repository / "workflow_configs" / "experiments" / f"{name}.yaml"
        assert (folder / file.name).read_text("utf-8") == file.read_text("utf-8")


def test_the_mine_is_large_and_says_what_it_assumes(mines):
    for mine in mines:
        g = mine.geometry
        assert g.width >= 150
        assert g.length >= 150
        assert (g.height, g.cell_size) == (300, 2)
        assert len(mine.drawpoints) == 100
        assert mine.stress.from_ == "castro_2006_1452"
        assert {"stress.s", "stress.R", "stress.E_min", "flow", "drawpoints"} <= set(mine.assumed)
        assert mine.measured is None
        assert mine.calibrate == ()
        assert "Castro, Vargas & de la Huerta 2012" in mine.source


def test_both_strategies_share_layout_and_mass_of_every_drawpoint(mines):
    panel, block = mines
    for key in ("geometry", "material", "stress", "flow", "drawpoints", "load_cells", "readings"):
        assert getattr(panel, key) == getattr(block, key)
    given = []
    for mine in mines:
        mass, done = np.zeros(100), 0.0
        for point, end in visits(mine):
            mass[point] += end - done
            done = end
        given.append(mass)
    np.testing.assert_allclose(given[0], given[1], rtol=1e-9)
    np.testing.assert_allclose(given[0], 1000 * 1900 * 2.0**3, rtol=1e-9)  # 1000 cells each


def test_panel_caving_draws_a_front_that_moves_along_the_drifts(mines):
    panel, _ = mines
    at = {point.name: point.x for point in panel.drawpoints}
    fronts = [[at[name] for name in line.drawpoints] for line in panel.draw]
    assert all(max(front) - min(front) <= 60 for front in fronts)
    assert [max(front) for front in fronts] == sorted(max(front) for front in fronts)


def test_e_is_carried_at_equal_base_stress_and_pillars_lie_between_drawbells(mines):
    mine, _ = mines
    E = declared_parameters(mine, {"castro_2006_1452": LABORATORY}).E
    assert pytest.approx(carry_transmission(0.9955, 0.1, 2.0, 300.0)) == E
    assert pytest.approx(0.1 / 0.0045, rel=1e-5) == 2.0 / (1.0 - E)  # saturated: ℓ stays
    for pillar in mine.load_cells:
        for point in mine.drawpoints:
            apart = abs(pillar.x - point.x) >= (pillar.width + point.width) / 2
            assert apart or abs(pillar.y - point.y) >= (pillar.length + point.length) / 2


def test_a_finer_mine_keeps_the_zone_s_length_and_brings_its_laboratory_test(written):
    folder = written("--cell-size", "0.7", "--cells-drawn", "100000", "--periods", "1")
    mine = load_experiments(folder)["mine_panel"]
    assert 0.7 / (1 - mine.stress.E_min.value) == pytest.approx(4.6, rel=1e-3)
    assert mine.mass_scheduled == pytest.approx(100_000 * 1900 * 0.7**3)
    cells = np.prod([side / 0.7 for side in (200, 160, 300)])
    assert cells > 27e6


@pytest.mark.parametrize("name", NAMES)
def test_weight_and_mass_are_conserved_in_a_coarse_mine(written, name):
    folder = written("--cell-size", "4", "--cells-drawn", "2000", "--replicates", "1")
    mine = load_experiments(folder)[name]
    setup = make_setup(mine)
    parameters = declared_parameters(mine, {"castro_2006_1452": LABORATORY})
    streams = (random_stream(mine.seed, name, purpose, 0) for purpose in (PACKING, FLOW))
    last = {}

    def observe(t, code, cell_id, load):
        last["granular"] = np.sort(cell_id[cell_id >= 0])

    readings = simulate(setup, parameters, *streams, observe)
    assert readings.weight_balance_error.max() < 1e-12
    assert len(readings.drawn_cell) == 2000
    everything = np.concatenate([last["granular"], np.sort(readings.drawn_cell)])
    np.testing.assert_array_equal(np.sort(everything), np.arange(setup.code.size))
    assert readings.vertical_stress.shape == (6, 45)
