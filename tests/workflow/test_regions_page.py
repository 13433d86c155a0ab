"""`docs/regions.md`, done as a reader does it: files written, commands run, results as it says."""

import re

import pytest

from pipeline.config.load import load_experiment
from pipeline.config.regions import Region
from pipeline.files.netcdf import read_dataset
from pipeline.lattice.block_model import build_block_model

pytestmark = pytest.mark.workflow

BLOCK = re.compile(r"^```(\w+) ?(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def page(repository):
    return (repository / "docs" / "regions.md").read_text("utf-8")


def test_the_page_does_what_it_says(fresh, page):
    said, kinds = "", []
    for kind, file, content in BLOCK.findall(page):
        kinds.append(kind)
        if kind in ("yaml", "csv"):
            path = fresh.folder / file
            path.parent.mkdir(exist_ok=True)
            path.write_text(content, "utf-8")
        elif kind == "sh":
            said = fresh.shell(content)
        else:
            assert kind == "text"
            for line in content.splitlines():
                pattern = r"\d*".join(map(re.escape, line.split("…")))
                assert any(re.fullmatch(pattern, one) for one in said.splitlines()), said
    assert {"yaml", "csv", "sh", "text"} == set(kinds)
    folder = fresh.folder / "my_results" / "experiments" / "two_ores"
    assert 'id="figure-drawn_dilution"' in (folder / "report.html").read_text("utf-8")
    assert '<a href="grade.csv">' in (folder / "report.html").read_text("utf-8")
    regions = read_dataset(folder / "block_model.nc")["region"]
    assert regions.attrs["flag_meanings"] == "no_region low_grade high_grade cap"
    by_rock = load_experiment(fresh.folder / "my_experiments" / "by_rock.yaml")
    assert [region.name for region in by_rock.regions] == ["ore", "cap"]
    grade = build_block_model(by_rock)["grade_Cu"].values
    assert sorted({*grade.ravel()}) == [0.0, 0.4, 0.8, 0.9, 1.2]
    settings = ("--config", "experiments_dir=my_experiments", "results_dir=my_results")
    assert fresh.pending("my_results/experiments/two_ores/report.html", *settings) == set()


def test_a_changed_file_of_a_region_reruns_the_block_model(fresh):
    """Its bytes count, not its date."""
    folder = fresh.folder / "mine"
    folder.mkdir()
    (folder / "a.yaml").write_text(
        "geometry: {width: 0.2, length: 0.2, height: 0.2, cell_size: 0.1}\n"
        "material: {name: a, bulk_density: 1600, particle_density: 2700}\n"
        "regions: [{name: ore, mask: ore.nc}]\n"
        "stress: {E: 0.9, s: 2}\n"
    )
    write = "import numpy, xarray; a = numpy.ones((2, 2, 2)); {change}"
    write += "xarray.Dataset({{'ore': (('z', 'y', 'x'), a)}}).to_netcdf('mine/ore.nc')"
    target = "out/experiments/a/block_model.nc"
    settings = ("--config", "experiments_dir=mine", "results_dir=out")
    assert fresh.python("-c", write.format(change="")).returncode == 0
    process = fresh.snakemake(target, *settings)
    assert process.returncode == 0, process.stdout
    assert fresh.pending(target, *settings) == set()
    assert fresh.python("-c", write.format(change="a[0] = 0; ")).returncode == 0
    assert fresh.pending(target, *settings) == {("a", "block_model")}


def test_every_key_of_a_region_is_on_the_page(page):
    keys = page.partition("## What a region says")[2].partition("\n## ")[0]
    for key in Region.model_fields:
        assert f"`{key}`" in keys
