"""What a reader is told where E was carried to cells of another size."""

import pytest

from pipeline.calibrate.carried import carried_statements
from pipeline.parameters import Parameters, declared_parameters


def calibration(E: float, interval_open: bool = False) -> dict:
    """`calibration.json` of a laboratory test on cells of 0.1 m."""
    used = Parameters(cell_size=0.1, E=E, s_mean=8.0, s_std=7.0)
    return {
        "experiment": "laboratory",
        "parameters_used": used.to_document(),
        "derived": {"hydraulic_radius": {"value": 0.5}},
        "parameters": {"E": {"interval_open": interval_open}},
    }


def declared(experiment, document):
    source = Parameters.from_document(document["parameters_used"])
    return declared_parameters(experiment, {"laboratory": source})


@pytest.fixture
def mine(column):
    """A column of 400 m on cells of 2 m, 40 m wide and long."""
    return column(
        geometry={"width": 40, "length": 40, "height": 400, "cell_size": 2},
        stress={"E": None, "from": "laboratory", "s": None},
    )


def test_length_saturation_and_janssen_s_length_are_told(mine):
    document = calibration(0.995)
    first, second = carried_statements(mine, document, declared(mine, document))
    assert "E = 0.995 of laboratory, on cells of 0.1 m, is carried to cells of 2 m" in first
    assert "E = 0.9, ℓ = 20 m (there 20 m)" in first
    assert "At rest 0.05 of the column's weight reaches the base" in first  # 20 of 400 m
    assert "what lies more than 60 m above the base adds less than 5%" in first
    assert "ℓ would be 400 m" in second  # R_h 10 m for 0.5 m


def test_a_column_that_is_not_saturated_is_not_called_so(mine):
    document = calibration(0.9995)
    first, _ = carried_statements(mine, document, declared(mine, document))
    assert "saturated" not in first


def test_an_interval_that_the_laboratory_leaves_open_is_told(mine):
    document = calibration(0.995, interval_open=True)
    assert "do not bound E" in list(carried_statements(mine, document, declared(mine, document)))[2]


def test_cells_of_the_same_size_need_no_word(column):
    same = column(stress={"E": None, "from": "laboratory", "s": None})
    document = calibration(0.995)
    assert list(carried_statements(same, document, declared(same, document))) == []
