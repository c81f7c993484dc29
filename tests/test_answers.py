"""What the Python module tells the user: messages of FMUs, and answers to mistakes."""

from pathlib import Path

import pytest

from fmu_master import FmuError, Message, System, simulate
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
