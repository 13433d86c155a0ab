"""What effects make of measured and of discrete-element data, in numbers."""

from dataclasses import replace

import numpy as np
import pytest
from fits import Case, fit, on, rms

WALLS = ("paperboard", "fine_sandpaper", "coarse_sandpaper")
DEM = ("base_rough_mu000", "base_rough_mu020", "base_rough_mu035", "base_rough_mu060",
       "base_rough_mu090", "wide_rough_mu035")  # fmt: skip
LOG_SHED = (-14.0, -1e-3)  # bounds of log(1 − E)
K_BOUNDS = (0.0, 5.0)


def with_E(case, log_shed, **more):
    return replace(case.parameters, E=-np.expm1(log_shed), **more)


def columns(cases, log_shed, active=()):
    """Simulated stresses of static columns of one E, kPa."""
    return np.concatenate([case.simulated(with_E(case, log_shed), active) for case in cases])


def measured(cases):
    return np.concatenate([case.measured for case in cases])


# ---------------------------------------------------------------------------------------------
# Seditest, Tests 4–9: measured means under three walls, two materials


@pytest.fixture(scope="module")
def seditest():
    """material → its three tests."""
    return {
        material: [Case(f"seditest_{material}_{wall}") for wall in WALLS]
        for material in ("gravel", "glass")
    }


def seditest_errors(seditest, log_shed, K, **options):
    """Simulated less measured, kPa; one E and one K for each material."""
    return np.concatenate(
        [
            columns(cases, u, [on("wall_friction", K=k, **options)]) - measured(cases)
            for cases, u, k in zip(seditest.values(), log_shed, K, strict=True)
        ]
    )


def fitted_per_material(seditest, **options):
    """E and K of each material by least squares; their values and the errors, kPa."""
    values, errors = [], []
    for material, cases in seditest.items():
        one = {material: cases}

        def of(x, one=one):
            return seditest_errors(one, x[:1], x[1:], **options)

        x = fit(of, [-2.0, 0.3], np.transpose([LOG_SHED, K_BOUNDS]))
        values.append(x)
        errors.append(of(x))
    return np.array(values), np.concatenate(errors)


def test_wall_friction_fits_seditest_to_8_pa(seditest):
    values, errors = fitted_per_material(seditest)
    assert rms(errors) <= 0.008
    assert rms(errors) == pytest.approx(0.0024, abs=2e-4)  # four parameters, six numbers
    np.testing.assert_allclose(values[:, 1], [0.889, 0.568], atol=0.01)  # K of gravel, glass


def test_one_K_for_both_materials_of_seditest_costs_10_pa(seditest):
    def of(x):
        return seditest_errors(seditest, x[:2], [x[2], x[2]])

    x = fit(of, [-2.0, -2.0, 0.5], np.transpose([LOG_SHED, LOG_SHED, K_BOUNDS]))
    assert rms(of(x)) == pytest.approx(0.012, abs=5e-4)


def test_seditest_without_walls_is_off_by_55_pa(seditest):
    def of(x):
        return seditest_errors(seditest, x, [0.0, 0.0])

    x = fit(of, [-1.0, -1.0], np.transpose([LOG_SHED, LOG_SHED]))
    assert rms(of(x)) == pytest.approx(0.055, abs=5e-4)


def test_walls_that_reach_the_outer_cells_alone_fit_gravel_worse(seditest):
    _, errors = fitted_per_material({"gravel": seditest["gravel"]}, reach="face")
    assert rms(errors) == pytest.approx(0.025, abs=1e-3)


# ---------------------------------------------------------------------------------------------
# discrete-element columns: five wall frictions, two widths, every fill level


def test_wall_friction_explains_the_dem_columns_with_one_E_and_one_K():
    cases = [Case(f"dem_column_{name}") for name in DEM]
    wanted = measured(cases)

    def of(x):
        active = [on("wall_friction", K=x[1])] if len(x) > 1 else []
        return columns(cases, x[0], active) / wanted - 1

    walls = fit(of, [-4.0, 0.3], np.transpose([LOG_SHED, K_BOUNDS]))
    without = min((fit(of, [u], LOG_SHED) for u in (-2.0, -5.0)), key=lambda x: rms(of(x)))
    assert len(wanted) == 29
    assert rms(of(walls)) == pytest.approx(0.075, abs=0.005)
    assert rms(of(without)) == pytest.approx(0.37, abs=0.01)


# ---------------------------------------------------------------------------------------------
# discrete-element draw box: two layouts fitted, one held out


@pytest.mark.slow
def test_walls_and_arching_on_the_dem_draw_box():
    """Neither helps here: one box cannot tell K from E, and its two layouts want no transfer."""
    cases = {name: Case(f"dem_box_{name}", 2) for name in ("isolated", "panel", "block_wide")}

    def errors(name, x):
        case = cases[name]
        active = [on("wall_friction", K=x[3]), on("arching", transfer=x[4])] if len(x) > 3 else []
        parameters = with_E(case, x[0], E_min_shift=x[1], R=x[2])
        return np.log(case.simulated(parameters, active) / case.measured)

    def of(x):
        return np.concatenate([errors(name, x) for name in ("isolated", "panel")])

    bounds = np.transpose([LOG_SHED, (-3.0, 3.0), (0.0, 1.0), (0.0, 3.0), (0.0, 1.0)])
    start = [-4.0, 0.0, 0.5, 0.4, 0.5]
    baseline = fit(of, start[:3], bounds[:, :3], step=1e-2)
    coupled = fit(of, start, bounds, step=1e-2)
    assert rms(of(coupled)) <= rms(of(baseline)) + 1e-3
    assert coupled[4] < 0.05
    held_out = [rms(errors("block_wide", x)) for x in (baseline, coupled)]
    np.testing.assert_allclose(held_out, 0.31, atol=0.03)
    assert held_out[1] == pytest.approx(held_out[0], abs=0.01)
