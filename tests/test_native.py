"""The native master: equality with FMPy, values of every type, connections, options and output.

`crates/cargo-fmu/tests/cmd` has its messages, `crates/fmu-master/tests/equality.rs` the runs of
Table 1. FMUs in C are `relay.c` and `adaptive.c` of FMI 2.0, and `sums.c` of FMI 3.0.
"""

import contextlib
import csv
import itertools
import os
import pty
import re
import resource
import subprocess
import termios
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from scipy.integrate import quad, solve_ivp

from native import (
    LOOPS,
    PROGRAM,
    RELAY,
    SOURCES,
    compiled,
    in_c,
    pack,
    read_csv,
    refusal,
    replaced,
    run,
    simulate,
    with_units,
    write_system,
)
from pendulum_fmus.loop import FREQUENCY, TS, Loop
from pendulum_fmus.master import simulate as couple
from pendulum_fmus.project import FMUS
from reference import derivatives

PID = LOOPS / "pid.toml"

FILES = {
    ("Pid", "own"): "pid.toml",
    ("PidRbf", "own"): "pid-rbf.toml",
    ("IpidRbf", "own"): "ipid-rbf.toml",
    ("IpidRbf", "supervisor"): "supervised.toml",
}
"""The example system of each loop."""

same = np.testing.assert_array_equal


@pytest.fixture(scope="module", autouse=True)
def _exported(fmus: Path) -> None:
    """Export the FMUs that the examples use."""


# --- equality -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("controller", "target", "order", "model", "step"),
    [
        ("Pid", "own", "sequential", "linear", TS),
        ("PidRbf", "own", "parallel", "linear", TS),
        ("IpidRbf", "own", "sequential", "transfer_function", TS),
        ("IpidRbf", "supervisor", "parallel", "nonlinear", 0.00025),
    ],
)
def test_every_output_equals_fmpys_bit_for_bit(controller, target, order, model, step, tmp_path):
    steps = 1000
    start = {f"source.{name}": value for name, value in {
        "signal": "sine", "frequency": FREQUENCY["sine"], "disturbance.amplitude": 1.0,
        "disturbance.start": 0.1, "disturbance.duration": 0.1,
    }.items()}  # fmt: skip
    loops = ("", "supervisor_")[: 1 + (target == "supervisor")]
    if order == "parallel":
        names = ("controller", "supervisor")[: len(loops)]
        start |= {f"{name}.previous_sample_terms": "false" for name in names}
    loop = Loop(controller, "sine", 1.0, target, plant_model=model, overrides=tuple(start.items()))
    with loop.system() as system:
        expected = couple(system, TS, step, steps, order=order)
    start |= {f"{prefix}plant.dynamics": model for prefix in loops}
    sets = (f"--set={name}={value}" for name, value in start.items())
    options = (f"--order={order}", f"--step={step}", f"--stop={TS + (steps - 1) * step}")
    computed = simulate(LOOPS / FILES[controller, target], tmp_path, *sets, *options)
    assert np.any(computed["source.d"])
    assert computed.keys() == expected.keys()
    for name, column in expected.items():
        assert computed[name].tobytes() == column.tobytes(), name  # 0.0 is not -0.0


def loop_of(folder: Path, example: str, outputs: str = "", **versions: str) -> Path:
    """Write an example with FMUs of other versions, and perhaps other outputs."""
    text = (LOOPS / example).read_text(encoding="utf-8")
    text = replaced(text, {f"/{model}.fmu": f"/{model}{v}.fmu" for model, v in versions.items()})
    system = folder / example
    system.write_text(outputs + text.replace("../../target/fmu", FMUS.as_posix()), encoding="utf-8")
    return system


def table(system: Path, *options: str) -> bytes:
    """Return the CSV file of a run."""
    simulate(system, system.parent, "--stop", "1", *options)
    return (system.parent / "results.csv").read_bytes()


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_any_pairing_of_versions_gives_the_same_bytes(tmp_path, order):
    options = (f"--order={order}", "--set=plant.theta0=0.1", "--set=source.signal=sine")
    models = ("Pid", "Pendulum", "Source")
    pairings = itertools.product(["", "_fmi3"], repeat=3)
    tables = {
        table(loop_of(tmp_path, "pid.toml", **dict(zip(models, v, strict=True))), *options)
        for v in pairings
    }
    assert [rows.count(b"\n") for rows in tables] == [1001]


@pytest.mark.parametrize("outputs", ["", 'outputs = ["controller.rbf.w[3]", "plant.theta"]\n'])
def test_elements_of_arrays_are_set_and_recorded_as_variables_of_fmi_2(tmp_path, outputs):
    sets = [f"--set=controller.rbf.{name}" for name in ("c[2]=-0.5", "c[4]=1.5", "w0[1]=3")]

    def run_with(version: str, *options: str) -> bytes:
        versions = dict.fromkeys(("IpidRbf", "Pendulum", "Source"), version)
        return table(loop_of(tmp_path, "ipid-rbf.toml", outputs, **versions), *options)

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
    fmu = "PidRbf_fmi3.fmu"
    for assignments, message in {
        "rbf.c=1": f"{fmu} has no variable rbf.c; its elements are rbf.c[1] to",
        "rbf.nodes=17": f"controller ({fmu}), rbf.nodes = 17: fmi3SetUInt64 returned fmi3Error: rbf"
        ".nodes",
        "rbf.nodes=8 rbf.c[8]=3": "rbf.c[8] cannot be set without controller.rbf.c[5], for which "
        "the FMU has no",
        "rbf.b[2]=-1": f"controller ({fmu}), rbf.b[2] = -1.0: fmi3SetFloat64 returned fmi3Error: "
        "rbf.b[2]",
    }.items():
        sets = (f"--set=controller.{assignment}" for assignment in assignments.split())
        assert message in refusal(tmp_path, "simulate", system, *sets)


ADAPTIVE = (SOURCES / "adaptive.xml").read_text(encoding="utf-8")


def adaptive(folder: Path, xml: str = ADAPTIVE, *definitions: str) -> Path:
    """Write an FMU with a solver of its own, whose name is no identifier."""
    xml = replaced(xml, {'Identifier="Adaptive"': 'Identifier="my-model 2"'})
    binary = compiled(folder, *definitions, source="adaptive.c")
    return pack(folder / "my-model 2.fmu", xml, binary)


@pytest.mark.parametrize(
    ("head", "own", "option", "tolerance", "stop"),
    [
        ({}, {}, (), 1e-3, 1),  # of the default experiment
        ({"tolerance": 1e-5}, {}, (), 1e-5, 1),
        ({"tolerance": 1e-5}, {"tolerance": 1e-7}, (), 1e-7, 1),
        ({"tolerance": 1e-5}, {"tolerance": 1e-7}, ("--tolerance=1e-6",), 1e-6, 1),
        ({}, {}, (), 0, 1),  # of none
        ({}, {"sampled": True}, (), 1e-3, 1 + 1 / 1024),  # a step from the stop time
    ],
)
def test_the_calls_are_those_of_simulate_fmu(tmp_path, head, own, option, tolerance, stop):
    """They pass the tolerance, the stop time and start values."""
    step = 1 / 1024  # without rounding errors, since FMPy takes differences of times
    xml = ADAPTIVE if tolerance else replaced(ADAPTIVE, {' tolerance="1e-3"': ""})
    fmu, start = adaptive(tmp_path, xml), {"x": 2.0, "u": 0.5}
    system = write_system(tmp_path, {"a": start}, (), fmu.stem, own, **{"step": step} | head)
    columns = simulate(system, tmp_path, *option)
    assert (set(columns["a.tolerance"]), set(columns["a.stop"])) == ({tolerance}, {stop})
    if stop > 1:
        return
    outputs = ["y", "tolerance", "stop"]
    times = {"stop_time": 1.0, "output_interval": step}
    given = tolerance if head else None
    expected = fmpy.simulate_fmu(
        fmu, start_values=start, output=outputs, relative_tolerance=given, **times
    )
    for name, column in columns.items():
        same(column, expected[name.removeprefix("a.")])


# --- one FMU without a system ---------------------------------------------------------------------

TABLE = "time,r [rad],y\n0.1,0,0.25\n0.3,1,0.5\n0.3,-1,0.5\n0.75,0.5,0.1\n"
"""Values of inputs, with a jump."""


def test_one_fmu_gives_the_bits_of_simulate_fmu(tmp_path):
    """Its inputs come from a table, its step from its default experiment."""
    fmu, file = FMUS / "Pid.fmu", tmp_path / "input.csv"
    file.write_text(TABLE)
    columnar = tmp_path / "input.parquet"
    pyarrow.parquet.write_table(pyarrow.csv.read_csv(file), columnar)
    options = ("--stop=1", "--set=pid.kp=10", "--output=u", "--output=e")
    columns, again = (simulate(fmu, tmp_path, "--input", f, *options) for f in (file, columnar))
    rows = [tuple(map(float, line.split(","))) for line in TABLE.splitlines()[1:]]
    signals = np.array(rows, dtype=[(name, float) for name in ("time", "r", "y")])
    expected = fmpy.simulate_fmu(
        fmu, input=signals, start_values={"pid.kp": 10.0}, output=["u", "e"], stop_time=1.0,
        step_size=1e-3, output_interval=1e-3,
    )  # fmt: skip
    assert list(columns) == ["time", "u", "e"]
    for name in ("u", "e"):
        same(columns[name], expected[name])
        same(again[name], expected[name])


# --- model exchange -------------------------------------------------------------------------------


def interfaces(system: Path, **interfaces: str) -> Path:
    """Let components of a system run by interfaces."""
    text = system.read_text(encoding="utf-8")
    changes = {
        f'name = "{name}"\n': f'name = "{name}"\ninterface = "{interface}"\n'
        for name, interface in interfaces.items()
    }
    system.write_text(replaced(text, changes), encoding="utf-8")
    return system


def test_what_has_no_equations_is_refused(tmp_path):
    options = ("--interface=model-exchange", "--set=dynamics=transfer_function")
    message = refusal(tmp_path, "simulate", FMUS / "Pendulum.fmu", *options)
    assert "dynamics = transfer_function is a difference equation without derivatives" in message


FORCE = np.array([(0.05, 1), (0.25, 3), (0.37, 2), (0.37, -4), (0.6, 5), (0.6, 0), (1, 1)])
"""Slopes and jumps between and at communication points."""


def driven(
    fmu: Path, folder: Path, names: str, *options: str, table: np.ndarray = FORCE
) -> dict[str, np.ndarray]:
    """Run an FMU by model exchange in steps of 0.1 s, with inputs from a table."""
    head = {"header": f"time,{names}", "comments": ""}
    np.savetxt(folder / "input.csv", table, delimiter=",", fmt="%.17g", **head)
    exchange = ("--interface=model-exchange", "--tolerance=1e-10", "--stop=1", "--step=0.1")
    return simulate(fmu, folder, *exchange, "--input", folder / "input.csv", *options)


@pytest.mark.parametrize("version", ["", "_fmi3"])
def test_equations_follow_a_table_within_a_step_as_in_scipy(version, tmp_path):
    options = ("--set=dynamics=nonlinear", "--set=theta0=0.1")
    ours = driven(FMUS / f"Pendulum{version}.fmu", tmp_path, "u", *options)
    expected, state = {0.0: np.array([0, 0, 0.1, 0])}, np.array([0, 0, 0.1, 0])
    rows = np.vstack([(0, 1), FORCE])
    for (t0, u0), (t1, u1) in itertools.pairwise(rows):
        if t1 == t0:
            continue
        times = np.unique([t for t in [*ours["time"], t1] if t0 < t <= t1])
        states = solve_ivp(
            lambda t, y, *row: derivatives(y, np.interp(t, row[::2], row[1::2])),
            (t0, t1), state, "DOP853", times, args=(t0, u0, t1, u1), rtol=1e-11, atol=1e-12,
        ).y.T  # fmt: skip
        expected |= dict(zip(times, states, strict=True))
        state = states[-1]
    states = np.array([expected[time] for time in ours["time"]]).T
    for name, column in zip(("x", "v", "theta", "omega"), states, strict=True):
        assert ours[name] == pytest.approx(column, abs=1e-7), name


@pytest.mark.parametrize("version", ["", "_fmi3"])
def test_samples_between_communication_points_have_the_inputs_of_a_table_as_in_fmpy(
    version, tmp_path
):
    fmu = FMUS / f"Pid{version}.fmu"
    ours = driven(fmu, tmp_path, "r")
    points = np.array(list(map(tuple, FORCE)), dtype=[("time", float), ("r", float)])
    expected = fmpy.simulate_fmu(
        fmu, fmi_type="ModelExchange", stop_time=1.0, output_interval=0.1, record_events=False,
        output=list(ours)[1:], input=points,
    )  # fmt: skip
    for name, column in ours.items():
        assert column == pytest.approx(expected[name], rel=1e-9, abs=1e-9), name


@pytest.mark.parametrize("version", ["", "_fmi3"])
@pytest.mark.parametrize("example", ["pid.toml", "pid-rbf.toml", "ipid-rbf.toml"])
def test_loops_of_both_kinds_equal_those_of_co_simulation(example, version, tmp_path):
    """A controller samples the inputs of its time; the linear plant has an exact step."""
    models = {"pid.toml": "Pid", "pid-rbf.toml": "PidRbf", "ipid-rbf.toml": "IpidRbf"}
    versions = {models[example]: version, "Pendulum": version}
    options = ("--tolerance=1e-9", "--set=controller.previous_sample_terms=false")

    def columns(**kinds: str) -> dict[str, np.ndarray]:
        system = interfaces(loop_of(tmp_path, example, **versions), **kinds)
        return simulate(system, tmp_path, "--stop", "1", *options)

    exchange = "model-exchange"
    expected = columns()
    for name, column in columns(controller=exchange).items():
        same(column, expected[name])
    for kinds in ({"plant": exchange}, {"plant": exchange, "controller": exchange}):
        for name, column in columns(**kinds).items():
            np.testing.assert_allclose(column, expected[name], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kinds", [("plant",), ("controller",), ("controller", "plant")])
def test_in_parallel_order_samples_arrive_one_step_late_except_the_first(kinds, tmp_path):
    """The sample of the start is zero on a sine from 0 s, and is not with an initial angle."""
    system = loop_of(tmp_path, "pid.toml")
    options = ("--order=parallel", "--start=0", "--stop=0.5", "--set=source.signal=sine")
    expected = simulate(system, tmp_path, *options)
    interfaces(system, **dict.fromkeys(kinds, "model-exchange"))
    columns = simulate(system, tmp_path, "--tolerance=1e-9", *options)
    assert np.ptp(columns["controller.u"]) > 10
    for name, column in columns.items():
        np.testing.assert_allclose(column, expected[name], rtol=1e-5, atol=1e-6)
    if "controller" in kinds:
        columns = simulate(system, tmp_path, "--set=plant.theta0=0.1", *options)
        alone = ("--set=theta0=0.1", f"--set=u={columns['controller.u'][0]}", "--stop=0.001")
        plant = simulate(FMUS / "Pendulum.fmu", tmp_path, *alone)
        assert columns["plant.omega"][1] == pytest.approx(plant["omega"][1], rel=1e-6)


@pytest.fixture(scope="module")
def hopper(tmp_path_factory) -> Path:
    """Return the FMU of tests/c/hopper.c."""
    return in_c(tmp_path_factory.mktemp("hopper") / "Hopper.fmu")


def check_kick(columns: dict[str, np.ndarray], kick: float, prefix: str = "") -> None:
    """Check that a ball lands 2e-4 s after its kick, which starts z again from 1e-9."""
    times = columns["time"]
    late = times > kick + 1e-9
    same(columns[f"{prefix}landings"], late)
    same(columns[f"{prefix}h"], 0)
    expected = np.cos(10 * (times[late] - kick))
    assert 1e9 * columns[f"{prefix}z"][late] == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("kick", [0, 0.3, 0.35])
def test_a_kick_changes_nominals_and_an_indicator_that_is_zero(kick, hopper, tmp_path):
    check_kick(driven(hopper, tmp_path, "n", table=np.array([(0, kick == 0), (kick, 1)])), kick)


@pytest.mark.parametrize(
    ("happens", "code", "message"),
    [
        ("ON_LANDING=abort()", 1,
         r"integration at t = 0.30*\d s: fmi3UpdateDiscreteStates was ended by sig"),
        ("ON_LANDING=return ERROR", 1, r"in the event at t = 0.3502\d* s, step of 0.1 s at "
         r"t = 0.30*\d s: fmi3UpdateDiscreteStates returned fmi3Error"),
        ("ON_LANDING=*terminate = true", 0,
         r"\(Hopper.fmu\) ended the simulation at t = 0.3502\d* s"),
        ("ON_EVENT=*terminate = true", 0, r"at t = 0 s(.|\n)*ended the simulation at t = 0.0 s"),
    ],
)  # fmt: skip
def test_what_happens_in_an_event_is_named(happens, code, message, tmp_path):
    fmu = in_c(tmp_path / "Hopper.fmu", happens)
    (tmp_path / "input.csv").write_text("time,n\n0,0\n0.35,1\n")
    result = run("simulate", fmu, "--step=0.1", "--input", "input.csv", cwd=tmp_path)
    assert result.returncode == code
    assert re.search(message, result.stdout + result.stderr), result


def test_elements_of_an_array_follow_a_table_within_a_step(hopper, tmp_path):
    """The other element keeps its start value."""
    table = np.insert(FORCE, 1, 20_000, axis=1)
    ours = driven(hopper, tmp_path, "n,a[2]", "--set=a[1]=-5", table=table)
    points = {"points": np.unique(FORCE[:, 0]), "epsabs": 1e-12}

    def rise(t: float) -> float:
        return quad(lambda s: (t - s) * (-5 + 2 * np.interp(s, *FORCE.T)), 0, t, **points)[0]

    expected = [20 * t + rise(t) for t in ours["time"]]
    assert ours["h"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("names", "order", "kicks"),
    [("abc", "sequential", (0.3, 0.3)), ("abc", "parallel", (0.4, 0.5)),
     ("cba", "sequential", (0.4, 0.5))],
)  # fmt: skip
def test_an_event_reaches_other_components_at_a_communication_point(
    names, order, kicks, hopper, tmp_path
):
    """A ball that lands kicks the next one."""
    system = write_system(
        hopper.parent, {name: {} for name in names}, ["a.landings -> b.n", "b.landings -> c.n"],
        "Hopper", step=0.1, order=order,
    )  # fmt: skip
    ours = driven(system, tmp_path, "a.n", table=np.array([(0, 0), (0.35, 1)]))
    for name, kick in zip("abc", (0.35, *kicks), strict=True):
        check_kick(ours, kick, f"{name}.")


def test_an_input_of_another_component_causes_a_state_event(tmp_path):
    """A ball rises when its acceleration becomes positive, at a communication point."""
    xml = (SOURCES / "hopper.xml").read_text(encoding="utf-8")
    xml = re.sub('<Int32 name="n".*/>', "", xml)  # all inputs are continuous
    in_c(tmp_path / "Hopper.fmu", xml=xml)
    lift = {"from": "a.z", "to": "b.a[1]", "factor": -1.0, "offset": 0.0}
    system = write_system(
        tmp_path, {"a": {}, "b": {}}, [lift], "Hopper", step=0.1, order="parallel"
    )
    columns = simulate(system, tmp_path)
    lifts = -columns["a.z"][:-1]
    accelerations = np.where(np.logical_or.accumulate(lifts > 0), lifts, 0)
    speeds = np.append(0, np.cumsum(0.1 * accelerations))
    heights = np.append(0, np.cumsum(0.1 * speeds[:-1] + 0.005 * accelerations))
    assert columns["b.h"] == pytest.approx(heights, abs=1e-9)
    assert heights[-1] > 0.05


def test_discrete_inputs_of_fmi_2_follow_a_table(tmp_path):
    """The FMU takes them in event mode only: m is n + 3, and c is b."""
    fmu = in_c(tmp_path / "Conformance.fmu")
    table = np.array([(0, 1, 0), (0.25, -4, 1), (0.6, 7, 0), (0.85, 7, 1)])
    ours = driven(fmu, tmp_path, "n,b", table=table)
    rows = np.searchsorted(table[:, 0], ours["time"] + 1e-9) - 1
    same(ours["m"], table[rows, 1] + 3)
    same(ours["c"], table[rows, 2])


# --- options and output ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "stop", "step", "steps"),
    [
        (0.001, 0.02, 0.001, 20),
        (0, 1, 1 / 1024, 1025),
        (-0.5, 0.4, 0.3, 4),
        (2, 2, 0.1, 1),
        (0.3, 0.6, 0.1, 4),
    ],
)
def test_options_set_the_times(start, stop, step, steps, tmp_path):
    options = (f"--start={start}", f"--stop={stop}", f"--step={step}")
    time = simulate(PID, tmp_path, *options)["time"]
    same(time, start + step * np.arange(steps))


def test_output_selects_the_columns_and_their_order_and_the_last_set_applies(tmp_path):
    names = ["source.r", "controller.u", "plant.theta"]
    options = ["--stop=0.1", *(f"--output={name}" for name in names)]
    sets = ("--set=source.amplitude=-2", "--set=source.amplitude=3", "--set=controller.u_max=7")
    columns = simulate(PID, tmp_path, *options, *sets)
    assert list(columns) == ["time", *names]
    assert set(columns["source.r"]) == {3.0}
    assert np.abs(columns["controller.u"]).max() == 7


def test_the_summary_has_extremes_last_values_units_and_alarms(tmp_path):
    """A controller that works on the terms of the previous sample in parallel order oscillates."""
    system, out = LOOPS / "pid-rbf.toml", tmp_path / "out.csv"
    late = ("--order=parallel", "--set=controller.previous_sample_terms=true")
    for options, alarms in [((), {"diverging:"}), (late, {"oscillating", "diverging:"})]:
        result = run("simulate", system, "--csv", out, *options)
        lines = [line.split() for line in result.stdout.splitlines()]
        heads = out.read_text(encoding="utf-8").splitlines()[0].split(",")
        for head, (name, column) in list(zip(heads, read_csv(out).items(), strict=True))[1:]:
            (shown,) = (line[1:] for line in lines if line[0] == name)
            assert head == f"{name} [{shown.pop()}]"
            assert float(shown[-1]) == pytest.approx(column[-1], rel=1e-9)
            expected = (column.min(), column.max(), np.sqrt(np.mean(column**2)), column[-1])
            np.testing.assert_allclose(np.array(shown, float), expected, rtol=1e-3)
        assert {line[1] for line in lines if line[0] == "alarm:"} == alarms
    # This pendulum moves towards the upright before it falls.
    falls = ("--set=theta0=0.1", "--set=omega0=-0.3", "--stop=2")
    assert "alarm: diverging: theta" in run("simulate", FMUS / "Pendulum.fmu", *falls).stdout
    # On a sine, it does so near the extremes of the angle only. A healthy force rings after a jump.
    sine = "--set=source.signal=sine"
    cycles = run("simulate", system, sine, *late, "--csv", out)
    assert "oscillating" in cycles.stdout
    for healthy in (sine, "--stop=2.75", "--stop=8"):
        assert "oscillating" not in run("simulate", system, healthy, "--csv", out).stdout


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


def test_rows_can_be_printed_and_then_nothing_else_is(tmp_path):
    simulate(PID, tmp_path, "--stop=0.5")
    expected = (tmp_path / "results.csv").read_text(encoding="utf-8")
    for options in ((), ("--plot", tmp_path / "page.html")):
        result = run("simulate", PID, "--stop=0.5", "--csv", "-", *options, cwd=tmp_path)
        assert (result.returncode, result.stdout) == (0, expected)
        assert "0.5 s in " in result.stderr
        assert bool(options) == (f"wrote {tmp_path}/page.html" in result.stderr)
    assert sorted(os.listdir(tmp_path)) == ["page.html", "results.csv"]
    command = f"'{PROGRAM}' simulate '{PID}' --stop 100 --csv - | head -n 1"
    shell = ["bash", "-o", "pipefail", "-c", command]
    result = subprocess.run(shell, capture_output=True, text=True, check=True)
    assert (result.stdout, result.stderr) == (expected.splitlines()[0] + "\n", "")
    with Path("/dev/full").open("w") as full:
        result = run(
            "simulate", PID, "--csv=-", capture_output=False, stdout=full, stderr=subprocess.PIPE
        )
    assert result.returncode == 1
    assert result.stderr.startswith("error: cannot write to the standard output: ")


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


# --- values of every type -------------------------------------------------------------------------

TIME = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Communication points of the systems of FMUs in C [s]."""

BEFORE = np.array([0.0, 0.0, 0.25, 0.5, 0.75])
"""The previous communication point of each [s]."""

SUMS = (SOURCES / "sums.xml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def binaries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the binaries of tests/c/relay.c and tests/c/sums.c."""
    folder = tmp_path_factory.mktemp("binaries")
    return {name: compiled(folder, source=f"{name}.c") for name in ("relay", "sums")}


@pytest.fixture
def relay(binaries: dict[str, bytes], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Relay.fmu, with a changed description, and a system of it."""

    def write(components: dict, connections=(), changes=None, resources=None, **settings) -> Path:
        xml = replaced(RELAY, changes or {})
        pack(tmp_path / "Relay.fmu", xml, binaries["relay"], **resources or {})
        return write_system(tmp_path, components, connections, **settings)

    return write


@pytest.fixture
def sums(binaries: dict[str, bytes], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Sums.fmu and a system of it."""

    def write(components: dict, connections=(), changes=None, **settings) -> Path:
        xml = replaced(SUMS, changes or {})
        pack(tmp_path / "Sums.fmu", xml, binaries["sums"])
        return write_system(tmp_path, components, connections, "Sums", **settings)

    return write


ALL = ["a.time -> b.u", "a.count -> b.n", "a.odd -> b.b"]
"""A connection of every type that can be connected."""

START = {"gain": -3, "shape": "square", "add": 7, "invert": True}
SETS = ["gain=-3e0", "shape=4", "add=7", "invert=true", "status_time=inf"]
"""Start values of every type, in a file and as options."""


@pytest.mark.parametrize(
    ("order", "names", "start", "sets", "fed"),
    [
        ("sequential", "ab", START, [], TIME),
        ("sequential", "ab", START | {"direct": True}, [], TIME),
        ("sequential", "ab", {"gain": 5}, SETS, TIME),
        ("parallel", "ab", START, [], BEFORE),
        ("sequential", "ba", START, [], BEFORE),
    ],
)
def test_values_of_every_type_reach_inputs(relay, tmp_path, order, names, start, sets, fed):
    """Values arrive one step later in parallel order, or from a component that is stepped later."""
    system = relay({name: start if name == "b" else {} for name in names}, ALL, order=order)
    columns = simulate(system, tmp_path, *(f"--set=b.{value}" for value in sets))
    count = fed / 0.25
    same(columns["a.time"], TIME)
    same(columns["a.count"], TIME / 0.25)
    same(columns["a.odd"], TIME / 0.25 % 2)
    same(columns["b.y"], -3 * fed**2)
    same(columns["b.choice"], 4)
    ran = TIME > 0  # without direct feedthrough, a relay outputs nothing before its first step
    same(columns["b.m"][ran], 7 + count[ran])
    same(columns["b.c"][ran], count[ran] % 2 == 0)


def test_values_are_converted_between_all_types(sums, tmp_path):
    connections = ["a.n -> b.u[2]", "a.y -> b.x", "a.c -> b.b"]
    system = sums({"a": {"u[1]": 7, "u[2]": 0, "u[3]": 0, "s[2]": "ab"}, "b": {}}, connections)
    columns = simulate(system, tmp_path)
    # u[1] and u[3] of b keep their start values 1 and 3.
    single = np.float32(0.1)
    assert {name: column[-1] for name, column in columns.items()} == {
        "time": 1,
        "a.n": 7, "a.y": 0.1, "a.c": 1,
        # The strings have 3 and 2 characters, with 5 in the description of the second.
        "a.k[1,1]": -23, "a.k[1,2]": -24, "a.k[2,1]": -25, "a.k[2,2]": -26,
        "a.large": 9007199254740993, "a.largest": 2**64, "a.shape": -5e9,
        "b.n": 1 + 10 * 7 + 300, "b.y": float(str(single + single)), "b.c": 0,
        "b.k[1,1]": 0, "b.k[1,2]": -1, "b.k[2,1]": -2, "b.k[2,2]": -3,
        "b.large": 9007199254740993, "b.largest": 2**64, "b.shape": 2,
    }  # fmt: skip


def test_an_element_of_an_array_feeds_several_inputs_during_the_initialization(tmp_path):
    in_c(tmp_path / "Vector.fmu", "START_W=10, 20, 30")
    names = ["b.r", "b.y", "b.d"]
    links, options = [f"a.w[1] -> {name}" for name in names], {"own": {"sampled": False}}
    parts = {"a": {}, "b": {}}
    system = write_system(tmp_path, parts, links, "Vector", outputs=names, **options)
    head, _, tail = system.read_text(encoding="utf-8").rpartition("Vector.fmu")
    system.write_text(f"{head}{FMUS}/Pid_fmi3.fmu{tail}", encoding="utf-8")
    columns = simulate(system, tmp_path)
    assert [columns[name][0] for name in names] == [10.0] * 3


TYPED = {
    # name: type in Parquet, text in CSV, value in Parquet
    "time [s]": ("double", "1.0", 1.0),
    "a.large": ("int64", "9007199254740993", 9007199254740993),
    "a.largest": ("uint64", "18446744073709551615", 18446744073709551615),
    "a.shape": ("int64", "far", -5000000000),
    "a.c": ("bool", "true", True),
    "a.y": ("float", "0.1", 0.10000000149011612),
    "a.k[2,1]": ("int16", "-2", -2),
    "a.texts[1]": ("string", "", ""),
    "a.texts[2]": ("string", 'a "b", c', 'a "b", c'),
    "a.texts[3]": ("string", "π\nline 2", "π\nline 2"),
    "a.bytes": ("binary", "001fff", b"\x00\x1f\xff"),
}


def test_results_keep_their_types_and_all_digits(sums, tmp_path):
    outputs = list(TYPED)[1:]
    system = sums({"a": {}}, outputs=outputs)
    for name in ("out.csv", "out.parquet"):
        result = run("simulate", system, "--csv", name, cwd=tmp_path)
        assert (result.returncode, result.stderr) == (0, "")
        assert result.stdout.endswith(f"wrote {name}: 5 rows\n")
    text = (tmp_path / "out.csv").read_bytes().decode()
    head, *_, last = csv.reader(text.splitlines(keepends=True))
    assert dict(zip(head, last, strict=True)) == {name: TYPED[name][1] for name in TYPED}
    assert ',far,true,0.1,-2,"","a ""b"", c","π\nline 2",001fff\n' in text
    found = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    assert {f.name: str(f.type) for f in found.schema} == {name: TYPED[name][0] for name in TYPED}
    assert found.to_pylist()[-1] == {name: TYPED[name][2] for name in TYPED}
    assert not list(tmp_path.glob("*.part"))


def test_elements_are_recorded_in_any_order_and_found_by_an_alias(sums, tmp_path):
    system = sums({"a": {"also[2]": 5}}, outputs=["a.k[2,1]", "a.n", "a.k[1,2]"])
    columns = simulate(system, tmp_path)
    expected = {"time": 0, "a.k[2,1]": -2, "a.n": 1 + 50 + 300, "a.k[1,2]": -1}
    assert [(name, column[0]) for name, column in columns.items()] == list(expected.items())


def test_all_outputs_except_strings_are_recorded_and_any_variable_on_request(relay, tmp_path):
    named = {'name="y"': 'name="y[1,2].&quot;x&quot;"'} | with_units("", "rad")
    columns = simulate(relay({"a, b": {}}, (), named), tmp_path)
    names = ["time", 'y[1,2]."x"', "number", "count", "m", "choice", "odd", "c"]
    assert list(columns) == ["time", *(f"a, b.{name}" for name in names)]
    outputs = ["a.add", "a.gain", 'a.y[1,2]."x"', "a.shape", "a.invert"]
    simulate(relay({"a": {"add": -5, "gain": 0.5}}, (), named, outputs=outputs), tmp_path)
    head, *_, last = (tmp_path / "results.csv").read_text().splitlines()
    assert head == 'time [s],a.add,a.gain,"a.y[1,2].""x"" [rad]",a.shape,a.invert'
    assert last == "1.0,-5,0.5,0.0,1,false"


def test_the_name_of_a_component_with_an_equals_sign_is_set_in_quotes(relay, tmp_path):
    columns = simulate(relay({"a=b": {"u": 1}}), tmp_path, "--set='a=b'.gain=3", "--output=a=b.y")
    assert columns["a=b.y"][-1] == 3


def test_start_values_may_be_of_outputs_and_name_resources(relay, tmp_path):
    files = {"first": "2.5", "größer & so": "1e300"}
    system = relay({"a": {"file": "first"}, "b": {"file": "größer & so"}}, resources=files)
    columns = simulate(system, tmp_path)
    assert (set(columns["a.number"]), set(columns["b.number"])) == ({2.5}, {1e300})
    old = 'name="number" valueReference="5" causality="output"><Real/>'
    exact = old.replace('"output"><Real', '"output" initial="exact"><Real start="0"')
    system = relay({"a": {"number": 7.5}, "b": {}}, (), {old: exact})
    columns = simulate(system, tmp_path, "--set=b.number=2")
    assert (set(columns["a.number"]), set(columns["b.number"])) == ({7.5}, {2.0})


# --- connections ----------------------------------------------------------------------------------


def test_one_output_feeds_several_inputs_and_an_fmu_itself(relay, tmp_path):
    connections = ["a.time -> b.u", "a.time -> c.u", "c.m -> c.n", "a.choice -> b.n"]
    components = {"a": {"shape": "square"}, "b": {"add": 1}, "c": {"add": 1}}
    columns = simulate(relay(components, connections), tmp_path)
    for name, expected in {
        "b.y": TIME, "c.y": TIME, "c.m": [0, 1, 2, 3, 4], "b.m": [0, 5, 5, 5, 5],
    }.items():  # fmt: skip
        same(columns[name], expected)


def test_a_connection_can_convert_the_unit(relay, tmp_path):
    units, components = with_units("deg", ""), {"a": {}, "b": {"direct": True}}
    scaled = {"from": "a.time", "to": "b.u", "factor": 2.0, "offset": -1.0}
    system = relay(components, ["a.count -> b.n", scaled], units)
    same(simulate(system, tmp_path)["b.y"], 2 * TIME - 1)
    for u, y in (("radian", "rad"), ("deg", ""), ("gon", "gon")):  # equal or missing
        system = relay({"a": {"gain": 2, "u": 0.5}, "b": {}}, ["a.y -> b.u"], with_units(u, y))
        same(simulate(system, tmp_path)["b.y"], [0, 1, 1, 1, 1])


SECONDS = np.arange(0, 400.1, 0.25)
"""Communication points of the systems with faults [s]."""


def faulty(relay, folder, faults: list[dict], **settings) -> np.ndarray:
    """Return what arrives of the time at its communication points after the first."""
    line = {"from": "a.time", "to": "b.u", "faults": faults}
    system = relay({"a": {}, "b": {"direct": True}}, [line], stop=SECONDS[-1], **settings)
    return simulate(system, folder)["b.y"][1:]


def test_faults_change_what_arrives(relay, tmp_path):
    """In sequential order, b receives in the step from t what a has for the end of the step."""
    ends, steps = SECONDS[1:], SECONDS[:-1]
    acts = (steps >= 100) & (steps < 200)
    faults = [
        {"delay": 0.0},
        {"delay": 2.0, "stop": 300.0},
        {"gain": -0.5, "start": 100.0, "stop": 200.0},
        {"offset": 3.0},
        {"drift": 0.125, "start": 40.0},
        {"dropout": 1.0, "start": 60.0, "stop": 70.0},
        {"saturation": [-20.0, 350.0]},
    ]
    arrived = np.where(steps < 300, np.maximum(ends - 2, ends[0]), ends)
    arrived = np.where(acts, -0.5 * arrived, arrived) + 3 + 0.125 * np.maximum(steps - 40, 0)
    arrived[(steps >= 60) & (steps < 70)] = arrived[steps == 59.75]
    same(faulty(relay, tmp_path, faults), np.clip(arrived, -20, 350))


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_random_faults_depend_on_the_seed_of_the_system(relay, tmp_path, order):
    faults = [{"noise": 2.0}, {"dropout": 0.25}]
    first, again, other = (faulty(relay, tmp_path, faults, order=order, seed=s) for s in (7, 7, 8))
    same(first, again)
    assert np.all(first != other)


DIRECT = {'<Unknown index="3"/>': '<Unknown index="3" dependencies="2"/>'}


def test_a_chain_of_connections_takes_time_in_proportion_to_its_length(relay, tmp_path):
    """Each output depends directly on an input, which the output before feeds."""

    def seconds(count: int) -> float:
        variable = '<ScalarVariable name="{}" valueReference="{}" causality="{}"><Real{}/>'
        kinds = [("u{}", 1, "input", ' start="0"'), ("y{}", 2, "output", "")]
        variables = "".join(
            f"{variable.format(name.format(k), *kind)}</ScalarVariable>"
            for name, *kind in kinds
            for k in range(count)
        )
        first = RELAY.count("<ScalarVariable") + 1
        unknowns = "".join(
            f'<Unknown index="{first + count + k}" dependencies="{first + k}"/>'
            for k in range(count)
        )
        changes = {
            "</ModelVariables>": f"{variables}</ModelVariables>",
            "</Outputs>": f"{unknowns}</Outputs>",
        }
        links = [f"a.y{k} -> a.u{k + 1}" for k in range(count - 1)]
        system = relay({"a": {}}, links, changes, outputs=["a.y"])
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        simulate(system, tmp_path)
        return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before

    assert seconds(20_000) < 8 * seconds(5_000)


def test_algebraic_loops_can_be_allowed(relay, tmp_path):
    links, options = ["a.y -> b.u", "b.y -> a.u"], {"allow_algebraic_loops": True}
    assert "a.y" in simulate(relay({"a": {"u": 1}, "b": {}}, links, DIRECT, **options), tmp_path)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_initial_values_pass_through_a_chain_of_direct_outputs(relay, tmp_path, order):
    """Each doubles its input, starting from 1: the n-th gives 2^n at the first point."""
    names = "abcde"
    start = {"direct": True, "gain": 2}
    # Against the order of stepping, where a single pass would only reach the first one.
    chain = {name: start | ({"u": 1} if name == "a" else {}) for name in reversed(names)}
    links = [f"{a}.y -> {b}.u" for a, b in itertools.pairwise(names)]
    columns = simulate(relay(chain, links, DIRECT, order=order), tmp_path)
    for power, name in enumerate(names, start=1):
        same(columns[f"{name}.y"], 2.0**power)


@pytest.mark.parametrize(
    ("own", "changes"),
    [({"sampled": True}, {}), ({}, {'"output"><Real': '"output" variability="discrete"><Real'})],
    ids=["declared", "only discrete outputs"],
)
def test_a_row_of_a_sampled_fmu_has_the_sample_at_its_time(relay, tmp_path, own, changes):
    """It is available a step later."""
    system = relay({"a": {}}, (), changes, own=own)
    columns = simulate(system, tmp_path)
    same(columns["time"], TIME)
    same(columns["a.time"], TIME + 0.25)
    is_told = (
        "note: a is recorded after each step; use --sampled false for before"
        in run("simulate", system).stdout
    )
    assert is_told == (not own)
    same(simulate(system, tmp_path, "--sampled=false")["a.time"], TIME)
    options = ("--sampled=true", "--step=0.25")
    same(simulate(tmp_path / "Relay.fmu", tmp_path, *options)["time"], TIME + 0.25)  # its output


# --- ends -----------------------------------------------------------------------------------------


def test_an_fmu_of_fmi_3_ends_the_simulation(sums, tmp_path):
    system = sums({"a": {}, "b": {"u[1]": 99}})
    result = run("simulate", system, "--csv=out.csv", "--enumerations=numbers", cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert "b (Sums.fmu) ended the simulation at t = 0.25 s\n" in result.stdout
    assert list(read_csv(tmp_path / "out.csv")["time"]) == [0.0]


def test_a_failed_end_of_the_initialization_is_named(tmp_path):
    fmu = adaptive(tmp_path, ADAPTIVE, "FAIL_INITIALIZATION")
    message = refusal(tmp_path, "simulate", write_system(tmp_path, {"a": {}}, (), fmu.stem))
    assert "end of the initialization at t = 0.0 s: fmi2ExitInitializationMode" in message
