"""Real Dask clusters on the loopback, from the commands that a user gives."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from distributed import get_worker

SECONDS = 60.0


class Cluster:
    """A `dask scheduler` and its `dask worker` processes, each with its nanny in a group."""

    def __init__(self, folder: Path, environment: dict[str, str]):
        self._folder, self._environment = folder, environment
        file = folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)
        )
        self.address = _wait(lambda: file.is_file() and json.loads(file.read_text())["address"])
        self.workers = []

    def add_worker(self, memory: str = "0") -> None:
        """One more worker of one thread; `memory` as `--memory-limit` takes it, 0 for none."""
        arguments = ("--nthreads", "1", "--memory-limit", memory, "--host", "127.0.0.1")
        folder = ("--local-directory", str(self._folder))
        self.workers.append(self._start("worker", self.address, *arguments, *folder))

    def _start(self, command: str, *arguments: str) -> subprocess.Popen:
        with open(self._folder / "dask.log", "a") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", command, *arguments, "--no-dashboard"],
                cwd=self._folder,
                env=self._environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )

    def stop(self) -> None:
        """End all its processes."""
        for process in (*self.workers, self.scheduler):
            kill(process)


def kill(process: subprocess.Popen) -> None:
    """Kill a process and its children; nothing if it has ended."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@contextmanager
def dask_cluster(folder: Path, workers: int = 2, code: Path | None = None, memory="0", **settings):
    """A running cluster; `code` is the folder whose `pipeline` it has, `settings` are Dask's."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {f"DASK_{key}": str(value) for key, value in settings.items()}
    code = code or Path(__file__).parents[1]
    environment["PYTHONPATH"] = os.pathsep.join([str(code), str(Path(__file__).parent)])
    cluster = Cluster(folder, environment)
    try:
        for _ in range(workers):
            cluster.add_worker(memory)
        yield cluster
    finally:
        cluster.stop()


def _wait(ready):
    deadline = time.monotonic() + SECONDS
    while not (result := ready()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return result


class Counted:
    """Knows when it was unpickled."""

    def __init__(self, pause):
        self.pause, self.when = pause, None

    def __setstate__(self, state):
        self.__dict__ = state | {"when": time.time()}


def slowly(shared, number):
    """Its number, the worker that did it, and when that got what is shared."""
    time.sleep(shared.pause)
    return number, get_worker().address, shared.when


def break_at_three(_, number):
    """A task that fails."""
    if number == 3:
        raise ZeroDivisionError("in replicate 3")
