"""The JSON schemas for editors stay in step with the models."""

import json

from pipeline.config.schema import FOLDER, MODELS, main, schema_text, stale_lines


def test_schema_files_are_in_step_with_the_models():
    assert stale_lines(FOLDER) == [], "run python -m pipeline.config.schema"


def test_check_shows_what_is_stale(tmp_path, capsys):
    assert main(["--folder", str(tmp_path)]) == 0
    assert main(["--check", "--folder", str(tmp_path)]) == 0
    path = tmp_path / "study.schema.json"
    path.write_text(path.read_text().replace("max_effects", "most_effects"))
    assert main(["--check", "--folder", str(tmp_path)]) == 1
    assert '+    "max_effects"' in capsys.readouterr().err


def properties(schema):
    if isinstance(schema, dict):
        for key, value in schema.items():
            if key == "properties":
                yield from value.items()
            yield from properties(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from properties(value)


def test_every_key_is_described():
    for name in MODELS:
        for key, value in properties(json.loads(schema_text(name))):
            assert "description" in value or "$ref" in value, f"{name}: {key}"
