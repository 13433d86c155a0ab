"""Every malformed file of the corpus gives one error that names the file, the key and the remedy.

Expectations stand in the files' first lines: ``# expect: TEXT``, one or more.
"""

from pathlib import Path

import pytest
from specs import expectations

from pipeline.config.load import (
    load_comparison,
    load_experiment,
    load_experiments,
    load_import_settings,
    load_study,
)

BAD = Path(__file__).parent / "bad"
EXPERIMENTS = sorted((BAD / "experiments").glob("*/*.yaml"))
STUDIES = sorted((BAD / "studies").glob("*.yaml"))
COMPARISONS = sorted((BAD / "comparisons").glob("*.yaml"))
IMPORTS = sorted((BAD / "imports").glob("*.yaml"))
TABLES = sorted((BAD / "experiments").glob("*/measured/*.csv"))


def identify(path: Path) -> str:
    return path.stem


@pytest.mark.parametrize("path", EXPERIMENTS, ids=identify)
def test_bad_experiment_is_named_with_key_and_remedy(path, message):
    text = message(load_experiments, path.parent)
    assert path.parent.name in text.splitlines()[0]
    expected = expectations(path)
    assert expected
    for part in expected:
        assert part in text


@pytest.mark.parametrize("path", TABLES, ids=identify)
def test_bad_table_is_named_with_line_and_column(path, message):
    text = message(load_experiment, next(path.parents[1].glob("*.yaml")))
    assert text.splitlines()[0].endswith(f"measured/{path.name}")
    expected = expectations(path)
    assert expected
    for part in expected:
        assert part in text


LOADED_BY = {
    **dict.fromkeys(STUDIES, load_study),
    **dict.fromkeys(COMPARISONS, load_comparison),
    **dict.fromkeys(IMPORTS, load_import_settings),
}


@pytest.mark.parametrize("path", LOADED_BY, ids=identify)
def test_bad_study_comparison_or_import_is_named_with_key_and_remedy(path, message):
    text = message(LOADED_BY[path], path)
    assert text.splitlines()[0].endswith(path.name)
    expected = expectations(path)
    assert expected
    for part in expected:
        assert part in text


def test_the_corpus_is_large_enough():
    kinds = (EXPERIMENTS, STUDIES, COMPARISONS, IMPORTS, TABLES)
    assert all(len(kind) >= 7 for kind in kinds)
    assert sum(map(len, kinds)) >= 150
