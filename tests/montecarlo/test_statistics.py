"""Statistics over replicates are the ones that NumPy gives."""

import numpy as np
import pytest
import xarray as xr

from pipeline.montecarlo.statistics import replicate_statistics


@pytest.fixture(scope="module")
def replicates():
    rng = np.random.default_rng(4)
    return xr.Dataset(
        {
            "vertical_stress": (("replicate", "time", "load_cell"), rng.normal(9, 2, (11, 3, 2))),
            "base_vertical_stress": (("replicate", "time"), rng.normal(9, 2, (11, 3))),
            "hang_ups": ("replicate", rng.integers(0, 9, 11)),
            "drawn_cell": (("replicate", "extraction"), rng.integers(0, 9, (11, 5))),
            "replicate_vertical_stress": (
                ("replicate", "time", "z", "y", "x"),
                rng.normal(9, 2, (11, 3, 2, 2, 2)),
            ),
            "fill_height": ("time", [0.1, 0.2, 0.3]),
        },
        coords={
            "time": [0.0, 1, 2],
            "replicate": np.arange(11),
            "load_cell_x": ("load_cell", [1.0, 2.0]),
        },
    )


@pytest.mark.parametrize("name", ["vertical_stress", "base_vertical_stress", "hang_ups"])
def test_statistics_equal_numpy(replicates, name):
    statistics, values = replicate_statistics(replicates), replicates[name].values
    std = values.std(axis=0, ddof=1)
    expected = {
        "mean": values.mean(axis=0),
        "std": std,
        "se": std / np.sqrt(11),
        "p05": np.quantile(values, 0.05, axis=0),
        "p50": np.median(values, axis=0),
        "p95": np.quantile(values, 0.95, axis=0),
    }
    for suffix, value in expected.items():
        found = statistics[f"{name}_{suffix}"]
        assert found.dims == replicates[name].dims[1:]
        np.testing.assert_allclose(found, value, rtol=1e-12)
    assert int(statistics["replicate_count"]) == 11


def test_what_has_no_replicates_stays_and_records_stay_behind(replicates):
    statistics = replicate_statistics(replicates)
    xr.testing.assert_identical(
        statistics["fill_height"].drop_vars("realization"), replicates["fill_height"]
    )
    assert "load_cell_x" in statistics.coords
    assert "replicate" not in statistics.dims
    assert not any(name.startswith(("drawn_cell", "replicate_vertical")) for name in statistics)


def test_one_replicate_has_no_standard_error(replicates):
    statistics = replicate_statistics(replicates.isel(replicate=[3]))
    values = replicates["base_vertical_stress"].values[3]
    np.testing.assert_array_equal(statistics["base_vertical_stress_mean"], values)
    np.testing.assert_array_equal(statistics["base_vertical_stress_p95"], values)
    assert np.isnan(statistics["base_vertical_stress_std"]).all()
    assert np.isnan(statistics["base_vertical_stress_se"]).all()
