"""What leaves the pipeline: VTK files, the table of base stress, the block model."""

import base64
import csv
import re
import shutil
import zlib
from itertools import islice
from xml.etree import ElementTree

import numpy as np
import pytest
from specs import MINE_ORIGIN as ORIGIN

from pipeline.__main__ import main
from pipeline.config.messages import ConfigError
from pipeline.files.export import FORMATS, export
from pipeline.files.netcdf import read_dataset
from pipeline.files.vtk import Grid, write_image_data


def table(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ---------------------------------------------------------------------------------------------
# VTK: read again by the letter of the format, with nothing of the writer


def parse_vti(path):
    """Attributes of the image and its cell arrays (z, y, x), from the XML and base64 alone."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib == {
        "type": "ImageData",
        "version": "1.0",
        "byte_order": "LittleEndian",
        "header_type": "UInt64",
        "compressor": "vtkZLibDataCompressor",
    }
    image, appended = root.find("ImageData"), root.find("AppendedData")
    piece = image.find("Piece")
    assert piece.attrib["Extent"] == image.attrib["WholeExtent"]
    _, nx, _, ny, _, nz = map(int, piece.attrib["Extent"].split())
    text = appended.text.strip()
    assert appended.attrib["encoding"] == "base64"
    assert text.startswith("_")
    kinds = {"Float32": "<f4", "Float64": "<f8", "UInt8": "u1", "Int32": "<i4", "Int8": "i1"}
    arrays = {}
    for array in piece.find("CellData"):
        at = 1 + int(array.attrib["offset"])
        count = np.frombuffer(base64.b64decode(text[at : at + 12])[:8], "<u8")[0]
        length = 4 * -(-8 * (3 + int(count)) // 3)
        head = np.frombuffer(base64.b64decode(text[at : at + length]), "<u8")
        sizes = head[3:].astype(int)
        coded = 4 * -(-int(sizes.sum()) // 3)
        data = base64.b64decode(text[at + length : at + length + coded])
        ends = np.cumsum(sizes)
        blocks = [
            zlib.decompress(data[end - size : end]) for size, end in zip(sizes, ends, strict=True)
        ]
        assert all(len(block) == head[1] for block in blocks[:-1])
        assert len(blocks[-1]) == (head[2] or head[1])
        values = np.frombuffer(b"".join(blocks), kinds[array.attrib["type"]])
        arrays[array.attrib["Name"]] = values.reshape(nz, ny, nx)
    return image.attrib, arrays


def test_an_image_has_every_value_at_its_place(tmp_path):
    values = np.arange(2 * 3 * 4, dtype=np.float32).reshape(2, 3, 4)
    write_image_data(tmp_path / "a.vti", Grid((1.5, -2.0, 1e6), (10.0, 10.0, 5.0)), {"a": values})
    image, arrays = parse_vti(tmp_path / "a.vti")
    assert image["WholeExtent"] == "0 4 0 3 0 2"
    assert [float(n) for n in image["Origin"].split()] == [1.5, -2.0, 1e6]
    assert [float(n) for n in image["Spacing"].split()] == [10.0, 10.0, 5.0]
    np.testing.assert_array_equal(arrays["a"], values)


@pytest.mark.parametrize("cells", [131072, 262144, 262145, 700001])
def test_blocks_of_compressed_data_add_up(tmp_path, cells):
    """Below, at and just above whole blocks of 2^20 bytes."""
    values = np.random.default_rng(1).normal(size=(1, 1, cells)).astype(np.float32)
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    write_image_data(tmp_path / "a.vti", grid, {"a": values, "b": -values})
    arrays = parse_vti(tmp_path / "a.vti")[1]
    np.testing.assert_array_equal(arrays["a"], values)
    np.testing.assert_array_equal(arrays["b"], -values)


def test_arrays_of_two_shapes_are_refused(tmp_path):
    cells = {"a": np.zeros((1, 2, 3), np.float32), "b": np.zeros((3, 2, 1), np.float32)}
    with pytest.raises(ValueError, match=r"b has shape \(3, 2, 1\)"):
        write_image_data(tmp_path / "a.vti", Grid((0, 0, 0), (1, 1, 1)), cells)
    assert list(tmp_path.iterdir()) == []


def test_the_series_names_each_reading_with_its_clock(folder):
    target = export(folder, "vtk")
    fields = read_dataset(folder / "fields.nc")
    (series,) = target.glob("*.pvd")
    steps = ElementTree.parse(series).getroot().findall("Collection/DataSet")
    clock = fields["mass_drawn" if "mass_drawn" in fields else "fill_height"].values
    assert [float(step.attrib["timestep"]) for step in steps] == clock.tolist()
    for t, step in enumerate(steps):
        arrays = parse_vti(target / step.attrib["file"])[1]
        np.testing.assert_array_equal(
            arrays["vertical_stress_mean_kpa"], fields["vertical_stress_mean"].values[t]
        )


def test_files_of_an_earlier_export_do_not_stay(written, tmp_path):
    target = tmp_path / "vtk"
    target.mkdir()
    (target / "column_0099.vti").write_text("old")
    export(written("static")[1], "vtk", target)
    assert sorted(path.name for path in target.iterdir()) == [
        "column.pvd",
        "column_0000.vti",
        "column_0001.vti",
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["vtk"]


def test_mine_coordinates_are_kept(written, tmp_path):
    experiment, folder = written("mine")
    image, _ = parse_vti(export(folder, "vtk", tmp_path / "vtk") / "mine_0000.vti")
    assert [float(n) for n in image["Origin"].split()] == list(ORIGIN.values())
    rows = table(export(folder, "csv", tmp_path / "a.csv"))
    cell = next(row for row in rows if row["name"] == "beside")
    assert float(cell["easting_m"]) == ORIGIN["easting"] + experiment.load_cells[0].x
    assert float(cell["northing_m"]) == ORIGIN["northing"] + experiment.load_cells[0].y
    first = table(export(folder, "block_model", tmp_path / "b.csv"))[0]
    half = experiment.geometry.cell_size / 2
    corner = [float(first[f"centroid_{axis}"]) - half for axis in "xyz"]
    np.testing.assert_allclose(corner, list(ORIGIN.values()), rtol=1e-11)


# ---------------------------------------------------------------------------------------------
# base stress


def test_base_stress_is_that_of_the_replicates(folder, tmp_path):
    rows = table(export(folder, "csv", tmp_path / "a.csv"))
    replicates = read_dataset(folder / "replicates.nc")
    names = [name.decode() for name in replicates["load_cell_name"].values]
    checked = set()
    for row in rows:
        if row["place"] == "drawpoint":
            continue
        if row["place"] == "base":
            values = replicates["base_vertical_stress"].values[:, int(row["period"])]
        else:
            place = names.index(row["name"])
            values = replicates["vertical_stress"].values[:, int(row["period"]), place]
        expected = {"mean": values.mean(), "std": values.std(ddof=1)}
        expected |= {f"p{p}": np.quantile(values, p / 100) for p in (10, 50, 90)}
        for name, value in expected.items():
            assert float(row[f"{name}_kpa"]) == pytest.approx(value, rel=1e-9)
            assert float(row[f"{name}_mpa"]) == pytest.approx(value / 1000, rel=1e-9)
        assert int(row["replicates"]) == len(values)
        checked.add((row["name"], row["period"]))
    cells = len(names) if "mass_drawn" in replicates else 0
    assert len(checked) == replicates.sizes["time"] * (1 + cells)


def test_base_stress_has_the_clock_of_its_kind(written, tmp_path):
    drawn = table(export(written("draw")[1], "csv", tmp_path / "a.csv"))
    assert [float(r["mass_drawn_t"]) for r in drawn if r["place"] == "base"] == [
        0.0,
        0.004,
        0.008,
        0.012,
    ]
    assert {row["fill_height_m"] for row in drawn} == {""}
    static = table(export(written("static")[1], "csv", tmp_path / "b.csv"))
    assert [float(row["fill_height_m"]) for row in static] == [0.3, 0.95]
    assert {row["mass_drawn_kg"] for row in static} == {""}


def test_stress_at_a_drawpoint_is_that_of_the_cells_it_covers(written, tmp_path):
    """The opening from 0.25 to 0.35 m by 0.2 to 0.3 m covers four cells of 0.05 m in full."""
    _, folder = written("mine")
    rows = table(export(folder, "csv", tmp_path / "a.csv"))
    kept = read_dataset(folder / "replicates.nc")["replicate_vertical_stress"].values
    for t in range(kept.shape[1]):
        row = next(r for r in rows if (r["place"], r["period"]) == ("drawpoint", str(t)))
        each = np.nan_to_num(kept[:, t, 0, 4:6, 5:7].astype(float)).mean(axis=(1, 2))
        assert float(row["mean_kpa"]) == pytest.approx(each.mean(), rel=1e-9)
        assert float(row["p90_kpa"]) == pytest.approx(np.quantile(each, 0.9), rel=1e-9)


def test_fields_alone_give_the_same_mean_at_a_drawpoint_and_no_percentiles(written, tmp_path):
    _, folder = written("mine")
    for name in ("block_model", "fields"):
        shutil.copy(folder / f"{name}.nc", tmp_path)
    replicates = read_dataset(folder / "replicates.nc").drop_vars("replicate_vertical_stress")
    replicates.to_netcdf(tmp_path / "replicates.nc")
    rows = [table(export(one, "csv", tmp_path / "a.csv")) for one in (folder, tmp_path)]
    full, less = ([row for row in some if row["place"] == "drawpoint"] for some in rows)
    for a, b in zip(full, less, strict=True):
        assert float(b["mean_kpa"]) == pytest.approx(float(a["mean_kpa"]), rel=1e-5)
        assert a["p50_kpa"]
        assert b["p50_kpa"] == ""


def test_what_came_out_of_the_drawpoints_is_what_was_drawn(written, tmp_path):
    folder = written("draw")[1]
    rows = table(export(folder, "csv", tmp_path / "a.csv"))
    drawn = [float(r["drawn_from_here_t"]) for r in rows if r["place"] == "drawpoint"]
    replicates = read_dataset(folder / "replicates.nc")
    expected = replicates["replicate_mass_drawn"].mean("replicate").values / 1000
    np.testing.assert_allclose(drawn, expected, rtol=1e-6)
    assert drawn[-1] == pytest.approx(0.012, rel=0.05)


# ---------------------------------------------------------------------------------------------
# block model


def test_the_block_model_has_one_row_for_each_ground_block(folder, tmp_path):
    rows = table(export(folder, "block_model", tmp_path / "a.csv"))
    model, fields = (read_dataset(folder / f"{name}.nc") for name in ("block_model", "fields"))
    ground = model["state"].values == 1
    assert len(rows) == ground.sum()
    z, y, x = np.nonzero(ground)
    for axis, index in zip("zyx", (z, y, x), strict=True):
        values = [float(row[f"centroid_{axis}"]) for row in rows]
        np.testing.assert_allclose(values, model[axis].values[index], rtol=1e-11)
    clock, unit = ("mass_drawn", "kg") if "mass_drawn" in fields else ("fill_height", "m")
    for t in (0, -1):
        column = f"vertical_stress_mean_kpa_at_{fields[clock].values[t]:g}{unit}"
        values = [float(row[column] or "nan") for row in rows]
        np.testing.assert_allclose(
            values, fields["vertical_stress_mean"].values[t][ground], rtol=1e-6
        )


def test_vulcan_gets_its_header(written, tmp_path):
    """Line 1 in lower case, lines 2 to 4 named in their first field, no data in the first seven."""
    folder = written("static")[1]
    path = export(folder, "vulcan", tmp_path / "a.csv")
    with open(path, newline="") as file:
        names, *headers, first = list(islice(csv.reader(file), 5))
    assert all(re.fullmatch("[a-z0-9_]+", name) for name in names)
    assert [row[0] for row in headers] == [
        "variable descriptions",
        "variable types",
        "variable defaults",
    ]
    for row in headers:
        assert row[1:7] == [""] * 6
        assert len(row) == len(names)
        assert not any("," in cell for cell in row)
    assert float(first[6]) == pytest.approx(0.001)
    text = path.read_text().splitlines()[4:]
    plain = export(folder, "block_model", tmp_path / "b.csv").read_text().splitlines()[1:]
    assert text == [re.sub(",(?=,|$)", ",-99", line) for line in plain]


# ---------------------------------------------------------------------------------------------
# the command


def test_the_command_says_where_the_file_went(written, tmp_path, capsys):
    folder = written("draw")[1]
    assert main(["export", str(folder), "--to", "csv", "--into", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'base_stress.csv'}\n"
    assert table(tmp_path / "base_stress.csv")


def test_the_command_offers_every_format():
    from pipeline.commands import export as command

    assert tuple(FORMATS) == command.FORMATS


def test_a_name_that_has_no_results_is_named_with_the_nearest(tmp_path, capsys):
    (tmp_path / "experiments" / "castro_2020").mkdir(parents=True)
    command = ["export", "castro_2002", "--results", str(tmp_path), "--to", "vtk"]
    assert main(command) == 1
    text = capsys.readouterr().err
    assert "castro_2002" in text
    assert "no such folder of results; did you mean castro_2020?" in text


def test_results_that_were_not_run_are_named_with_the_rule(written, tmp_path):
    (tmp_path / "block_model.nc").write_bytes((written("draw")[1] / "block_model.nc").read_bytes())
    with pytest.raises(ConfigError) as raised:
        export(tmp_path, "csv")
    text = str(raised.value)
    assert "fields.nc" in text
    assert "replicates.nc" in text
    assert text.count("no such file; run the workflow first (rule replicates)") == 2
    assert [path.name for path in tmp_path.iterdir()] == ["block_model.nc"]


# ---------------------------------------------------------------------------------------------
# regions


def test_an_image_has_regions_and_grades(written, tmp_path):
    folder = written("regions")[1]
    arrays = parse_vti(export(folder, "vtk", tmp_path / "vtk") / "regions_0000.vti")[1]
    model = read_dataset(folder / "block_model.nc")
    np.testing.assert_array_equal(arrays["region"], model["region"].fillna(-1))
    np.testing.assert_array_equal(arrays["grade_Au_g_t"], model["grade_Au"])
    assert set(np.unique(arrays["region"])) == {-1, 1, 2}


@pytest.mark.parametrize("to", ["block_model", "vulcan"])
def test_a_block_model_has_the_region_by_name_and_its_grades(written, tmp_path, to):
    rows = table(export(written("regions")[1], to, tmp_path / "a.csv"))
    grade = "grade_Au_g_t"
    if to == "vulcan":
        grade = grade.lower()
        types, defaults = rows[1], rows[2]
        assert (types["region"], types[grade]) == ("name", "double")
        assert (defaults["region"], defaults[grade]) == ("none", "-99")
        rows = rows[3:]
    for row in rows:
        low = float(row["centroid_z"]) < 0.4
        assert row["region"] == ("ore" if low else "cap")
        assert float(row[grade]) == (1.5 if low else 0.0)
        assert float(row["bulk_density_kg_m3"]) == (1600 if low else 1400)
    assert {row["region"] for row in rows} == {"ore", "cap"}
