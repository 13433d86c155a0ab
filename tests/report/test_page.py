"""Numbers, tables and their data, apart from any experiment."""

import math

import numpy as np
import pytest
from markupsafe import escape

from pipeline.report.page import Badge, Data, Link, Number, Table, decimals_of, parts, plain


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (32.4912, 2, "32.49"),
        (0.98971, None, "0.9897"),
        (-0.5, 1, "−0.5"),
        (-0.0004, 2, "0.00"),
        (12, 0, "12"),
    ],
)
def test_a_number_is_shown_rounded_and_kept_in_full(value, decimals, text):
    html = str(escape(Number(value, decimals)))
    assert html == f'<data value="{plain(value)}">{text}</data>'


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_a_missing_number_is_a_dash(value):
    assert escape(Number(value)) == "–"


@pytest.mark.parametrize(
    ("scale", "decimals"), [(32.49, 2), (0.68, 4), (1500.0, 0), (0.0, 3), (math.nan, 3)]
)
def test_decimals_give_four_significant_digits(scale, decimals):
    assert decimals_of(scale) == decimals


def test_texts_are_escaped_everywhere():
    evil = '<script>&"'
    for html in (escape(Badge(evil)), escape(Link(evil, evil)), parts("a {}", evil)):
        assert "<script>" not in html
        assert "&lt;script&gt;&amp;" in html


def test_data_is_long_and_reads_back():
    data = Data()
    data.add("f", "p", "s", "x (m)", [0.5, 1.0], "y (kPa)", [1.0, np.nan], [0.5, 0.5], None)
    data.number("t", "row", "column", np.float64(1 / 3), unit="m")
    data.number("t", "row", "empty", None)
    lines = data.to_csv().splitlines()
    assert lines[0] == "figure,panel,series,x_name,x,y_name,y,y_low,y_high"
    assert lines[1:] == ["f,p,s,x (m),0.5,y (kPa),1,0.5,", "f,p,s,x (m),1,y (kPa),,0.5,",
                         "t,row,column,,,m,0.3333333333,,"]  # fmt: skip
    assert data.to_records()[0]["y"] == 1.0


def test_grouped_columns_and_empty_columns():
    table = Table("t", "caption", ["name", "a: x", "a: y", "b"], Data())
    table.add_numbers("first", [(1.0, 0), (None, None), (2.0, 1)])
    table.add_numbers("second", [(1.5, 1), (math.nan, None), (None, 1)])
    table.without_empty_columns()
    assert table.columns == ["name", "a: x", "b"]
    assert table.heads == [("", ["name"]), ("a", ["x"]), ("", ["b"])]
    heads = [("", "name"), ("a", "x"), ("", "b")]
    assert [table.has_numbers(*head) for head in heads] == [False, True, True]
