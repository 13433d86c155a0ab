"""JSON schemas of the files a user may write, for editors: ``python -m pipeline.config.schema``."""

import argparse
import difflib
import json
import sys
from pathlib import Path

from pipeline.config.comparison import Comparison
from pipeline.config.experiment import Experiment
from pipeline.config.imports import ImportSettings
from pipeline.config.study import Study

FOLDER = Path(__file__).parents[2] / "workflow_configs" / "schema"
MODELS = {
    "experiment.schema.json": Experiment,
    "study.schema.json": Study,
    "comparison.schema.json": Comparison,
    "import.schema.json": ImportSettings,
}


def schema_text(name: str) -> str:
    """Text of the schema file ``name``, one of ``MODELS``."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(head | MODELS[name].model_json_schema(), indent=2) + "\n"


def write_schemas(folder: Path = FOLDER) -> None:
    """Write every schema file into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in MODELS:
        (folder / name).write_text(schema_text(name), encoding="utf-8")


def stale_lines(folder: Path = FOLDER) -> list[str]:
    """Unified diff from the schema files in ``folder`` to those of the models; [] in step."""
    lines: list[str] = []
    for name in MODELS:
        path = folder / name
        old = path.read_text(encoding="utf-8") if path.is_file() else ""
        lines += difflib.unified_diff(
            old.splitlines(), schema_text(name).splitlines(), name, f"{name} (models)", lineterm=""
        )
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Write the schemas; with --check return 1 when those written are stale."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when stale")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the schemas lie")
    chosen = parser.parse_args(arguments)
    if not chosen.check:
        write_schemas(chosen.folder)
        return 0
    lines = stale_lines(chosen.folder)
    print(*lines, sep="\n", end="\n" if lines else "", file=sys.stderr)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
