"""The FMPy master: its script, and systems of FMUs of both versions."""

import csv
import math
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numpy as np
import pytest

from pendulum_fmus import loop, master, run
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, FmpySystem, MasterError, simulate
from pendulum_fmus.project import ROOT

# --- the script ---------------------------------------------------------------------------------


@pytest.fixture
def script(fmus, tmp_path, monkeypatch, capsys):
    """Return a function that runs the script in an empty folder: (exit status, output, errors)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        given = [] if "--fmus" in arguments else ["--fmus", str(fmus)]
        try:
            status = run.main([*given, *map(str, arguments)])
        except SystemExit as exit_:  # of argparse
            status = exit_.code
        return status, *capsys.readouterr()

    return call


def test_an_installed_package_takes_the_fmus_of_the_current_folder(fmus, tmp_path):
    shutil.copytree(Path(run.__file__).parent, tmp_path / "pendulum_fmus")

    def call(module: str, *options: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", f"pendulum_fmus.{module}", *options]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    message = "run `cargo fmu export` first, or name the folder of the FMUs"
    assert message in call("run").stderr
    assert "\n  python -m pendulum_fmus.run --order parallel" in call("run", "--help").stdout
    assert re.match(r"python -m pendulum_fmus\.table1: .*/PidRbf\.fmu does", call("table1").stderr)
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "fmu").symlink_to(fmus)
    assert "final e" in call("run", "--stop", "0.1").stdout


def test_csv_contains_every_sample_to_the_last_bit(script, fmus, tmp_path):
    weights = (-0.1, 0.2, 0.3, 0.4)
    options = ["--controller", "PidRbf", "--signal", "sine", "--disturbance", 0.5, "--stop", 1]
    status, said, _ = script(*options, "-w0", *weights, "--csv", "out.csv")
    assert status == 0
    assert "1000 rows" in said
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    with Loop("PidRbf", "sine", 0.5, w0=weights).system(fmus) as system:
        results = simulate(system, TS, TS, 1000)
    assert [name.split(" [")[0] for name in header] == list(results)
    units = ("time [s]", "source.r [rad]", "plant.v [m/s]", "controller.rbf.w[1] [N]")
    assert set(units) < set(header)
    np.testing.assert_array_equal(np.array(rows, float), np.column_stack(list(results.values())))
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]


def test_the_script_in_the_tests_has_the_same_options():
    command = [sys.executable, ROOT / "tests" / "master.py", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert all(option in done.stdout for option in ("--controller", "--signal", "--order", "--csv"))


def test_the_summary_shows_the_last_error_the_settling_time_and_the_force(script):
    _, said, _ = script("--target", "supervisor", "--stop", 5)
    assert "settling time   2.483 s (band of ±0.3%)" in said
    options = ["--set", "controller.u_max=7", "--set", "plant.dynamics=nonlinear"]
    _, said, _ = script("--controller", "Pid", "--stop", 0.1, *options)
    assert "settling time   never" in said
    assert "maximum |u|     7 N" in said
    assert "rad at t = 0.1 s" in said


def test_the_script_takes_fmus_of_both_versions(script):
    expected = script("--stop", 0.2)
    assert expected[0] == 0
    for arguments in (["--fmi3"], ["--fmi3", "plant"], ["--fmi3", "controller", "source"]):
        assert script("--stop", 0.2, *arguments) == expected


BAD_INPUT = [
    (["--step", "0"], "not a positive number"),
    (["--step", "nan"], "not a positive number"),
    (["--step", "1e-12"], "are too many"),
    (["--stop", "0"], "before the start time"),
    (["--fmus", "nowhere"], "run `cargo fmu export` first"),
    (["--fmus", "nowhere", "--fmi3"], "run `cargo fmu export --fmi 3.0` first"),
    (["--fmi3", "robot"], "no component 'robot'"),
    (["--set", "pid.kp"], "component.variable=value"),
    (["--set", "robot.kp=1"], "no component 'robot'"),
    (["--set", "controller.pid.kpp=1"], "IpidRbf.fmu has no variable pid.kpp"),
    (["--set", "controller.pid.kp=high"], "pid.kp = high: could not convert"),
    (["--set", "controller.previous_sample_terms=maybe"], "previous_sample_terms = maybe: invalid"),
    (["--set", "plant.dynamics=cubic"], "dynamics = cubic: invalid"),
    (["--set", "plant.M=-1"], "M = -1"),
    (["--csv", "missing/out.csv"], "missing/out.csv cannot be written: No such file"),
    (["--csv", "."], ". cannot be written: Is a directory"),
    (["--controller", "Pid", "--target", "supervisor"], "only IpidRbf"),
    (["--controller", "Pid", "-w0", "1", "2", "3", "4"], "rbf.w0[1]"),
    (["--supervisor-w0", "1", "2", "3", "4"], "no supervisor"),
    (["--plant-model", "transfer_function", "--step", "0.0005"], "at t = 0.001 s"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT, ids=lambda v: " ".join(v)[:40])
def test_errors_on_bad_input_say_what_to_do(script, tmp_path, arguments, message):
    status, _, said = script(*arguments)
    assert status in (1, 2)
    assert message in said
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_fmu_is_named(script, tmp_path):
    for content in (b"", b"no zip at all", b"PK\x05\x06" + bytes(18)):
        (tmp_path / "IpidRbf.fmu").write_bytes(content)
        status, _, said = script("--fmus", tmp_path)
        assert status == 1
        assert "IpidRbf.fmu" in said


def test_a_failed_run_keeps_the_old_csv_and_a_device_stays_one(script, tmp_path):
    (tmp_path / "out.csv").write_text("precious")
    assert script("--csv", "out.csv", "--set", "controller.ts=0")[0] == 1
    assert (tmp_path / "out.csv").read_text() == "precious"
    assert script("--stop", 0.01, "--csv", "/dev/null")[0] == 0
    assert Path("/dev/null").is_char_device()


def test_the_example_in_the_docstring_balances_the_pendulum(fmus, monkeypatch):
    monkeypatch.chdir(ROOT)
    example = master.__doc__.split("`fmu_master`.\n\n")[1].split("\n\nThere are two")[0]
    namespace = dict(vars(master))
    exec(textwrap.dedent(example).replace("target/fmu", str(fmus)), namespace)
    theta = namespace["results"]["plant.theta"]
    assert theta[0] == 0.1
    assert abs(theta[-1]) < 1e-3


# --- systems ------------------------------------------------------------------------------------


def test_closing_removes_the_unzipped_files(fmus, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Loop("IpidRbf", target="supervisor").system(fmus) as system:
        assert len(list(tmp_path.iterdir())) == 5
        simulate(system, TS, TS, 10)
    with pytest.raises(MasterError, match=r"no variable M2"):
        Loop("Pid", overrides=(("plant.M2", 1.0),)).system(fmus)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fmi3", [(), ("all",)], ids=["2.0", "3.0"])
def test_a_failed_step_names_the_fmu_the_time_and_the_reason(fmus, fmi3):
    message = (
        r"plant \(Pendulum(_fmi3)?\.fmu\), step of 0\.0015 s at t = 0\.001 s:"
        r" fmi[23]DoStep returned status \d: .*ts"
    )
    with (
        Loop("Pid", plant_model="transfer_function", fmi3=fmi3).system(fmus) as system,
        pytest.raises(MasterError, match=message),
    ):
        simulate(system, TS, 0.0015, 10)


def test_settling_time_is_the_last_entry_into_the_band():
    time = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    for error, settled in {
        (9, 0, -9, 0.5, 1): 4,
        (0, 0, 0, 0, 0): 1,
        (0, 0, 0, 0, 2): math.nan,
        (0, 0, 0, 0, math.nan): math.nan,
    }.items():
        found = loop.settling_time(time, np.array(error, float), 1.0)
        assert found == pytest.approx(settled, nan_ok=True)


def test_the_last_communication_point_is_not_after_the_stop_time():
    assert run.steps_until(20, 0.001, 0.001) == 20000
    assert run.steps_until(0.001, 0.001, 0.001) == 1
    assert run.steps_until(1, 0, 1 / 1024) == 1025
    assert run.steps_until(1, 0, 0.3) == 4


# --- arrays and structural parameters of FMI 3.0 ------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rbf.nodes": 6, "rbf.w0[5]": 1.0}, r"rbf\.w0\[6\] = None: "),
        *(({"rbf.nodes": n}, r"rbf\.nodes") for n in (0, 17, -1, 2**64, 4.5, "many")),
        ({"rbf.w0[5]": 1.0}, r"no variable rbf\.w0\[5\]"),
        ({"rbf.w0": 1.0}, r"no variable rbf\.w0$"),
        ({"rbf.b[2]": -1.0}, r"fmi3SetFloat64 returned status \d: .*rbf\.b"),
    ],
)
def test_wrong_start_values_are_refused_by_name(fmus, given, message):
    with (
        pytest.raises(MasterError, match=message),
        Component("part", fmus / "PidRbf_fmi3.fmu", given) as instance,
    ):
        instance.initialize(0.0)


def test_elements_of_arrays_are_set_connected_and_recorded_as_variables_of_fmi_2(fmus):
    def run(ending: str) -> dict[str, np.ndarray]:
        controller = Component("controller", fmus / f"PidRbf{ending}.fmu", {"rbf.w0[3]": 5.0})
        plant = Component("plant", fmus / f"Pendulum{ending}.fmu", {"theta0": 0.1})
        connections = [("controller.rbf.w[3]", "plant.u"), ("plant.theta", "controller.y")]
        record = ["controller.rbf.w[3]", "plant.v", "controller.rbf.h[1]", "controller.rbf.w[1]"]
        with FmpySystem([controller, plant], connections) as system:
            return simulate(system, TS, TS, 100, record=record)

    columns, expected = run("_fmi3"), run("")
    assert list(columns) == list(expected)
    for name, column in expected.items():
        assert columns[name].tobytes() == column.tobytes(), name
    assert columns["controller.rbf.w[3]"][0] == 5.0
    assert columns["plant.v"][1] > 0
