"""FMUs that crash, exit, hang or fill the memory: what is reported, what is kept, what is left."""

import os
import re
import resource
import shutil
import signal
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from native import in_c, read_csv, run, write_system
from pendulum_fmus.project import PROGRAM
from sweeps import table, wait_until

LIMIT = 3
"""Time limit of calls that hang [s], which no other call takes on a busy machine."""

FAULTS = """NONE CRASH ABORT EXIT EXIT_AT_ONCE HANG FILL WRITE PRINT FAIL TELL END FORK START
FATALLY""".split()
"""The faults of tests/c/faulty.c, by number."""


@pytest.fixture(scope="session")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the FMU of tests/c/faulty.c and faulty.xml."""
    return in_c(tmp_path_factory.mktemp("faulty") / "Faulty.fmu")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faulty: Path) -> Iterator[Path]:
    """Return a folder with a system; nothing may be left in TMPDIR."""
    shutil.copy(faulty, tmp_path / "Faulty.fmu")
    write_system(tmp_path, {"plant": {}}, fmu="Faulty", step=0.001)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    yield tmp_path
    assert list(temporary.iterdir()) == []


def simulated(folder: Path, fault: str, at: float = 0.5, *options: object):
    """Simulate the system with a fault, writing out.csv."""
    sets = (f"--set=plant.fault={FAULTS.index(fault)}", f"--set=plant.at={at}")
    csv = [] if "--csv=-" in options else ["--csv=out.csv"]
    return run("simulate", "system.toml", *csv, *sets, *options, cwd=folder)


# --- simulations ----------------------------------------------------------------------------------

ACCESS = "was ended by signal 11, illegal memory access"

ENDS = {
    "CRASH": ACCESS,
    "ABORT": "was ended by signal 6, abort",
    "EXIT": "exited with code 0 before it had finished",
    "EXIT_AT_ONCE": "exited with code 3 before it had finished",
    "HANG": f"did not return within {LIMIT} s and was killed",
    "WRITE": ACCESS,
    "TELL": f"{ACCESS}: about to crash",
    "FAIL": "returned fmi2Error",
    "FILL": r"used more than 0\.\d GB of memory and was killed",
}
"""How each fault ends a step, as a regular expression."""


@pytest.mark.parametrize("fault", ENDS)
def test_an_fmu_that_ends_the_process_is_named_and_its_rows_are_kept(folder, fault):
    (folder / "out.csv").write_text("of an earlier run")
    limit = "--memory-limit=0.3" if fault == "FILL" else f"--call-timeout={LIMIT}"
    result = simulated(folder, fault, 0.5, limit)
    assert result.returncode == 1
    where = r"plant \(Faulty.fmu\), step of 0.001 s at t = 0.5 s: fmi2DoStep "
    reason = "" if fault == "TELL" else "; the FMU logged no reason"
    kept = "; the rows up to t = 0.5 s are in out.csv.part"
    said = f"error: {where}{ENDS[fault]}{reason}{kept}\n"
    assert re.fullmatch(said, result.stderr), result.stderr
    assert (folder / "out.csv").read_text() == "of an earlier run"
    kept = read_csv(folder / "out.csv.part")
    assert len(kept["time"]) == 501
    assert list(kept["plant.y"]) == pytest.approx(list(kept["time"]))


def test_a_complete_run_replaces_the_file_and_what_was_kept(folder):
    simulated(folder, "CRASH")
    assert simulated(folder, "NONE").stderr == ""
    assert len(read_csv(folder / "out.csv")["time"]) == 1001
    assert not (folder / "out.csv.part").exists()


def test_an_fmu_that_ends_the_simulation_leaves_a_complete_table(folder):
    result = simulated(folder, "END")
    assert (result.returncode, result.stderr) == (0, "")
    ended = "plant (Faulty.fmu) ended the simulation at t = 0.501 s: it has arrived\n"
    assert ended in result.stdout
    times = read_csv(folder / "out.csv")["time"]
    assert list(times) == [*(k * 0.001 for k in range(501)), 0.5 + 0.001]


def test_a_process_that_an_fmu_has_forked_writes_nothing(folder):
    """The original worker continues."""
    warning = "warning: an FMU has forked the process, and returned in both; the second process"
    for command in ("simulate", "sweep"):
        if command == "simulate":
            result = simulated(folder, "FORK")
            times = read_csv(folder / "out.csv")["time"]
            assert list(times) == [k * 0.001 for k in range(1001)]
        else:
            sweep_file(folder, 5, "FORK", 0.005)
            result = run("sweep", "sweep.toml", "--out=runs.csv", "--threads=1", cwd=folder)
            assert [row["failure"] for row in table(folder / "runs.csv")] == 5 * [""]
        assert (result.returncode, result.stderr) == (0, f"{warning} was ended\n")


def test_an_fmu_may_run_the_program(folder, monkeypatch):
    monkeypatch.setenv("FAULTY_COMMAND", f"{PROGRAM} simulate system.toml --csv=inner.csv")
    result = simulated(folder, "START")
    assert (result.returncode, result.stderr) == (0, "")
    assert [lines(folder / file) for file in ("inner.csv", "out.csv")] == [1002, 1002]


@pytest.mark.parametrize("fault", ["CRASH", "EXIT"])
def test_a_crash_before_the_first_row_leaves_no_file(folder, fault):
    result = simulated(folder, fault, -1)
    assert result.returncode == 1
    start = "error: plant (Faulty.fmu), initialization at t = 0.0 s: fmi2EnterInitializationMode "
    assert result.stderr.startswith(start)
    assert result.stderr.endswith("; no file was written\n")
    assert not list(folder.glob("out*"))


def interrupted(folder: Path, number: int, condition, *arguments: object):
    """Run the program, send it a signal under a condition; return its exit code and its report."""
    command = [PROGRAM, *map(str, arguments)]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process:
        wait_until(condition, process)
        process.send_signal(number)
        _, stderr = process.communicate()
    return process.returncode, stderr


def lines(file: Path) -> int:
    """Return the number of lines in a file, 0 if there is none."""
    return file.read_bytes().count(b"\n") if file.exists() else 0


FAULT = f"--set=plant.fault={FAULTS.index('HANG')}"
HANG = ("simulate", "system.toml", FAULT, "--set=plant.at=0.5")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_simulation_keeps_its_rows(folder, number):
    def hangs() -> bool:
        return lines(folder / "out.csv.part") == 502

    code, errors = interrupted(folder, number, hangs, *HANG, "--csv=out.csv")
    assert code == 128 + number
    kept = "the rows up to t = 0.5 s are in out.csv.part"
    assert errors == f"interrupted at t = 0.5 s; {kept}\n"
    assert len(read_csv(folder / "out.csv.part")["time"]) == 501


def test_a_killed_supervisor_takes_its_worker_along(folder):
    """All rows but those of the last second are in the file."""
    part = folder / "out.csv.part"
    with subprocess.Popen([PROGRAM, *HANG, "--csv=out.csv"], cwd=folder) as process:
        wait_until(lambda: lines(part) == 502, process)
        process.kill()
    wait_until(lambda: not list((folder / "temporary").iterdir()))
    assert read_csv(part)["time"][-1] == 0.5


def test_the_next_command_removes_what_killed_sweeps_have_left_though_workers_still_write(folder):
    sweep_file(folder, 1000, "NONE", 0.005)
    command = [PROGRAM, "sweep", "sweep.toml", "--out=runs.csv", "--threads=2"]
    for _ in range(5):
        with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL) as process:
            wait_until(lambda: list((folder / "temporary").glob("*/worker-1")), process)
            process.kill()

    def is_empty() -> bool:
        assert run("simulate", "system.toml", "--stop=0.01", cwd=folder).returncode == 0
        return not list((folder / "temporary").iterdir())

    wait_until(is_empty)


def test_the_next_command_removes_the_folder_of_one_that_was_killed_before_it_locked_it(folder):
    old, new = (folder / "temporary" / f"cargo-fmu-{name}" for name in ("old", "new"))
    for made in (old, new):
        made.mkdir()
    os.utime(old, (0, 0))
    assert run("simulate", "system.toml", "--stop=0.01", cwd=folder).returncode == 0
    assert list(new.parent.iterdir()) == [new]
    new.rmdir()


def test_the_next_command_removes_what_a_killed_one_has_left(folder):
    with subprocess.Popen([PROGRAM, *HANG], cwd=folder) as process:
        wait_until(lambda: list((folder / "temporary").rglob("*.so")), process)
        (session,) = (folder / "temporary").iterdir()
        left = session.with_name("cargo-fmu-left")
        shutil.copytree(session, left)
        assert run("simulate", "system.toml", "--stop=0.01", cwd=folder).returncode == 0
        assert not left.exists()
        assert list(session.rglob("*.so"))
        process.terminate()


# --- sweeps ---------------------------------------------------------------------------------------


def sweep_file(folder: Path, runs: int, fault: str, at: float) -> None:
    """Write a sweep whose last run has the fault at a time; it never occurs in the other runs."""
    times = [100.0 + k for k in range(runs - 1)] + [at]
    (folder / "sweep.toml").write_text(
        f'system = "system.toml"\nstop = 0.01\nset = {{ "plant.fault" = {FAULTS.index(fault)} }}\n'
        f'[[parameter]]\nvariable = "plant.at"\nvalues = {times}\n'
        '[signals]\nreference = "plant.r"\noutput = "plant.y"\nerror = "plant.e"\n'
        'control = "plant.u"\n'
    )


STEP = "plant (Faulty.fmu), step of 0.001 s at t = 0.005 s: fmi2DoStep "


def test_a_sweep_with_one_crashing_run_in_a_thousand_finishes(folder):
    sweep_file(folder, 1000, "CRASH", 0.005)
    for threads in (1, 2):
        options = (f"--out={threads}.csv", f"--threads={threads}")
        result = run("sweep", "sweep.toml", *options, cwd=folder)
        assert result.returncode == 0, result.stderr
        assert result.stderr == ""
        assert "1 run failed, the first was run 999: " + STEP in result.stdout
    rows = table(folder / "1.csv")
    assert (folder / "2.csv").read_bytes() == (folder / "1.csv").read_bytes()
    assert len(rows) == 1000
    *sound, crashed = rows
    assert {(row["failure"], row["diverged"], float(row["final_e"])) for row in sound} == {
        ("", "false", 0.99)
    }
    assert crashed["failure"] == STEP + "was ended by signal 11, illegal memory access"
    assert (crashed["diverged"], float(crashed["diverged_at"])) == ("true", 0.005)


@pytest.mark.parametrize(
    ("fault", "limit", "reason"),
    [
        ("EXIT", "--threads=1", "exited with code 0 before it had finished"),
        ("EXIT_AT_ONCE", "--threads=2", "exited with code 3 before it had finished"),
        ("HANG", f"--call-timeout={LIMIT}", f"did not return within {LIMIT} s and was killed"),
        ("FILL", "--memory-limit=0.4", "used too much memory and was killed"),
        ("FAIL", "--threads=2", "returned fmi2Error"),
        ("END", "--threads=2", "asked to end the simulation"),
    ],
)
def test_a_failed_run_has_its_reason_in_the_table(folder, fault, limit, reason):
    sweep_file(folder, 5, fault, 0.005)
    result = run("sweep", "sweep.toml", "--out=out.csv", limit, cwd=folder)
    assert result.returncode == 0, result.stderr
    assert [row["failure"] for row in table(folder / "out.csv")] == [*4 * [""], STEP + reason]


def test_a_sweep_is_refused_only_if_every_value_that_is_tried_crashes(folder):
    crash = "plant (Faulty.fmu), initialization at t = 0.0 s: fmi2EnterInitializationMode was ended"
    sweep_file(folder, 5, "CRASH", -1.0)
    result = run("sweep", "sweep.toml", "--out=some.csv", cwd=folder)
    assert result.returncode == 0, result.stderr
    *sound, failure = [row["failure"] for row in table(folder / "some.csv")]
    assert sound == 4 * [""]
    assert failure.startswith(crash)
    sweep_file(folder, 1, "CRASH", -1.0)
    result = run("sweep", "sweep.toml", "--out=all.csv", cwd=folder)
    assert result.returncode == 1
    assert result.stderr.startswith(f"error: sweep.toml: {crash}")
    assert not list(folder.glob("all*"))


def test_what_an_fmu_prints_is_not_among_the_rows(folder):
    sweep_file(folder, 3, "PRINT", 0.005)
    result = run("sweep", "sweep.toml", "--rows=0..3", cwd=folder)
    assert sorted(line.split(",")[0] for line in result.stdout.splitlines()) == ["0", "1", "2"]
    assert result.stderr == "0,1,2,3\n"


def test_what_an_fmu_prints_is_not_among_printed_rows_which_are_kept_after_a_crash(folder):
    for fault in ("PRINT", "CRASH"):
        result = simulated(folder, fault, 0.005, "--csv=-", "--stop=0.01")
        times = [line.split(",")[0] for line in result.stdout.splitlines()]
        last = 10 if fault == "PRINT" else 5
        assert times == ["time [s]", *(str(k * 0.001) for k in range(last + 1))]
        assert (fault == "PRINT") == ("0,1,2,3\n" in result.stderr)
        assert (result.returncode == 0) == (fault == "PRINT")
        assert not list(folder.glob("*.part"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sweep_resumes_without_repeating_the_failed_run(folder, number):
    sweep_file(folder, 3, "HANG", 0.005)
    text = (folder / "sweep.toml").read_text()
    crash, hang = FAULTS.index("CRASH"), FAULTS.index("HANG")
    fault = f'[[parameter]]\nvariable = "plant.fault"\nvalues = [0, {crash}, {hang}, 0]\n[signals]'
    (folder / "sweep.toml").write_text(text.replace("[signals]", fault))
    arguments = ("sweep", "sweep.toml", "--out=out.csv", "--threads=1")

    def crashed() -> bool:
        journal = folder / "out.csv.part"
        return lines(journal) >= 12 and "signal 11" in journal.read_text()

    code, errors = interrupted(folder, number, crashed, *arguments)
    assert code == 128 + number
    kept = "11 of 12 runs" if "11 of" in errors else "10 of 12 runs"
    assert errors == f"interrupted; {kept} are in out.csv.part; run the same command to resume\n"
    before = (folder / "out.csv.part").read_text()
    assert before.count("signal 11") == 1

    result = run(*arguments, f"--call-timeout={LIMIT}", cwd=folder)
    assert result.returncode == 0, result.stderr
    assert "runs already done" in result.stdout
    rows = [row["failure"] for row in table(folder / "out.csv")]
    assert [bool(row) for row in rows] == [*9 * [False], True, True, False]
    assert not (folder / "out.csv.part").exists()


# --- files that cannot be written -----------------------------------------------------------------


def test_the_first_failed_write_ends_a_run(folder):
    result = run("simulate", "system.toml", "--csv=/dev/full", cwd=folder)
    assert result.returncode == 1
    assert result.stderr.startswith("error: cannot write /dev/full: ")


def limited(folder: Path, size: int, *options: str) -> subprocess.CompletedProcess[str]:
    """Simulate where no file can be larger, as on a full disk."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    # With the signals of Python, writing fails instead of ending the process.
    as_python = {"preexec_fn": limit, "restore_signals": False}
    return run("simulate", "system.toml", *options, cwd=folder, **as_python)


@pytest.mark.parametrize("file", ["out.csv", "out.parquet"])
def test_a_full_disk_leaves_the_rows_that_were_written(folder, file):
    size = 1_000_000
    result = limited(folder, size, f"--csv={file}", "--step=0.00001")
    assert result.returncode == 1
    kept = read_csv(folder / f"{file}.part")["time"]
    last = f"; the rows up to t = {kept[-1]} s are in {file}.part\n"
    assert result.stderr == f"error: cannot write {file}: File too large (os error 27){last}"
    assert size - 100 < (folder / f"{file}.part").stat().st_size <= size
    assert not (folder / file).exists()


@pytest.mark.parametrize("size", [100_000, 400_000])
def test_a_full_folder_for_temporary_files_is_named(folder, size):
    with zipfile.ZipFile(folder / "Faulty.fmu", "a") as archive:
        archive.writestr("resources/data", bytes(1_000_000))
    result = limited(folder, size)
    assert result.returncode == 1
    assert f" to the folder {folder / 'temporary' / 'cargo-fmu-'}" in result.stderr
    assert "File too large (os error 27)\n" in result.stderr


def test_two_runs_do_not_write_the_same_file(folder):
    command = [PROGRAM, *HANG, "--csv=out.csv"]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL) as process:
        wait_until((folder / "out.csv.part").exists, process)
        result = run("simulate", "system.toml", "--csv=out.csv", cwd=folder)
        process.terminate()
    assert result.returncode == 1
    assert result.stderr == "error: out.csv.part is in use by another process\n"
