"""Event mode in co-simulation of FMI 3.0: the master handles the events where they happen."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fmu_master import FmuError, Result, System, python_component, simulate
from native import SOURCES, in_c
from native import run as command

Make = Callable[..., Path]


@pytest.fixture
def beats(tmp_path: Path) -> Make:
    def make(*definitions: str, **replacements: str) -> Path:
        xml = (SOURCES / "beats.xml").read_text(encoding="utf-8")
        for old, new in replacements.items():
            xml = xml.replace(old, new)
        return in_c(tmp_path / "Beats.fmu", *definitions, xml=xml)

    return make


def run(fmu: Path, period: float, step: float = 1.0, **keys: object) -> Result:
    start = {"period": period}
    return simulate(fmu, stop_time=4.0, step_size=step, start_values=start, event_mode=True, **keys)


@pytest.mark.parametrize("definitions", [(), ("ANNOUNCES",)])
def test_events_are_handled_where_they_happen(beats, definitions):
    """By steps that end early, or because the FMU announces them."""
    result = run(beats(*definitions), 0.3)
    # floor(t / 0.3) at whole seconds.
    assert list(result["beats"]) == [0, 3, 6, 10, 13]
    # One update for each, and the first one.
    assert list(result["updates"] - result["beats"]) == [1] * 5


def test_a_step_may_have_any_number_of_events(beats):
    result = run(beats(), 1e-5, step=2.0)
    assert list(result["beats"]) == [0, 200000, 400000]


def test_discrete_inputs_are_set_in_event_mode(beats):
    """Also those of a component with steps of its own, and from other components."""
    table = {"time": [0.0, 1.0, 1.0, 2.5, 2.5], "level": [2.0, 2.0, -1.0, -1.0, 3.0]}
    result = run(beats(), 0.3, step=0.5, input=table)
    exact = [0, 1, 2, 1.5, 1, 0.5, 2, 3.5, 5]
    np.testing.assert_allclose(result["x"], exact, atol=1e-12)
    beating = {"fmu": beats(), "event_mode": True, "step": 0.125, "start": {"period": 0.3}}
    source = python_component([], ["y"], lambda t: -1.0 if t >= 1 else 2.0)
    system = System(
        components={"source": source, "beating": beating},
        connections=[("source.y", "beating.level")],
        step=0.5,
        stop=4.0,
    )
    result = system.simulate()
    np.testing.assert_allclose(result["beating.x"][:5], [0, 1, 2, 1.5, 1], atol=1e-12)
    assert list(result["beating.beats"]) == [0, 1, 3, 4, 6, 8, 9, 11, 13]


def test_tunable_parameters_are_set_in_event_mode(beats):
    table = {"time": [0.0, 2.0], "period": [0.5, 0.25], "level": [0.0, 0.0]}
    result = simulate(beats(), stop_time=2.0, step_size=1.0, input=table, event_mode=True)
    assert list(result["beats"]) == [0, 2, 4]


@pytest.mark.parametrize(
    ("definitions", "message"),
    [
        (("NEVER_STABLE",), r"the event at t = 0\.0 s needs more than 1000 updates"),
        (("STALLS",), r"returned 1000 times at t = 0\.0 s, without progress"),
    ],
)
def test_a_run_without_progress_ends(beats, definitions, message):
    with pytest.raises(FmuError, match=message):
        run(beats(*definitions), 0.3)


def test_an_event_can_end_the_simulation(beats):
    table = {"time": [0.0, 2.0, 2.0], "level": [1.0, 1.0, 99.0]}
    result = run(beats(), 0.3, input=table)
    assert result.ended == "Beats (Beats.fmu) ended the simulation at t = 2.0 s"
    assert result["time"][-1] == 2.0


def test_event_mode_is_used_on_demand_or_with_clocks(beats, tmp_path):
    """The FMU refuses to be instantiated without event mode."""
    with pytest.raises(FmuError, match="cannot be instantiated"):
        simulate(beats(), stop_time=1.0)
    clock = (
        '<Clock name="tick" valueReference="9" causality="output" intervalVariability="triggered"/>'
    )
    with_clock = beats(**{"<ModelVariables>": f"<ModelVariables>{clock}"})
    assert simulate(with_clock, stop_time=1.0, step_size=0.5)["beats"][-1] == 4
    without = beats(**{'hasEventMode="true"': ""})
    with pytest.raises(FmuError, match=r"event_mode = true, but Beats\.fmu has no event mode"):
        simulate(without, stop_time=1.0, event_mode=True)
    beats()
    told = command("simulate", "Beats.fmu", "--event-mode=true", "--stop=1", cwd=tmp_path)
    assert (told.returncode, told.stderr) == (0, "")


def test_the_impacts_of_our_bouncing_ball_are_the_same_in_event_mode(equations):
    """Times of impacts in closed form: with g and e, the ball rises to e^2 of its height."""
    file = equations / "BouncingBall_fmi3.fmu"
    heights = [
        simulate(file, stop_time=2.0, step_size=0.01, event_mode=used)["h"]
        for used in (False, True)
    ]
    np.testing.assert_allclose(*heights, atol=1e-9)
