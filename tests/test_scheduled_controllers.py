"""Controllers in scheduled execution, whose samples FMPy activates: the bits of co-simulation."""

from collections.abc import Callable
from contextlib import ExitStack
from ctypes import byref, c_double, c_int, c_uint
from pathlib import Path

import numpy as np
import pytest

from native import LOOPS, read_csv, refusal, run
from pendulum_fmus import table1
from pendulum_fmus.loop import PREVIOUS_SAMPLE_TERMS, TS, Columns, Loop
from pendulum_fmus.master import Component, FmpySystem, MasterError, simulate
from pendulum_fmus.project import ROOT

TIMES = {"start": 4.95, "step": TS, "steps": 100}
"""The disturbance and the jump of the square wave are at 5 s."""


class Scheduled(Component):
    """A controller whose sample is a model partition."""

    interface = "ScheduledExecution"

    def step(self, time: float, step: float) -> None:
        """Activate the sample at `time` [s]."""
        self.time = time
        with self._explained("activation"):
            self.fmu.activateModelPartition(self.variable("sample").valueReference, time)

    def interval(self) -> tuple[float, int]:
        """Return the interval [s] of the clock, and its qualifier."""
        interval, qualifier = c_double(), c_int()
        clock = byref(c_uint(self.variable("sample").valueReference))
        function, instance = self.fmu.fmi3GetIntervalDecimal, self.fmu.component
        function(instance, clock, 1, byref(interval), byref(qualifier))
        return interval.value, qualifier.value


@pytest.fixture(scope="module")
def scheduled(export: Callable[..., Path]) -> Path:
    """Export the controllers for scheduled execution; return their folder."""
    options = ("--fmi", "3.0", "--interface", "scheduled-execution")
    return export(ROOT / "target" / "scheduled", *PREVIOUS_SAMPLE_TERMS, *options)


def results(loop: Loop, plants: Path, controllers: Path, kind: type[Component]) -> Columns:
    """Run a loop with instances of a kind as controllers."""
    models, starts, components = loop.models(), loop.starts(), []
    with ExitStack() as stack:
        for name, model in models.items():
            is_controller = model in PREVIOUS_SAMPLE_TERMS
            folder, of = (controllers, kind) if is_controller else (plants, Component)
            path = folder / f"{model}_fmi3.fmu"
            component = of(name, path, starts[name], sampled=is_controller)
            components.append(stack.enter_context(component))
        system = FmpySystem(components, loop.connections())
        return simulate(system, **TIMES, order=loop.order)


@pytest.mark.parametrize("loop", sorted(table1.runs(), key=repr))
def test_all_loops_of_table_1_have_the_bits_of_co_simulation(fmus, scheduled, loop):
    expected = results(loop, fmus, fmus, Component)
    found = results(loop, fmus, scheduled, Scheduled)
    assert found.keys() == expected.keys()
    assert np.ptp(expected["controller.u"]) > 0
    for name, column in expected.items():
        assert found[name].tobytes() == column.tobytes(), name


@pytest.mark.parametrize("name", ["pid", "pid-rbf", "ipid-rbf"])
def test_the_native_master_gives_the_bits_of_co_simulation(fmus, scheduled, name, tmp_path):
    """In the systems of the examples, whose controllers have the only clock."""
    text = (LOOPS / f"{name}.toml").read_text(encoding="utf-8")
    text = text.replace("stop = 20.0", "stop = 6.0")
    columns = []
    for controllers in (fmus, scheduled):
        system = tmp_path / "system.toml"
        of_model = {model: controllers / f"{model}_fmi3.fmu" for model in PREVIOUS_SAMPLE_TERMS}
        files = {"Pendulum": fmus / "Pendulum.fmu", "Source": fmus / "Source.fmu"} | of_model
        described = text
        for model, file in files.items():
            described = described.replace(f"../../target/fmu/{model}.fmu", file.as_posix())
        system.write_text(described, encoding="utf-8")
        outputs = ("--output=controller.u", "--output=plant.theta")
        run("simulate", system, "--csv", tmp_path / "out.csv", *outputs)
        columns.append(read_csv(tmp_path / "out.csv"))
    for column, values in columns[0].items():
        assert values.tobytes() == columns[1][column].tobytes(), column


def test_the_clock_of_the_sample_has_the_interval_of_the_sample_time(scheduled):
    with Scheduled("pid", scheduled / "Pid_fmi3.fmu", {"ts": 0.25, "r": 0.1}) as pid:
        clock = pid.variable("sample")
        assert (clock.type, clock.causality) == ("Clock", "input")
        last = max(v.valueReference for v in pid.description.modelVariables)
        assert clock.valueReference == last
        sampled = {"input", "output"}
        clocked = {v.name for v in pid.description.modelVariables if v.clocks}
        names = {v.name for v in pid.description.modelVariables if v.causality in sampled}
        assert clocked == names - {"sample"}
        pid.fmu.enterInitializationMode(startTime=1.0)
        assert pid.interval() == (0.25, 2)  # fmi3IntervalChanged
        pid.fmu.exitInitializationMode()
        assert pid.interval() == (0.25, 1)  # fmi3IntervalUnchanged
        pid.step(1.0, 0.0)
        assert pid.get("e") == 0.1
        with pytest.raises(MasterError, match=r"cannot tick at 1.1 s; expected 1.25 s, or later"):
            pid.step(1.1, 0.0)


def test_an_fmu_for_scheduled_execution_has_another_token_and_nothing_else(fmus, scheduled):
    files = [folder / "Pid_fmi3.fmu" for folder in (fmus, scheduled)]
    tokens = [Component("pid", files[0]).description.guid, Scheduled("pid", files[1])]
    with tokens[1] as pid:
        assert pid.description.guid != tokens[0]
        assert pid.description.coSimulation is pid.description.modelExchange is None
        with pytest.raises(MasterError, match='"CoSimulation" is not supported'):
            Component("pid", files[1])
    shown = run("info", files[1]).stdout
    assert "scheduled execution" in shown
    assert "co-simulation" not in shown
    assert "fixed, priority 0" in shown or "calculated, priority 0" in shown
    assert "discrete at sample" in shown


def test_fmi_2_has_no_scheduled_execution(tmp_path):
    options = ("--interface", "scheduled-execution", "--manifest-path", ROOT / "Cargo.toml")
    message = refusal(tmp_path, "export", "Pid", *options, "--out", tmp_path / "fmu")
    expected = "FMI 2.0 has no scheduled execution, for which the package fmu-controller"
    assert message.startswith(expected)
    assert message.endswith("expected --fmi 3.0")
