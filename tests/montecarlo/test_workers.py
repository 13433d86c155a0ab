"""Workers on this machine: who does the jobs, what comes back, and what a death says."""

import os
import signal
import threading
import time

import pytest

from pipeline.montecarlo.workers import Execution, WorkersLostError, crew, pieces, run_tasks

KINDS = {
    "here": (Execution(1), False),
    "threads": (Execution(2), False),
    "processes": (Execution(2), True),
}


@pytest.fixture(params=KINDS)
def ready(request):
    """A crew of one of the kinds."""
    execution, processes = KINDS[request.param]
    with crew(execution, "column", processes) as workers:
        yield request.param, workers


def _who(shared, number):
    time.sleep(0.01)
    return shared + number, os.getpid(), threading.get_ident()


def test_every_job_is_done_once_by_the_workers_asked_for(ready):
    kind, workers = ready
    results = dict(workers.each(_who, [(k,) for k in range(20)], 100))
    assert [results[k][0] for k in range(20)] == list(range(100, 120))
    processes = {process for _, process, _ in results.values()}
    threads = {thread for *_, thread in results.values()}
    if kind == "processes":
        assert len(processes) == 2
        assert os.getpid() not in processes
    else:
        assert processes == {os.getpid()}
        assert len(threads) == workers.workers
        assert (threading.get_ident() in threads) == (kind == "here")


def test_no_job_is_no_result(ready):
    assert list(ready[1].each(_who, [], 0)) == []


def _fails(_, number):
    if number == 3:
        raise ValueError("number 3")
    return number


def test_the_error_of_a_job_ends_the_others(ready):
    with pytest.raises(ValueError, match="number 3"):
        list(ready[1].each(_fails, [(k,) for k in range(1000)], None))


def test_results_do_not_pile_up_while_nobody_takes_them():
    started = []
    with crew(Execution(2)) as workers:
        results = workers.each(lambda _, k: started.append(k), [(k,) for k in range(100)], None)
        next(results)
        time.sleep(0.1)
        assert len(started) <= 4
        assert len(list(results)) == 99


def _dies(_, number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_killed_process_says_what_was_running_and_what_helps():
    with (
        crew(Execution(2), "my_column", processes=True) as workers,
        pytest.raises(WorkersLostError) as caught,
    ):
        list(workers.each(_dies, [(k,) for k in range(8)], None))
    for words in ("my_column", "memory", "the next run goes on", "fewer --cores"):
        assert words in str(caught.value)


def test_tasks_give_their_results_in_order():
    tasks = [lambda k=k: time.sleep(0.02 / (k + 1)) or k for k in range(8)]
    assert run_tasks(tasks, Execution(2)) == list(range(8))
    assert run_tasks(tasks, Execution(2), processes=True) == list(range(8))


def test_short_work_is_a_task_for_each_worker_and_long_work_many():
    assert pieces(0.1, 2) == 2
    assert pieces(20.0, 2) == 8
    assert pieces(3600.0, 2) == 240


def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    file = tmp_path / "child"
    parent = os.fork()
    if parent == 0:

        def linger(_, __):
            file.write_text(str(os.getpid()))
            time.sleep(60)

        with crew(Execution(2), processes=True) as workers:
            list(workers.each(linger, [(0,), (1,)], None))
        os._exit(0)
    deadline = time.monotonic() + 30
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    child = int(file.read_text())
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    while _alive(child):
        assert time.monotonic() < deadline, "it outlives its parent"
        time.sleep(0.05)


def _alive(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
