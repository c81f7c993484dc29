"""pendulum_fmus.sweep: sweeps on Dask, whose workers, coordinator or scheduler are killed."""

import contextlib
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest
from dask.distributed import KilledWorker

import sweeps
from pendulum_fmus import sweep as driver
from pendulum_fmus.project import PROGRAM
from sweeps import SHORT, done, expected, journal_of, local


def options(sweep: Path, out: Path, *given: object) -> list[str]:
    """Return the options of the script, with two workers unless there is a scheduler."""
    where = [] if "--scheduler" in given else ["--workers", 2]
    return list(map(str, [sweep, "--out", out, *where, *given]))


def start(sweep: Path, out: Path, *given: object) -> subprocess.Popen[str]:
    """Start a sweep, in its own process group as in a terminal."""
    words = [sys.executable, "-m", "pendulum_fmus.sweep", *options(sweep, out, *given)]
    # A program in the background ignores SIGINT, and so do the programs that it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words, cwd=out.parent, process_group=0, **pipes)


def distributed(sweep: Path, out: Path, *given: object) -> str:
    """Run a sweep; return what it prints."""
    process = start(sweep, out, *given)
    said, errors = process.communicate()
    assert process.returncode == 0, errors
    return said


def acting(folder: Path, action: str, runs: str = "") -> Path:
    """Write a program that does something before it simulates the chunk that begins with `runs`."""
    program = folder / "acting"
    case = f'case "$*" in *"--rows={runs}"*) {action};; esac'
    program.write_text(f'#!/bin/sh\n{case}\nexec {PROGRAM} "$@"\n')
    program.chmod(0o755)
    return program


def killing(folder: Path, number: str) -> Path:
    """Write a program that sends a signal to the process whose id the file `pid` has."""
    pid = folder / "pid"
    wait = f"until [ -s {pid} ]; do sleep 0.1; done"
    return acting(folder, f"{wait}; kill -{number} $(cat {pid}); sleep 20", "20..")


@pytest.fixture
def sweep(program, tmp_path) -> Path:
    """Return a sweep with 32 runs."""
    return sweeps.written(tmp_path, SHORT)


# --- rows and kills -------------------------------------------------------------------------------


def test_the_table_equals_that_of_the_local_sweep(sweep, tmp_path):
    out = tmp_path / "out.parquet"
    said = distributed(sweep, out)
    assert re.match(r"32 runs in [0-9.]+ s: [0-9]+ a second\n", said)
    assert said.endswith(f"wrote {out}: 32 rows\n")
    assert out.read_bytes() == expected(sweep, ".parquet")
    assert not journal_of(out).exists()


def test_finished_runs_are_not_repeated_and_a_killed_worker_loses_no_rows(sweep, tmp_path):
    out, killed = tmp_path / "out.csv", tmp_path / "killed"
    header = json.loads(sweeps.printed(sweep, "--plan"))["header"]
    chunks = ["31..32", "3..5", "0..1", "9..10"]
    rows = [sweeps.printed(sweep, "--rows", chunk) for chunk in chunks]
    torn = rows[1][:20]
    journal_of(out).write_text(header + "".join(rows) + torn)
    once = acting(tmp_path, f"mkdir {killed} 2>/dev/null && kill -9 $PPID && sleep 20")
    said = distributed(sweep, out, "--chunk", 3, "--program", once)
    assert killed.exists()
    assert said.startswith("27 runs in ")
    assert "\n5 runs were already done\n" in said
    assert out.read_bytes() == expected(sweep)


@pytest.mark.parametrize("number", ["9", "INT"])
def test_a_sweep_whose_coordinator_ends_is_resumed(sweep, tmp_path, number):
    out = tmp_path / "out.csv"
    process = start(sweep, out, "--chunk", 4, "--program", killing(tmp_path, number))
    group = "-" * (number == "INT")  # Ctrl-C reaches all processes
    (tmp_path / "pid").write_text(f"{group}{process.pid}")
    _, errors = process.communicate()
    with journal_of(out).open() as journal:
        fcntl.flock(journal, fcntl.LOCK_EX)  # until the program that collects the rows has ended
    before = done(out)
    assert len(set(before)) == len(before) < 32
    with journal_of(out).open("a") as journal:
        journal.write("31,40")  # as if it had ended during a write
    if number == "INT":
        assert process.returncode == 130
        assert errors == "sweep.py: interrupted; run the same command to resume\n"
        said = local(sweep, out).stdout
    else:
        assert process.returncode == -signal.SIGKILL
        said = distributed(sweep, out)
    assert f"{32 - len(before)} runs in " in said
    assert out.read_bytes() == expected(sweep)


@pytest.mark.parametrize(
    ("code", "returned", "message"),
    [
        (0, KilledWorker("", None, 4), "the runs 0..2 crash every worker that runs them"),
        (0, OSError("Exec format error"), "Exec format error; does it run on the same"),
        (1, b"error: no licence\n", "^no licence$"),
        (0, b"0,1\n0,1\n", "a worker returned rows that do not match the runs 0..2"),
    ],
)
def test_failures_on_workers_are_reported(code, returned, message):
    error = returned if isinstance(returned, Exception) else None
    result = subprocess.CompletedProcess([], code, returned, returned)
    future = Mock(**{"result.side_effect": error, "result.return_value": result})
    with pytest.raises(driver.SweepError, match=message):
        driver.rows_of(future, 0, 2)


# --- a scheduler elsewhere ------------------------------------------------------------------------


@contextlib.contextmanager
def dask(folder: Path, *words: str) -> Iterator[subprocess.Popen]:
    """Run the command line of Dask in a folder without anything of this project."""
    with (
        (folder / f"{words[0]}.log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"],
            cwd=folder, stdout=log, stderr=log,
            env={**os.environ, "DASK_TEMPORARY_DIRECTORY": str(folder)},
        ) as process,
    ):  # fmt: skip
        try:
            yield process
        finally:
            process.terminate()


@contextlib.contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """Start a scheduler; yield its process and its address."""
    folder.mkdir()
    with dask(folder, "scheduler", "--port", "0") as process:
        log = folder / "scheduler.log"
        while not (found := re.search(r"Scheduler at: +(tcp://\S+)", log.read_text())):
            assert process.poll() is None
            time.sleep(0.1)
        yield process, found[1]


def test_remote_workers_need_nothing_of_the_project_and_a_lost_scheduler_is_reported(
    sweep, tmp_path
):
    out, elsewhere = tmp_path / "out.csv", tmp_path / "elsewhere"
    with scheduler(tmp_path / "lost") as (process, address):
        (tmp_path / "pid").write_text(str(process.pid))
        given = ["--chunk", 4, "--scheduler", address, "--program", killing(tmp_path, "9")]
        with dask(tmp_path / "lost", "worker", address), start(sweep, out, *given) as sweeping:
            _, errors = sweeping.communicate()
    assert sweeping.returncode == 1
    assert errors == "sweep.py: lost the scheduler; run the same command to resume\n"
    with scheduler(elsewhere) as (_, address), start(sweep, out, "--scheduler", address) as process:
        assert process.stdout.readline() == f"no worker yet; `dask worker {address}` starts one\n"
        with dask(elsewhere, "worker", address, "--nworkers", "2", "--nthreads", "1"):
            process.communicate()
            assert process.returncode == 0
            assert not [p for p in elsewhere.rglob("*") if "cargo-fmu" in p.name], "not removed"
    assert out.read_bytes() == expected(sweep)


# --- invalid input --------------------------------------------------------------------------------


@pytest.fixture
def refused(monkeypatch, capsys) -> Callable[..., str]:
    """Return a function that runs a sweep that fails without workers: its message."""

    def call(*given: object) -> str:
        monkeypatch.setattr(sys, "argv", ["sweep", *options(*given)])
        assert driver.main() == 1
        said = capsys.readouterr().err
        assert re.fullmatch(r"sweep\.py: [^\n]+\n", said)
        return said

    return call


def test_invalid_files_are_reported(sweep, tmp_path, refused):
    out = tmp_path / "out.csv"
    assert "cannot read" in refused(tmp_path / "no.toml", out)
    assert "expected a file named .csv" in refused(sweep, tmp_path / "out.xlsx")
    assert "make fmus" in refused(sweep, out, "--program", tmp_path / "nothing")
    said = refused(sweep, out, "--scheduler", "tcp://127.0.0.1:9")  # unused port
    assert "no scheduler is running at tcp://127.0.0.1:9" in said
    parameter = 'variable = "controller.pid.kpp"\nvalues = [1]'
    said = refused(sweeps.written(tmp_path, f"[[parameter]]\n{parameter}"), out)
    assert "did you mean pid.kp" in said
    assert said == local(sweep, out).stderr.replace("error: ", "sweep.py: ", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.toml"]


def test_different_fmus_with_the_same_name_are_rejected(fmus, program, tmp_path, refused):
    text = (sweeps.LOOPS / "supervised.toml").read_text()
    for folder, model in (("a", "PidRbf"), ("b", "IpidRbf")):
        (tmp_path / folder).mkdir()
        text = text.replace(f"../../target/fmu/{model}.fmu", f"{folder}/Controller.fmu")
        shutil.copy(fmus / f"{model}.fmu", tmp_path / folder / "Controller.fmu")
    (tmp_path / "system.toml").write_text(text.replace("../../target/fmu", str(fmus)))
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(f'system = "system.toml"\n{SHORT}{sweeps.SIGNALS}')
    message = refused(sweep, tmp_path / "out.csv")
    assert "b/Controller.fmu are different FMUs; give them different names" in message
