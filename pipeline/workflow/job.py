"""What every rule's script does first."""

from __future__ import annotations

import logging
import sys
from pathlib import Path


def log_to(path: str | Path) -> None:
    """Send log messages, and the traceback of an error that ends the job, to the rule's log."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(
        filename=path,
        filemode="w",
        level=logging.INFO,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    logging.captureWarnings(True)

    def to_log(kind, error, traceback):
        logging.critical("the job failed", exc_info=(kind, error, traceback))
        print(f"{kind.__name__}: {error} (log: {path})", file=sys.stderr)

    sys.excepthook = to_log
