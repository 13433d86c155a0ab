"""Digests of the code that a rule's result depends on, for Snakemake to see when it changes."""

from __future__ import annotations

import ast
import atexit
import hashlib
import json
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

from pipeline.files.atomic import whole_file

PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".pyc", ".smk")
MEMORY = Path(".snakemake") / "pipeline_modules.json"


@cache
def source_digest(script: str) -> str:
    """Digest of the code that a rule's script runs: itself and all of `pipeline` it imports.

    Comments and layout do not count; data files beside a module do.
    """
    return digest_with_imports(PACKAGE / "workflow" / "scripts" / f"{script}.py")


def effects_digest() -> str:
    """Digest of all effects: they are found by being in their folder, not by an import."""
    modules = sorted((PACKAGE / "effects").glob("*.py"))
    return sha256("".join(f"{m.name}{digest_with_imports(m)}" for m in modules))


@cache
def digest_with_imports(path: Path) -> str:
    seen: dict[Path, str] = {}
    todo = [path]
    while todo:
        path = todo.pop()
        if path not in seen:
            seen[path], imported = _read_module(path)
            todo += imported
    return sha256("".join(f"{path.name}{seen[path]}" for path in sorted(seen)))


@cache
def _read_module(path: Path) -> tuple[str, list[Path]]:
    """Digest of a module with the data files beside it, and the modules here that it imports."""
    code, names = _MEMORY.read(path.read_text("utf-8"))
    imported = [target for name in names if (target := _path_of(name)) is not None]
    return sha256(code + _data_digest(path.parent)), imported


@cache
def _data_digest(folder: Path) -> str:
    data = sorted(f for f in folder.iterdir() if f.is_file() and f.suffix not in CODE)
    return "".join(sha256(f.read_text("utf-8")) for f in data)


class _Memory:
    """Digests and imports of module texts, kept between runs: to parse them all takes a second.

    They are found by the text itself, so that none can be out of date.
    """

    def __init__(self):
        self._kept: dict[str, list] | None = None

    def read(self, text: str) -> tuple[str, list[str]]:
        """Digest of a module's code and the names that it imports."""
        if self._kept is None:
            self._kept = self._load()
            atexit.register(self._save, len(self._kept))
        key = sha256(sys.version + text)
        if key not in self._kept:
            self._kept[key] = _parsed(text)
        return self._kept[key]

    def _load(self) -> dict[str, list]:
        with suppress(OSError, ValueError):
            return json.loads(MEMORY.read_text("utf-8"))
        return {}

    def _save(self, known: int) -> None:
        if len(self._kept) > known and MEMORY.parent.is_dir():
            with suppress(OSError), whole_file(MEMORY) as partial:
                partial.write_text(json.dumps(self._kept), "utf-8")


_MEMORY = _Memory()


def _parsed(text: str) -> list:
    tree = ast.parse(text)
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [sha256(ast.dump(tree)), names]


def _path_of(module: str) -> Path | None:
    """Source file of a module of this package; None for anything else."""
    head, *rest = module.split(".")
    if head != PACKAGE.name:
        return None
    path = PACKAGE.joinpath(*rest)
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def sha256(text: str) -> str:
    """SHA-256 (hex) of a text."""
    return hashlib.sha256(text.encode()).hexdigest()
