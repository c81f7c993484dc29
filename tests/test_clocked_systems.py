"""Systems of components with clocks: the master ticks them to the instant."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_master import FmuError, Instance, Result, System, python_component, simulate
from native import SOURCES, in_c

Make = Callable[..., Path]

CONSTANT = 'intervalVariability="constant" intervalDecimal="0.25"'
SAMPLE = f'<Clock name="sample" valueReference="1" causality="input" {CONSTANT}/>'


@pytest.fixture
def ticker(tmp_path: Path) -> Make:
    """Make the FMU, which returns an error if the host violates the standard."""

    def make(*definitions: str, sample: str = CONSTANT, **replacements: str) -> Path:
        xml = (SOURCES / "ticker.xml").read_text(encoding="utf-8")
        for old, new in {CONSTANT: sample, **replacements}.items():
            assert old in xml
            xml = xml.replace(old, new)
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        return in_c(folder / "Ticker.fmu", *definitions, xml=xml)

    return make


@pytest.fixture
def silent(ticker: Make) -> Path:
    """Make the FMU without its own sample."""
    return ticker("SILENT", **{SAMPLE: ""})


def run(connections: list[str], stop: float = 2.0, step: float = 1.0, **components: Any) -> Result:
    """Run a system; the keys of a component are its start values."""

    def component(given: Any) -> Any:
        fmu, start = given if isinstance(given, tuple) else (given, {})
        return {"fmu": fmu, "start": start} if isinstance(fmu, Path) else fmu

    described = {name: component(given) for name, given in components.items()}
    system = System(components=described, connections=connections, step=step, stop=stop)
    return system.simulate()


NEVER = {"received": False}
"""Start values: nothing ticks the triggered clock."""


# --- time-based clocks ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "sample",
    [
        CONSTANT,
        'intervalVariability="fixed" intervalDecimal="0.25"',
        'intervalVariability="tunable" intervalDecimal="0.25"',
        # The FMU has the interval.
        'intervalVariability="fixed"',
        'intervalVariability="tunable"',
    ],
)
def test_periodic_clocks_tick_at_their_interval(ticker, sample):
    result = run([], ticker=(ticker(sample=sample), NEVER))
    # The ticks at the time of a row are before the row.
    assert list(result["ticker.samples"]) == [1, 5, 9]
    assert list(result["ticker.sampled_at"]) == [0, 1, 2]


@pytest.mark.parametrize(
    "sample", [f'{CONSTANT} shiftDecimal="0.1"', 'intervalVariability="fixed"']
)
def test_a_shift_delays_the_first_tick(ticker, sample):
    result = run([], ticker=(ticker(sample=sample), {**NEVER, "shift": 0.1}))
    # 0.1 + 0.25 k
    assert list(result["ticker.samples"]) == [0, 4, 8]
    np.testing.assert_allclose(result["ticker.sampled_at"], [0, 0.85, 1.85], rtol=1e-15)


def test_ticks_do_not_drift(ticker):
    """The FMU refuses a tick that is 1 ns off."""
    tenth = 'intervalVariability="constant" intervalDecimal="0.1"'
    start = {**NEVER, "interval": 0.1}
    result = run([], stop=300.0, step=0.3, ticker=(ticker(sample=tenth), start))
    assert result["ticker.samples"][-1] == 3001
    # Rows and ticks at the same time are one instant: each communication step has three steps.
    assert result["ticker.steps"][-1] == 3000


def test_fractions_are_exact(ticker):
    third = (
        'intervalVariability="constant" intervalDecimal="0.3333333333333333"'
        ' supportsFraction="true" resolution="3" intervalCounter="1"'
    )
    start = {**NEVER, "interval": 1 / 3}
    result = run([], stop=1000.0, step=1000.0, ticker=(ticker(sample=third), start))
    assert result["ticker.samples"][-1] == 3001
    assert result["ticker.sampled_at"][-1] == 1000.0


def test_a_changing_clock_is_asked_at_each_tick(ticker):
    fmu = ticker("CHANGING", sample='intervalVariability="changing"')
    result = run([], stop=3.0, ticker=(fmu, {**NEVER, "interval": 0.1}))
    # 0.1 k (k + 1) / 2 = 0.1, 0.3, 0.6, 1.0, 1.5, 2.1, 2.8
    assert list(result["ticker.samples"]) == [0, 4, 5, 7]
    np.testing.assert_allclose(result["ticker.sampled_at"], [0, 1, 1.5, 2.8], atol=1e-12)


def test_a_tunable_clock_restarts_at_the_change_of_its_interval(ticker):
    fmu = ticker("TUNABLE", sample='intervalVariability="tunable"')
    table = {"time": [0.0, 1.1], "interval": [0.25, 0.5]}
    result = simulate(fmu, input=table, start_values=NEVER, step_size=0.1, stop_time=3.0)
    samples = dict(zip(np.round(result["time"], 9), result["samples"], strict=True))
    # 0, 0.25 ... 1, then 1.6, 2.1, 2.6
    assert [samples[time] for time in (1.0, 1.5, 1.6, 2.0, 2.1, 3.0)] == [5, 5, 6, 6, 7, 8]


def test_our_clocks_tick_as_their_table_says(clocks):
    """A periodic, a changing and a countdown clock, which ticks at once."""
    result = simulate(clocks / "Counter_fmi3.fmu", stop_time=9.0, step_size=1.0)
    assert list(result["total"]) == [2, 4, 5, 6, 8, 9, 10, 11, 13, 15]
    # Absent without a tick.
    assert list(result["delays"].mask) == [True] * 4 + [False] + [True] * 5
    assert result["delays"][4] == 1


# --- triggered clocks -----------------------------------------------------------------------------

TO_B = ["a.sent -> b.received", "a.value -> b.message"]


@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")])
def test_a_triggered_clock_ticks_in_the_same_instant(ticker, silent, names):
    """In any order of the components."""
    components = {"a": (ticker(), NEVER), "b": silent}
    result = run(TO_B, **{name: components[name] for name in names})
    for suffix in ("samples", "receipts"):
        assert list(result[f"{'a' if suffix == 'samples' else 'b'}.{suffix}"]) == [1, 5, 9]
    assert list(result["b.received_at"]) == [0, 1, 2]
    assert list(result["b.seen"]) == [1, 1, 1]
    # One update for each tick, and none else.
    assert list(result["b.updates"]) == [1, 5, 9]


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_countdown_clock_ticks_after_its_interval(ticker, silent, delay):
    result = run(TO_B, a=(ticker(), NEVER), b=(silent, {"delay": delay}))
    expected = [1, 5, 9] if delay == 0 else [0, 4, 8]
    assert list(result["b.alarms"]) == expected
    last = [0, 1, 2] if delay == 0 else [0, 0.85, 1.85]
    np.testing.assert_allclose(result["b.alarmed_at"], last, atol=1e-12)


@pytest.mark.parametrize("told", ["PENDING_IS_NAN", "PENDING_IS_UNKNOWN"])
def test_a_countdown_that_is_pending_needs_no_interval(ticker, told):
    """The sample is an event meanwhile, at which the interval of the alarm is asked for."""
    fmu = ticker(told, **{CONSTANT: 'intervalVariability="constant" intervalDecimal="0.125"'})
    start = {"interval": 0.125, "delay": 0.2}
    result = run(TO_B, a=(ticker(), NEVER), b=(fmu, start))
    # 0.2 + 0.25 k
    assert list(result["b.alarms"]) == [0, 4, 8]
    np.testing.assert_allclose(result["b.alarmed_at"], [0, 0.95, 1.95], atol=1e-12)


def test_a_loop_with_a_delay_passes_messages_on(ticker, silent):
    """The answer to a message arrives at its sender after the delay."""
    connections = [*TO_B, "b.sent -> a.received", "b.value -> a.message"]
    result = run(connections, a=ticker(), b=(silent, {"delay": 0.1}))
    assert list(result["a.receipts"]) == [0, 4, 8]
    # A message is the last one plus 1, on both ways: 1 -> b, 2 -> a, 3 -> b ...
    assert list(result["b.seen"]) == [1, 9, 17]
    assert list(result["a.seen"]) == [0, 8, 16]


def test_an_echo_ends(ticker, silent):
    """The answer of b arrives in the same instant, when a has acted already."""
    connections = [*TO_B, "b.sent -> a.received", "b.value -> a.message"]
    result = run(connections, a=ticker(), b=(silent, {"echo": True}))
    assert list(result["a.receipts"]) == [1, 5, 9]
    assert list(result["a.received_at"]) == [0, 1, 2]
    assert list(result["a.seen"]) == [2, 10, 18]


def test_one_clock_may_tick_several(ticker, silent):
    connections = [*TO_B, "a.sent -> c.received", "a.value -> c.message", "b.sent -> d.received"]
    components = dict.fromkeys("cd", silent)
    result = run(connections, b=(silent, {"echo": True}), a=(ticker(), NEVER), **components)
    for name in "bcd":
        assert list(result[f"{name}.receipts"]) == [1, 5, 9]


# --- events ---------------------------------------------------------------------------------------


def test_an_early_return_ticks_others_at_its_time(silent):
    result = run(TO_B, b=silent, a=(silent, {**NEVER, "period": 0.3}))
    # floor(t / 0.3)
    assert list(result["b.receipts"]) == [0, 3, 6]
    np.testing.assert_allclose(result["b.received_at"], [0, 0.9, 1.8], atol=1e-12)


def test_two_components_may_return_early(silent):
    connections = [*TO_B, "c.sent -> d.received", "c.value -> d.message"]
    starts = {"a": 0.3, "c": 0.4}
    parts = {name: (silent, {**NEVER, "period": period}) for name, period in starts.items()}
    result = run(connections, **parts, b=silent, d=silent)
    assert list(result["b.receipts"]) == [0, 3, 6]
    assert list(result["d.receipts"]) == [0, 2, 5]
    # Each of them returns to its state, if it has stepped too far.
    np.testing.assert_allclose(result["b.received_at"], [0, 0.9, 1.8], atol=1e-12)
    np.testing.assert_allclose(result["d.received_at"], [0, 0.8, 2.0], atol=1e-12)


def test_discrete_inputs_without_clocks_follow_at_the_instant(ticker, silent):
    """The FMU refuses to set them in step mode."""
    result = run(["a.samples -> b.level"], b=(silent, NEVER), a=(ticker(), NEVER))
    assert list(result["b.followed"]) == [1, 5, 9]


def test_outputs_of_other_components_are_held_over_a_step(ticker):
    """Also if their component has stepped before."""
    ramp = python_component([], ["y"], lambda t: t)
    result = run(["ramp.y -> a.u"], stop=3.0, ramp=ramp, a=(ticker(), NEVER))
    # The integral of floor(t)
    np.testing.assert_allclose(result["a.sum"], [0, 0, 1, 3], atol=1e-12)


def test_a_clocked_output_feeds_a_component_without_clocks(ticker, silent):
    twice = python_component(["u"], ["y"], lambda t, u: 2 * u)
    connections = [*TO_B, "b.value -> twice.u"]
    result = run(connections, a=(ticker(), NEVER), b=(silent, {"echo": True}), twice=twice)
    assert result["twice.y"][-1] == 4.0


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_the_order_of_stepping_does_not_matter_among_clocks(ticker, silent, order):
    system = System(
        components={"b": silent, "a": {"fmu": ticker(), "start": NEVER}},
        connections=TO_B,
        step=1.0,
        stop=2.0,
        order=order,
    )
    assert list(system.simulate()["b.receipts"]) == [1, 5, 9]


def test_ticks_are_recorded_as_booleans(ticker, silent):
    """Whether a clock has ticked since the last row."""
    system = System(
        components={
            "a": {"fmu": ticker(), "start": NEVER},
            "b": {"fmu": silent, "start": {"delay": 0.6}},
        },
        connections=TO_B,
        outputs=["a.sample", "a.sent", "b.received", "b.alarm"],
        step=0.2,
        stop=1.0,
    )
    result = system.simulate()
    # Ticks at 0, 0.25, 0.5, 0.75 and 1.
    for name in ("a.sample", "a.sent", "b.received"):
        assert list(result[name]) == [True, False, True, True, True, True]
    # At 0.6, but each message begins the delay anew.
    assert not result["b.alarm"].any()


# --- what is refused ------------------------------------------------------------------------------


def refusal(*connections: str, **components: Any) -> str:
    with pytest.raises(FmuError) as error:
        run(list(connections), **components)
    return str(error.value)


def test_clocks_that_nobody_ticks_are_named(ticker, silent):
    message = refusal(a=ticker())
    assert message.startswith("nothing ticks a.received: it is a triggered clock")
    # Alone, the FMU runs.
    result = simulate(ticker(), stop_time=1.0, step_size=1.0)
    assert result["samples"][-1] == 5
    assert [note.split(":")[0] for note in result.notes] == ["nothing ticks received"]
    assert "a.received = true cannot be set" in refusal(a=(ticker(), {"received": True}))


def test_a_clock_has_one_source(ticker, silent):
    parts = {name: (ticker(), NEVER) for name in "ac"}
    assert (
        refusal(*TO_B, "c.sent -> b.received", **parts, b=silent) == "b.received is connected twice"
    )


def test_a_time_based_clock_cannot_be_connected(ticker):
    message = refusal("a.sent -> b.sample", a=(ticker(), NEVER), b=(ticker(), NEVER))
    assert message.startswith(
        "b.sample cannot be connected: it is a constant clock, which ticks at"
    )
    message = refusal("a.sent -> b.alarm", a=(ticker(), NEVER), b=(ticker(), NEVER))
    assert "b.alarm cannot be connected: it is a countdown clock" in message
    message = refusal("a.sent -> b.u", a=(ticker(), NEVER), b=(ticker(), NEVER))
    assert message == "a.sent (Clock) cannot feed b.u (Float64): the types differ"


RING = [*TO_B, "b.sent -> a.received", "b.value -> a.message"]


def test_a_cycle_of_clocks_that_tick_each_other_ends_the_run(ticker, silent):
    message = refusal(*RING, a=(ticker(), {"echo": True}), b=(silent, {"echo": True}))
    assert re.search(
        r"the event at t = 0\.0 s needs more than 1000 updates of these clocks, which tick again "
        r"and again: (a\.received|b\.received)",
        message,
    )


def test_a_cycle_of_clocks_that_wait_for_each_other_is_refused(ticker):
    sent = '<Output valueReference="4"'
    fmu = ticker("SILENT", **{SAMPLE: "", sent: f'{sent} dependencies="2"'})
    message = refusal(*RING, a=fmu, b=fmu)
    assert message == (
        "cycle of triggered clocks, each of which ticks only if another one does: "
        "b.sent -> a.received, a.sent -> b.received"
    )


@pytest.mark.parametrize(
    ("sample", "message"),
    [
        ('intervalVariability="constant" intervalDecimal="0"', "with the interval 0.0 s"),
        ('intervalVariability="constant" intervalDecimal="-1"', "with the interval -1.0 s"),
        ('intervalVariability="constant" intervalDecimal="NaN"', "without intervalDecimal"),
        ('intervalVariability="constant"', "without intervalDecimal"),
        (f'{CONSTANT} shiftDecimal="-1"', "with the shift -1.0 s"),
    ],
)
def test_invalid_intervals_in_a_description_are_refused(ticker, sample, message):
    told = refusal(a=(ticker(sample=sample), NEVER))
    assert told.startswith("a.sample is a ")
    assert message in told


@pytest.mark.parametrize("kind", ["fixed", "tunable", "changing"])
@pytest.mark.parametrize(
    ("definitions", "start", "message"),
    [
        (("NOT_A_NUMBER",), {}, "the interval NaN s is returned, expected"),
        (("NEVER_KNOWN",), {}, "fmi3IntervalNotYetKnown"),
        ((), {"interval": -1.0}, "the interval -1.0 s is returned, expected"),
    ],
)
def test_invalid_intervals_that_an_fmu_returns_end_the_run(
    ticker, kind, definitions, start, message
):
    fmu = ticker(*definitions, sample=f'intervalVariability="{kind}"')
    told = refusal(a=(fmu, {**NEVER, **start}))
    assert message in told
    assert "a.sample" in told


def test_a_run_that_clocks_do_not_support_is_refused(ticker, tmp_path):
    fmu = {"fmu": ticker(), "start": NEVER}

    def told(component: dict[str, Any] | None = None, **keys: Any) -> str:
        described = {"a": {**fmu, **(component or {})}}
        with pytest.raises(FmuError) as error:
            System(components=described, step=1.0, stop=2.0, **keys).simulate()
        return str(error.value)

    assert told(order="implicit") == 'a has clocks, which order = "implicit" does not support'
    assert told(step_tolerance=1e-3) == "a has clocks, which step_tolerance does not support"
    assert "a has clocks and a step of its own" in told({"step": 0.5})
    assert "the clock sample of Ticker.fmu ticks in event mode" in told({"event_mode": False})
    with pytest.raises(FmuError, match=r"the clock sample of Ticker\.fmu ticks in event mode"):
        Instance(fmu["fmu"])
    without = ticker(**{'hasEventMode="true"': ""})
    with pytest.raises(
        FmuError, match="its clock sample ticks in event mode, which it does not have"
    ):
        simulate(without, stop_time=1.0)
