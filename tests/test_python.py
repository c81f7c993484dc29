"""The Python module `fmu_master`."""

import _thread
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.parquet
import pytest
from dask.distributed import Client
from IPython.core.formatters import DisplayFormatter

from fmu_master import (
    FmuError,
    Instance,
    Result,
    Sweep,
    System,
    python_component,
    simulate,
    sweep,
)
from fmu_master._command import COMMAND
from native import LOOPS, SECONDS, in_c
from native import simulate as by_command_line
from sweeps import done, journal_of
from test_crashes import FAULTS, faulty
from test_native import binaries, relay, sums

__all__ = ["binaries", "faulty", "relay", "sums"]  # fixtures

PENDULUM = "target/fmu/Pendulum.fmu"


@pytest.mark.parametrize("in_process", [False, True])
def test_a_run_has_the_bits_of_the_command_line(fmus, tmp_path, in_process):
    expected = by_command_line(LOOPS / "pid.toml", tmp_path, "--set", "controller.pid.kp=250")
    system = System(LOOPS / "pid.toml")
    result = system.simulate({"controller.pid.kp": 250}, in_process=in_process)
    assert list(result) == list(expected)
    for name, column in result.items():
        np.testing.assert_array_equal(column, expected[name])
    assert result.units["plant.theta"] == "rad"


@pytest.mark.parametrize("in_process", [False, True])
def test_runs_of_a_loaded_system_have_the_bits_of_others(fmus, in_process):
    system, start = System(fmus / "PidRbf_fmi3.fmu"), {"r": 0.1}
    gain, size = {"pid.kp": 200.0}, {"rbf.nodes": 3}
    changes = [{}, gain, size, size | gain, {"m0": 1.0}, {}]
    options = {"stop_time": 0.1, "output": ["u"], "in_process": in_process}

    def forces(system: System, change: dict) -> list[float] | str:
        try:
            return system.simulate(start | change, **options)["u"].tolist()
        except FmuError as error:
            return str(error)

    expected = [forces(system, change) for change in changes]
    with system.loaded() as loaded, ThreadPoolExecutor(3) as pool:
        for change, one in zip(changes, expected, strict=True):
            assert list(pool.map(partial(forces, loaded), [change] * 5)) == [one] * 5
    assert "has no variable m0" in expected[4]
    assert len(set(map(str, expected))) == 5


@pytest.mark.parametrize(("fault", "ended"), [("CRASH", "signal 11"), ("FATALLY", "fmi2Fatal")])
def test_a_loaded_system_runs_again_after_a_crash_or_a_fatal_error(faulty, fault, ended):
    def run(at: float) -> Result:
        start = {"fault": FAULTS.index(fault), "at": at}
        return loaded.simulate(start, stop_time=1.0, step_size=0.125)

    with System(faulty).loaded() as loaded:
        for _ in range(2):
            assert len(run(2.0)["time"]) == 9
            with pytest.raises(FmuError, match=ended):
                run(0.5)


def test_a_run_of_one_fmu_has_the_bits_of_fmpy(fmus):
    fmu, options = fmus / "PidRbf_fmi3.fmu", {"start_values": {"r": 0.1}, "start_time": 0.5}
    options |= {"stop_time": 1.0, "output": ["rbf.w", "u"]}  # an array
    expected, result = fmpy.simulate_fmu(fmu, **options), simulate(fmu, **options)
    for column in expected.dtype.names:
        np.testing.assert_array_equal(result[column], expected[column])


def test_a_system_of_keywords_is_that_of_a_file(fmus):
    fmu = {name: fmus / f"{name}.fmu" for name in ("Pid", "Pendulum", "Source")}
    system = System(
        components={
            "controller": {"fmu": fmu["Pid"], "start": {"previous_sample_terms": True}},
            "plant": {"fmu": fmu["Pendulum"]},
            "source": fmu["Source"],
        },
        connections=[
            ("source.r", "controller.r"),
            ("source.d", "controller.d"),
            ("plant.theta", "controller.y"),
            "controller.u -> plant.u",
        ],
        start=0.001,
        stop=1.0,
        step=0.001,
    )
    expected = System(LOOPS / "pid.toml").simulate(stop_time=1.0)
    result = system.simulate()
    for name in ("time", "plant.theta", "controller.u"):
        np.testing.assert_array_equal(result[name], expected[name])


@pytest.mark.parametrize(
    ("fault", "ended"), [("CRASH", "signal 11"), ("FAIL", "returned fmi2Error")]
)
def test_a_fault_is_an_exception_with_the_rows_so_far(faulty, fault, ended):
    start = {"fault": FAULTS.index(fault), "at": 0.5}
    with pytest.raises(FmuError, match=f"Faulty.*at t = 0.5 s: fmi2DoStep.*{ended}") as caught:
        simulate(faulty, stop_time=1.0, step_size=0.125, start_values=start)
    error = caught.value
    assert (error.component, error.function, error.time) == ("Faulty", "fmi2DoStep", 0.5)
    assert error.result["time"].tolist() == [0.0, 0.125, 0.25, 0.375, 0.5]


def test_jupyter_shows_a_picture_of_a_result(fmus):
    result = simulate(PENDULUM, stop_time=0.1)
    shown, _ = DisplayFormatter().format(result)
    assert shown["image/png"].startswith(b"\x89PNG")
    assert shown["text/plain"] == (
        f"<Result: {len(result['time'])} rows, t = 0 to 0.1 s: time, theta, omega, x, v>"
    )


def test_a_progress_bar_moves(capsys):
    slow = python_component([], ["y"], lambda t: time.sleep(0.12) or t)
    clock = System(components={"clock": slow}, step=1.0, stop=4.0)
    clock.simulate(progress=True)
    percents = re.findall(r"(\d+)%\|", capsys.readouterr().err)
    assert int(percents[0]) == 0 < int(percents[-1]) <= 100


def test_the_last_step_reaches_the_stop_time_though_times_are_rounded():
    tick = python_component([], ["y"], lambda t: t)
    clock = System(components={"tick": tick}, step=1.0, stop=1.0)
    for start in (0.0, 0.3, 1e9):
        result = clock.simulate(start_time=start, stop_time=start + 0.01, step_size=0.001)
        assert len(result["time"]) == 11


def test_messages_name_what_python_has(loop, tmp_path):
    loop["component"] = [dict(part) for part in loop["component"]]
    note, short = System({**loop, "stop": 0.0115}).simulate().notes
    assert short.startswith("the step size does not divide the run: it ends at t = 0.011")
    assert note.startswith("controller is recorded after each step; use `sampled=False` ")
    plan = tmp_path / "sweep.toml"
    plan.write_text('system = "a.toml"\n[[parameter]]\nvariable = "a.b"\nvalues = [1]\n')
    for file, start, message in (
        (PENDULUM, {"zzz": 1}, r'; `Instance\("Pendulum.fmu"\).variables` has its variables'),
        (plan, {}, "it is a sweep, expected `sweep`"),
    ):
        with pytest.raises(FmuError, match=message):
            simulate(file, start_values=start)
    with pytest.raises(FmuError, match=r"^unknown field `stopp`, expected one of"):
        System({**loop, "stopp": 1.0}).simulate()
    for given, message in (
        ({"u": [1.0]}, r"input = u, expected also a column time \[s\]"),
        ({"r": lambda t: t, "u": [1.0]}, r"input = r, u, expected also a column time \[s\]"),
        ({"time": [0.0, 1.0], "u": [1.0]}, r"input u: 1 values, expected 2"),
        ({"time": np.array([0, 1], "m8[s]"), "u": [0, 1]}, "time has dates or durations, expected"),
        (Result.of({"time": [0], "u": [1]}, {"u": "kN"}), "input: u is in kN, expected N"),
        (np.zeros((2, 2)), "ndarray, expected a table of named columns"),
        ({"time": [0.0, 1.0], "u": [1.0, "x"]}, r"^input: row 2: u is x, expected a number"),
    ):
        with pytest.raises((FmuError, TypeError), match=message):
            simulate(PENDULUM, input=given)
    for keys in ({"step": 1.0}, {"stop": 1.0}):
        with pytest.raises(FmuError, match=r"Pendulum.fmu has no keys, expected a system file"):
            System(PENDULUM, **keys)


def test_what_does_not_fit_is_named(fmus):
    for options, message in (
        ({"start_values": {"M": "heavy"}}, 'M = "heavy" is invalid'),
        ({"start_values": {"m0": 1}}, "has no variable m0"),
        ({"stop_time": -1.0}, "stop = -1.0, expected at least start = 0.0"),
        ({"interface": "scripted"}, 'interface = "scripted": .* expected one of `co-simulation`'),
        ({"step_size": "small"}, 'step = "small": .* expected a number'),
        ({"start_values": {1: 2}}, r"start values {1: 2}, expected a dict from names to values"),
        ({"start_values": [1]}, r"start values \[1\], expected a dict from names to values"),
        ({"output": "y"}, "has no variable y"),
        ({"filename": None}, "^None, expected the file of a system, or its keys"),
        ({"filename": 3}, "^3, expected the file of a system, or its keys"),
    ):
        with pytest.raises((FmuError, TypeError), match=message):
            simulate(**{"filename": PENDULUM} | options)
    for keys, message in (
        ({}, "components = {}, expected a dict from names to FMUs"),
        ({"components": [PENDULUM]}, r"components = \['.*'\], expected a dict from names to FMUs"),
        ({"components": {"a": PENDULUM}, "connections": "a.y -> a.u"}, "has no variable y"),
    ):
        with pytest.raises((FmuError, TypeError), match=message):
            System(**keys, step=0.1, stop=1.0).simulate()


LARGEST, ODD = 2**64 - 1, 2**53 + 1
"""The largest UInt64, and the smallest whole number that is no Float64."""


@pytest.fixture
def echo(tmp_path) -> Path:
    """Return an FMU whose outputs are its inputs: yw of w and so on."""
    return in_c(tmp_path / "Echo.fmu")


SHAPES = {
    "2 x 2": [[1, 2], [3, 4]],
    "3 x 2": np.zeros((3, 2)),
    "6": [1, 2, 3, 4, 5, 6],
    "1 x 3": [range(3)],
    "lists of different lengths": [[1, 2, 3], [4, 5]],
}
"""Values for a matrix of 2 rows and 3 columns, by what is said of them."""


@pytest.mark.parametrize("shape", SHAPES)
def test_an_array_of_another_shape_is_an_error_with_both_shapes(echo, shape):
    value = SHAPES[shape]
    system = System(components={"a": echo}, step=0.5, stop=1.0)
    signals = dict.fromkeys(("reference", "output", "error", "control"), "a.yA[1,1]")
    started = System(components={"a": {"fmu": echo, "start": {"A": value}}}, step=0.5, stop=1.0)
    for use in (
        lambda: simulate(echo, start_values={"A": value}),
        lambda: Instance(echo, start_values={"A": value}),
        lambda: Instance(echo).set("A", value),
        lambda: system.simulate({"a.A": value}),
        started.times,
        lambda: sweep({"a.w": [1]}, system, signals=signals, set={"a.A": value}),
    ):
        with pytest.raises(FmuError, match=rf"A = \[.*\]: values: {shape}, expected 2 x 3$"):
            use()


def test_arrays_are_set_in_their_shape_also_with_other_sizes(echo, fmus):
    matrix = np.arange(6.0).reshape(2, 3)
    assert simulate(echo, start_values={"A": matrix})["yA"][-1].tolist() == matrix.ravel().tolist()
    system = System(components={"a": echo}, step=0.5, stop=1.0)
    assert system.simulate({"a.A": matrix.tolist()})["a.yA[2,3]"][-1] == 5

    def arrays(count: int) -> dict[str, object]:
        return {"rbf.c": np.linspace(-1, 1, count), "rbf.b": [0.5] * count, "rbf.w0": [0] * count}

    start = {"rbf.nodes": 2, **arrays(2)}
    nodes = System(components={"a": {"fmu": fmus / "PidRbf_fmi3.fmu", "start": start}}, step=0.001)
    nodes = nodes.changed(stop=0.01, outputs=["a.rbf.c"])
    changes = {f"a.{name}": value for name, value in {"rbf.nodes": 3, **arrays(3)}.items()}
    with nodes.loaded() as loaded:
        for _ in range(2):
            assert loaded.simulate()["a.rbf.c"][-1].tolist() == [-1, 1]
            assert loaded.simulate(changes)["a.rbf.c"][-1].tolist() == [-1, 0, 1]
            with pytest.raises(FmuError, match=r"rbf\.b = \[.*\]: values: 2, expected 3$"):
                loaded.simulate({name: changes[name] for name in ("a.rbf.nodes", "a.rbf.c")})


FORKED = """
import gc, os, sys
from pathlib import Path
from fmu_master import FmuError, Instance, System

fmu, folder, in_process = sys.argv[1], Path(sys.argv[2]), sys.argv[3] == "True"
start = {"theta0": 0.1}


def files():
    return sorted(folder.rglob("*"))


def forked(call, ends):
    child = os.fork()
    if child == 0:
        try:
            call()
            code = 0
        except FmuError as error:
            assert "from which this one was forked" in str(error)
            code = 1
        ends(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def drop():
    global plant, loop
    plant.free()
    loop._runners[in_process].free()
    del plant, loop
    gc.collect()


plant = Instance(fmu, start_values=start, in_process=in_process)
plant.step(0.1)
with System(fmu).loaded() as loop:
    run = lambda: loop.simulate(start, in_process=in_process)["theta"].tolist()
    before, kept = run(), files()
    assert kept
    calls = {plant.save: not in_process, run: not in_process, drop: 0}
    calls[lambda: Instance(fmu).step(0.1)] = 0
    for call, code in calls.items():
        for ends in (os._exit, sys.exit):
            assert forked(call, ends) == code
            assert files() == kept
    plant.step(0.1)
    assert run() == before
plant.free()
"""


@pytest.mark.parametrize("in_process", [False, True])
def test_a_forked_process_leaves_what_it_inherits_to_its_parent(fmus, tmp_path, in_process):
    """FMUs in the same process are copied with it."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", FORKED, PENDULUM, str(tmp_path), str(in_process)]
    subprocess.run(command, env=env, timeout=SECONDS, check=True)
    assert list(tmp_path.iterdir()) == []


def passing(loop: dict, **component: object) -> System:
    """Return the loop of a system file with a component in Python between controller and plant."""
    table = {"name": "actuator", "fmu": python_component(["u"], ["f"], **component)}
    parts = {part["name"]: part for part in loop["component"]}
    parts = [parts["source"], parts["controller"], table, parts["plant"]]
    links = [link for link in loop["connections"] if "controller.u" not in link]
    links += [("controller.u", "actuator.u"), ("actuator.f", "plant.u")]
    return System({**loop, "component": parts, "connections": links, "stop": 0.5})


@pytest.fixture
def loop(fmus) -> dict:
    """Return the loop of the PID, with absolute paths."""
    loop = tomllib.loads((LOOPS / "pid.toml").read_text())
    for component in loop["component"]:
        component["fmu"] = fmus / Path(component["fmu"]).name
    return loop


@pytest.mark.parametrize("in_process", [False, True])
def test_a_component_in_python_that_passes_its_input_on_keeps_the_bits(loop, in_process):
    expected = System(LOOPS / "pid.toml").simulate(stop_time=0.5)
    result = passing(loop, step=lambda t, u: u).simulate(in_process=in_process)
    for name in expected:
        np.testing.assert_array_equal(result[name], expected[name])
    np.testing.assert_array_equal(result["actuator.f"], expected["controller.u"])


@pytest.mark.parametrize("in_process", [False, True])
def test_a_component_in_python_is_called_at_its_samples_and_may_raise(loop, in_process):
    times = []

    def hold(time: float, force: float) -> float:
        times.append(time)
        if time > 0.1:
            raise ZeroDivisionError("no force")
        return force

    system = passing(loop, step=hold, sample_time=0.05, reset=times.clear)
    message = r"actuator \(Python\), step of 0.001 s at t = 0.101 s: .*ZeroDivisionError: no force"
    for _ in range(2):
        with pytest.raises(FmuError, match=message) as caught:
            system.simulate(in_process=in_process)
        assert times == pytest.approx([0.001, 0.051, 0.101])
    error = caught.value
    assert (error.component, error.function, error.time) == ("actuator", None, 0.101)
    assert isinstance(error.__cause__, ZeroDivisionError)
    assert error.result["time"][-1] == pytest.approx(0.1)

    def interrupt(time: float, force: float) -> float:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        passing(loop, step=interrupt).simulate(in_process=in_process)


class Counter:
    """Counts its calls, in an attribute and in a list."""

    def __init__(self) -> None:
        self.unused = threading.Lock()  # cannot be pickled
        self.reset()

    def reset(self) -> None:
        self.count, self.list = 0.0, []

    def step(self, time: float) -> float:
        self.count += 1
        self.list.append(time)
        return self.count

    def passed(self, time: float) -> float:
        return time

    __call__ = step


def test_a_state_that_a_run_leaves_to_the_next_is_reset_or_a_warning(recwarn):
    def last(step, reset=None) -> list[float]:
        component = python_component([], ["y"], step, reset=reset)
        system = System(components={"a": component}, step=0.5, stop=1.0)
        return [float(system.simulate()["a.y"][-1]) for _ in range(3)]

    counter = Counter()
    assert last(counter.step, counter.reset) == [3, 3, 3]
    assert last(Counter().passed) == [1, 1, 1]
    assert last(lambda time: time) == [1, 1, 1]
    assert last(math.sqrt) == [1, 1, 1]
    assert not recwarn
    for step in (Counter().step, Counter()):
        with pytest.warns(UserWarning, match=r"changed count, list of .*Counter.* `reset`") as told:
            assert last(step) == [3, 6, 9]
        assert [warning.filename for warning in told] == [__file__]


def test_components_in_python_have_what_fmus_have():
    """Inputs over time, faults, the parallel order, start values and types, in closed form."""
    types = {"n": "Int64", "m": "Int64", "on": "Boolean", "off": "Boolean"}
    first = python_component(
        ["u", "n", "on"], ["y", "m", "off"], lambda t, u, n, on: (2 * u, n + 1, not on), types=types
    )
    system = System(
        components={
            "first": {"fmu": first, "start": {"n": 2**53, "y": 7.0}},
            "second": python_component(["u"], ["y"], lambda t, u: np.array([u])),
        },
        connections=[{"from": "first.y", "to": "second.u", "faults": [{"gain": 3}]}],
        order="parallel",
        step=0.125,
        stop=0.5,
    )
    result = system.simulate({"first.on": True}, input={"first.u": lambda t: t})
    assert result["first.y"].tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert result["second.y"].tolist() == [21, 0, 0.75, 1.5, 2.25]
    assert result["first.m"].tolist() == [2**53 + 1] * 5
    assert result["first.off"].tolist() == [False] * 5


def test_what_does_not_fit_a_component_in_python_is_named(loop):
    assert python_component("yaw", "f", abs).inputs == ("yaw",)
    for component, message in (
        ({"step": lambda t, u: (u, u)}, "the function failed: values returned: 2, expected 1"),
        ({"step": lambda t, u: "far"}, "it returned far for f, expected a Float64"),
        ({"step": lambda t, u: None}, "TypeError: None is not a number, Boolean, string or bytes"),
        ({"step": abs, "sample_time": 1e-4}, "sample_time = 0.0001 of actuator, expected at least"),
        ({"step": abs, "types": {"u": "Int8"}}, 'type of actuator.u: "Int8", expected "Float64"'),
        ({"step": abs, "types": {"g": "Int64"}}, "g has a unit or type, but is no input or output"),
        ({"step": abs, "units": {"f": "m"}}, r"actuator.f \[m\] cannot feed plant.u \[N\]"),
    ):
        with pytest.raises((FmuError, ValueError), match=message):
            passing(loop, **component).simulate()
    connections = ["controller.u -> actuator.v", "actuator.f -> plant.u"]
    system = System({**passing(loop, step=abs).description, "connections": connections})
    with pytest.raises(FmuError, match=r"actuator\.v: Python has no variable v"):
        system.simulate()
    with pytest.raises(FmuError, match="actuator is a function of Python"):
        _ = system.toml


SIGNALS = {
    "reference": "source.r",
    "output": "plant.theta",
    "error": "controller.e",
    "control": "controller.u",
}


def test_a_sweep_of_start_values_has_the_metrics_of_the_runs(loop, tmp_path):
    """The integrals of the error are those of the samples, by the left rectangle."""
    plan = {
        "controller.pid.kp": [200.0, 300.0, 250.0],
        "plant.M": [1.0, 1.1, 1.2],
        "source.signal": ["sine", "square", "step"],
        "controller.previous_sample_terms": [True, False, True],
    }
    out = tmp_path / "out.parquet"
    system = System({**loop, "stop": 1.0})
    runs = sweep(plan, system, out, signals=SIGNALS)
    for index, values in enumerate(zip(*plan.values(), strict=True)):
        assert tuple(runs[name][index] for name in plan) == values
        result = system.simulate(dict(zip(plan, values, strict=True)))
        error = result["controller.e"]
        assert runs["final_e"][index] == error[-1]
        assert runs["largest_u"][index] == np.max(np.abs(result["controller.u"]))
        since, size = result["time"][:-1] - result["time"][0], np.abs(error[:-1])
        for name, held in {"iae": size, "ise": size**2, "itae": since * size}.items():
            integral = np.sum(held * np.diff(result["time"]))
            assert runs[name][index] == pytest.approx(integral, rel=1e-12)
    fields = {field.name: str(field.type) for field in pyarrow.parquet.read_schema(out)}
    assert list(fields)[:3] == ["index", "controller.pid.kp", "plant.M"]
    assert [fields[name] for name in ("index", "iae", "diverged")] == ["int64", "double", "bool"]
    # Without a file, by a temporary one in CSV.
    with Client(processes=False, dashboard_address="127.0.0.1:0") as client:
        distributed = Sweep(plan, system, signals=SIGNALS).dask(client)
    for name in runs:
        np.testing.assert_array_equal(distributed[name], runs[name])
    for changes, message in (
        ({"plan": {"controller.kp": [200.0]}}, "^sweep: controller.kp: .*has no variable kp"),
        ({"plan": plan | {"plant.M": [1.0]}}, "^sweep: together = .* expected lists of the same"),
        ({"processes": -1}, "processes = -1, expected at least 0"),
    ):
        with pytest.raises((FmuError, ValueError), match=message):
            sweep(**{"plan": plan, "system": system, "signals": SIGNALS} | changes)


def test_a_run_that_crashes_is_a_row_of_a_sweep_of_a_frame_also_on_dask(faulty):
    plan = {"at": [2.0, 0.5, 2.0], "fault": [FAULTS.index("CRASH")] * 3}
    signals = {"reference": "r", "output": "y", "error": "e", "control": "u"}
    frames = pandas.DataFrame(plan), polars.DataFrame(plan)
    all_ = [Sweep(frame, System(faulty), signals=signals, stop=1.0) for frame in frames]
    with Client(processes=False, dashboard_address="127.0.0.1:0") as client:
        tables = [all_[0].run(), all_[1].run(), all_[1].dask(client)]
    for runs in tables:
        assert runs["at"].tolist() == plan["at"]
        assert [text is not None for text in runs["failure"]] == [False, True, False]
        assert "at t = 0.5" in runs["failure"][1]
        assert "signal 11" in runs["failure"][1]
    with pytest.raises(FmuError, match="1 of 1 run failed, the first was run 0: ") as caught:
        sweep({"at": [0.5], "fault": [FAULTS.index("CRASH")]}, System(faulty), signals=signals)
    assert "signal 11" in caught.value.result["failure"][0]


def test_a_sweep_of_a_frame_resumes(loop, tmp_path):
    plan = polars.DataFrame({"controller.pid.kp": [200.0, 300.0, 400.0]})
    out = tmp_path / "out.csv"
    swept = Sweep(plan, System({**loop, "stop": 0.1}), out, signals=SIGNALS)
    with swept.files() as arguments:
        # Only the row of the second run arrives.
        rows = [*COMMAND, "sweep", *arguments, "--rows=1..2"]
        row = subprocess.run(rows, capture_output=True, check=True).stdout
        collect = [*COMMAND, "sweep", *arguments, "--out", out, "--collect"]
        subprocess.run(collect, input=row, capture_output=True, check=False)
    assert done(out) == [1]
    text = journal_of(out).read_text(encoding="utf-8")
    assert text.count(",300.0,") == 1
    # Known by another gain: what is kept is not run again.
    journal_of(out).write_text(text.replace(",300.0,", ",301.0,"), encoding="utf-8")
    assert swept.run()["controller.pid.kp"].tolist() == [200.0, 301.0, 400.0]


def test_keywords_replace_the_keys_of_a_sweep_file(loop):
    swept = Sweep({"plant.M": [1.0, 2.0]}, System({**loop, "stop": 0.2}), signals=SIGNALS)
    with swept.files() as (file, *_):
        runs = sweep(file, stop=0.1)
        for changes in ({"nosuch": 3}, {"signals": SIGNALS | {"error": "nosuch.e"}}):
            with pytest.raises(FmuError, match="nosuch"):
                sweep(file, **changes)
    assert not np.array_equal(runs["iae"], swept.run()["iae"])
    # No run settles, and none fails.
    assert np.isnan(runs["settling_time"]).tolist() == [True, True]
    assert runs["failure"].tolist() == [None, None]
    assert repr(runs).startswith("<Result: 2 rows: index, plant.M, iae, ")
    assert runs.to_pandas().index.tolist() == runs.plot().axes[0].lines[0].get_xdata().tolist()
    assert "index" not in runs.summary


def test_ctrl_c_ends_a_run_and_leaves_nothing(faulty, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    hang = {"fault": FAULTS.index("HANG"), "at": 0.5}
    # A job in the background of a shell ignores the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    for start in (
        lambda: simulate(faulty, stop_time=1.0, step_size=0.125, start_values=hang),
        lambda: simulate(PENDULUM, stop_time=1e5, step_size=1e-3, in_process=True),
        # A step takes a tenth of a second.
        lambda: simulate("target/fmu/IpidRbf.fmu", stop_time=1e6, step_size=1e3, in_process=True),
    ):
        threading.Timer(0.5, _thread.interrupt_main).start()
        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            start()
        assert time.monotonic() - began < 10
    signal.signal(signal.SIGINT, before)
    assert list(tmp_path.iterdir()) == []
