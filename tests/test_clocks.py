"""FMPy ticks the clocks of FMUs in all types of interfaces.

The hosts here find the instants of time-based clocks by the intervals that the FMU says.
"""

from collections.abc import Callable, Iterator
from ctypes import c_double, c_int, c_uint32, c_uint64
from pathlib import Path

import fmpy
import pytest
from fmpy.fmi3 import FMU3Model, FMU3ScheduledExecution, FMU3Slave, fmi3ClockUpdateCallback

NOT_YET_KNOWN, UNCHANGED, CHANGED = range(3)
"""The qualifiers of intervals."""

TOTAL = [2, 4, 5, 6, 8, 9, 10, 11, 13, 15]
"""The ticks of all clocks of the example `Counter`, at 0 s, 1 s, ..., from its table."""
FIFTHS = [2, 6, 9]
"""The seconds at which its output clock ticks."""


class Scheduled(FMU3ScheduledExecution):
    """An instance whose host does something in `clockUpdate`."""

    on_update: Callable[[], None] = staticmethod(lambda: None)

    def __init__(self, **arguments) -> None:
        super().__init__(**arguments)
        instantiate = self.fmi3InstantiateScheduledExecution
        self.update = fmi3ClockUpdateCallback(lambda *_: self.on_update())

        def with_update(*arguments):
            return instantiate(*arguments[:7], self.update, *arguments[8:])

        self.fmi3InstantiateScheduledExecution = with_update


TYPES = {"CoSimulation": FMU3Slave, "ModelExchange": FMU3Model, "ScheduledExecution": Scheduled}


@pytest.fixture
def instance(clocks: Path, tmp_path: Path) -> Iterator[Callable]:
    """Return a function that makes an instance of a model in initialization mode."""
    made = []

    def make(model: str, of: str, **values: float):
        file = clocks / f"{model}_fmi3.fmu"
        folder = fmpy.extract(file, tmp_path / f"{len(made)}")
        description = fmpy.read_model_description(folder)
        fmu = TYPES[of](
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=model,
            instanceName=model,
        )
        fmu.names = {v.name: v.valueReference for v in description.modelVariables}
        fmu.instantiate(**({"eventModeUsed": True} if of == "CoSimulation" else {}))
        made.append(fmu)
        for name, value in values.items():
            fmu.setFloat64([fmu.names[name]], [value])
        fmu.enterInitializationMode()
        return fmu

    yield make
    for fmu in made:
        fmu.terminate()
        fmu.freeInstance()


def interval(fmu, clock: str) -> tuple[float, int]:
    """Return the interval of a clock with its qualifier."""
    found, qualifier = (c_double * 1)(), (c_int * 1)()
    fmu.getIntervalDecimal((c_uint32 * 1)(fmu.names[clock]), found, qualifier)
    return found[0], qualifier[0]


def shift(fmu, clock: str) -> float:
    found = (c_double * 1)()
    fmu.getShiftDecimal((c_uint32 * 1)(fmu.names[clock]), found)
    return found[0]


def is_active(fmu, clock: str) -> bool:
    return bool(fmu.getClock([fmu.names[clock]])[0])


def whole(fmu, *names: str) -> list[int]:
    return fmu.getInt32([fmu.names[name] for name in names])


def real(fmu, name: str) -> float:
    return fmu.getFloat64([fmu.names[name]])[0]


def tick(fmu, *clocks: str) -> None:
    fmu.setClock([fmu.names[clock] for clock in clocks], [True] * len(clocks))


class Instants:
    """The instants at which the clocks of `Counter` tick next."""

    def __init__(self, fmu) -> None:
        self.fmu = fmu
        self.of = {"second": 0.0}
        self.ask(0.0)

    def ask(self, now: float) -> None:
        """Ask for intervals that are known."""
        for clock in ("twice", "late"):
            time, qualifier = interval(self.fmu, clock)
            if qualifier == CHANGED:
                self.of[clock] = now + time

    def due(self, now: float) -> list[str]:
        """Return the clocks that tick now, and take their ticks."""
        clocks = [clock for clock, time in self.of.items() if time == now]
        for clock in clocks:
            del self.of[clock]
        if "second" in clocks:
            self.of["second"] = now + 1.0
        return clocks


@pytest.mark.parametrize("of", ["CoSimulation", "ModelExchange"])
def test_clocks_tick_in_event_mode_at_the_instants_of_the_table(instance, of: str) -> None:
    fmu = instance("Counter", of)
    instants = Instants(fmu)
    fmu.exitInitializationMode()
    totals, fifths = [], set()
    for second in range(10):
        now = float(second)
        while clocks := instants.due(now):
            tick(fmu, *clocks)
            if "twice" in clocks:
                fmu.setInt32([fmu.names["added"]], [second])
            if is_active(fmu, "fifth"):
                fifths.add(second)
            # Whether there are other events, of which there are none.
            assert not any(fmu.updateDiscreteStates()[:4])
            assert not is_active(fmu, "fifth")
            instants.ask(now)
        totals += whole(fmu, "total")
        if of == "CoSimulation":
            fmu.enterStepMode()
            assert fmu.doStep(now, 1.0) == (False, False, False, now + 1.0)
        else:
            fmu.enterContinuousTimeMode()
            fmu.setTime(now + 1.0)
        fmu.enterEventMode()
    assert totals == TOTAL
    assert sorted(fifths) == FIFTHS
    expected = {"seconds": 10, "pairs": 4, "delays": 1, "sum": 0 + 1 + 8 + 9, "code": 1000}
    assert whole(fmu, *expected) == [*expected.values()]


def test_partitions_act_at_the_instants_of_the_table(instance) -> None:
    fmu = instance("Counter", "ScheduledExecution")
    instants = Instants(fmu)
    fmu.exitInitializationMode()
    now, totals, fifths = 0.0, [], []

    def on_update() -> None:
        fifths.extend([now] if is_active(fmu, "fifth") else [])
        assert not is_active(fmu, "fifth")  # each tick is reported once
        time, qualifier = interval(fmu, "late")
        if qualifier == CHANGED:
            instants.of["late"] = now + time

    fmu.on_update = on_update
    for second in range(10):
        now = float(second)
        while clocks := instants.due(now):
            for clock in sorted(clocks, key=["second", "twice", "late"].index):
                fmu.activateModelPartition(fmu.names[clock], now)
            instants.ask(now)
        totals += whole(fmu, "total")
    assert totals == TOTAL
    assert fifths == FIFTHS


def test_each_tick_is_told_although_the_host_did_not_ask_for_the_last_one(instance) -> None:
    fmu = instance("Counter", "ScheduledExecution")
    fmu.exitInitializationMode()
    told, asked = [], []

    def on_update() -> None:
        told.append(second)
        if second == 14:
            asked.append((is_active(fmu, "fifth"), interval(fmu, "late")))

    fmu.on_update = on_update
    for second in range(15):
        fmu.activateModelPartition(fmu.names["second"], second)
    # `fifth` ticks with every fifth tick of `second`, and the first of them starts `late`.
    assert told == [4, 9, 14]
    assert asked == [(True, (0.0, CHANGED))]


def test_intervals_are_set_by_the_host_or_follow_parameters(instance) -> None:
    fmu = instance("Sampler", "CoSimulation", ts=0.5)
    assert [interval(fmu, clock) for clock in ("fixed", "sample", "tuned", "set")] == [
        (0.25, UNCHANGED),
        (0.5, CHANGED),
        (0.2, CHANGED),
        (0.5, UNCHANGED),
    ]
    assert [shift(fmu, clock) for clock in ("fixed", "sample")] == [0.125, 0.0]
    fixed, half = (c_uint32 * 1)(fmu.names["fixed"]), (c_uint64 * 1)(500)
    fmu.setIntervalFraction(fixed, half, (c_uint64 * 1)(1000))
    assert interval(fmu, "fixed") == (0.5, UNCHANGED)
    fmu.exitInitializationMode()
    fmu.setFloat64([fmu.names["period"]], [0.75])
    assert [interval(fmu, "tuned") for _ in range(2)] == [(0.75, CHANGED), (0.75, UNCHANGED)]
    fmu.setIntervalDecimal((c_uint32 * 1)(fmu.names["set"]), (c_double * 1)(2.0))
    # All of them tick, and the host asks for the sum at the same instant.
    tick(fmu, "fixed", "sample", "tuned", "set", "request")
    for u in (1.0, 3.0):
        fmu.setFloat64([fmu.names["u"]], [u])
        assert (real(fmu, "sum"), real(fmu, "interval")) == (4 * u, 2.0)
    assert is_active(fmu, "answer")
    fmu.updateDiscreteStates()
    assert real(fmu, "at_tuned") == 3.0
