"""The native master: bitwise equality with FMPy's master, Table 1, options, output."""

import csv
import os
import pty
import re
import shutil
import subprocess
import termios
from pathlib import Path

import numpy as np
import pytest

from native import LOOPS, PROGRAM, read_csv, refusal, run, simulate, write_system
from pendulum_fmus import table1
from pendulum_fmus.loop import FREQUENCY, TS, Loop
from pendulum_fmus.master import simulate as couple
from pendulum_fmus.project import FMUS

FILES = {
    ("Pid", "own"): "pid.toml",
    ("PidRbf", "own"): "pid-rbf.toml",
    ("IpidRbf", "own"): "ipid-rbf.toml",
    ("IpidRbf", "supervisor"): "supervised.toml",
}
"""The example system of each loop."""


@pytest.fixture(scope="module", autouse=True)
def _exported(fmus: Path) -> None:
    """Export the FMUs that the examples use."""


# --- equality with FMPy's master ------------------------------------------------------------------


def sets(loop: Loop) -> list[str]:
    """Return the options that give an example the signals of a run of Table 1."""
    values = {"source.signal": loop.signal, "source.disturbance.amplitude": loop.disturbance}
    if loop.signal in FREQUENCY:
        values["source.frequency"] = FREQUENCY[loop.signal]
    for component, weights in (("controller", loop.w0), ("supervisor", loop.supervisor_w0)):
        for j, weight in enumerate(weights or (), start=1):
            values[f"{component}.rbf.w0[{j}]"] = weight
    return [f"--set={name}={value}" for name, value in values.items()]


def assert_same_bits(computed: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """Compare columns by name, distinguishing 0.0 from -0.0."""
    assert computed.keys() == expected.keys()
    for name, column in expected.items():
        differ = np.flatnonzero(computed[name].view(np.uint64) != column.view(np.uint64))
        assert differ.size == 0, (name, differ[0], computed[name][differ[0]], column[differ[0]])


@pytest.mark.parametrize(
    "loop",
    sorted(table1.runs(), key=repr),
    ids=lambda run: f"{run.controller}-{run.signal}-{run.disturbance}-{run.w0}",
)
def test_the_runs_of_table_1_equal_fmpys_bit_for_bit(loop, table_results, tmp_path):
    expected = table_results[loop]
    outputs = [f"--output={name}" for name in expected if name != "time"]
    file = LOOPS / FILES[loop.controller, loop.target]
    assert_same_bits(simulate(file, tmp_path, *sets(loop), *outputs), expected)


def test_pid_rbf_alone_equals_the_supervisor_bit_for_bit(table_results, tmp_path):
    """It equals the supervising loop in `supervised.toml`."""
    excitation = ("square", 1.0)
    beside = table_results[Loop("IpidRbf", *excitation, "supervisor")]
    expected = {"time": beside["time"]} | {
        name: beside[name.replace("controller", "supervisor").replace("plant", "supervisor_plant")]
        for name in ("controller.e", "controller.u", "plant.theta")
    }
    options = sets(Loop("PidRbf", *excitation))
    outputs = [f"--output={name}" for name in expected if name != "time"]
    assert_same_bits(simulate(LOOPS / "pid-rbf.toml", tmp_path, *options, *outputs), expected)


VARIATIONS = [
    # order, model of the plant, communication step [s]
    ("parallel", "linear", TS),
    ("sequential", "transfer_function", TS),
    ("parallel", "nonlinear", 0.00025),
]


@pytest.mark.parametrize(("order", "model", "step"), VARIATIONS)
@pytest.mark.parametrize(("controller", "target"), FILES)
def test_every_output_equals_fmpys_bit_for_bit(controller, target, order, model, step, tmp_path):
    steps = 1000
    start = {"source.disturbance.start": 0.1, "source.disturbance.duration": 0.1}
    if order == "parallel":
        start |= {
            f"{name}.previous_sample_terms": "false"
            for name in ("controller", "supervisor")
            if name == "controller" or target == "supervisor"
        }
    loop = Loop(controller, "sine", 1.0, target, plant_model=model, overrides=tuple(start.items()))
    with loop.system() as system:
        expected = couple(system, TS, step, steps, order=order)
    start["plant.model"] = model
    if target == "supervisor":
        start["supervisor_plant.model"] = model
    computed = simulate(
        LOOPS / FILES[controller, target], tmp_path,
        *sets(Loop(controller, "sine", 1.0, target)),
        *(f"--set={name}={value}" for name, value in start.items()),
        f"--order={order}", f"--step={step}", f"--stop={TS + (steps - 1) * step}",
    )  # fmt: skip
    assert np.any(computed["source.d"])
    assert_same_bits(computed, expected)


# --- options --------------------------------------------------------------------------------------

PID = LOOPS / "pid.toml"


@pytest.mark.parametrize(
    ("start", "stop", "step", "steps"),
    [(0.001, 0.02, 0.001, 20), (0, 1, 1 / 1024, 1025), (-0.5, 0.4, 0.3, 4), (2, 2, 0.1, 1)],
)
def test_options_set_the_times(start, stop, step, steps, tmp_path):
    options = (f"--start={start}", f"--stop={stop}", f"--step={step}")
    time = simulate(PID, tmp_path, *options)["time"]
    np.testing.assert_array_equal(time, start + step * np.arange(steps))


def test_set_reaches_every_type_of_parameter(tmp_path):
    columns = simulate(
        PID, tmp_path, "--stop=0.1", "--set=controller.u_max=7", "--set=plant.theta0=0.25",
        "--set=plant.model=nonlinear", "--set=controller.previous_sample_terms=false",
        "--set=source.amplitude=-2", "--set=source.amplitude=3",
    )  # fmt: skip
    assert np.abs(columns["controller.u"]).max() == 7
    assert columns["plant.theta"][0] == 0.25
    assert set(columns["source.r"]) == {3.0}, "the last of two applies"


def test_output_selects_the_columns_and_their_order(tmp_path):
    names = ["source.r", "controller.u", "plant.theta", "controller.e"]
    columns = simulate(PID, tmp_path, "--stop=0.1", *(f"--output={name}" for name in names))
    assert list(columns) == ["time", *names]


def test_fmus_can_be_in_another_folder(tmp_path):
    shutil.copytree(FMUS, tmp_path / "others")
    shutil.copy(FMUS / "PidRbf.fmu", tmp_path / "others" / "Pid.fmu")
    columns = simulate(PID, tmp_path, "--stop=0.1", "--fmus", tmp_path / "others")
    assert "controller.rbf.w[1]" in columns


def test_an_option_sets_the_order(tmp_path):
    """In parallel order the plant receives the first force one step later."""
    first_move = {
        order: np.flatnonzero(simulate(PID, tmp_path, f"--order={order}", "--stop=0.1")["plant.v"])[
            0
        ]
        for order in ("sequential", "parallel")
    }
    assert first_move["parallel"] == first_move["sequential"] + 1


def test_paths_in_a_file_are_relative_to_its_folder(tmp_path):
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    (tmp_path / "target").symlink_to(FMUS.parent)
    shutil.copy(PID, folder)
    result = run("simulate", "a/b/pid.toml", "--stop=0.1", cwd=tmp_path)
    assert result.returncode == 0, result.stderr


# --- output ---------------------------------------------------------------------------------------


def test_the_summary_shows_last_values_with_units_and_the_speed(tmp_path):
    result = run("simulate", PID, "--stop=0.5", "--csv", "out.csv", cwd=tmp_path)
    assert result.stderr == "", "no progress bar without a terminal"
    head, *lines, speed, wrote = result.stdout.splitlines()
    assert head.split() == ["output", "at", "t", "=", "0.5", "s", "unit"]
    with (tmp_path / "out.csv").open(newline="") as file:
        heads, *_, last = csv.reader(file)
    expected = dict(zip(heads[1:], last[1:], strict=True))
    assert len(lines) == len(expected)
    for line in lines:
        name, value, unit = line.split()
        assert float(value) == float(f"{float(expected[f'{name} [{unit}]']):.9e}")
    assert "plant.theta [rad]" in expected
    assert "controller.u [N]" in expected
    simulated, elapsed, factor = re.fullmatch(
        r"([\d.]+) s in ([\d.]+) ms: ([\d.]+) times real time", speed
    ).groups()
    assert float(simulated) == 0.5
    assert float(factor) == pytest.approx(0.5 / (float(elapsed) / 1e3), rel=0.01)
    assert wrote == "wrote out.csv: 500 rows"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_csv_can_be_written_to_a_device(tmp_path):
    result = run("simulate", PID, "--stop=0.003", "--csv", "/dev/stdout", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    head, *rows = result.stdout.splitlines()[:4]
    assert head.startswith("time [s],controller.")
    assert [row.split(",")[0] for row in rows] == ["0.001", "0.002", "0.003"]


def test_an_existing_csv_file_is_replaced_and_a_link_to_it_is_kept(tmp_path):
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "link.csv").symlink_to("real.csv")
    run("simulate", PID, "--stop=0.003", "--csv", "link.csv", cwd=tmp_path)
    assert (tmp_path / "link.csv").is_symlink()
    assert len(read_csv(tmp_path / "real.csv")["time"]) == 3


def test_a_closed_pipe_is_not_an_error():
    command = f"'{PROGRAM}' simulate '{PID}' --csv /dev/stdout | head -n 1"
    result = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True
    )
    assert result.returncode == 0
    assert result.stderr == ""
    assert result.stdout.startswith("time [s],")


def on_a_terminal(*arguments: object) -> str:
    """Run the program with stderr on a terminal; return the terminal output."""
    ours, its = pty.openpty()
    termios.tcsetwinsize(its, (24, 120))
    with subprocess.Popen(
        [PROGRAM, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=its,
        env=os.environ | {"TERM": "xterm"},
    ) as process:
        os.close(its)
        shown = b""
        try:
            while some := os.read(ours, 4096):
                shown += some
        except OSError:  # end of file on Linux
            pass
    os.close(ours)
    assert process.returncode == 0, shown
    return shown.decode()


def test_a_terminal_shows_the_progress():
    shown = on_a_terminal("simulate", PID, "--step=0.000002", "--stop=5")
    times = re.findall(r"t = ([\d.]+) of 5 s, ([\d.]+) times real time", shown)
    assert len({time for time, _ in times}) > 2
    assert all(0 <= float(time) <= 5 and float(factor) >= 0 for time, factor in times)
    assert float(times[-1][1]) > 0


# --- failures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "1e300"])
def test_an_initialization_error_is_reported_with_its_reason(fmus, tmp_path, value):
    shutil.copy(fmus / "Pid.fmu", tmp_path / "Relay.fmu")
    write_system(tmp_path, {"controller": {}})
    options = ("--csv=out.csv", f"--set=controller.ts={value}")
    said = refusal(tmp_path, "simulate", "system.toml", *options)
    assert said.startswith("controller (Relay.fmu), ")
    assert re.search(r"fmi2\w+ returned fmi2Error: .*\bts\b.*; no file was written", said)


def test_divergence_is_reported(fmus, tmp_path):
    shutil.copy(fmus / "Pendulum.fmu", tmp_path / "Relay.fmu")
    write_system(tmp_path, {"plant": {"u": 1.0}}, stop=1000.0, step=0.001)
    said = refusal(tmp_path, "simulate", "system.toml")
    assert re.match(r"plant \(Relay\.fmu\), step of 0\.001 s at t = [\d.]+ s: fmi2DoStep", said)
    assert said.count("fmi2DoStep") == 1, "the name is not repeated, though the FMU logs it too"
    assert "diverge" in said
