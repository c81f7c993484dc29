"""Runs at the pace of the clock, inputs and outputs through pipes, and several threads.

The tests wait for what happens, and only bound times from below.
"""

import os
import subprocess
import time
from pathlib import Path

import pytest

from fmu_master import FmuError, simulate
from native import LOOPS, in_c, run, write_system
from pendulum_fmus.project import PROGRAM

PENDULUM = "target/fmu/Pendulum.fmu"
SHORT = ("--output=theta", "--step=0.1", "--stop=0.3")


def test_a_paced_run_takes_its_time_and_has_the_same_rows(fmus, tmp_path):
    files = [tmp_path / "paced.csv", tmp_path / "plain.csv"]
    begin = time.monotonic()
    result = run("simulate", PENDULUM, "--set=theta0=0.1", *SHORT, "--csv", files[0], "--real-time")
    assert time.monotonic() - begin >= 0.3
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert any(line.startswith("real time x 1: ") and " of 3 steps " in line for line in lines)
    assert any(line.startswith("longest step: ") and "Pendulum took" in line for line in lines)
    run("simulate", PENDULUM, "--set=theta0=0.1", *SHORT, "--csv", files[1])
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize("in_process", [False, True])
def test_python_has_the_numbers_of_a_paced_run(fmus, in_process):
    begin = time.monotonic()
    result = simulate(PENDULUM, stop_time=0.4, step_size=0.1, real_time=2.0, in_process=in_process)
    assert time.monotonic() - begin >= 0.2
    kept = result.real_time
    assert (kept.factor, kept.steps, kept.overruns <= 4) == (2.0, 4, True)
    assert kept.longest_step[2] == "Pendulum"
    if kept.jitter:
        assert list(kept.jitter) == [50.0, 99.0, 99.9, 100.0]
        assert sorted(kept.jitter.values()) == list(kept.jitter.values())
    assert simulate(PENDULUM, stop_time=0.1).real_time is None


@pytest.mark.parametrize("factor", ["0", "-1", "nan", "inf", "fast"])
def test_a_factor_is_a_positive_number(fmus, factor):
    assert "--real-time" in run("simulate", PENDULUM, "--real-time", factor).stderr
    if factor != "fast":
        with pytest.raises(FmuError, match=r"^real_time = .*expected a finite number above 0"):
            simulate(PENDULUM, real_time=float(factor))


LIVE = ("--output=theta", "--output=u", "--step=0.05", "--real-time", "--csv=-")


def started(*options: str, given=subprocess.PIPE) -> subprocess.Popen[str]:
    """Start a run in real time whose rows are read as they come."""
    command = [PROGRAM, "simulate", PENDULUM, *LIVE, *options]
    return subprocess.Popen(
        command, stdin=given, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def inputs(process: subprocess.Popen[str]) -> list[float]:
    """Return the inputs of the rows that follow, to the end of the run."""
    return [float(line.split(",")[2]) for line in process.stdout]


def test_a_row_of_inputs_takes_effect_when_it_arrives_and_holds(fmus):
    with started("--input=-", "--stop=1") as process:
        process.stdin.write("time,u\n0,1\n")
        process.stdin.flush()
        assert process.stdout.readline() == "time [s],theta [rad],u [N]\n"
        first = process.stdout.readline()
        assert first.startswith("0.0,0.0,")
        # Its time has passed, or not come.
        process.stdin.write("0,2\n100,3\n")
        process.stdin.close()
        found = inputs(process)
    assert process.wait() == 0
    assert set(found) <= {1.0, 2.0}
    assert found == sorted(found)
    assert found[-1] == 2.0


def test_a_pipe_with_a_name_has_inputs_and_the_start_value_holds_until_a_row(fmus, tmp_path):
    pipe = tmp_path / "inputs"
    os.mkfifo(pipe)
    process = started(f"--input={pipe}", "--set=u=5", "--stop=0.2", given=None)
    with process, pipe.open("w") as rows:
        rows.write("time,u\n")
        rows.flush()
        found = inputs_after_names(process)
    assert found == [5.0] * 5


def inputs_after_names(process: subprocess.Popen[str]) -> list[float]:
    """Return the inputs of all rows."""
    process.stdout.readline()
    return inputs(process)


def test_an_invalid_row_ends_the_run_by_its_number(fmus):
    with started("--input=-", "--stop=60") as process:
        process.stdin.write("time,u\n0,1\n")
        process.stdin.flush()
        process.stdout.readline()
        process.stdout.readline()
        process.stdin.write("0,fast\n")
        process.stdin.flush()
        said = process.stderr.read()
    assert "standard input: row 2: u is fast, expected a number" in said
    assert process.wait() == 1


def test_a_table_through_a_pipe_is_read_whole_without_real_time(fmus, tmp_path):
    table = "time,u\n0,0\n1,1\n"
    (tmp_path / "table.csv").write_text(table)
    options = ("simulate", PENDULUM, "--step=0.25", "--stop=1", "--output=u", "--csv=-")
    piped = run(*options, "--input=-", input=table)
    assert piped.returncode == 0, piped.stderr
    assert piped.stdout == run(*options, "--input", tmp_path / "table.csv").stdout
    assert piped.stdout.splitlines()[2] == "0.25,0.0"


def test_only_tables_are_standard_input_or_output(fmus, tmp_path):
    table = "time,u\n0,1\n"
    (tmp_path / "a.csv").write_text(table)
    assert run("compare", "a.csv", "-", input=table, cwd=tmp_path).returncode == 0
    assert "one standard input" in run("compare", "-", "-", input="", cwd=tmp_path).stderr
    said = run("simulate", Path(PENDULUM).absolute(), "--plot=-", cwd=tmp_path).stderr
    assert "expected the name of an HTML page" in said
    said = run(
        "simulate", Path(PENDULUM).absolute(), "--stop=0.01", "--trace=-", cwd=tmp_path
    ).stderr
    assert "to which only rows in CSV are written" in said
    assert "it is the standard input" in run("info", "-", cwd=tmp_path).stderr
    assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_threads_do_not_change_results(fmus, tmp_path, order):
    system = LOOPS / "pid.toml"
    options = ("--order", order, "--stop=0.5")
    files = [tmp_path / f"{threads}.csv" for threads in (1, 2, 8)]
    for threads, file in zip((1, 2, 8), files, strict=True):
        assert (
            run("simulate", system, *options, f"--threads={threads}", "--csv", file).returncode == 0
        )
    assert len({file.read_bytes() for file in files}) == 1


@pytest.mark.parametrize(
    ("fault", "how"),
    [
        (1, "was ended by signal 11"),
        (2, "was ended by signal 6"),
        (3, "exited with code 0"),
        (9, "returned fmi2Error"),
    ],
)
def test_with_threads_the_component_that_ends_the_process_is_named(tmp_path, fault, how):
    in_c(tmp_path / "Faulty.fmu")
    write_system(tmp_path, {name: {} for name in "abcd"}, fmu="Faulty", step=0.001)
    for name in "ad":
        options = (f"--set={name}.fault={fault}", f"--set={name}.at=0.5", "--threads=2")
        said = run("simulate", "system.toml", *options, cwd=tmp_path).stderr
        assert f"{name} (Faulty.fmu), step of 0.001 s at t = 0.5 s: fmi2DoStep {how}" in said


def test_threads_without_components_for_them_are_noted(fmus):
    said = run("simulate", PENDULUM, "--stop=0.1", "--threads=2").stdout
    assert "threads have no effect" in said
