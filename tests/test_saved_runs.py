"""Saved runs: a run that continues from a file has the rows of one without a break."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_master import FmuError, Instance, Result, System, python_component, simulate
from fmu_master import read as read_table
from native import LOOPS, in_c, printed, read, refusal, run, write, write_system

FAULTS = [
    {"from": "plant.theta", "to": "controller.y", "faults": [{"delay": 0.003}, {"noise": 1e-4}]},
    {"from": "controller.u", "to": "plant.u", "faults": [{"dropout": 0.3}, {"drift": 0.5}]},
]


def same(one: Result, other: Result) -> None:
    assert list(one) == list(other)
    for name in one:
        assert np.asarray(one[name]).tobytes() == np.asarray(other[name]).tobytes(), name


def check(
    system: System, folder: Path, stop: float, until: float, **options: Any
) -> tuple[Result, Result]:
    """Check that a run in two parts has the rows of one in one part; return both parts."""
    file = folder / "run.state"
    whole = system.simulate(stop_time=stop, **options)
    first = system.simulate(stop_time=until, save_state=file, **options)
    second = system.simulate(stop_time=stop, load_state=file, **options)
    count = len(first["time"])
    assert 0 < count < len(whole["time"])
    assert second["time"][0] == first["time"][-1] == pytest.approx(until)
    for name in whole:
        parts = [np.asarray(part[name]) for part in (first, second)]
        joined = np.concatenate([parts[0][:-1], parts[1]])
        assert joined.tobytes() == np.asarray(whole[name]).tobytes(), name
        # The last row of the first part is the first row of the second one.
        assert parts[0][-1:].tobytes() == parts[1][:1].tobytes(), name
    return first, second


def loop(fmus: Path, ending: str = "", **keys: Any) -> System:
    """Return the loop of the paper, by default of FMI 2.0, from 0.001 s on."""
    components = {
        "controller": {"fmu": fmus / f"PidRbf{ending}.fmu"},
        "plant": {"fmu": fmus / f"Pendulum{ending}.fmu", "start": {"theta0": 0.1}},
    }
    connections = ["plant.theta -> controller.y", "controller.u -> plant.u"]
    times = {"start": 0.001, "step": 0.001, "stop": 0.3}
    return System(**{"components": components, "connections": connections, **times, **keys})


@pytest.mark.parametrize("file", ["pid.toml", "supervised.toml"])
def test_the_loops_of_the_paper_continue_with_the_same_bits(fmus, tmp_path, file):
    check(System(LOOPS / file), tmp_path, 0.4, 0.2)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("ending", ["", "_fmi3"])
def test_what_faults_remember_continues_with_the_same_bits(fmus, tmp_path, ending, order):
    system = loop(fmus, ending, connections=FAULTS, seed=7, order=order)
    check(system, tmp_path, 0.2, 0.1, in_process=True)


def test_a_run_is_continued_again_and_again_from_the_file_that_it_replaces(fmus, tmp_path):
    system, file = loop(fmus, connections=FAULTS), tmp_path / "run.state"
    whole = system.simulate(stop_time=0.05)
    parts = [system.simulate(stop_time=0.01, save_state=file)]
    with system.loaded() as loaded:
        for stop in (0.02, 0.03, 0.05):
            parts.append(loaded.simulate(stop_time=stop, load_state=file, save_state=file))
    theta = np.concatenate([part["plant.theta"][:-1] for part in parts])
    assert theta.tobytes() == whole["plant.theta"][:-1].tobytes()


@pytest.mark.parametrize("ending", ["", "_fmi3"])
@pytest.mark.parametrize("model", ["BouncingBall", "Thermostat", "VanDerPol", "Stair"])
def test_an_integration_continues_with_the_same_bits(equations, tmp_path, model, ending):
    file = equations / f"{model}{ending}.fmu"
    options = {"step_size": 0.01, "in_process": True}
    for interface in ("model-exchange", "co-simulation"):
        check(System(file), tmp_path, 2.0, 1.13, interface=interface, **options)


def test_inputs_of_a_table_continue_at_the_time_of_the_state(fmus, tmp_path):
    times = np.linspace(0, 0.3, 31)
    table = {"time": times, "u": np.where(times < 0.15, np.sin(40 * times), -1.0)}
    system = System(fmus / "Pendulum.fmu")
    check(system, tmp_path, 0.3, 0.1, step_size=0.004, input=table)
    table["u"] = lambda time: np.cos(9 * time)
    check(system, tmp_path, 0.3, 0.1, step_size=0.004, input=table)


def test_the_command_line_and_python_share_files(fmus, tmp_path):
    system, file = LOOPS / "pid.toml", tmp_path / "run.state"
    saved = printed("simulate", system, "--stop", 0.1, "--save-state", file)
    assert f"wrote {file}: the state of the run\n" in saved
    by_python = System(system).simulate(stop_time=0.2, load_state=file)
    table = tmp_path / "part.csv"
    printed("simulate", system, "--stop", 0.2, "--load-state", file, "--csv", table)
    same(by_python, read_table(table))


# --- start values ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "before", "after", "output"),
    [
        ("Pid.fmu", {"y": 0.2}, {"y": 0.3, "pid.kp": 150.0}, "u"),
        ("Thermostat.fmu", {}, {"set_point": 25.0, "window": True}, "temperature"),
        ("BouncingBall.fmu", {"e": 0.6}, {"e": 0.9}, "h"),
        ("BouncingBall_fmi3.fmu", {"e": 0.6}, {"e": 0.9}, "h"),
    ],
)
def test_inputs_and_tunable_parameters_may_differ(
    fmus, equations, tmp_path, model, before, after, output
):
    """The same FMU, stepped by hand, gets them at the same time."""
    file, saved = (fmus if model == "Pid.fmu" else equations) / model, tmp_path / "run.state"
    for interface in ("co-simulation", *(["model-exchange"] if model != "Pid.fmu" else [])):
        options = {"step_size": 0.01, "interface": interface}
        simulate(file, stop_time=0.5, save_state=saved, start_values=before, **options)
        starts = {**before, **after}
        run = simulate(file, stop_time=0.8, load_state=saved, start_values=starts, **options)
        with Instance(file, start_values=before, interface=interface) as fmu:
            for k in range(80):
                if k == 50:
                    fmu.set(after)
                fmu.step(0.01)
            assert run[output][-1] == fmu.get(output), interface


def test_other_start_values_are_refused_by_name(fmus, tmp_path):
    file, model = tmp_path / "run.state", fmus / "Pendulum.fmu"
    simulate(model, stop_time=0.1, save_state=file, start_values={"theta0": 0.1})
    expected = "theta0 = 0.2: the saved run began with 0.1, and only inputs and tunable parameters"
    with pytest.raises(FmuError, match=expected):
        simulate(model, stop_time=0.2, load_state=file, start_values={"theta0": 0.2})
    with pytest.raises(FmuError, match=r"theta0 = 0\.0: the saved run began with 0\.1"):
        simulate(model, stop_time=0.2, load_state=file)


def test_a_sweep_begins_each_run_from_a_state(fmus, tmp_path):
    file, system = tmp_path / "run.state", System(LOOPS / "pid.toml")
    system.simulate(stop_time=0.5, save_state=file)
    gains = [200.0, 400.0]
    text = f"""
system = "{LOOPS / "pid.toml"}"
stop = 0.7
load_state = "run.state"
parameter = [{{ variable = "controller.pid.kp", values = {gains} }}]
signals.reference = "source.r"
signals.output = "plant.theta"
signals.error = "controller.e"
signals.control = "controller.u"
"""
    (tmp_path / "sweep.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "rows.csv"
    printed("sweep", tmp_path / "sweep.toml", "--out", out)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    for gain, error in zip(gains, rows["iae"], strict=True):
        values = {"controller.pid.kp": gain}
        part = system.simulate(values, stop_time=0.7, load_state=file)
        assert error == pytest.approx(np.sum(np.abs(part["controller.e"])) * 0.001, rel=0.02)


# --- refused --------------------------------------------------------------------------------------


@pytest.fixture
def saved(fmus: Path, tmp_path: Path) -> Path:
    file = tmp_path / "run.state"
    loop(fmus).simulate(stop_time=0.05, save_state=file)
    return file


def components(fmus: Path) -> dict[str, dict[str, Any]]:
    """Return the components of `loop`."""
    start = {"theta0": 0.1}
    return {
        "controller": {"fmu": fmus / "PidRbf.fmu"},
        "plant": {"fmu": fmus / "Pendulum.fmu", "start": start},
    }


Changes = Callable[[Path, Path], dict[str, Any]]

OTHERS: dict[str, tuple[Changes, str]] = {
    "another FMU": (
        lambda fmus, _: {
            "components": components(fmus) | {"controller": {"fmu": fmus / "Pid.fmu"}}
        },
        r"controller was PidRbf\.fmu \{.*\}, and is Pid\.fmu \{.*\}: the state of another FMU",
    ),
    "another version of the file": (
        lambda fmus, folder: {
            "components": components(fmus)
            | {"controller": {"fmu": another_version(fmus / "PidRbf.fmu", folder)}}
        },
        r"controller was another version of PidRbf\.fmu: the bytes of the file PidRbf\.fmu differ",
    ),
    "another version of FMI": (
        lambda fmus, _: {
            "components": components(fmus) | {"controller": {"fmu": fmus / "PidRbf_fmi3.fmu"}}
        },
        r"controller was another version of PidRbf\.fmu: the bytes of the file PidRbf_fmi3",
    ),
    "another component": (
        lambda fmus, _: {"components": components(fmus) | {"more": {"fmu": fmus / "Source.fmu"}}},
        "with the components controller, plant, and this one has controller, plant, more",
    ),
    "another step": (
        lambda *_: {"step": 0.002},
        r"saved with step = 0\.001, expected the same; got 0\.002",
    ),
    "another order": (
        lambda *_: {"order": "parallel"},
        "saved with order = sequential, expected the same; got parallel",
    ),
    "a missing connection": (
        lambda *_: {"connections": ["plant.theta -> controller.y"]},
        "saved with the connection controller.u -> plant.u, which the system does not have",
    ),
    "another fault": (
        lambda *_: {"connections": FAULTS},
        r"saved with another factor, offset or other faults of plant\.theta -> controller\.y",
    ),
    "another tolerance": (
        lambda *_: {"tolerance": 1e-3},
        r"controller was run with the tolerance .*, expected the same; got 0\.001",
    ),
}


def another_version(fmu: Path, folder: Path) -> Path:
    """Write the FMU with a file more."""
    return write(folder / fmu.name, read(fmu) | {"resources/more.txt": "x"})


@pytest.mark.parametrize(("changes", "message"), OTHERS.values(), ids=OTHERS)
def test_the_state_of_another_system_is_refused_by_name(fmus, tmp_path, saved, changes, message):
    with pytest.raises(FmuError, match=message) as refused:
        loop(fmus, **changes(fmus, tmp_path)).simulate(load_state=saved)
    assert str(saved) in str(refused.value)


def test_a_file_that_is_no_state_is_refused(fmus, tmp_path, saved):
    content = saved.read_bytes()
    for bad, message in (
        (b"", "it is not the saved state of a run"),
        ((LOOPS / "pid.toml").read_bytes(), "it is not the saved state of a run"),
        (content[:-1], "damaged or truncated"),
        (content[:20], "truncated"),
        (content[:8] + b"\xff\0\0\0" + content[12:], "the format 255, expected 1"),
    ):
        saved.write_bytes(bad)
        with pytest.raises(FmuError, match=message):
            loop(fmus).simulate(load_state=saved)
    with pytest.raises(FmuError, match=r"cannot read .*missing"):
        loop(fmus).simulate(load_state=tmp_path / "missing")


def test_times_that_do_not_fit_a_state_are_refused(fmus, saved):
    with pytest.raises(FmuError, match=r"the state is of t = 0\.05 s, expected a stop time from"):
        loop(fmus).simulate(load_state=saved, stop_time=0.04)
    with pytest.raises(FmuError, match=r"start_time = 1\.0, but the state has a time"):
        loop(fmus).simulate(load_state=saved, start_time=1.0)
    result = run("simulate", LOOPS / "pid.toml", "--start", 1, "--load-state", saved)
    assert (result.returncode, result.stdout) == (2, "")
    assert "'--start <T>' cannot be used with '--load-state <FILE>'" in result.stderr


def test_a_component_without_a_state_is_named_before_the_first_step(fmus, tmp_path):
    in_c(tmp_path / "Relay.fmu")
    system = write_system(tmp_path, {"a": {}})
    expected = (
        "the state of a (Relay.fmu) cannot be saved: its model description does not declare "
        "canGetAndSetFMUstate"
    )
    assert expected in refusal(tmp_path, "simulate", system, "--save-state", "run.state")
    hold = python_component(["theta"], ["y"], lambda time, theta: theta)
    parts = {"plant": {"fmu": fmus / "Pendulum.fmu"}, "hold": hold}
    with pytest.raises(FmuError, match=r"the state of hold .* it is a function, whose state"):
        System(components=parts, step=0.1, stop=1).simulate(save_state=tmp_path / "run.state")


def test_a_place_that_cannot_be_written_is_found_before_the_first_step(fmus, tmp_path):
    file = Path("missing", "run.state")
    message = refusal(tmp_path, "simulate", fmus / "Pendulum.fmu", "--save-state", file)
    assert f"cannot write {file}: the folder missing does not exist" in message


def test_the_place_of_the_files_does_not_matter(fmus, tmp_path, saved):
    folder = tmp_path / "other"
    folder.mkdir()
    for name in ("PidRbf.fmu", "Pendulum.fmu"):
        shutil.copy(fmus / name, folder)
    same(loop(folder).simulate(load_state=saved), loop(fmus).simulate(load_state=saved))
