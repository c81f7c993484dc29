"""The Source FMU alone: its parameters and jumps. test_table1.py compares its signals in loops."""

import fmpy
import numpy as np
import pytest

import reference
from pendulum_fmus.master import Component


def signals(source: Component) -> tuple[float, float]:
    """Return (r, d) [rad]."""
    return source.get("r"), source.get("d")


def test_amplitude_frequency_and_pulse_are_parameters(instance):
    start = {"signal": "square", "amplitude": 3.0, "frequency": 2.0}
    pulse = {"amplitude": -0.5, "start": 0.1, "duration": 0.2}
    start |= {f"disturbance.{name}": value for name, value in pulse.items()}
    source, seen = instance("Source", start, time=0.05), []
    for k in range(6):
        seen.append(signals(source))
        source.step(0.05 + k * 0.1, 0.1)
    # at 0.05, 0.15, 0.25 (the jump, where the old value holds), 0.35, 0.45, 0.55 s
    assert seen == [(3, 0), (3, -0.5), (3, -0.5), (-3, 0), (-3, 0), (3, 0)]


@pytest.mark.parametrize("ending", ["", "_fmi3"])
@pytest.mark.parametrize("signal", ["step", "sine", "square"])
def test_in_model_exchange_the_jumps_are_events(fmus, ending, signal):
    item = 1 + ["step", "sine", "square"].index(signal)
    start = {"signal": item, "frequency": 0.3, "disturbance.amplitude": 1.0}
    start |= {"disturbance.start": 1.25, "disturbance.duration": 0.55}
    result = fmpy.simulate_fmu(
        fmus / f"Source{ending}.fmu", fmi_type="ModelExchange", start_values=start, stop_time=4,
        output_interval=0.1,
    )  # fmt: skip
    jumps = [1.25, 1.8] + [k / 0.6 for k in range(3)] * (signal == "square")
    times = result["time"]
    for jump in jumps:
        assert min(abs(times - jump)) < 1e-9, "an event"
    between = [i for i, t in enumerate(times) if min(abs(t - np.array(jumps))) > 1e-9]
    for i in between:
        t = times[i]
        assert result["r"][i] == pytest.approx(reference.reference(signal, t, 0.3), abs=1e-9)
        assert result["d"][i] == (1.25 <= t < 1.8)
    # after the jump at the event itself
    last = {jump: np.flatnonzero(abs(times - jump) < 1e-9)[-1] for jump in jumps}
    assert [result["d"][last[jump]] for jump in (1.25, 1.8)] == [1, 0]
