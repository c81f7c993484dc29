"""The FMPy master: its script, errors, communication steps, and comparison with other masters."""

import csv
import itertools
import math
import shutil
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from pendulum_fmus import loop, master
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, MasterError, System, simulate, steps_until
from pendulum_fmus.project import ROOT
from side_by_side import assert_close, both

SCRIPT = ROOT / "tests" / "master.py"


def script(*arguments: object, cwd: Path) -> subprocess.CompletedProcess:
    """Run master.py from a directory outside the project."""
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


# --- the script ---------------------------------------------------------------------------------


def test_help_lists_every_option_and_gives_examples(tmp_path):
    run = script("--help", cwd=tmp_path)
    assert run.returncode == 0
    for option in (
        "--controller", "--target", "--signal", "--disturbance", "--order", "--step", "--start",
        "--stop", "--plant-model", "--fmus", "--csv", "--set", "-w0", "examples:",
    ):  # fmt: skip
        assert option in run.stdout


def read_csv(path: Path) -> tuple[list[str], np.ndarray]:
    """Return header and values of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, float)


def test_csv_contains_every_sample_to_the_last_bit(fmus, tmp_path):
    run = script(
        "--controller", "PidRbf", "--signal", "sine", "--disturbance", 0.5, "--stop", 1,
        "--csv", "out.csv", "-w0", -0.1, 0.2, 0.3, 0.4, cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    header, values = read_csv(tmp_path / "out.csv")
    with Loop("PidRbf", "sine", 0.5, w0=(-0.1, 0.2, 0.3, 0.4)).system(fmus) as system:
        results = simulate(system, TS, TS, 1000)
    assert [name.split(" [")[0] for name in header] == list(results)
    for name in ("time [s]", "source.r [rad]", "plant.theta [rad]", "plant.v [m/s]",
                 "controller.u [N]", "controller.rbf.w[1] [N]"):  # fmt: skip
        assert name in header
    np.testing.assert_array_equal(values, np.column_stack(list(results.values())))
    np.testing.assert_array_equal(values[:, 0], TS + TS * np.arange(1000))
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]


def test_the_last_sample_of_the_script_matches_table_1(fmus, tmp_path, table_results):
    run = script("--controller", "Pid", "--csv", "pid.csv", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    header, values = read_csv(tmp_path / "pid.csv")
    error = values[:, header.index("controller.e [rad]")]
    np.testing.assert_array_equal(error, table_results[Loop("Pid", "step", 0.0)]["controller.e"])
    assert "-1.96384" in run.stdout
    assert "maximum |u|     100 N" in run.stdout
    assert "20000 rows" in run.stdout


def test_summary_shows_the_settling_time(fmus, tmp_path):
    run = script("--target", "supervisor", "--stop", 5, cwd=tmp_path)
    assert "settling time   2.483 s (band of ±0.3%)" in run.stdout
    never = script("--target", "supervisor", "--stop", 1, cwd=tmp_path)
    assert "settling time   never" in never.stdout


def test_set_reaches_any_parameter(fmus, tmp_path):
    run = script(
        "--controller", "Pid", "--stop", 0.1, "--set", "controller.u_max=7",
        "--set", "plant.model=nonlinear", "--set", "controller.previous_sample_terms=false",
        cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert "maximum |u|     7 N" in run.stdout


BAD_INPUT = [
    (["--controller", "Lqr"], "invalid choice: 'Lqr'"),
    (["--signal", "noise"], "invalid choice: 'noise'"),
    (["--step", "abc"], "invalid float value: 'abc'"),
    (["--step", "0"], "not a positive number"),
    (["--step", "nan"], "not a positive number"),
    (["--step", "-1"], "not a positive number"),
    (["--step", "1e-12"], "are too many"),
    (["--stop", "0"], "before the start time"),
    (["--stop", "inf"], "before the start time"),
    (["--fmus", "nowhere"], "run `cargo fmu export`"),
    (["--set", "pid.kp"], "component.variable=value"),
    (["--set", "robot.kp=1"], "no component 'robot'"),
    (["--set", "controller.pid.kpp=1"], "did you mean pid.kp"),
    (["--set", "controller.pid.kp=high"], "a number is expected"),
    (["--set", "controller.previous_sample_terms=maybe"], "true or false is expected"),
    (["--set", "plant.model=cubic"], "one of transfer_function, linear, nonlinear"),
    (["--set", "plant.model=9"], "one of transfer_function, linear, nonlinear"),
    (["--set", "controller.u=1"], "only inputs and parameters can be set"),
    (["--set", "controller.ts=0"], "ts"),
    (["--set", "controller.pid.kp=nan"], "pid.kp"),
    (["--disturbance", "nan"], "disturbance.amplitude"),
    (["--csv", "missing/out.csv"], "missing/out.csv cannot be written: No such file"),
    (["--csv", "."], ". cannot be written: Is a directory"),
    (["--controller", "Pid", "--target", "supervisor"], "only IpidRbf"),
    (["--controller", "Pid", "-w0", "1", "2", "3", "4"], "rbf.w0[1]"),
    (["--supervisor-w0", "1", "2", "3", "4"], "no supervisor"),
    (["-w0", "1", "2"], "expected 4 arguments"),
    (["--plant-model", "transfer_function", "--step", "0.0005"], "at t = 0.001 s"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT, ids=lambda v: " ".join(v)[:40])
def test_errors_on_bad_input_say_what_to_do(fmus, tmp_path, arguments, message):
    run = script(*arguments, cwd=tmp_path)
    assert run.returncode in (1, 2)
    assert message in run.stderr
    assert "Traceback" not in run.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x05\x06" + bytes(18)])
def test_a_damaged_fmu_is_named(tmp_path, content):
    (tmp_path / "IpidRbf.fmu").write_bytes(content)
    run = script("--fmus", tmp_path, cwd=tmp_path)
    assert run.returncode == 1
    assert "IpidRbf.fmu" in run.stderr
    assert "Traceback" not in run.stderr


def test_a_failed_run_keeps_the_old_csv(fmus, tmp_path):
    (tmp_path / "out.csv").write_text("precious")
    run = script("--csv", "out.csv", "--set", "controller.ts=0", cwd=tmp_path)
    assert run.returncode == 1
    assert (tmp_path / "out.csv").read_text() == "precious"


def test_csv_can_be_written_to_a_device(fmus, tmp_path):
    run = script("--stop", 0.01, "--csv", "/dev/stdout", cwd=tmp_path)
    assert run.stdout.startswith("time [s],")


def test_the_example_in_the_docstring_balances_the_pendulum(fmus, monkeypatch):
    monkeypatch.chdir(ROOT)
    example = master.__doc__.split("communication step.\n\n")[1].split("\n\nThere are two")[0]
    namespace = dict(vars(master))
    exec(textwrap.dedent(example), namespace)
    theta = namespace["results"]["plant.theta"]
    assert theta[0] == 0.1
    assert abs(theta[-1]) < 1e-3


# --- systems ------------------------------------------------------------------------------------


def test_closing_removes_the_unzipped_files(fmus, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Loop("IpidRbf", target="supervisor").system(fmus) as system:
        assert len(list(tmp_path.iterdir())) == 5
        simulate(system, TS, TS, 10)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_instantiation_frees_the_earlier_components(fmus, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(MasterError, match=r"no variable M2"):
        Loop("Pid", overrides=(("plant.M2", 1.0),)).system(fmus)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("connections", "message"),
    [
        ([("plant.theta", "robot.y")], "no component 'robot'"),
        ([("plant.thetta", "controller.y")], "did you mean theta"),
        ([("plant.u", "controller.y")], "plant.u is connected as an output"),
        ([("plant.theta", "controller.u")], "controller.u is connected as an input"),
        ([("plant.theta", "controller.y"), ("plant.x", "controller.y")], "connected twice"),
    ],
)
def test_wrong_connections_are_rejected(fmus, connections, message):
    with (
        Component("plant", fmus / "Pendulum.fmu") as plant,
        Component("controller", fmus / "Pid.fmu") as controller,
        pytest.raises(MasterError, match=message),
    ):
        System([controller, plant], connections)


def test_only_reals_can_be_recorded(fmus):
    with Loop("Pid").system(fmus) as system, pytest.raises(MasterError, match="not a Real"):
        simulate(system, TS, TS, 1, record=["plant.model"])


def test_a_failed_step_names_the_fmu_the_time_and_the_reason(fmus):
    with (
        Loop("Pid", plant_model="transfer_function").system(fmus) as system,
        pytest.raises(
            MasterError,
            match=r"plant \(Pendulum\.fmu\), step of 0\.0015 s at t = 0\.001 s: "
            r"fmi2DoStep returned status 3: .*ts",
        ),
    ):
        simulate(system, TS, 0.0015, 10)


def test_settling_time_is_the_last_entry_into_the_band():
    time = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert loop.settling_time(time, np.array([9, 0, -9, 0.5, 1]), 1.0) == 4.0
    assert loop.settling_time(time, np.zeros(5)) == 1.0
    assert math.isnan(loop.settling_time(time, np.array([0, 0, 0, 0, 2.0]), 1.0))
    assert math.isnan(loop.settling_time(time, np.array([0, 0, 0, 0, math.nan]), 1.0))


@pytest.mark.parametrize(
    ("stop", "start", "step", "steps"),
    [(20, 0.001, 0.001, 20000), (0.001, 0.001, 0.001, 1), (1, 0, 1 / 1024, 1025), (1, 0, 0.3, 4)],
)
def test_the_last_communication_point_is_not_after_the_stop_time(stop, start, step, steps):
    assert steps_until(stop, start, step) == steps


# --- any step, both orders ----------------------------------------------------------------------

LOOPS = [("Pid", "own"), ("PidRbf", "own"), ("IpidRbf", "own"), ("IpidRbf", "supervisor")]


@pytest.mark.parametrize(
    ("order", "step", "steps"), [("sequential", 1 / 1024, 6000), ("parallel", 0.01, 200)]
)
@pytest.mark.parametrize(("controller", "target"), LOOPS)
def test_loop_agrees_with_the_reference_at_any_step(fmus, controller, target, step, steps, order):
    """At 10 ms the loops are unstable, as the derivative acts on one sample in ten."""
    computed, expected = both(
        fmus, controller, "square", 1.0, target=target, order=order,
        step=step, steps=steps, previous_sample_terms=False,
    )  # fmt: skip
    assert_close(computed, expected, 1e-10)


def test_parallel_stepping_does_not_depend_on_the_order_of_the_components(fmus):
    def run(order: list[str]) -> dict[str, np.ndarray]:
        with Loop("IpidRbf", "sine", target="supervisor").system(fmus) as system:
            components = [system.components[name] for name in order]
            reordered = System(components, system.connections)
            return simulate(reordered, TS, TS, 500, order="parallel", record=system.outputs())

    names = ["supervisor", "supervisor_plant", "controller", "plant", "source"]
    first = run(names)
    for order in itertools.islice(itertools.permutations(names), 7, None, 23):
        for name, column in run(list(order)).items():
            np.testing.assert_array_equal(column, first[name])


def test_two_sources_equal_one_at_any_position_after_the_controller(fmus):
    def run(order: list[str], reference: str, disturbance: str) -> np.ndarray:
        start = {"signal": "sine", "disturbance.amplitude": 1.0, "disturbance.start": 0.1}
        parts = {
            "controller": Component("controller", fmus / "Pid.fmu", sampled=True),
            "plant": Component("plant", fmus / "Pendulum.fmu"),
            "source": Component("source", fmus / "Source.fmu", start),
            "other": Component("other", fmus / "Source.fmu", start),
        }
        connections = [
            (f"{reference}.r", "controller.r"),
            (f"{disturbance}.d", "controller.d"),
            ("plant.theta", "controller.y"),
            ("controller.u", "plant.u"),
        ]
        with System([parts[name] for name in order], connections) as system:
            return simulate(system, TS, TS, 500, record=["plant.theta"])["plant.theta"]

    expected = run(["controller", "plant", "source", "other"], "source", "source")
    assert np.any(expected != 0)
    for order in (
        ["controller", "plant", "source", "other"],
        ["controller", "source", "plant", "other"],
        ["controller", "other", "source", "plant"],
    ):
        np.testing.assert_array_equal(run(order, "source", "other"), expected)


# --- other masters ------------------------------------------------------------------------------


class Plain:
    """An FMU accessed through FMPy's convenience methods, without master.py."""

    def __init__(self, path: Path, start: float, **values: float | bool):
        description = fmpy.read_model_description(path)
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        folder = fmpy.extract(path)
        self.fmu: FMU2Slave = fmpy.instantiate_fmu(folder, description, "CoSimulation")
        self.folder = folder
        for name, value in values.items():
            setter = self.fmu.setBoolean if isinstance(value, bool) else self.fmu.setReal
            setter([self.references[name.replace("__", ".")]], [value])
        self.fmu.setupExperiment(startTime=start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        """Set inputs."""
        self.fmu.setReal([self.references[name] for name in values], list(values.values()))

    def get(self, *names: str) -> list[float]:
        """Return outputs."""
        return self.fmu.getReal([self.references[name] for name in names])

    def step(self, time: float, h: float) -> None:
        """Step from `time` to `time + h`."""
        self.fmu.doStep(time, h)

    def close(self) -> None:
        """Terminate, free and remove."""
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_plain_fmpy_loop_gives_the_same_bits(fmus, order):
    steps = 1500
    source = Plain(fmus / "Source.fmu", TS, disturbance__amplitude=1.0, disturbance__start=0.5)
    controller = Plain(fmus / "PidRbf.fmu", TS, previous_sample_terms=order == "sequential")
    plant = Plain(fmus / "Pendulum.fmu", TS)
    angles = []
    for k in range(steps):
        t = TS + k * TS
        (r, d), (theta,), (u,) = source.get("r", "d"), plant.get("theta"), controller.get("u")
        angles.append(theta)
        controller.set(r=r, d=d, y=theta)
        controller.step(t, TS)
        if order == "sequential":
            (u,) = controller.get("u")
        plant.set(u=u)
        plant.step(t, TS)
        source.step(t, TS)
    for fmu in (source, controller, plant):
        fmu.close()

    loop = Loop(
        "PidRbf",
        disturbance=1.0,
        previous_sample_terms=order == "sequential",
        overrides=(("source.disturbance.start", 0.5),),
    )
    with loop.system(fmus) as system:
        results = simulate(system, TS, TS, steps, order=order, record=["plant.theta"])
    np.testing.assert_array_equal(angles, results["plant.theta"])
