"""Adaptive communication steps: errors against closed forms, and what cannot take them.

The FMU in C is `body.c` of FMI 2.0: a body between springs.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from fmu_master import FmuError, System
from native import SOURCES, in_c, refusal, replaced, run, write_system

XML = (SOURCES / "body.xml").read_text(encoding="utf-8")
STARTS = {"a": {"m": 1.0, "k": 10.0, "x": 1.0}, "b": {"m": 2.0, "k": 5.0, "c": 8.0}}
CONNECTIONS = ["b.force -> a.f", "a.x -> b.p"]


@pytest.fixture(scope="module")
def body(tmp_path_factory) -> Path:
    return in_c(tmp_path_factory.mktemp("adaptive") / "Body.fmu")


def coupled(fmu: Path, starts: dict[str, dict[str, float]] = STARTS, **keys: Any) -> System:
    """Return two bodies with a spring between them, with rows every 0.25 s."""
    components = {name: {"fmu": fmu, "start": start} for name, start in starts.items()}
    defaults = {"stop": 2.0, "step": 0.25, "connections": CONNECTIONS, "components": components}
    return System(**{**defaults, **keys})


def exact(times: np.ndarray, d: float = 0.0) -> np.ndarray:
    """Return x of both bodies: the closed form of the linear equations of both together."""
    (a, b), c = STARTS.values(), STARTS["b"]["c"]
    equations = np.zeros((4, 4))
    equations[0, 1] = equations[2, 3] = 1.0
    equations[1] = [-(a["k"] + c) / a["m"], -d / a["m"], c / a["m"], 0.0]
    equations[3] = [c / b["m"], 0.0, -(b["k"] + c) / b["m"], -d / b["m"]]
    states = [expm(time * equations) @ [1.0, 0.0, 0.0, 0.0] for time in times]
    return np.array(states)[:, [0, 2]]


def error(result: Any, d: float = 0.0) -> float:
    found = np.stack([result["a.x"], result["b.x"]], axis=1)
    return float(abs(found - exact(result["time"], d)).max())


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("order", ["sequential", "parallel", "implicit"])
def test_the_error_follows_the_tolerance_in_the_same_rows(body, order, interface):
    run = {"order": order, "interface": interface}
    system = coupled(body)
    results = [system.simulate(step_tolerance=tolerance, **run) for tolerance in (1e-3, 1e-5)]
    errors = [error(result) for result in results]
    for result in results:
        np.testing.assert_array_equal(result["time"], np.arange(9) * 0.25)
    # The error of a step goes with its square, that of the run with the step: tenfold.
    assert 4.0 < errors[0] / errors[1] < 25.0, errors
    assert errors[1] < 0.02 < error(system.simulate(**run))
    coarse, fine = (result.adaptive_steps for result in results)
    assert 5.0 < fine.accepted / coarse.accepted < 20.0
    assert (fine.missed, coarse.missed) == (0, 0)


def test_steps_are_short_in_a_transient_and_long_after_it(body):
    """A strongly damped swing dies out within a second of ten."""
    starts = {name: {**start, "d": 8.0} for name, start in STARTS.items()}
    short, long = (
        coupled(body, starts, stop=stop, step=1.0).simulate(step_tolerance=1e-4).adaptive_steps
        for stop in (3.0, 30.0)
    )
    assert long.accepted < 2.5 * short.accepted
    size, time = long.smallest
    assert size < 0.02
    assert time < 1.0
    equal = coupled(body, starts, stop=3.0, step=3.0 / short.accepted)
    adaptive = coupled(body, starts, stop=3.0, step=1.0).simulate(step_tolerance=1e-4)
    assert error(adaptive, 8.0) < 0.02
    assert error(equal.simulate(), 8.0) < 0.2


def test_a_sampled_component_and_faults_act_once_in_each_communication_step(body):
    starts = {**STARTS, "clock": {}}
    components = {name: {"fmu": body, "start": start} for name, start in starts.items()}
    components["clock"] |= {"sampled": True}
    faulty = [{"from": "b.force", "to": "a.f", "faults": [{"delay": 0.25}]}, CONNECTIONS[1]]
    system = coupled(body, connections=faulty, components=components)
    result = system.simulate(step_tolerance=1e-5)
    np.testing.assert_array_equal(result["clock.steps"], np.arange(1, 10))
    assert result["b.steps"][-1] > 100
    # a receives the force of the step before, held over the step: exact for a constant.
    f, (x, v) = result["b.force"], (1.0, 0.0)
    w = np.sqrt(10.0)
    for row in range(8):
        held = f[max(row - 1, 0)] / 10.0
        c, s = np.cos(0.25 * w), np.sin(0.25 * w)
        x, v = held + (x - held) * c + v / w * s, -(x - held) * w * s + v * c
        assert result["a.x"][row + 1] == pytest.approx(x, abs=1e-8)


def test_an_algebraic_loop_is_solved_in_each_adaptive_step(body):
    """The force is c x / (1 + 2 c), as the other body returns p = 2 force."""
    starts = {"a": {"gain": 2.0}, "b": {"c": 5.0, "k": 4.0, "x": 1.0}}
    links = ["b.force -> a.u", "a.y -> b.p"]
    system = coupled(body, starts, connections=links, algebraic_loops="iterate")
    result = system.simulate(step_tolerance=1e-5)
    np.testing.assert_allclose(result["b.force"], 5.0 / 11.0 * result["b.x"], atol=3e-6)
    frequency = np.sqrt(4.0 + 5.0 / 11.0)
    np.testing.assert_allclose(result["b.x"], np.cos(frequency * result["time"]), atol=5e-3)
    assert result.adaptive_steps.accepted > 50


def test_the_smallest_step_bounds_the_work_and_is_told(body):
    result = coupled(body).simulate(step_tolerance=1e-9, min_step=0.0625)
    assert (result.adaptive_steps.accepted, result.adaptive_steps.missed) == (32, 32)
    assert result.adaptive_steps.smallest[0] == 0.0625


def test_what_cannot_take_adaptive_steps_is_named(body, tmp_path):
    fmu = in_c(tmp_path / "Body.fmu", xml=replaced(XML, {'canGetAndSetFMUstate="true"': ""}))
    with pytest.raises(FmuError, match=r"a cannot take adaptive steps: .*canGetAndSetFMUstate"):
        coupled(fmu).simulate(step_tolerance=1e-3)
    components = {name: {"fmu": body, "start": start} for name, start in STARTS.items()}
    components["b"]["step"] = 0.125
    with pytest.raises(FmuError, match=r"b has a step of its own, 0\.125 s, expected none"):
        coupled(body, components=components).simulate(step_tolerance=1e-3)
    for wrong, expected in (
        ({"step_tolerance": 0.0}, "step_tolerance = 0 is invalid"),
        ({"step_tolerance": 1e-3, "min_step": 1.0}, r"min_step = 1\.0, expected a positive number"),
    ):
        with pytest.raises(FmuError, match=expected):
            coupled(body).simulate(**wrong)


def test_the_command_line_tells_the_steps(body, tmp_path):
    file = write_system(tmp_path, STARTS, CONNECTIONS, fmu=str(body.with_suffix("")))
    said = run("simulate", file, "--step-tolerance", "1e-3").stdout
    assert "adaptive steps: " in said
    assert " accepted, " in said
    assert "min_step = 9.0" in refusal(tmp_path, "simulate", file, "--min-step=9")
