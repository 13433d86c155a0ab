"""Table 5 of Gómez & Castro (2022) with the published parameters; nothing is calibrated.

Means do not vary from packing to packing (weight is conserved), so their checks cannot fail by
chance. The tolerances of the spatial standard deviations are at least 5 standard errors of 20
replicates: a fresh seed fails one of the four with a probability below 1e-5. The seed is fixed.
"""

import numpy as np
import pytest

from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

REPLICATES = 20
GRAVEL, GLASS = 1150, 970  # kg m-3, the declared bulk densities of the two, exchanged


@pytest.fixture(scope="module")
def simulated(published):
    """simulated(name, bulk_density): mean and spatial sd of the base stress, kPa, by replicate."""

    def run(name, bulk_density=None):
        changes = {} if bulk_density is None else {"material": {"bulk_density": bulk_density}}
        experiment = published(name, **changes)
        assert experiment.seed == 2022
        setup = make_setup(experiment)
        parameters = declared_parameters(experiment)
        readings, _ = run_replicates(setup, parameters, REPLICATES, Execution(2), fields=False)
        return tuple(
            readings[name].values[:, -1]
            for name in ("base_vertical_stress", "base_vertical_stress_std")
        )

    return run


@pytest.mark.parametrize(
    ("name", "bulk_density", "mean", "mean_tolerance", "std", "std_tolerance"),
    [
        ("castro_2006", None, 42.45, 0.05, 20.35, 0.6),
        ("castro_2006", 1452, 32.4, 0.1, 15.6, 0.5),
        ("orellana_2012", None, 8.57, 0.05, 6.5, 0.3),
        ("castro_2020", None, 19.44, 0.05, 5.8, 0.3),
    ],
)
def test_tests_1_to_3_have_the_known_mean_and_spatial_scatter(
    simulated, name, bulk_density, mean, mean_tolerance, std, std_tolerance
):
    means, stds = simulated(name, bulk_density)
    assert means.mean() == pytest.approx(mean, abs=mean_tolerance)
    assert stds.mean() == pytest.approx(std, abs=std_tolerance)
    standard_error = stds.std(ddof=1) / np.sqrt(REPLICATES)
    assert std_tolerance > 5 * standard_error, "the tolerance no longer is 5 standard errors"


@pytest.mark.parametrize(
    ("name", "declared", "density", "exchanged"),
    [
        ("seditest_gravel_paperboard", 0.414, GRAVEL, 0.490),
        ("seditest_gravel_fine_sandpaper", 0.327, GRAVEL, 0.388),
        ("seditest_gravel_coarse_sandpaper", 0.309, GRAVEL, 0.367),
        ("seditest_glass_paperboard", 0.800, GLASS, 0.675),
        ("seditest_glass_fine_sandpaper", 0.730, GLASS, 0.616),
        ("seditest_glass_coarse_sandpaper", 0.637, GLASS, 0.538),
    ],
)
def test_tests_4_to_9_have_the_known_means_as_declared_and_with_densities_exchanged(
    simulated, name, declared, density, exchanged
):
    assert simulated(name)[0].mean() == pytest.approx(declared, abs=1e-3)
    means, stds = simulated(name, density)
    assert means.mean() == pytest.approx(exchanged, abs=1e-3)
    low, high = (0.015, 0.045) if "gravel" in name else (0.055, 0.095)
    assert low < stds.mean() < high


def test_the_mean_over_the_base_does_not_vary_from_packing_to_packing(simulated):
    means, stds = simulated("seditest_glass_paperboard")
    assert means.std() < 1e-9 * means.mean()
    assert stds.std() > 1e-3 * stds.mean()


@pytest.mark.parametrize(
    ("name", "mean", "std"), [("orellana_2012", 8.65, 6.37), ("castro_2020", 19.51, 5.37)]
)
def test_what_the_paper_simulated_is_reproduced_as_declared(simulated, name, mean, std):
    means, stds = simulated(name)
    assert means.mean() == pytest.approx(mean, rel=0.01)
    assert stds.mean() == pytest.approx(std, rel=0.12)
