"""The Source FMU alone: its parameters and jumps. test_table1.py compares its signals in loops."""

import fmpy
import numpy as np
import pytest

import reference


@pytest.mark.parametrize("ending", ["", "_fmi3"])
@pytest.mark.parametrize("signal", ["step", "sine", "square"])
def test_in_model_exchange_the_jumps_are_events(fmus, ending, signal):
    item = 1 + ["step", "sine", "square"].index(signal)
    start = {"signal": item, "amplitude": 3.0, "frequency": 0.3, "disturbance.amplitude": -0.5}
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
        assert result["r"][i] == pytest.approx(3 * reference.reference(signal, t, 0.3), abs=1e-9)
        assert result["d"][i] == -0.5 * (1.25 <= t < 1.8)
    # after the jump at the event itself
    last = {jump: np.flatnonzero(abs(times - jump) < 1e-9)[-1] for jump in jumps}
    assert [result["d"][last[jump]] for jump in (1.25, 1.8)] == [-0.5, 0]
