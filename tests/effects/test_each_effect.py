"""The law of each effect, in closed form where there is one."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from runs import run

from pipeline.effects import Active, State, as_filled, effects
from pipeline.effects.pillar_relaxation import relax as relax_beside_pillars
from pipeline.effects.tilt import OFFSETS, RING
from pipeline.lattice.block_model import build_block_model
from pipeline.lattice.cells import MOVEMENT, OUTSIDE, STAGNANT, VOID
from pipeline.lattice.closed_form import closed_form_stress
from pipeline.lattice.grid import GRAVITY, make_lattice
from pipeline.lattice.stress import UNCOUPLED

E, C, DENSITY = 0.9, 0.1, 1600  # of the filling of `runs`: 0.5 × 0.4 m, read at 0.35, 0.7, 1 m
DEPTHS = np.array([3.5, 7.0, 10.0])  # in cells


def on(name, load_cell=None, **values) -> Active:
    return Active(name, effects()[name].neutral | values, load_cell)


def uniform(transmission, depths=DEPTHS):
    """kPa at the base of the filling with another E."""
    return closed_form_stress(DENSITY, GRAVITY, C, transmission, depths) / 1e3


def means(experiment, *active):
    """Mean base stress (time) of one replicate in double precision, kPa."""
    return run(experiment, active, dtype=np.float64)[0].base_vertical_stress


def sweeps(experiment, *active, replicates=1):
    """What the sweep took at each reading, of all replicates."""
    kept = []
    run(
        experiment,
        active,
        replicates,
        inspect=lambda t, sweep, state: kept.append(
            sweep._replace(**{n: getattr(sweep, n).copy() for n in sweep._fields if n in COPIED})
        ),
    )
    return kept


COPIED = ("weight", "shed_fraction", "edge", "corner", "code", "load", "base_load")

# ---------------------------------------------------------------------------------------------
# walls


def share(K, angle=25.0, radius=0.2 / 1.8):
    """Of a level's load that the walls of the filling take."""
    return -math.expm1(-K * math.tan(math.radians(angle)) * C / radius)


def test_uniform_column_with_wall_friction_has_the_closed_form(filling):
    found = means(filling(), on("wall_friction", K=0.5))
    np.testing.assert_allclose(found, uniform(E * (1 - share(0.5))), rtol=1e-12)


def test_a_wall_is_no_rougher_than_the_material_where_capped(filling):
    smooth = filling(material={"internal_friction_angle": 20})
    found = means(smooth, on("wall_friction", K=0.5, cap=True))
    np.testing.assert_allclose(found, uniform(E * (1 - share(0.5, angle=20.0))), rtol=1e-12)
    found = means(filling(), on("wall_friction", K=0.5, cap=True))
    np.testing.assert_allclose(found, uniform(E * (1 - share(0.5))), rtol=1e-12)


def test_walls_keep_their_declared_lengths_on_a_rounded_lattice(filling):
    rounded = filling(geometry={"width": 0.53, "length": 0.37}, load_cells=None)
    found = means(rounded, on("wall_friction", K=0.5))
    walls = share(0.5, radius=0.53 * 0.37 / (2 * 0.9))
    np.testing.assert_allclose(found, uniform(E * (1 - walls)), rtol=1e-12)


@pytest.mark.parametrize("mask", [None, {"type": "cylinder"}])
def test_both_reaches_agree_where_every_cell_has_the_same_walls(filling, mask):
    corner_cells = filling(
        geometry={"width": 0.2, "length": 0.2, "mask": mask}, load_cells=None
    )  # 2 × 2 cells, two wall faces each
    level, face = (
        means(corner_cells, on("wall_friction", K=0.5, reach=reach)) for reach in ("level", "face")
    )
    np.testing.assert_allclose(face, level, rtol=1e-12)


def test_cells_at_the_wall_run_empty_where_walls_reach_no_farther(filling):
    walls = on("wall_friction", K=0.5, reach="face")
    last = sweeps(filling(stress={"s": {"mean": 4, "std": 0}}), walls)[-1]
    assert last.base_load[0].mean() < 0.75 * last.base_load[1:3, 1:4].mean()
    shed = last.shed_fraction[0]
    assert shed[1, 1] == pytest.approx(1 - E)
    assert shed[0, 0] > shed[0, 1] > shed[1, 1]


def test_walls_rub_on_flowing_ground_too(pillar):
    K = 0.5
    w = -math.expm1(-K * math.tan(math.radians(25)) * 0.04 / (0.2 / 2.4))
    plain, rough = sweeps(pillar()), sweeps(pillar(), on("wall_friction", K=K))
    granular = np.isin(plain[-1].code, (STAGNANT, MOVEMENT))
    expected = 1 - (1 - plain[-1].shed_fraction[granular]) * (1 - w)
    np.testing.assert_allclose(rough[-1].shed_fraction[granular], expected, rtol=1e-6)


# ---------------------------------------------------------------------------------------------
# weights


def test_stress_is_proportional_to_the_density_factor(filling):
    plain = run(filling())[0].vertical_stress
    denser = run(filling(), [on("density_misdeclared", factor=1.3)])[0].vertical_stress
    np.testing.assert_allclose(denser, 1.3 * plain, rtol=1e-6)


def test_a_kilogram_of_a_denser_bed_is_fewer_cells(pillar):
    plain = run(pillar())[0]
    denser = run(pillar(), [on("density_misdeclared", factor=2.0)])[0]
    cell = DENSITY * 0.04**3
    assert len(plain.drawn_cell) == pytest.approx(20.0 / cell, abs=1)
    assert len(denser.drawn_cell) == pytest.approx(10.0 / cell, abs=1)
    np.testing.assert_allclose(denser.replicate_mass_drawn, [0, 5, 10, 15, 20], atol=2 * cell)


def test_a_fill_height_factor_equals_a_column_declared_that_tall(filling):
    taller = filling(geometry={"height": 1.2}, filling={"levels": [0.35 * 1.2, 0.7 * 1.2]})
    misdeclared = run(filling(), [on("fill_height_misdeclared", factor=1.2)])[0]
    (declared,) = run(taller)
    np.testing.assert_array_equal(misdeclared.vertical_stress, declared.vertical_stress)


def test_a_block_model_is_as_high_as_the_bed_was_filled(filling):
    experiment = filling(effects={"fill_height_misdeclared": {"factor": 1.25}})
    assert build_block_model(as_filled(experiment)).sizes["z"] == 13  # of 10 declared
    assert as_filled(experiment, ()) is experiment


def test_a_surcharge_adds_what_the_column_transmits(filling):
    q = 3.0
    walls = on("wall_friction", K=0.5)
    for active, transmission in (((), E), ((walls,), E * (1 - share(0.5)))):
        added = means(filling(), on("surcharge", stress=q), *active) - means(filling(), *active)
        levels = np.ceil(DEPTHS)  # the top cell's load passes through all others
        np.testing.assert_allclose(added, q * transmission ** (levels - 1), rtol=1e-10)


def test_a_surcharge_is_untouched_by_density_and_lies_on_what_is_the_top(pillar):
    q, area = 2.0, 0.04**2
    dense = on("density_misdeclared", factor=1.5)
    for t, (plain, loaded) in enumerate(
        zip(
            sweeps(pillar(), dense), sweeps(pillar(), dense, on("surcharge", stress=q)), strict=True
        )
    ):
        granular = np.isin(loaded.code, (STAGNANT, MOVEMENT))
        added = (loaded.weight - plain.weight).astype(np.float64)
        columns = granular.any(axis=0)
        np.testing.assert_allclose(added.sum(axis=0)[columns], 1e3 * q * area, rtol=1e-4)
        highest = loaded.code.shape[0] - 1 - np.argmax(granular[::-1], axis=0)
        top = np.take_along_axis(added, highest[None], axis=0)[0]
        np.testing.assert_allclose(top, added.sum(axis=0), err_msg=str(t))
    assert highest.min() < highest.max()  # the surface has subsided somewhere


def test_no_surcharge_gets_below_a_roof():
    code = np.full((3, 1, 2), STAGNANT)
    code[1, 0, 0] = OUTSIDE
    code[2, 0, 0] = VOID
    state = ground(code)
    loaded = effects()["surcharge"].state(state, {"stress": 1.0})
    assert loaded.weight[:, 0, 0].sum() == 0.0
    assert loaded.weight[2, 0, 1] == pytest.approx(1e3 * C**2)


def ground(code, zone=None, **more) -> State:
    """A state of weightless ground, for effects that look at codes and zones."""
    nothing = np.zeros(code.shape)
    given = {
        "experiment": SimpleNamespace(is_draw=True),
        "lattice": make_lattice(1.0, 1.0, 1.0, C),
        "code": code,
        "zone": np.full(code.shape, -1, np.int16) if zone is None else zone,
        "zone_root": np.full(code.shape, -1, np.int16),
        "zone_height": np.zeros(0),
        "own_shed": nothing,
        "steps_at_rest": nothing,
        "relaxation": 0.4,
        "weight": nothing,
        "shed_fraction": nothing,
        "edge": np.ones(code.shape, np.float32),
        "corner": np.ones(code.shape, np.float32),
        "coupling": UNCOUPLED,
    }
    return State(**given | more)


def test_compaction_keeps_the_mass_at_every_fill_level(filling):
    experiment = filling()
    plain = sweeps(experiment)
    for was, now in zip(plain, sweeps(experiment, on("compaction", index=0.2)), strict=True):
        scale = np.ones(len(was.weight))
        scale[-1] = was.top_fraction
        mass = (was.weight * scale[:, None, None]).sum(dtype=np.float64)
        assert now.weight.sum(dtype=np.float64) == pytest.approx(mass, rel=1e-6)
    density = now.weight[:, 0, 0].astype(np.float64)  # of the full bed, all levels whole
    depth = np.arange(len(density))[::-1] + 0.5
    slope = np.diff(np.log(density)) / np.diff(np.log(depth))
    np.testing.assert_allclose(slope, 0.2, rtol=1e-4)


def test_compaction_keeps_the_mass_of_a_bed_to_be_drawn(pillar):
    plain, compact = sweeps(pillar())[0], sweeps(pillar(), on("compaction", index=0.2))[0]
    total = plain.weight.sum(dtype=np.float64)
    assert compact.weight.sum(dtype=np.float64) == pytest.approx(total, rel=1e-6)
    assert compact.weight[0, 0, 0] > plain.weight[0, 0, 0] > compact.weight[-1, 0, 0]


def test_loosened_ground_loses_the_solids_of_its_added_porosity(pillar):
    plain = sweeps(pillar())[-1]
    loose = sweeps(pillar(), on("loosening_density", porosity_increase=0.1))[-1]
    ratio = loose.weight[plain.code == MOVEMENT] / plain.weight[plain.code == MOVEMENT]
    solid = DENSITY / 2700
    np.testing.assert_allclose(ratio, (solid - 0.1) / solid, rtol=1e-6)
    still = plain.code != MOVEMENT
    np.testing.assert_array_equal(loose.weight[still], plain.weight[still])


# ---------------------------------------------------------------------------------------------
# packings


def test_packing_variability_has_the_stated_scatter_and_keeps_the_mean(filling):
    cv, replicates = 0.3, 400
    small = filling(geometry={"height": 0.2}, filling=None)
    first = [s.shed_fraction for s in sweeps(small, on("packing_variability", cv=cv),
                                             replicates=replicates)]  # fmt: skip
    shed = np.array([field[0, 0, 0] for field in first], dtype=np.float64)
    assert all(np.ptp(field) == 0.0 for field in first)  # one factor for the whole replicate
    zeta = math.sqrt(math.log1p(cv**2))
    # 400 replicates: the standard error of a standard deviation is zeta / sqrt(800)
    assert np.std(np.log(shed)) == pytest.approx(zeta, abs=4 * zeta / math.sqrt(800))
    assert shed.mean() == pytest.approx(1 - E, abs=4 * (1 - E) * cv / math.sqrt(400))


def test_segregation_shifts_s_by_the_size_of_the_cell_and_keeps_its_mean(filling):
    slope, still = 3.0, {"s": {"mean": 4.0, "std": 0.0}}
    experiment = filling(stress=still, geometry={"cell_size": 0.025}, filling=None)
    (sweep,) = sweeps(experiment, on("segregation", slope=slope))
    s = -2.0 * np.log2(sweep.edge.astype(np.float64))
    half = 0.5 * slope * math.log(10)  # particles of 2 to 20 mm
    assert np.abs(s - 4.0).max() <= half * (1 + 1e-5)
    count = s.size  # uniform: sd = half / sqrt(3)
    assert s.mean() == pytest.approx(4.0, abs=4 * half / math.sqrt(3 * count))
    assert s.std() == pytest.approx(half / math.sqrt(3), rel=0.05)


def test_particles_of_one_size_do_not_segregate(filling):
    experiment = filling(material={"particle_size": [0.01, 0.01]})
    plain, on_ = run(experiment)[0], run(experiment, [on("segregation", slope=5.0)])[0]
    np.testing.assert_array_equal(on_.vertical_stress, plain.vertical_stress)


def test_arches_that_never_fade_keep_the_weights_of_the_place(pillar):
    before, *_, after = sweeps(pillar(), on("arch_memory", persistence=1.0))
    np.testing.assert_allclose(after.edge, before.edge, rtol=1e-6)
    np.testing.assert_allclose(after.corner, before.corner, rtol=1e-6)
    assert np.any(sweeps(pillar())[-1].edge != before.edge)


# ---------------------------------------------------------------------------------------------
# paths of load


@pytest.mark.parametrize("angles", [(5.0, 0.0), (-20.0, 10.0), (0.0, 40.0)])
@pytest.mark.parametrize("s", [(2.0, 0.0), (4.0, 3.0), (30.0, 0.0)])
def test_tilt_shifts_the_mean_weights_by_the_tangent(filling, angles, s):
    experiment = filling(stress={"s": {"mean": s[0], "std": s[1]}}, filling=None)
    (sweep,) = sweeps(experiment, on("tilt", angle_x=angles[0], angle_y=angles[1]))
    total = 1.0 + 4.0 * (np.float64(sweep.edge) + sweep.corner)
    beta = np.array([np.mean(w / total) for w in (1.0, sweep.edge, sweep.corner)])[RING]
    leaning = beta * np.exp(OFFSETS @ [sweep.coupling.lean_x, sweep.coupling.lean_y])
    shift = leaning @ OFFSETS / leaning.sum()
    np.testing.assert_allclose(shift, np.tan(np.radians(angles)), atol=1e-6)


def test_straight_share_of_stagnant_ground_decays_with_increments_drawn(pillar):
    rate = 0.02
    kept = sweeps(pillar(), on("relaxation_in_time", rate=rate))
    increments = np.array([0, 10, 20, 30, 40])  # 5 kg between readings, 0.5 kg at a time
    for sweep, steps in zip(kept, increments, strict=True):
        factor = sweep.coupling.straight.astype(np.float64)
        aside = 4.0 * (np.float64(sweep.edge) + sweep.corner)
        decay = factor / (factor + aside) * (1.0 + aside)
        stagnant = sweep.code == STAGNANT
        np.testing.assert_allclose(decay[stagnant], math.exp(-rate * steps), rtol=1e-5)
        np.testing.assert_array_equal(factor[~stagnant], 1.0)


def test_more_readings_do_not_age_the_ground(pillar):
    few, many = (
        sweeps(pillar(readings={"every": every}), on("relaxation_in_time", rate=0.02))[-1]
        for every in (10.0, 1.0)
    )
    still = (few.code == STAGNANT) & (many.code == STAGNANT)
    np.testing.assert_array_equal(few.coupling.straight[still], many.coupling.straight[still])


def test_R_falls_with_the_width_of_the_pillar_beside_the_zone():
    #                 wide ground, zone of 0, pillar of two cells, zone of 1, and its pocket
    code = np.array([STAGNANT] * 2 + [MOVEMENT] * 4 + [STAGNANT] * 2 + [MOVEMENT] * 5, np.int8)
    zone = np.array([-1] * 2 + [0] * 4 + [-1] * 2 + [1] * 5, np.int16)
    code[10], zone[10] = STAGNANT, -1
    state = ground(code[None, None], zone[None, None])
    width = 0.3
    field = relax_beside_pillars(state, {"width": width}).coupling.relaxation[0, 0]
    R, pillar = 0.4, 2 * C
    narrowness = {i: (i - 1) / 5 / pillar for i in range(2, 6)}  # 0 at wide ground, 1/W at 6
    narrowness |= {i: (13 - i) / 6 / pillar for i in (8, 9, 11, 12)}  # 1/W at 7, 0 at the wall
    for i, n in narrowness.items():
        assert field[i] == pytest.approx(R / (1 + width * n), rel=1e-6)
    turned = ground(code[None, :, None], zone[None, :, None])
    along_y = relax_beside_pillars(turned, {"width": width}).coupling.relaxation[0, :, 0]
    np.testing.assert_array_equal(along_y[code == MOVEMENT], field[code == MOVEMENT])


def test_one_drawpoint_makes_no_pillar(pillar):
    alone = pillar(
        drawpoints=[{"name": "left", "x": 0.3, "y": 0.1, "width": 0.12, "length": 0.2}],
        draw=[{"drawpoints": ["left"], "mass": 20.0, "increment": 0.5}],
    )
    for sweep in sweeps(alone, on("pillar_relaxation", width=1.0)):
        np.testing.assert_array_equal(sweep.coupling.relaxation, np.float32(0.3))


def test_transmission_bends_at_half_the_overburden(filling):
    slope = 0.4
    experiment = filling(geometry={"width": 0.1, "length": 0.1}, load_cells=None)
    stress = 0.0
    expected = []
    for _ in range(10):  # one cell wide: the recursion by hand
        stress += DENSITY * GRAVITY * C
        expected.append(stress)
        shed = (1 - E) * (stress / (DENSITY * GRAVITY * 1.0 / 2)) ** slope
        stress *= 1 - min(shed, 1.0)
    found = means(experiment, on("stress_dependent_transmission", slope=slope))
    np.testing.assert_allclose(found[1:], np.array(expected)[[6, 9]] / 1e3, rtol=1e-12)


def test_all_that_is_shed_beyond_E_comes_back_by_arching(pillar):
    """With full transfer a zone sheds as much in all as it would at rest, walls included."""
    walls = on("wall_friction", K=0.3)
    for sweep in sweeps(pillar(), walls, on("arching", transfer=1.0))[1:]:
        granular = np.isin(sweep.code, (STAGNANT, MOVEMENT))
        carried = np.where(granular, sweep.load, 0.0)[1:].astype(np.float64)
        own = sweep.coupling.own_shed.astype(np.float64)[1:]
        shed = sweep.weight.sum(dtype=np.float64) - sweep.base_load.sum()
        assert shed == pytest.approx((carried * own).sum(), rel=1e-4)


def test_cohesion_acts_in_force_over_a_face(pillar):
    sweep = sweeps(pillar(), on("cohesion", stress=0.5))[-1]
    assert sweep.coupling.cohesion == pytest.approx(500 * 0.04**2)


# ---------------------------------------------------------------------------------------------
# sensors


def test_sensors_read_what_their_equations_say(pillar):
    experiment = pillar()
    plain = run(experiment)[0]
    mass = np.array([0.0, 5, 10, 15, 20])
    active = [
        on("sensor_offset", "zone", offset=0.7),
        on("sensor_gain", "zone", gain=1.1),
        on("sensor_drift", "zone", rate=0.01),
        on("sensor_gain", "outer", gain=0.9),
    ]
    (found,) = run(experiment, active)
    expected = plain.vertical_stress.copy()
    expected[:, 1] = 1.1 * (1 + 0.01 * mass) * expected[:, 1] + 0.7
    expected[:, 2] *= 0.9
    np.testing.assert_allclose(found.vertical_stress, expected, rtol=1e-14)
    same = replace(found, vertical_stress=plain.vertical_stress)
    for name, value in vars(same).items():  # the ground itself is as it was
        np.testing.assert_array_equal(value, vars(plain)[name])
