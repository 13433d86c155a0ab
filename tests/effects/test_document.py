"""docs/add_an_effect.md: its file, dropped into the folder, is all that it takes."""

import importlib
import re
import sys

import numpy as np
import pytest
import yaml
from runs import run
from specs import COLUMN, merged

import pipeline.effects
from pipeline.config.load import load_experiment
from pipeline.effects import declared_effects, effects


@pytest.fixture
def blocks(repository):
    """language → code block of the document."""
    text = (repository / "docs" / "add_an_effect.md").read_text(encoding="utf-8")
    return dict(re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL))


@pytest.fixture
def dropped(tmp_path, blocks):
    """The document's effect, in a folder that counts as part of the package's."""
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "wet_foot.py").write_text(blocks["python"], encoding="utf-8")
    pipeline.effects.__path__.append(str(folder))
    importlib.invalidate_caches()
    effects.cache_clear()
    yield
    pipeline.effects.__path__.remove(str(folder))
    sys.modules.pop("pipeline.effects.wet_foot", None)
    effects.cache_clear()


def test_the_document_shows_all_that_an_effect_needs(dropped, blocks, tmp_path, filling):
    content = merged(COLUMN, yaml.safe_load(blocks["yaml"]))
    path = tmp_path / "wet.yaml"
    path.write_text(yaml.safe_dump(content))
    experiment = load_experiment(path)
    (active,) = declared_effects(experiment)
    assert active.values == {"water": 0.3}
    plain, wet = run(experiment, [])[0], run(experiment, [active])[0]
    assert wet.vertical_stress[0, 0] > plain.vertical_stress[0, 0]
    assert wet.weight_balance_error.max() < 1e-6

    lowest = []
    run(
        filling(),
        [active],
        inspect=lambda t, sweep, state: lowest.append(sweep.weight[:2, 0, 0].copy()),
    )
    np.testing.assert_allclose(lowest[-1][0] / lowest[-1][1], 1.3, rtol=1e-6)


def test_its_values_are_checked_like_any_other(dropped, tmp_path):
    path = tmp_path / "wet.yaml"
    path.write_text(yaml.safe_dump(merged(COLUMN, {"effects": {"wet_foot": {"water": 2}}})))
    with pytest.raises(ValueError, match=r"wet_foot.water = 2: expected a number from 0 to 1"):
        load_experiment(path)


def test_without_the_file_the_effect_is_unknown(tmp_path):
    path = tmp_path / "wet.yaml"
    path.write_text(yaml.safe_dump(merged(COLUMN, {"effects": {"wet_foot": {"water": 0.3}}})))
    with pytest.raises(ValueError, match="unknown effect"):
        load_experiment(path)
