"""What the Python module tells the user: messages of FMUs, and answers to mistakes."""

import re
from pathlib import Path

import numpy as np
import pytest

from fmu_master import (
    FmuError,
    Message,
    System,
    _keys,
    python_component,
    simulate,
    sweep,
)
from native import LOOPS, run

PENDULUM = "target/fmu/Pendulum.fmu"


def test_messages_have_levels_and_changes_of_the_state_are_told_on_request(fmus):
    run = {"filename": PENDULUM, "stop_time": 0.1}
    assert simulate(**run).messages == []
    told = simulate(**run, debug_logging=True).messages
    assert {(m.instance, m.level, m.category, m.warning) for m in told} == {
        ("Pendulum", "info", "logEvents", False)
    }
    assert "state: terminated" in [message.text for message in told]
    assert Message("plant", "warning", "it is full", 1, "").warning
    with pytest.raises(FmuError) as caught:
        simulate(**run, start_values={"M": -1})
    assert caught.value.result.messages == []  # the reason is in the text


class Loop(System):
    """A system with a name."""

    def __init__(self, file: Path, name: str):
        super().__init__(file)
        self.name = name


def test_a_changed_or_loaded_system_keeps_its_class_and_attributes(fmus):
    loop = Loop(LOOPS / "pid.toml", "fast")
    changed = loop.changed(stop=0.1)
    assert isinstance(changed, Loop)
    assert (changed.name, changed.times()[1], loop.times()[1]) == ("fast", 0.1, 20.0)
    assert loop.description is None
    with changed.loaded() as loaded:
        assert isinstance(loaded, Loop)
        # Changes of a loaded system are loaded anew.
        assert loaded.changed(stop=0.2).simulate()["time"][-1] == 0.2


def test_a_variable_that_cannot_be_set_suggests_its_initial_value(fmus):
    for start, meant in (("theta", "theta0"), ("x", "x0"), ("omega", "omega0")):
        with pytest.raises(
            FmuError, match=rf"^{start} = 1 cannot be set: .*; did you mean {meant}\?"
        ):
            simulate(PENDULUM, start_values={start: 1})
    said = run("simulate", LOOPS / "pid.toml", "--set", "plant.theta=0.1").stderr
    assert said.rstrip().endswith("start values; did you mean plant.theta0?")
    with pytest.raises(FmuError, match=r"approx have start values$"):
        simulate("target/fmu/Pid.fmu", start_values={"u": 1})
    with pytest.raises(FmuError, match=r"has no variable PID\.KP; did you mean pid\.kp\?"):
        simulate("target/fmu/Pid.fmu", start_values={"PID.KP": 1})


COMPONENTS = {"controller": "target/fmu/Pid.fmu", "plant": PENDULUM}
CONNECTIONS = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
SIGNALS = {
    "reference": "controller.r",
    "output": "plant.theta",
    "error": "controller.e",
    "control": "controller.u",
}


def loop(**keys: object) -> System:
    parts = {"components": COMPONENTS, "connections": CONNECTIONS, "step": 0.001, "stop": 0.01}
    return System(**parts | keys)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"connection": []}, "unknown field `connection`, .*did you mean `connections`"),
        ({"component": COMPONENTS}, "unknown field `component`, .*did you mean `components`"),
        ({"stop_time": 1.0}, "unknown field `stop_time`, .*did you mean `stop`"),
        ({"stop": "1"}, "^stop = '1', expected a number"),
        ({"stop": None}, "^missing field `stop`, expected the stop time in s"),
        ({"order": "seq"}, '^order = \'seq\', expected "sequential", "parallel" or "implicit"'),
        ({"seed": -1}, "^seed = -1, expected a whole number of at least 0"),
        ({"outputs": [1]}, r"^outputs = \[1\], expected names of variables"),
        ({"input": {"time": [0]}}, "^input = .* expected a file; `simulate` takes tables"),
        (
            {"components": {"c": lambda t, y: y}},
            r"^components: c = <.*> is a function, expected \"c\": python_component\(inputs",
        ),
        ({"components": {"c": 3}}, "^components: c = 3, expected the file of an FMU, a dict with"),
        ({"components": {1: PENDULUM}}, "^components: the name 1, expected a text"),
        ({"components": {"c": {}}}, "^component c: fmu is missing, expected the file of an FMU"),
        (
            {"components": {"c": {"fmu": PENDULUM, "start_values": {}}}},
            "^component c: unknown field `start_values`, .*did you mean `start`",
        ),
        (
            {"components": {"c": {"fmu": PENDULUM, "sampled": 1}}},
            "sampled = 1, expected True or Fal",
        ),
        ({"connections": ("plant.theta", "controller.y")}, r"^connections = .* a list of pairs \("),
        ({"connections": {"plant.theta": "controller.y"}}, r"^connections = .* a list of pairs \("),
        ({"connections": [("plant.theta", 1)]}, r"^connections: \('plant.theta', 1\), expected"),
        ({"connections": [{"from": "plant.theta"}]}, "^connections: to is missing in {'from'"),
        (
            {"connections": [{"from": "plant.theta", "to": "controller.y", "factors": 2}]},
            "^connections: unknown field `factors`, .*did you mean `factor`",
        ),
        (
            {"connections": [("controller.y", "plant.theta")]},
            "controller.y is connected as an .*; did you mean plant.theta -> controller.y",
        ),
    ],
)
def test_a_mistake_in_a_system_is_answered_by_what_is_expected(fmus, keys, message):
    with pytest.raises((FmuError, TypeError), match=message):
        loop(**keys).simulate()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stop": 1.0}, "^simulate: unknown argument `stop`, .*did you mean `stop_time`"),
        ({"output_interval": 0.1}, "did you mean `step_size`"),  # as FMPy names it
        ({"start_time": {"theta0": 0.1}}, "^start_time = .* a number; did you mean start_values"),
        ({"start_values": {"theta0": None}}, "^theta0: None is not a number"),
        ({"output": [1]}, r"^output = \[1\], expected names of variables"),
        ({"in_process": "yes"}, "^in_process = 'yes', expected True or False"),
        ({"filename": "target/fmu/Pendulun.fmu"}, r"did you mean Pendulum.fmu\?$"),
        ({"filename": "target/fmu/Pendulum"}, r"did you mean Pendulum.fmu\?$"),
        ({"filename": loop}, "expected the file of a system, or its keys"),
    ],
)
def test_a_mistake_in_a_run_is_answered_by_what_is_expected(fmus, arguments, message):
    with pytest.raises((FmuError, TypeError), match=message):
        simulate(**{"filename": PENDULUM} | arguments)


GAINS = {"controller.pid.kp": [200.0, 300.0]}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"system": None}, "^the argument system is missing, expected a `System`"),
        ({"signals": None}, '^sweep: signals is missing, expected signals={"reference": "comp'),
        ({"signals": {"output": "plant.theta"}}, "^sweep: signals: reference is missing, expect"),
        ({"signals": ["plant.theta"]}, r"^sweep: signals = \['plant.theta'\], expected a dict"),
        ({"signals": SIGNALS | {"errors": "a.b"}}, "field `errors`, .*did you mean `error`"),
        ({"stop_time": 1.0}, "^sweep: unknown field `stop_time`, .*did you mean `stop`"),
        ({"draws": "3"}, "^sweep: draws = '3', expected a whole number"),
        ({"metrics": {"bands": 1}}, "^sweep: metrics: unknown field `bands`, .*mean `band`"),
        ({"out": 3}, "^out = 3, expected a file, .csv or .parquet"),
        ({"processes": 1.5}, r"^processes = 1\.5, expected a whole number"),
        ({"plan": {}}, "^plan = {}, expected a list of start values"),
        ({"plan": [1.0]}, r"^plan = \[1\.0\]: list, expected a table of named columns"),
        ({"plan": {"plant.M": 1.0}}, "^plan: plant.M = 1.0, expected a list of finite numbers"),
        ({"plan": {"plant.M": []}}, r"^plan: plant.M = \[\], expected a list of finite numbers"),
        ({"plan": {"plant.M": [None]}}, "^plan: plant.M has the value None, expected a list"),
        (
            {"plan": {"plant.M": np.eye(2)}},
            r"^plan: plant.M has the value \[1\.0, 0\.0\], expected",
        ),
        (
            {"plan": GAINS | {"plant.M": [1.0]}},
            "2 values of controller.pid.kp, 1 values of plant.M",
        ),
        ({"plan": {"parameters": [{"variable": "a.b"}]}}, "; did you mean `parameter`"),
        ({"plan": {"parameter": {"variable": "a.b"}}}, "parameter = .* expected a list of dicts"),
        (
            {"plan": {"parameter": [{"variable": "plant.M", "value": [1]}]}},
            "^sweep: parameter: unknown field `value`, .*did you mean `values`",
        ),
        ({"plan": PENDULUM}, "Pendulum.fmu is an FMU, expected a sweep file, or for a run `simul"),
    ],
)
def test_a_mistake_in_a_sweep_is_answered_by_what_is_expected(fmus, arguments, message):
    given = {"plan": GAINS, "system": loop(), "signals": SIGNALS} | arguments
    if isinstance(given["plan"], str):
        del given["system"], given["signals"]
    with pytest.raises((FmuError, TypeError), match=message):
        sweep(**given)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"inputs": 3}, "^inputs = 3, expected names of variables"),
        ({"outputs": [1]}, r"^outputs = \[1\], expected names of variables"),
        ({"step": "f"}, "^step = 'f', expected a function"),
        ({"reset": 1}, "^reset = 1, expected a function"),
        ({"units": ["N"]}, r"^units = \['N'\], expected a dict"),
        ({"types": {"u": float}}, "^types = .*float.* expected a dict"),
        ({"sampletime": 0.1}, "^python_component: unknown argument .* did you mean `sample_time`"),
    ],
)
def test_a_mistake_in_a_component_in_python_is_answered_at_once(arguments, message):
    with pytest.raises(TypeError, match=message):
        python_component(**{"inputs": ["y"], "outputs": ["u"], "step": lambda t, y: y} | arguments)


def test_what_a_run_replaces_may_be_missing_from_a_system(fmus):
    system = System(components={"plant": PENDULUM}, outputs="plant.theta")
    result = system.simulate(step_size=0.01, stop_time=0.1)
    assert list(result) == ["time", "plant.theta"]
    assert result["time"][-1] == pytest.approx(0.1)


SYSTEM_FILE = """
step = 0.1
stop = 1.0
{0}
[[component]]
name = "plant"
fmu = "Pendulum.fmu"
{1}
"""
SWEEP_FILE = """
{0}
system = "system.toml"
[[parameter]]
variable = "plant.M"
values = [1.0]
{1}
[signals]
reference = "plant.x"
output = "plant.theta"
error = "plant.theta"
control = "plant.u"
{2}
[metrics]
{3}
"""


def test_python_knows_the_keys_of_the_files(tmp_path):
    """The reader of each file lists its keys when it finds an unknown one."""

    def known(command: str, text: str, place: int) -> set[str]:
        (tmp_path / "a.toml").write_text(
            text.format(*("nosuch = 1" * (n == place) for n in range(4)))
        )
        said = run(command, "a.toml", cwd=tmp_path).stderr
        return set(re.findall(r"`(\w+)`", said.partition("unknown field `nosuch`, expected")[2]))

    system = set(_keys.SYSTEM) - {"components"} | {"component"}
    assert known("simulate", SYSTEM_FILE, 0) == system
    assert known("simulate", SYSTEM_FILE, 1) == {"name", *_keys.COMPONENT}
    for place, keys in enumerate((_keys.SWEEP, _keys.PARAMETER, _keys.SIGNALS, _keys.METRICS)):
        assert known("sweep", SWEEP_FILE, place) == set(keys)
