"""Scheduled execution in the master: partitions are activated by their clocks and priorities."""

from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_master import FmuError, System, simulate
from native import SOURCES, in_c, printed, refusal, run

Make = Callable[..., Path]

CALLS = {
    "time": [0, 1, 3, 8, 9],
    "call": [True, True, False, True, True],
    "addend": [1, 2, 4, 8, 16],
}
"""The table of the Reference FMU Clocks, whose second clock the host ticks at 0, 1, 8 and 9 s."""


@pytest.fixture
def partitions(tmp_path: Path) -> Make:
    def make(*definitions: str, **replacements: str) -> Path:
        xml = (SOURCES / "partitions.xml").read_text(encoding="utf-8")
        for old, new in replacements.items():
            assert old in xml
            xml = xml.replace(old, new)
        return in_c(tmp_path / "Partitions.fmu", *definitions, xml=xml)

    return make


def order(log: float) -> str:
    """Return the partitions that were activated, by their numbers."""
    return f"{log:.0f}"


def test_partitions_are_activated_when_their_clocks_tick(partitions):
    """A constant clock, one that the table ticks, and a countdown clock."""
    result = simulate(partitions(), input=CALLS)
    assert list(result["time"]) == list(range(10))
    assert list(result["calls"]) == [1, 2, 2, 2, 2, 2, 2, 2, 3, 4]
    assert list(result["delays"]) == [0] * 4 + [1] * 6
    assert list(result["total"]) == [2, 4, 5, 6, 8, 9, 10, 11, 13, 15]
    assert order(result["log"][-1]) == "121211131111212"


def test_an_output_clock_ticks_with_every_fifth_tick(partitions):
    result = simulate(partitions(), input=CALLS, output=["fifth"])
    ticks = [time for time, fifth in zip(result["time"], result["fifth"], strict=True) if fifth]
    assert ticks == [2, 6, 9]


def test_inputs_are_set_before_and_outputs_got_after_an_activation(partitions):
    """The column `addend` holds its value, as it is discrete."""
    result = simulate(partitions(), input=CALLS, output=["sum", "calls"])
    assert result["sum"][result["calls"] == 4][0] == 1 + 2 + 8 + 16


def test_countdown_clocks_tick_between_communication_points(partitions):
    """Also where the step of the system is longer than the delay."""
    result = simulate(partitions(), start_values={"delay": 0.25}, step_size=0.25, stop_time=5)
    assert result["time"][result["delays"] == 1][0] == 4.25
    result = simulate(partitions(), start_values={"delay": 1.5}, step_size=3, stop_time=6)
    assert order(result["log"][-1]) == "11111131"


def test_the_table_ticks_clocks_between_communication_points(partitions):
    table = {"time": [0.5, 0.75, 2.25], "call": [True, True, True]}
    result = simulate(partitions(), input=table, step_size=3, stop_time=3)
    assert order(result["log"][-1]) == "1221121"


def test_priorities_come_before_the_order_of_components(partitions):
    """Two FMUs trigger each other at their fifth ticks, which are at 4 s."""
    other = partitions()
    other = other.rename(other.with_name("Other.fmu"))
    components = {"a": {"fmu": partitions()}, "b": {"fmu": other}}
    connections = [("a.fifth", "b.call"), ("b.fifth", "a.call")]
    system = System(
        components=components, connections=connections, step=1, stop=4, outputs=["a.log", "b.log"]
    )
    assert [order(system.simulate()[f"{name}.log"][-1]) for name in "ab"] == ["1111123"] * 2
    # With a lower priority of a.second, the partitions of b come first that a does not tick.
    xml = {'priority="0"': 'priority="7"', 'priority="1"': 'priority="6"'}
    late = partitions(**xml)
    late = late.rename(late.with_name("Late.fmu"))
    components = {"a": {"fmu": late}, "b": {"fmu": other}}
    system = System(
        components=components, connections=connections, step=1, stop=4, outputs=["a.log", "b.log"]
    )
    result = system.simulate()
    assert order(result["a.log"][-1]) == "1111213"
    assert order(result["b.log"][-1]) == "1111132"


@pytest.mark.parametrize(
    ("definitions", "message"),
    [
        (("KEEPS_LOCK",), "fmi3ActivateModelPartition returned without unlocking preemption"),
        (("STRANGE_QUALIFIER",), "returned an interval qualifier that does not exist"),
    ],
)
def test_a_violation_ends_the_run(partitions, definitions, message):
    with pytest.raises(FmuError, match=message):
        simulate(partitions(*definitions))


def test_an_interval_must_not_be_negative(partitions):
    with pytest.raises(FmuError, match=r"interval -0\.5 s.*the clock delayed"):
        simulate(partitions(), start_values={"delay": -0.5})


def test_a_partition_is_activated_once_at_an_instant(partitions):
    components = {"a": {"fmu": partitions("EVERY=1")}}
    system = System(components=components, connections=[("a.fifth", "a.call")], step=1, stop=4)
    with pytest.raises(FmuError, match=r"the clock a\.call ticks once more at t = 0\.0 s"):
        system.simulate()


def test_a_clock_that_nothing_ticks_is_an_error(partitions):
    system = System(components={"a": {"fmu": partitions()}}, step=1, stop=4)
    with pytest.raises(FmuError, match=r"nothing ticks a\.call"):
        system.simulate()


def test_the_interface_is_chosen_by_its_key(partitions, tmp_path):
    interface = "--interface=scheduled-execution"
    partitions()
    assert printed("simulate", "Partitions.fmu", interface, cwd=tmp_path)
    in_c(tmp_path / "Beats.fmu")
    told = refusal(tmp_path, "simulate", "Beats.fmu", interface)
    assert "it does not support scheduled execution, only co-simulation" in told


def test_a_binary_without_the_functions_is_refused(tmp_path):
    xml = (SOURCES / "partitions.xml").read_text(encoding="utf-8")
    in_c(tmp_path / "Beats.fmu", xml=xml.replace('"Partitions"', '"Beats"'))
    told = refusal(tmp_path, "simulate", "Beats.fmu")
    assert "fmi3InstantiateScheduledExecution is missing from the binary" in told


def test_rows_that_arrive_cannot_tick_clocks(partitions, tmp_path):
    partitions()
    live = ("simulate", "Partitions.fmu", "--real-time", "--input=-")
    told = run(*live, cwd=tmp_path, input="time,call\n0,true\n")
    assert told.returncode == 1
    assert "call is a clock, which can only tick at times that are known" in told.stderr


def test_the_table_ticks_triggered_clocks_only(partitions):
    with pytest.raises(
        FmuError, match="delayed is a countdown clock, which ticks at its intervals"
    ):
        simulate(partitions(), input={"time": [0], "delayed": [True]})
