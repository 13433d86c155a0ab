"""Experiments: what loads, what it means, and that it comes back from its own resolved form."""

import copy
import json
import math
import pickle
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.config import effects as effects_module
from pipeline.config.effects import known_effects
from pipeline.config.experiment import Experiment
from pipeline.config.load import (
    check_measured,
    digest,
    load_experiment,
    load_experiments,
    resolved,
)
from pipeline.config.messages import ConfigError, shown

STATIC = {
    "geometry": {"width": 0.1, "length": 0.08, "height": 0.5, "cell_size": 0.02},
    "material": {"name": "gravel", "bulk_density": 970, "particle_density": 2670},
    "stress": {"E": 0.54, "s": {"mean": 2.0, "std": 0.1}},
}
DRAW = {
    "geometry": {"width": 0.3, "length": 0.1, "height": 0.4, "cell_size": 0.02},
    "material": {"name": "ore", "bulk_density": 1420, "particle_density": 2600},
    "walls": {"friction_angle": 25},
    "stress": {
        "E": 0.9895,
        "s": 4,
        "R": 0.29,
        "E_min": {"type": "table", "height": [0.0, 0.4], "value": [0.93, 0.96]},
    },
    "flow": {"exponent": 3.0, "bulking": 0.15},
    "drawpoints": [{"name": "D1", "x": 0.1, "y": 0.05, "width": 0.06, "length": 0.1}],
    "draw": [{"drawpoints": ["D1"], "mass": 2.0, "increment": 0.2}],
    "readings": {"every": 0.5},
    "load_cells": [{"name": "C1", "x": 0.05, "y": 0.05, "width": 0.04, "length": 0.1}],
}


def write(folder: Path, content, name: str = "column") -> Path:
    path = folder / f"{name}.yaml"
    text = content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False)
    path.write_text(text, encoding="utf-8")
    return path


def changed(base: dict, dotted: str, value) -> dict:
    content = copy.deepcopy(base)
    *way, last = dotted.split(".")
    inner = content
    for key in way:
        inner = inner.setdefault(key, {})
    inner[last] = value
    return content


def test_name_and_paths_follow_the_file(tmp_path):
    write(tmp_path, changed(STATIC, "geometry.mask", {"type": "file", "path": "ground.nc"}))
    (tmp_path / "ground.nc").touch()
    column = load_experiment(tmp_path / "column.yaml")
    assert column.name == "column"
    assert column.path == tmp_path / "column.yaml"
    assert column.files == {("geometry", "mask", "path"): tmp_path / "ground.nc"}
    assert column.measured_path is None
    assert (column.is_draw, column.mass_scheduled) == (False, 0)


def test_experiments_are_frozen(tmp_path):
    column = load_experiment(write(tmp_path, STATIC))
    with pytest.raises(ValueError):
        column.seed = 3


def test_E_follows_from_attenuation_length(tmp_path):
    content = changed(STATIC, "stress", {"attenuation_length": 0.04, "s": 2})
    fraction = load_experiment(write(tmp_path, content)).E
    assert fraction == pytest.approx(0.5)
    assert load_experiment(write(tmp_path, STATIC)).E == 0.54


def test_s_as_a_number_has_no_scatter(tmp_path):
    column = load_experiment(write(tmp_path, changed(STATIC, "stress.s", 3)))
    assert (column.stress.s.mean, column.stress.s.std) == (3.0, 0.0)


def test_numbers_may_have_exponents_without_a_point(tmp_path):
    text = yaml.safe_dump(STATIC) + "seed: 0\n"
    column = load_experiment(write(tmp_path, text.replace("0.02", "2e-2").replace("970", "9.7E+2")))
    assert column.geometry.cell_size == 0.02
    assert column.material.bulk_density == 970


def test_cylinder_fills_the_smaller_side():
    content = changed(STATIC, "geometry.mask", {"type": "cylinder"})
    assert Experiment.model_validate(content).geometry.diameter == 0.08
    assert Experiment.model_validate(STATIC).geometry.diameter is None


def test_E_min_has_a_power_form():
    E_min = {"type": "power", "at_height": 0.5, "value": 0.9}
    stress = Experiment.model_validate(changed(DRAW, "stress.E_min", E_min)).stress
    assert (stress.E_min.at_height, stress.E_min.value, stress.E_min.exponent) == (0.5, 0.9, 0.5)


def test_published_numbers_load():
    content = changed(STATIC, "published", {"vertical_stress_mean": 0.48, "test": 4})
    assert Experiment.model_validate(content).published.test == 4


def test_digest_sees_values_not_spelling(tmp_path):
    first = load_experiment(write(tmp_path, STATIC))
    same = load_experiment(write(tmp_path, "# a comment\n" + json.dumps(STATIC), "other"))
    spelled_out = load_experiment(write(tmp_path, resolved(first), "third"))
    other = load_experiment(write(tmp_path, changed(STATIC, "seed", 2), "fourth"))
    assert digest(first) == digest(same) == digest(spelled_out) != digest(other)
    assert resolved(first)["replicates"] == 10


def test_effects_are_read_with_numbers_options_and_load_cells(tmp_path):
    content = changed(DRAW, "effects.wall_friction", {"K": 1, "reach": "face", "cap": False})
    content = changed(content, "effects.sensor_gain", {"C1": {"gain": 1.1}})
    loaded = load_experiment(write(tmp_path, content))
    assert loaded.effects == content["effects"]
    assert isinstance(loaded.effects["wall_friction"]["K"], float)
    again = load_experiment(write(tmp_path, resolved(loaded), "again"))
    assert digest(again) == digest(loaded)


def test_effects_of_draw_may_stand_in_a_static_experiment(tmp_path):
    content = changed(STATIC, "effects", {"arching": {"transfer": 0.5}, "arch_memory": {}})
    assert load_experiment(write(tmp_path, content)).effects == content["effects"]


def test_experiments_without_effects_load_without_the_catalogue(tmp_path):
    path = write(tmp_path, changed(STATIC, "effects", {}))
    code = (
        "import sys; from pipeline.config.load import load_experiment; "
        f"load_experiment({str(path)!r}); print('numpy' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"


def test_known_effects_are_the_public_modules_of_the_package(tmp_path, monkeypatch):
    for module in ("__init__", "tilt", "_registry"):
        (tmp_path / f"{module}.py").touch()

    package = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    monkeypatch.setattr(effects_module, "find_spec", lambda name: package)
    assert known_effects() == ("tilt",)
    monkeypatch.setattr(effects_module, "find_spec", lambda name: None)
    assert known_effects() == ()


def test_folder_loads_both_endings_in_order(tmp_path):
    write(tmp_path, STATIC, "b")
    write(tmp_path, STATIC, "a").rename(tmp_path / "a.yml")
    (tmp_path / "notes.txt").touch()
    assert list(load_experiments(tmp_path)) == ["a", "b"]


def test_folder_reports_every_file_at_once(tmp_path, message):
    write(tmp_path, changed(STATIC, "stress.E", 54), "a")
    write(tmp_path, changed(STATIC, "seed", -1), "b")
    write(tmp_path, changed(STATIC, "stress", {"from": "a"}), "c")
    text = message(load_experiments, tmp_path)
    assert "a.yaml\n  stress.E = 54" in text
    assert "b.yaml\n  seed = -1" in text
    assert "c.yaml" not in text  # what it refers to is there, and reported itself


@pytest.mark.parametrize("names", [("a.yaml", "a.yml")])
def test_two_files_of_one_name_are_refused(tmp_path, names, message):
    for name in names:
        (tmp_path / name).write_text(yaml.safe_dump(STATIC))
    assert "a.yaml has the same name; rename one" in message(load_experiments, tmp_path)


def test_missing_and_empty_folders_are_named(tmp_path, message):
    assert "holds no experiments" in message(load_experiments, tmp_path)
    assert "no such folder" in message(load_experiments, tmp_path / "none")


def test_missing_file_names_its_neighbors(tmp_path, message):
    write(tmp_path, STATIC)
    assert "no such file; did you mean column.yaml?" in message(
        load_experiment, tmp_path / "colum.yaml"
    )
    assert "cannot be read" in message(load_experiment, tmp_path)


def test_paths_below_the_working_directory_are_relative(tmp_path, monkeypatch, message):
    path = write(tmp_path, changed(STATIC, "stress.E", 98.95))
    monkeypatch.chdir(tmp_path)
    assert message(load_experiment, path) == (
        "column.yaml\n  stress.E = 98.95: expected a fraction in (0, 1]; did you mean 0.9895?"
    )


def test_from_gives_what_draw_needs(tmp_path, message):
    taker = changed(DRAW, "stress", {"from": "source"})
    del taker["flow"]
    write(tmp_path, taker, "taker")
    write(tmp_path, DRAW, "source")
    assert load_experiments(tmp_path)["taker"].stress.from_ == "source"
    write(tmp_path, STATIC, "source")
    text = message(load_experiments, tmp_path)
    assert "flow: missing here and in source; draw needs it" in text
    assert "stress.R: missing" in text
    assert "stress.E_min: missing" in text


def test_from_in_a_circle_is_refused(tmp_path, message):
    write(tmp_path, changed(STATIC, "stress", {"from": "b"}), "a")
    write(tmp_path, changed(STATIC, "stress", {"from": "a"}), "b")
    write(tmp_path, changed(STATIC, "stress", {"from": "a"}), "c")
    assert "leads back to itself (a → b → a)" in message(load_experiments, tmp_path)


def test_long_values_are_shortened():
    assert len(shown("x" * 200)) == 40
    assert shown(list(range(100))) == "[0, 1, 2, 3, 4, 5, 6, 7, 8, ...]"
    assert len(shown(10**400)) < 41


def test_check_measured_without_a_table_is_empty():
    assert check_measured(Experiment.model_validate(STATIC)) == ()


# ---------------------------------------------------------------------------------------------
# properties


def numbers(least, most, **more):
    return st.floats(least, most, allow_nan=False, allow_subnormal=False, **more)


@st.composite
def valid_experiments(draw) -> dict:
    width, length, height = (draw(numbers(0.1, 10)) for _ in range(3))
    least = min(width, length, height)
    cell_size = draw(numbers(least / 50, least))
    particle_density = draw(numbers(200, 9000))
    E = draw(numbers(0.1, 1))
    content = {
        "title": draw(st.text(max_size=20)),
        "geometry": {"width": width, "length": length, "height": height, "cell_size": cell_size},
        "material": {
            "name": draw(st.text("abc xyz", min_size=1)),
            "bulk_density": draw(numbers(100, particle_density)),
            "particle_density": particle_density,
        },
        "stress": {"s": draw(st.one_of(numbers(-5, 50), st.integers(0, 9)))},
        "replicates": draw(st.integers(1, 1000)),
        "seed": draw(st.integers(0, 2**63 - 1)),
        "keep_fields": draw(st.booleans()),
    }
    if draw(st.booleans()):
        content["stress"]["E"] = E
    else:
        content["stress"]["attenuation_length"] = cell_size * draw(numbers(1.01, 100))
    if draw(st.booleans()):
        content["walls"] = {"friction_angle": draw(numbers(0, 89.9))}
    if draw(st.booleans()):
        content["geometry"]["mask"] = draw(
            st.sampled_from(
                [
                    {"type": "cylinder"},
                    {"type": "cylinder", "diameter": min(width, length) / 2},
                ]
            )
        )
    if draw(st.booleans()):
        content["load_cells"] = [
            {
                "name": f"C{n}",
                "x": width / 2,
                "y": length / 2,
                "width": width / (n + 1),
                "length": length / (n + 2),
            }
            for n in range(draw(st.integers(1, 3)))
        ]
    if draw(st.booleans()):
        shares = draw(st.lists(numbers(0.05, 1), min_size=1, max_size=4, unique=True))
        content["filling"] = {"levels": sorted(height * share for share in shares)}
        return content
    bed = content["material"]["bulk_density"] * width * length * height
    mass = bed * draw(numbers(0.01, 0.3))
    content["stress"] |= {
        "R": draw(numbers(0, 1)),
        "E_min": draw(
            st.sampled_from(
                [
                    {"type": "power", "at_height": height, "value": 0.05, "exponent": 0.3},
                    {"type": "table", "height": [0.0, height], "value": [0.0, 0.1]},
                ]
            )
        ),
    }
    content["flow"] = {"exponent": draw(numbers(0, 9)), "bulking": draw(numbers(0, 1))}
    content["drawpoints"] = [
        {"name": "D1", "x": width / 2, "y": length / 2, "width": width / 3, "length": length / 3}
    ]
    content["draw"] = [{"drawpoints": ["D1"], "mass": mass, "increment": mass / 7}] * 2
    content["readings"] = draw(
        st.sampled_from(
            [
                {"every": mass / 3},
                {"at_mass_drawn": [mass / 2, mass]},
            ]
        )
    )
    content["calibrate"] = draw(
        st.lists(
            st.sampled_from(["E", "s.mean", "s.std", "E_min", "R", "exponent", "bulking"]),
            unique=True,
        )
    )
    return content


in_one_folder = settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@in_one_folder
@given(content=valid_experiments())
def test_resolved_experiment_loads_as_the_same(tmp_path, content):
    first = load_experiment(write(tmp_path, json.dumps(content)))
    assert load_experiment(write(tmp_path, json.dumps(resolved(first)))) == first
    assert resolved(first)["geometry"]["width"] == content["geometry"]["width"]
    assert first.E is None or 0 < first.E <= 1


def places(content, way=()):
    yield way
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in pairs if isinstance(content, dict | list) else ():
        if isinstance(value, dict | list):
            yield from places(value, (*way, key))
        else:
            yield (*way, key)


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**6), 10**6),
    st.just(10**400),
    st.floats(),
    st.text(max_size=8),
    st.just([]),
    st.just({}),
    st.just([[1]]),
    st.just({"type": "table"}),
    st.just([None]),
    st.just({"": 1}),
    st.just({1: 2}),
    st.sampled_from(["E", "D1", "1e", "0x1"]),
)


@in_one_folder
@given(data=st.data())
def test_any_wrong_value_gives_a_message_in_house_style(tmp_path, assert_in_house_style, data):
    content = copy.deepcopy(data.draw(st.sampled_from([STATIC, DRAW])))
    for _ in range(data.draw(st.integers(1, 3))):
        way = data.draw(st.sampled_from([way for way in places(content) if way]))
        inner = content
        for key in way[:-1]:
            inner = inner[key]
        inner[way[-1]] = copy.deepcopy(data.draw(JUNK))
    path = write(tmp_path, yaml.safe_dump(content, allow_unicode=True))
    try:
        loaded = load_experiment(path)
    except ConfigError as error:
        assert_in_house_style(str(error))
    else:
        assert all(math.isfinite(value) for value in (loaded.geometry.width, loaded.seed))


SPLICES = st.sampled_from(
    [
        "\t",
        ":",
        "{",
        "}",
        "[",
        "]",
        "&a ",
        "*a",
        "!!map ",
        "!!set ",
        "!x ",
        "? ",
        "- ",
        "#",
        "|",
        ">",
        "<<: ",
        "'",
        '"',
        "\\ud800",
        "---\n",
        "...\n",
        "%TAG",
        "\x00",
        "\x85",
        "é",
        "1e999",
        "0o7",
        "~",
    ]
)


@in_one_folder
@given(data=st.data())
def test_any_broken_text_gives_a_message_in_house_style(tmp_path, assert_in_house_style, data):
    text = yaml.safe_dump(data.draw(st.sampled_from([STATIC, DRAW])))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text)))
        text = text[:place] + data.draw(SPLICES) + text[place + data.draw(st.integers(0, 3)) :]
    try:
        load_experiment(write(tmp_path, text))
    except ConfigError as error:
        assert_in_house_style(str(error))


def test_json_is_read_as_yaml(tmp_path):
    content = changed(STATIC, "title", "\U0001f3d4 column")
    path = write(tmp_path, json.dumps(content))
    assert load_experiment(path).title == "\U0001f3d4 column"


def test_merged_mappings_may_be_overridden(tmp_path):
    text = (
        yaml.safe_dump(STATIC)
        + """
load_cells:
- &first {name: C1, x: 0.03, y: 0.04, width: 0.04, length: 0.04}
- {<<: *first, name: C2, x: 0.07}
"""
    )
    loaded = load_experiment(write(tmp_path, text)).load_cells
    assert [(cell.name, cell.x, cell.width) for cell in loaded] == [
        ("C1", 0.03, 0.04),
        ("C2", 0.07, 0.04),
    ]


def test_experiments_travel_between_processes(tmp_path):
    box = load_experiment(write(tmp_path, DRAW, "box"))
    again = pickle.loads(pickle.dumps(box))
    assert again == box
    assert again.name == "box"
