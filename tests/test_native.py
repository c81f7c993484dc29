"""The native master: equality with FMPy's master, options, output, messages."""

import contextlib
import csv
import os
import pty
import re
import subprocess
import termios
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from native import LOOPS, PROGRAM, refusal, replaced, run, simulate
from pendulum_fmus.loop import FREQUENCY, TS, Loop
from pendulum_fmus.master import simulate as couple
from pendulum_fmus.project import FMUS

PID = LOOPS / "pid.toml"

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


# --- equality -------------------------------------------------------------------------------------

VARIATIONS = [
    # order, model of the plant, communication step [s]
    ("sequential", "linear", TS),
    ("parallel", "linear", TS),
    ("sequential", "transfer_function", TS),
    ("parallel", "nonlinear", 0.00025),
]


@pytest.mark.parametrize(("order", "model", "step"), VARIATIONS)
@pytest.mark.parametrize(("controller", "target"), FILES)
def test_every_output_equals_fmpys_bit_for_bit(controller, target, order, model, step, tmp_path):
    """`crates/fmu-master/tests/equality.rs` compares the runs of Table 1 with the mathematics."""
    steps = 1000
    start = {
        "source.signal": "sine",
        "source.frequency": FREQUENCY["sine"],
        "source.disturbance.amplitude": 1.0,
        "source.disturbance.start": 0.1,
        "source.disturbance.duration": 0.1,
    }
    loops = ("", "supervisor_")[: 1 + (target == "supervisor")]
    if order == "parallel":
        names = ("controller", "supervisor")[: len(loops)]
        start |= {f"{name}.previous_sample_terms": "false" for name in names}
    loop = Loop(controller, "sine", 1.0, target, plant_model=model, overrides=tuple(start.items()))
    with loop.system() as system:
        expected = couple(system, TS, step, steps, order=order)
    start |= {f"{prefix}plant.model": model for prefix in loops}
    sets = (f"--set={name}={value}" for name, value in start.items())
    stop = TS + (steps - 1) * step
    options = (f"--order={order}", f"--step={step}", f"--stop={stop}")
    computed = simulate(LOOPS / FILES[controller, target], tmp_path, *sets, *options)
    assert np.any(computed["source.d"])
    assert computed.keys() == expected.keys()
    for name, column in expected.items():
        # This distinguishes 0.0 from -0.0.
        differ = np.flatnonzero(computed[name].view(np.uint64) != column.view(np.uint64))
        assert differ.size == 0, (name, differ[0], computed[name][differ[0]], column[differ[0]])


def loop_of(folder: Path, example: str, outputs: str = "", **versions: str) -> Path:
    """Write an example with FMUs of other versions, and perhaps other outputs."""
    text = (LOOPS / example).read_text(encoding="utf-8")
    text = replaced(text, {f"/{model}.fmu": f"/{model}{v}.fmu" for model, v in versions.items()})
    system = folder / example
    text = text.replace("../../target/fmu", FMUS.as_posix())
    system.write_text(outputs + text, encoding="utf-8")
    return system


def table(system: Path, *options: str) -> bytes:
    """Return the CSV file of a run."""
    simulate(system, system.parent, "--stop", "1", *options)
    return (system.parent / "results.csv").read_bytes()


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_any_pairing_of_versions_gives_the_same_bytes(tmp_path, order):
    options = (f"--order={order}", "--set=plant.theta0=0.1", "--set=source.signal=sine")
    models = ("Pid", "Pendulum", "Source")
    pairings = [dict(zip(models, v, strict=True)) for v in product(["", "_fmi3"], repeat=3)]
    first, *others = [table(loop_of(tmp_path, "pid.toml", **p), *options) for p in pairings]
    assert first.count(b"\n") == 1001
    assert len(others) == 7
    assert all(rows == first for rows in others)


@pytest.mark.parametrize(("model", "example"), [("PidRbf", "pid-rbf"), ("IpidRbf", "ipid-rbf")])
@pytest.mark.parametrize("outputs", ["", 'outputs = ["controller.rbf.w[3]", "plant.theta"]\n'])
def test_elements_of_arrays_are_set_and_recorded_as_variables_of_fmi_2(
    tmp_path, model, example, outputs
):
    sets = [f"--set=controller.rbf.{name}" for name in ("c[2]=-0.5", "c[4]=1.5", "w0[1]=3")]

    def run_with(version: str, *options: str) -> bytes:
        versions = dict.fromkeys((model, "Pendulum", "Source"), version)
        return table(loop_of(tmp_path, f"{example}.toml", outputs, **versions), *options)

    assert run_with("_fmi3", *sets) == run_with("", *sets) != run_with("")


def test_a_structural_parameter_makes_arrays_larger(tmp_path):
    outputs = 'outputs = ["controller.u", "controller.rbf.nodes"]\n'
    system = loop_of(tmp_path, "pid-rbf.toml", outputs, PidRbf="_fmi3")

    def forces(nodes: int, **arrays: list[float]) -> np.ndarray:
        sets = [f"--set=controller.rbf.nodes={nodes}"]
        for name, values in arrays.items():
            sets += [f"--set=controller.rbf.{name}[{k}]={v}" for k, v in enumerate(values, 1)]
        results = simulate(system, tmp_path, "--stop", "1", *sets)
        assert set(results["controller.rbf.nodes"]) == {nodes}
        return results["controller.u"]

    centres, widths = [-2.0, -1.0, 1.0, 2.0], [0.5] * 4
    # Nodes that are never active add nothing.
    more = forces(8, c=centres + [1e9] * 4, b=widths + [1e-6] * 4, w0=[0.0] * 8)
    np.testing.assert_allclose(more, forces(4), rtol=1e-12)
    assert np.any(forces(1, c=[0.0], b=[1.0], w0=[0.0]) != more)

    def message(*assignments: str) -> str:
        sets = (f"--set=controller.{assignment}" for assignment in assignments)
        return refusal(tmp_path, "simulate", system, *sets)

    fmu = "PidRbf_fmi3.fmu"
    assert f"{fmu} has no variable rbf.c; its elements are rbf.c[1] to" in message("rbf.c=1")
    refused = f"controller ({fmu}), rbf.nodes = 17: fmi3SetUInt64 returned fmi3Error: rbf.nodes"
    assert refused in message("rbf.nodes=17")
    missing = "rbf.c[8] cannot be set without controller.rbf.c[5], for which the FMU has no"
    assert missing in message("rbf.nodes=8", "rbf.c[8]=3")
    refused = f"controller ({fmu}), rbf.b[2] = -1.0: fmi3SetFloat64 returned fmi3Error: rbf.b[2]"
    assert refused in message("rbf.b[2]=-1")


# --- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "stop", "step", "steps"),
    [(0.001, 0.02, 0.001, 20), (0, 1, 1 / 1024, 1025), (-0.5, 0.4, 0.3, 4), (2, 2, 0.1, 1)],
)
def test_options_set_the_times(start, stop, step, steps, tmp_path):
    options = (f"--start={start}", f"--stop={stop}", f"--step={step}")
    time = simulate(PID, tmp_path, *options)["time"]
    np.testing.assert_array_equal(time, start + step * np.arange(steps))


def test_output_selects_the_columns_and_their_order_and_the_last_set_applies(tmp_path):
    names = ["source.r", "controller.u", "plant.theta"]
    options = ["--stop=0.1", *(f"--output={name}" for name in names)]
    sets = ("--set=source.amplitude=-2", "--set=source.amplitude=3", "--set=controller.u_max=7")
    columns = simulate(PID, tmp_path, *options, *sets)
    assert list(columns) == ["time", *names]
    assert set(columns["source.r"]) == {3.0}
    assert np.abs(columns["controller.u"]).max() == 7


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
    assert expected.keys() >= {"plant.theta [rad]", "controller.u [N]"}
    simulated, elapsed, factor = re.fullmatch(
        r"([\d.]+) s in ([\d.]+) ms: ([\d.]+) times real time", speed
    ).groups()
    assert float(simulated) == 0.5
    # Both are rounded: the duration to a microsecond, the factor to an integer or two digits.
    seconds = float(elapsed) / 1e3
    slack = 0.51 + 0.51e-6 / seconds * (0.5 / seconds)
    assert float(factor) == pytest.approx(0.5 / seconds, abs=slack)
    assert wrote == "wrote out.csv: 500 rows"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_csv_can_be_written_to_a_device_and_a_closed_pipe_is_not_an_error():
    result = run("simulate", PID, "--stop=0.003", "--csv", "/dev/stdout")
    assert result.returncode == 0, result.stderr
    head, *rows = result.stdout.splitlines()[:4]
    assert head.startswith("time [s],controller.")
    assert [row.split(",")[0] for row in rows] == ["0.001", "0.002", "0.003"]
    command = f"'{PROGRAM}' simulate '{PID}' --csv /dev/stdout | head -n 1"
    shell = ["bash", "-o", "pipefail", "-c", command]
    result = subprocess.run(shell, capture_output=True, text=True, check=True)
    assert (result.stdout, result.stderr) == (head + "\n", "")


def test_a_terminal_shows_the_progress():
    ours, its = pty.openpty()
    termios.tcsetwinsize(its, (24, 120))
    command = [PROGRAM, "simulate", PID, "--step=0.000002", "--stop=5"]
    env = os.environ | {"TERM": "xterm"}
    shown = b""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=its, env=env) as process:
        os.close(its)
        with contextlib.suppress(OSError):  # end of file on Linux
            while some := os.read(ours, 4096):
                shown += some
    os.close(ours)
    assert process.returncode == 0, shown
    times = re.findall(r"t = ([\d.]+) of 5 s, ([\d.]+) times real time", shown.decode())
    assert len({time for time, _ in times}) > 2
    assert all(0 <= float(time) <= 5 and float(factor) >= 0 for time, factor in times)
    assert float(times[-1][1]) > 0
