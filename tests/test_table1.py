"""Closed loops of the FMUs against the independent implementation.

`test_controllers.py` and `test_plant.py` compare all settings of one FMU.
"""

import math

import numpy as np
import pytest

import reference
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import simulate
from pendulum_fmus.table1 import agrees

TIMES = {"start": 4.8, "step": TS, "steps": 1000, "order": "sequential"}
"""The disturbance and the jump of the square wave are at 5 s."""

PARALLEL = {"order": "parallel", "previous_sample_terms": False}

WEIGHTS = (1.0, -2.0, 3.0, -0.5)

SUPERVISED = {"target": "supervisor"}


@pytest.mark.parametrize(
    ("controller", "signal", "options"),
    [
        ("Pid", "step", {}),
        ("PidRbf", "square", PARALLEL),
        ("IpidRbf", "step", {"plant_model": "nonlinear", "steps": 500}),
        ("IpidRbf", "sine", PARALLEL | {"w0": WEIGHTS}),
        ("IpidRbf", "sine", SUPERVISED | {"w0": WEIGHTS, "supervisor_w0": (-0.1, 0.2, 0.3, 0.4)}),
        # At 10 ms the loops are unstable, as the derivative acts on one sample in ten
        ("IpidRbf", "square", SUPERVISED | PARALLEL | {"step": 0.01, "steps": 200}),
        ("IpidRbf", "square", SUPERVISED | {"previous_sample_terms": False, "step": 1 / 1024}),
    ],
)
def test_loop_agrees_sample_by_sample(fmus, controller, signal, options):
    times = {name: options.get(name, value) for name, value in TIMES.items()}
    options = {name: value for name, value in options.items() if name not in TIMES}
    expected = reference.closed_loop(controller, signal, 1.0, **options, **times)
    with Loop(controller, signal, 1.0, **options).system(fmus) as system:
        record = [name for name in expected if name != "time"]
        computed = simulate(system, record=record, **times)
    for name, column in expected.items():
        # In an unstable loop, deviations grow as fast as the signals.
        scale = np.maximum(1.0, np.maximum.accumulate(np.abs(column)))
        worst = int(np.argmax(np.abs(computed[name] - column) / scale))
        assert abs(computed[name][worst] - column[worst]) <= 1e-10 * scale[worst], (name, worst)


@pytest.mark.parametrize(
    ("value", "printed", "agreed"),
    [
        (-1.963846e-3, "-0.0020", True),
        (-1.949e-3, "-0.0020", False),
        (8.2377058e-4, "8.2377e-4", True),
        (8.25470e-4, "8.2377e-4", False),
        (3.839, "3.8", True),
        (math.nan, "3.8", False),
        (math.inf, "3.8", False),
    ],
)
def test_rounding_to_the_printed_digits(value, printed, agreed):
    assert agrees(value, printed) == agreed
