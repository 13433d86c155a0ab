"""The commands of ``python -m pipeline``: each public module of this folder is one.

A module's docstring is the command's help, its first line the line in the list. It has
``add_arguments(parser)``, which declares the command's arguments, and ``run(arguments)``, which
does the work and returns the exit status. What is wrong with a user's files or arguments is raised
as ``ConfigError``: it is printed as it is, and the exit status is 1. A name that Python keeps for
itself gets an underscore, which the command has not (``import_.py``).

All modules are imported whenever one command runs, so what is slow to import (numba, xarray) is
imported inside ``run``.
"""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType


def commands() -> dict[str, ModuleType]:
    """Modules of the commands by name, sorted."""
    names = sorted(m.name for m in iter_modules(__path__) if not m.name.startswith("_"))
    return {name.rstrip("_"): import_module(f"{__name__}.{name}") for name in names}
