"""The usual measures of a control loop, in families: speed, overshoot, accuracy and so on."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...loop import FREQUENCY
from ..beyond.robustness import SWEPT, growths
from ..data import Data, Trace
from ..metrics import (
    energy,
    excess,
    final,
    half_periods,
    iae,
    ise,
    itae,
    lag,
    largest,
    overshoot,
    peak_time,
    rise_time,
    rms,
    settling,
    time_to,
    variation,
)
from ..scenarios import SIGNALS
from ..stability import LAWS, delay_margin, gain_margin, growth, modulus_margin, phase_margin
from .compare import Measure, measured

JUMP = 2.0
"""Height of the square wave's jumps [rad]."""

PULSE = (5.0, 5.5)
"""Interval of the disturbance [s]."""

BANDS = {"±5 %": 0.05, "±2 %": 0.02, "±0.3 %": 0.003}
"""Settling bands, relative to the jump: the two usual ones, and that of the paper's 3.8 s."""

DISTURBED = (("step", 1.0), ("sine", 1.0), ("sine", 2.0), ("square", 1.0), ("square", 2.0))
"""The disturbed loops: those of Table 1, and those of the captions of Figures 12 and 14."""


def heights(signal: str) -> float:
    """Return what the settling bands of a signal refer to [rad]."""
    return JUMP if signal == "square" else 1.0


def worst(measure: Callable[[Trace], float]) -> Callable[[Trace], float]:
    """Return the largest value after the square wave's jumps at 5, 10 and 15 s; NaN if one is."""
    return lambda trace: float(np.max([measure(part) for part in half_periods(trace)]))


def swing(trace: Trace) -> float:
    """Return by how much theta exceeds a sine's amplitude from 1 s on [%]; 0 if it does not."""
    late = trace.part(1.0, 21.0)
    return 100 * max(largest(late.theta) / largest(late.r) - 1, 0.0)


def after_pulse(trace: Trace) -> Trace:
    """Return what follows the beginning of the pulse, up to the next jump."""
    return trace.part(PULSE[0] + 0.002, 10.0)


def peak_after_pulse(trace: Trace) -> float:
    """Return the maximum deviation of theta from the reference from the pulse on [rad]."""
    after = after_pulse(trace)
    return largest(after.theta - after.r)


def beyond(trace: Trace) -> float:
    """Return the overshoot of theta beyond the set-point -1 between 5 s and 10 s [rad]."""
    return excess(after_pulse(trace))


def displaced(trace: Trace) -> float:
    """Return the integral of |theta - r| from the pulse to 10 s [rad s]."""
    after = after_pulse(trace)
    return float(np.sum(np.abs(after.theta - after.r)) * trace.ts)


def recovery(trace: Trace, height: float, band: float = BANDS["±0.3 %"]) -> float:
    """Return the settling time after the end of the pulse, up to the next jump [s]."""
    return settling(trace.part(PULSE[1], 10.0), height, band)


def late_rms(trace: Trace) -> float:
    """Return the root mean square of e from 19 s on [rad]."""
    return rms(trace.part(19.0, 21.0).e)


LATE = tuple(
    measured("max |e| from 19 s on", "rad", lambda t: largest(t.part(19.0, 21.0).e), signal)
    for signal in SIGNALS
)

AFTER_START = measured("max |e| from 1 s on", "rad", lambda t: largest(t.part(1.0, 21.0).e), "sine")
"""The largest error of a sine, without that of its start."""

SPEED = (
    measured("rise time 10 % to 90 %", "s", rise_time),
    measured("delay time to 50 %", "s", lambda t: time_to(t, 0.5)),
    measured("time to 90 %", "s", lambda t: time_to(t, 0.9)),
    measured("rise time 10 % to 90 %, slowest jump", "s", worst(rise_time), "square"),
    measured("lag or lead", "s", lambda t: abs(lag(t, FREQUENCY["sine"])), "sine"),
)


PEAK = measured("time of the largest overshoot", "s", peak_time)
"""Tells nothing of a loop that does not overshoot."""


def adjustment(signals: Sequence[str] = ("step", "square")) -> tuple[Measure, ...]:
    """Return the settling times from the start, or the slowest after the jumps of the wave."""
    found = []
    for signal in signals:
        for name, band in BANDS.items():
            if signal == "square":
                of = worst(lambda part, b=band: settling(part, JUMP, b))
                measure = measured(f"settling {name}, slowest jump", "s", of, signal)
            else:
                of = partial(settling, band=band)
                measure = measured(f"settling {name}", "s", of, signal)
            found.append(measure)
    return tuple(found)


ADJUSTMENT = adjustment()

OVERSHOOT = (
    measured("overshoot", "%", overshoot),
    measured(
        "largest overshoot of a jump", "%", worst(lambda part: overshoot(part, JUMP)), "square"
    ),
    measured("beyond the amplitude from 1 s on", "%", swing, "sine"),
)


def accuracy(signals: Sequence[str] = SIGNALS, amplitude: float = 0.0) -> tuple[Measure, ...]:
    """Return the integrals of the error, and the last one."""
    measures = (
        ("integral of |e|", "rad s", iae),
        ("integral of e²", "rad² s", ise),
        ("integral of t |e|", "rad s²", itae),
        ("|e(20 s)|", "rad", final),
    )
    return tuple(
        measured(name, unit, of, signal, amplitude)
        for signal in signals
        for name, unit, of in measures
    )


def returns(
    cases: Sequence[tuple[str, float]] = DISTURBED, bands: Sequence[str] = tuple(BANDS)
) -> tuple[Measure, ...]:
    """Return the times from the end of the pulse until the pendulum has settled again."""
    found = []
    for signal, amplitude in cases:
        for name in bands:
            height, band = heights(signal), BANDS[name]
            found.append(
                measured(
                    f"settling {name} after the pulse",
                    "s",
                    lambda t, height=height, band=band: recovery(t, height, band),
                    signal,
                    amplitude,
                )
            )
    return tuple(found)


def deviations(cases: Sequence[tuple[str, float]] = DISTURBED) -> tuple[Measure, ...]:
    """Return how far the disturbance drives the pendulum off."""
    found = []
    for signal, amplitude in cases:
        # The wave jumps with the disturbance, so that only what lies beyond the set-point counts
        peak = beyond if signal == "square" else peak_after_pulse
        found += [
            measured("largest deviation", "rad", peak, signal, amplitude),
            measured("∫|θ − r| dt, 5 s to 10 s", "rad s", displaced, signal, amplitude),
        ]
    return tuple(found)


INTERFERENCE = (*deviations(), *returns())

EFFORT = (
    *(
        measured("total variation of u", "N", lambda t: variation(t.u), signal)
        for signal in SIGNALS
    ),
    measured("∫u² dt", "N² s", lambda t: energy(t.u, t.ts)),
)


def _delay(_: Data, kind: str) -> float:
    law = LAWS[kind]
    return delay_margin(law) + law.previous_sample_terms


ROBUSTNESS = (
    Measure("delay borne from measurement to force [samples]", _delay, more=True),
    Measure("gain margin [1]", lambda _, kind: gain_margin(LAWS[kind]), more=True),
    Measure("phase margin [°]", lambda _, kind: phase_margin(LAWS[kind]), more=True),
    Measure("modulus margin, min |1 + L| [1]", lambda _, kind: modulus_margin(LAWS[kind]), True),
    *(
        Measure(
            f"largest growth of ∫|e| dt for {name} from a quarter to four times [%]",
            lambda data, kind, name=name: 100 * growths(name, data.fmus)[kind],
        )
        for name in SWEPT
    ),
)

GROWTH = Measure("rate of the fastest growing mode [1/s]", lambda _, kind: growth(LAWS[kind]))
