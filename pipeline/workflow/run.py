"""`python -m pipeline.workflow.run [SNAKEMAKE ARGUMENTS]`: the README's run command.

Snakemake locks its folder while it works. A run that was killed leaves the lock behind; it is
cleared here, but only when no Snakemake process works in the folder.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import psutil


def main(arguments: list[str]) -> int:
    """Run Snakemake here with `arguments`; its exit status, or 1 if the folder is in use."""
    folder = Path.cwd()
    snakemake = [sys.executable, "-m", "snakemake"]
    if any((folder / ".snakemake" / "locks").glob("*")):
        holders = snakemake_processes(folder)
        if holders:
            pids = ", ".join(str(process.pid) for process in holders)
            print(
                f"Snakemake is already working in {folder} (process {pids}): wait until it has "
                f"finished, or stop it, then run this again.",
                file=sys.stderr,
            )
            return 1
        print("A run that was stopped left its lock behind; clearing it.", file=sys.stderr)
        subprocess.run([*snakemake, "--unlock", "--quiet", "all"], check=True)
    return subprocess.run([*snakemake, *arguments], check=False).returncode


def snakemake_processes(folder: Path) -> list[psutil.Process]:
    """Other processes of Snakemake, or of one of its jobs, whose working folder is `folder`."""
    found = []
    family = {process.pid for process in [psutil.Process(), *psutil.Process().parents()]}
    for process in psutil.process_iter():
        try:
            if process.pid in family or Path(process.cwd()) != folder:
                continue
            if any(
                "snakemake" in Path(part).name or ".snakemake" in part for part in process.cmdline()
            ):
                found.append(process)
        except (psutil.Error, OSError):
            continue  # it has ended, or belongs to another user
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
