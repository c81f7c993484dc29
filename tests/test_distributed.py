"""pendulum_fmus.sweep: distributed sweeps with workers that come and go."""

import contextlib
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from dask.distributed import Client

import sweeps
from pendulum_fmus import sweep as by_dask
from sweeps import LONG, PROGRAM, SHORT, done, expected, journal_of, local, wait_until


def command(sweep: Path, out: Path, *options: object) -> list[str]:
    """Return the command line of the script."""
    return [sys.executable, "-m", "pendulum_fmus.sweep", *map(str, [sweep, "--out", out, *options])]


def distributed(sweep: Path, out: Path, *options: object) -> subprocess.CompletedProcess[str]:
    """Run a sweep on two workers of this machine, whatever its exit code."""
    where = [] if "--scheduler" in options else ["--workers", 2]
    return subprocess.run(
        command(sweep, out, *where, *options),
        cwd=out.parent,
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * sweeps.TIMEOUT,
    )


@contextlib.contextmanager
def begun(sweep: Path, out: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """Start a long sweep on two workers, and wait for some additional rows."""
    before = len(done(out))
    words = command(sweep, out, "--chunk", 5, "--workers", 2, *options)
    # A program in the background ignores SIGINT, and so do the programs that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # In its own process group, as in a terminal
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0
    ) as process:
        try:
            wait_until(lambda: len(done(out)) > before + 20, process)
            yield process
        finally:
            process.kill()


def workers(process: subprocess.Popen) -> list[psutil.Process]:
    """Return the processes of the workers."""
    children = psutil.Process(process.pid).children()
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def alive(process: psutil.Process) -> bool:
    """Return whether a process is running; an orphan may remain listed after its end."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.status() != psutil.STATUS_ZOMBIE
    return False


def complaint(result: subprocess.CompletedProcess[str], code: int = 1) -> str:
    """Return the message of a failed sweep: one line, without a traceback."""
    assert result.returncode == code, result.stderr
    assert re.fullmatch(r"sweep\.py: [^\n]+\n", result.stderr), result.stderr
    return result.stderr


@pytest.fixture(scope="module")
def long_table(program, tmp_path_factory) -> bytes:
    """Return the table of the long sweep."""
    return expected(sweeps.written(tmp_path_factory.mktemp("long"), LONG))


# --- rows -----------------------------------------------------------------------------------------


def test_the_table_equals_that_of_the_local_sweep(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.parquet"
    result = distributed(sweep, out)
    assert result.returncode == 0, result.stderr
    assert re.match(r"32 runs in [0-9.]+ s: [0-9]+ a second\n", result.stdout)
    assert result.stdout.endswith(f"wrote {out}: 32 rows\n")
    assert out.read_bytes() == expected(sweep, ".parquet")
    assert not journal_of(out).exists()


def test_finished_runs_are_not_repeated(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    chunks = ["31..32", "3..5", "0..1", "9..10"]
    header = json.loads(sweeps.printed(sweep, "--plan"))["header"]
    rows = [sweeps.printed(sweep, "--rows", chunk) for chunk in chunks]
    torn = rows[1][:20]
    journal_of(out).write_text(header + "".join(rows) + torn)
    result = distributed(sweep, out, "--chunk", 3)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("27 runs in ")
    assert "\n5 runs were already done\n" in result.stdout
    assert out.read_bytes() == expected(sweep)


def test_queued_chunks_are_executed(monkeypatch):
    """If omitted, they would silently be run by the program that writes the table."""
    monkeypatch.setattr(by_dask, "MAX_QUEUED", 3)
    answer = subprocess.CompletedProcess([], 0, b"rows", b"")
    monkeypatch.setattr(by_dask, "simulate", lambda bundle, chunk: answer)
    with Client(processes=False, n_workers=1, dashboard_address=None) as client:
        found = list(by_dask.results(client, "bundle", by_dask.chunks(20, {0, 4, 5, 19}, 2)))
    expected = [[1, 2], [3], [6, 7], [8, 9], [10, 11], [12, 13], [14, 15], [16, 17], [18]]
    assert sorted(list(chunk) for chunk, _ in found) == expected
    assert {rows for _, rows in found} == {b"rows"}


# --- kills ----------------------------------------------------------------------------------------


def test_a_killed_worker_loses_no_rows(tmp_path, long_table):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    with begun(sweep, out) as process, journal_of(out).open(encoding="utf-8") as journal:
        one, _ = workers(process)
        one.kill()
        runs = len(done(out))
        _, errors = process.communicate(timeout=sweeps.TIMEOUT)
        assert process.returncode == 0, errors
        assert 20 < runs < 200, "it was killed in the middle"
        # Still readable through the open file, though it has been removed
        assert sorted(sweeps.runs_in(journal.read())) == list(range(200))
    assert out.read_bytes() == long_table


def test_a_killed_coordinator_resumes(tmp_path, long_table):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    for _ in range(2):
        before = done(out)
        with begun(sweep, out) as process:
            orphans = workers(process)
            process.kill()
            process.wait()
        after = done(out)
        assert after[: len(before)] == before, "nothing is lost"
        assert len(set(after)) == len(after) < 200, "nothing is done twice"
        wait_until(lambda orphans=orphans: not any(map(alive, orphans)))
        with journal_of(out).open("a") as journal:
            journal.write("199,40")  # simulates a kill during a write
    result = distributed(sweep, out)
    assert result.returncode == 0, result.stderr
    assert f"\n{len(after)} runs were already done\n" in result.stdout
    assert out.read_bytes() == long_table


def test_local_and_distributed_sweeps_resume_each_other(tmp_path, long_table):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    with subprocess.Popen([PROGRAM, "sweep", sweep, "--out", out, "--threads", "1"]) as process:
        wait_until(lambda: len(done(out)) > 20, process)
        process.kill()
    native = len(done(out))
    with begun(sweep, out) as process:
        process.kill()
    both = len(done(out))
    assert 20 < native < both < 200
    result = local(sweep, out)
    assert result.returncode == 0, result.stderr
    assert f"{200 - both} runs in " in result.stdout
    assert out.read_bytes() == long_table


def test_an_interrupt_ends_the_sweep_immediately_and_quietly(program, tmp_path):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    with begun(sweep, out) as process:
        family = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=sweeps.TIMEOUT)
        assert process.returncode == 130
        assert errors == "sweep.py: interrupted; run the same command to resume\n"
    wait_until(lambda: not any(map(alive, family)))
    assert 20 < len(done(out)) < 200


def failing(folder: Path, action: str) -> Path:
    """Write a program that behaves differently when run by a worker."""
    program = folder / "failing"
    program.write_text(f'#!/bin/sh\ncase "$*" in *--rows*) {action};; esac\nexec {PROGRAM} "$@"\n')
    program.chmod(0o755)
    return program


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ("kill -9 $PPID", "the runs 0..32 crash every worker that runs them"),
        ("echo error: no licence >&2; exit 1", "sweep.py: no licence"),
        ("echo 0,1; echo 0,1; exit 0", "a worker returned rows that do not match the runs 0..32"),
    ],
)
def test_a_program_that_fails_on_the_workers_ends_the_sweep(program, tmp_path, action, message):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    other = failing(tmp_path, action)
    assert message in complaint(distributed(sweep, out, "--program", other, "--chunk", 32))
    assert done(out) == []


# --- a scheduler elsewhere ------------------------------------------------------------------------


@contextlib.contextmanager
def dask(folder: Path, *words: str) -> Iterator[subprocess.Popen]:
    """Run the command line of Dask in a folder without anything of this project."""
    log = folder / f"{words[0]}.log"
    with (
        log.open("w") as file,
        subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"],
            cwd=folder,
            stdout=file,
            stderr=file,
            env={**os.environ, "DASK_TEMPORARY_DIRECTORY": str(folder)},
        ) as process,
    ):
        try:
            yield process
        finally:
            process.terminate()
            process.wait(sweeps.TIMEOUT)


@contextlib.contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """Start a scheduler; yield its process and its address."""
    with dask(folder, "scheduler", "--port", "0") as process:

        def address() -> str | None:
            found = re.search(r"Scheduler at: +(tcp://\S+)", (folder / "scheduler.log").read_text())
            return found and found[1]

        yield process, wait_until(address, process)


def test_remote_workers_need_nothing_of_the_project(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    with scheduler(elsewhere) as (_, address):
        words = command(sweep, out, "--scheduler", address)
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            hint = process.stdout.readline()
            assert hint == f"no worker yet; `dask worker {address}` starts one\n"
            with dask(elsewhere, "worker", address, "--nworkers", "2", "--nthreads", "1"):
                said, _ = process.communicate(timeout=sweeps.TIMEOUT)
                assert process.returncode == 0
                left = [path for path in elsewhere.rglob("*") if "cargo-fmu" in path.name]
                assert left == [], "the workers have removed the program"
    assert said.startswith("32 runs in ")
    assert out.read_bytes() == expected(sweep)


def test_a_lost_scheduler_is_reported(program, tmp_path):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    with (
        scheduler(tmp_path) as (scheduling, address),
        dask(tmp_path, "worker", address, "--nthreads", "1"),
        subprocess.Popen(
            command(sweep, out, "--scheduler", address, "--chunk", 5),
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        wait_until(lambda: len(done(out)) > 20, process)
        scheduling.kill()
        _, errors = process.communicate(timeout=sweeps.TIMEOUT)
        assert process.returncode == 1
        assert errors == "sweep.py: lost the scheduler; run the same command to resume\n"
    assert 20 < len(done(out)) < 200


def test_a_missing_scheduler_is_reported_within_seconds(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    result = distributed(sweep, out, "--scheduler", "tcp://127.0.0.1:9")  # unused port
    assert "no scheduler is running at tcp://127.0.0.1:9" in complaint(result)
    assert not journal_of(out).exists()


def test_local_workers_are_not_reachable_from_other_machines(program, tmp_path):
    sweep = sweeps.written(tmp_path, LONG)
    with begun(sweep, tmp_path / "out.csv") as process:
        listening = {
            connection.laddr.ip
            for one in [psutil.Process(process.pid), *workers(process)]
            for connection in one.net_connections()
            if connection.status == psutil.CONN_LISTEN
        }
    assert listening == {"127.0.0.1"}


# --- invalid input --------------------------------------------------------------------------------


def test_an_invalid_sweep_is_reported_as_by_the_local_one(program, tmp_path):
    parameter = 'variable = "controller.pid.kpp"\nvalues = [1]'
    sweep = sweeps.written(tmp_path, f"[[parameter]]\n{parameter}")
    out = tmp_path / "out.csv"
    result = distributed(sweep, out)
    assert result.returncode == 1
    assert "did you mean pid.kp" in result.stderr
    assert result.stderr == local(sweep, out).stderr.replace("error: ", "sweep.py: ", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.toml"]


def test_a_value_rejected_during_the_sweep_ends_it(program, tmp_path):
    """A normal distribution around the minimum mass; the first draw of this seed is above it."""
    text = 'seed = 2\ndraws = 50\nstop = 0.01\n[[parameter]]\nvariable = "plant.M"\nnormal = [0, 1]'
    sweep = sweeps.written(tmp_path, text)
    message = complaint(distributed(sweep, tmp_path / "out.csv"))
    assert re.match(r"sweep\.py: run \d+: plant \(Pendulum\.fmu\), M = -", message)


def test_invalid_files_are_reported(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    assert "cannot read" in complaint(distributed(tmp_path / "no.toml", out))
    assert "expected a file named .csv" in complaint(distributed(sweep, tmp_path / "out.xlsx"))
    assert "make fmus" in complaint(distributed(sweep, out, "--program", tmp_path / "nothing"))
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.toml"]
    nowhere = tmp_path / "nowhere" / "out.csv"
    result = subprocess.run(
        command(sweep, nowhere, "--workers", 1), capture_output=True, text=True, check=False
    )
    assert f"cannot open {nowhere}.part: No such file" in complaint(result)


def test_a_journal_of_another_sweep_or_in_use_is_not_changed(program, tmp_path):
    sweep = sweeps.written(tmp_path, SHORT)
    out = tmp_path / "out.csv"
    journal_of(out).write_text("# sweep c0ffee\nindex,plant.M\n0,1.0\n")
    assert "belongs to another sweep" in complaint(distributed(sweep, out))
    assert done(out) == [0]
    with journal_of(out).open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert "is in use by another process" in complaint(distributed(sweep, out))


def test_different_fmus_with_the_same_name_are_rejected(program, fmus, tmp_path):
    text = (sweeps.SYSTEMS / "supervised.toml").read_text()
    for folder, model in (("a", "PidRbf"), ("b", "IpidRbf")):
        (tmp_path / folder).mkdir()
        text = text.replace(f"../../target/fmu/{model}.fmu", f"{folder}/Controller.fmu")
        shutil.copy(fmus / f"{model}.fmu", tmp_path / folder / "Controller.fmu")
    (tmp_path / "system.toml").write_text(text.replace("../../target/fmu", str(fmus)))
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('system = "system.toml"\n' + LONG.replace("180.0", "0.01") + sweeps.SIGNALS)
    out = tmp_path / "out.csv"
    message = complaint(distributed(sweep, out))
    assert "b/Controller.fmu are different FMUs; give them different names" in message

    (tmp_path / "c").mkdir()
    shutil.copy(fmus / "Pendulum.fmu", tmp_path / "c")
    text = text.replace("b/Controller.fmu", "../../target/fmu/IpidRbf.fmu")
    text = text.replace("../../target/fmu/Pendulum.fmu", "c/Pendulum.fmu", 1)
    (tmp_path / "system.toml").write_text(text.replace("../../target/fmu", str(fmus)))
    result = distributed(sweep, out)
    assert result.returncode == 0, result.stderr
    assert out.read_bytes() == expected(sweep)


def test_help_lists_every_option_and_gives_examples():
    result = subprocess.run(
        [sys.executable, "-m", "pendulum_fmus.sweep", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    for option in ("--out", "--scheduler", "--workers", "--chunk", "--program",
                   "dask scheduler", "dask worker", "same platform"):  # fmt: skip
        assert option in result.stdout
