"""pendulum_fmus.sweep: sweeps on Dask, whose workers, coordinator or scheduler are killed."""

import contextlib
import fcntl
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import sweeps
from native import printed, run
from pendulum_fmus.project import PROGRAM
from sweeps import SHORT, done, expected, journal_of, local, wait_until

SIGNALS = '[signals]\nreference = "c.r"\noutput = "c.y"\nerror = "c.e"\ncontrol = "c.u"'


def start(sweep: Path, out: Path, *given: object) -> subprocess.Popen[str]:
    """Start a sweep, in its own process group as in a terminal."""
    command = [sys.executable, "-m", "pendulum_fmus.sweep", sweep, "--out", out, *given]
    # A program in the background ignores SIGINT, and so do the programs that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(list(map(str, command)), cwd=out.parent, process_group=0, **pipes)


def distributed(sweep: Path, out: Path, *given: object) -> str:
    """Run a sweep; return what it prints."""
    process = start(sweep, out, *given)
    said, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    return said


def acting(folder: Path, action: str, runs: str = "") -> Path:
    """Write a program that does something before it simulates the runs that begin with `runs`."""
    program = folder / "acting"
    case = f'case "$*" in *"--rows={runs}"*) {action};; esac'
    program.write_text(f'#!/bin/sh\n{case}\nexec {PROGRAM} "$@"\n')
    program.chmod(0o755)
    return program


def killing(out: Path, number: str) -> Path:
    """Write a program that sends a signal to the process whose id the file `pid` has.

    It waits until a row of the sweep is kept.
    """
    folder, pid = out.parent, out.with_name("pid")
    has_rows = f"[ -s {journal_of(out)} ] && tail -n +3 {journal_of(out)} | grep -q ."
    wait = f"until [ -s {pid} ] && {has_rows}; do sleep 0.1; done"
    return acting(folder, f"{wait}; kill -{number} $(cat {pid}); sleep 20", "20..")


@pytest.fixture
def sweep(program, tmp_path) -> Path:
    """Return a sweep with 32 runs."""
    return sweeps.written(tmp_path, SHORT)


def test_finished_runs_are_not_repeated_and_a_killed_worker_loses_no_rows(sweep, tmp_path):
    out, killed = tmp_path / "out.csv", tmp_path / "killed"
    rows = [printed("sweep", sweep, "--rows", runs) for runs in ("31..32", "3..5", "0..1", "9..10")]
    run("sweep", sweep, "--out", out, "--collect", input="".join(rows))
    with journal_of(out).open("a") as journal:
        journal.write(rows[1][:20])  # torn
    once = acting(tmp_path, f"mkdir {killed} 2>/dev/null && kill -9 $PPID && sleep 20")
    said = distributed(sweep, out, "--program", once)
    assert killed.exists()
    assert re.fullmatch(rf"27 runs in [\d.]+ s: \d+ a second\nwrote {out}: 32 rows\n", said)
    assert out.read_bytes() == expected(sweep)
    assert not journal_of(out).exists()


@pytest.mark.parametrize(("number", "group"), [("9", ""), ("INT", "-")])
def test_a_sweep_whose_coordinator_ends_is_resumed(sweep, tmp_path, number, group):
    """Ctrl-C reaches all processes."""
    out = tmp_path / "out.csv"
    process = start(sweep, out, "--program", killing(out, number))
    (tmp_path / "pid").write_text(f"{group}{process.pid}")
    _, errors = process.communicate()
    if number == "INT":
        assert process.returncode == 130, errors
        assert errors == "error: interrupted; run the same command to resume\n"
    with journal_of(out).open() as journal:
        fcntl.flock(journal, fcntl.LOCK_EX)  # until the program that collects the rows has ended
    before = done(out)
    assert len(set(before)) == len(before) < 32
    assert f"{32 - len(before)} runs in " in local(sweep, out).stdout
    assert out.read_bytes() == expected(sweep)


def test_an_interrupt_during_garbage_collection_is_not_lost(sweep, tmp_path):
    """Python ignores exceptions in `__del__`, too."""
    code = """
import signal, sys, time
from pendulum_fmus import sweep

class Interrupting:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def wait(options):
    Interrupting()
    time.sleep(600)

sweep.sweep = wait
sys.exit(sweep.main())
"""
    done = subprocess.run([sys.executable, "-c", code, sweep], capture_output=True, check=False)
    assert done.returncode == 130
    assert done.stderr == b"error: interrupted; run the same command to resume\n"


STRUCTURE = """
<s:SystemStructureDescription version="1.0" name="a" xmlns:s="http://ssp-standard.org/SSP1/SystemStructureDescription">
<s:System name="a"><s:Elements><s:Component name="c" source="data/Pid.fmu"/></s:Elements>
<s:ParameterBindings><s:ParameterBinding source="data/y.ssv"/></s:ParameterBindings></s:System>
</s:SystemStructureDescription>
"""

PARAMETERS = """
<v:ParameterSet version="1.0" name="y" xmlns:v="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
<v:Parameters><v:Parameter name="c.y"><v:Real value="1"/></v:Parameter></v:Parameters>
</v:ParameterSet>
"""

SYSTEM = """
stop = 1.0
step = 0.1
input = "data/y.csv"
component = [{ name = "c", fmu = "data/Pid.fmu" }]
"""


@pytest.mark.parametrize(
    ("system", "text", "file", "values"),
    [
        ("system.toml", SYSTEM, "y.csv", "time,c.y\n0,0\n1,1\n"),
        ("system.ssd", STRUCTURE, "y.ssv", PARAMETERS),
    ],
)
def test_all_files_of_a_system_reach_the_workers_and_belong_to_the_sweep(
    program, tmp_path, system, text, file, values
):
    data, out = tmp_path / "data", tmp_path / "out.csv"
    data.mkdir()
    (data / "Pid.fmu").symlink_to(sweeps.ROOT / "target/fmu/Pid.fmu")
    (data / file).write_text(values)
    (tmp_path / system).write_text(text)
    text = '[[parameter]]\nvariable = "c.pid.kp"\nvalues = [200, 300]'
    sweep = sweeps.written(tmp_path, text, signals=SIGNALS)
    sweep.write_text(sweep.read_text().replace(f"{sweeps.LOOPS}/pid-rbf.toml", system))
    distributed(sweep, out)
    assert out.read_bytes() == expected(sweep)
    row = printed("sweep", sweep, "--rows", "0..1")
    run("sweep", sweep, "--out", out, "--collect", input=row)
    (data / file).write_text(values.replace("1\n", "2\n").replace('"1"', '"2"'))
    assert "belongs to another sweep" in local(sweep, out).stderr


@contextlib.contextmanager
def dask(folder: Path, *words: str) -> Iterator[subprocess.Popen]:
    """Run the command line of Dask in a folder without anything of this project."""
    command = [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"]
    env = {**os.environ, "DASK_TEMPORARY_DIRECTORY": str(folder)}
    with (folder / f"{words[0]}.log").open("w") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log, env=env)
    with process:
        yield process
        process.terminate()


@contextlib.contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """Start a scheduler; yield its process and its address."""
    folder.mkdir()
    with dask(folder, "scheduler", "--port", "0") as process:
        log = folder / "scheduler.log"
        address = re.compile(r"Scheduler at: +(tcp://\S+)")
        yield process, wait_until(lambda: address.search(log.read_text()), process)[1]


def test_workers_elsewhere_need_nothing_of_the_project_and_a_lost_scheduler_is_reported(
    sweep, tmp_path
):
    out, elsewhere = tmp_path / "out.csv", tmp_path / "elsewhere"
    with scheduler(tmp_path / "lost") as (process, address):
        (tmp_path / "pid").write_text(str(process.pid))
        given = ["--scheduler", address, "--program", killing(out, "9")]
        with dask(tmp_path / "lost", "worker", address), start(sweep, out, *given) as sweeping:
            _, errors = sweeping.communicate()
    assert sweeping.returncode == 1
    assert errors == "error: lost the scheduler; run the same command to resume\n"
    with scheduler(elsewhere) as (_, address), start(sweep, out, "--scheduler", address) as process:
        assert process.stdout.readline() == f"no worker yet; `dask worker {address}` starts one\n"
        with dask(elsewhere, "worker", address, "--nworkers", "2", "--nthreads", "1"):
            assert process.wait() == 0
            assert not list(elsewhere.rglob("_native*")), "not removed"
    assert out.read_bytes() == expected(sweep)


def test_a_sweep_that_cannot_run_is_refused(sweep, tmp_path, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "1")
    unused = "tcp://127.0.0.1:9"
    failing = acting(tmp_path, "echo error: no licence >&2; exit 1")
    text = (sweeps.LOOPS / "supervised.toml").read_text()
    for folder, model in (("a", "PidRbf"), ("b", "IpidRbf")):
        (tmp_path / folder).mkdir()
        fmu = f"../../target/fmu/{model}.fmu"
        (tmp_path / folder / "Own.fmu").symlink_to((sweeps.LOOPS / fmu).resolve())
        text = text.replace(fmu, f"{folder}/Own.fmu")
    system = tmp_path / "supervised.toml"
    system.write_text(text.replace("../..", str(sweeps.ROOT)))
    twice = tmp_path / "twice.toml"
    twice.write_text(sweep.read_text().replace(f"{sweeps.LOOPS / 'pid-rbf.toml'}", system.name))
    for file, options, message in (
        (tmp_path / "no.toml", [], "cannot read "),
        (sweep, ["--program", tmp_path / "nothing"], "`make fmus` builds it"),
        (sweep, ["--scheduler", unused], f"trying to connect to {unused}"),
        (sweep, ["--program", failing], "no licence"),
        (twice, [], "/b/Own.fmu are different files; give them different names"),
    ):
        process = start(file, tmp_path / "out.csv", *options)
        _, said = process.communicate()
        assert process.returncode in (1, 2)
        assert message in said
        assert "Traceback" not in said
    assert not list(tmp_path.glob("out*"))
