"""The measures by which statements are judged, by the keys that `statements.toml` uses.

Columns have shape (steps,); angles are in rad, forces in N.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from ..loop import FREQUENCY, SETTLING_BAND, settling_time
from . import stability
from .runs import END, KINDS, Data, Trace, alone, both_plants, sweep
from .stability import LAWS, NOMINAL, Law

SIGNAL_NAMES = {"step": "step", "sine": "sine", "square": "square wave"}

PULSE = (5.0, 5.5)
"""Interval of the disturbance [s]."""

LOST = 0.5
"""A pendulum with a larger error no longer stands [rad]."""

LIMIT = 100.0
"""Limit of the force [N]."""

RESIDUE = 1e-9
"""An error below this is rounding residue [rad]."""

BURST = 50.0
"""A force beyond this, half of the limit, is a large adjustment [N]."""

HOLD = 0.1
"""Minimum time for which an error must stay within its band to count as settled [s]."""

BURST_GAP = 0.25
"""Large adjustments closer together than this count as one [s]."""

SCALES = np.geomspace(0.25, 4, 33)
"""Factors of a parameter of the plant; 1 is in the middle."""


# --- functions ----------------------------------------------------------------------------------


def integral(column: np.ndarray, ts: float) -> float:
    """Return the integral over time of a column sampled every `ts` [s], by the rectangle rule."""
    return float(np.sum(column) * ts)


def iae(trace: Trace) -> float:
    """Return the integral of |e| [rad s]."""
    return integral(np.abs(trace.e), trace.ts)


def finite(value: float) -> float:
    """Return a number to compare: NaN (never) counts as the largest."""
    return math.inf if math.isnan(value) else value


def rms(column: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(column**2)))


def largest(column: np.ndarray) -> float:
    """Return the maximum absolute value."""
    return float(np.max(np.abs(column)))


def change(column: np.ndarray) -> float:
    """Return the largest change from one sample to the next."""
    return largest(np.diff(column))


def variation(column: np.ndarray) -> float:
    """Return the total variation: the sum of the absolute changes between samples."""
    return float(np.sum(np.abs(np.diff(column))))


def tone(column: np.ndarray, ts: float) -> float:
    """Return the dominant frequency [Hz] of a column sampled every `ts` [s]."""
    changes = np.diff(column) * np.hanning(len(column) - 1)
    spectrum = np.abs(np.fft.rfft(changes))
    return float(np.fft.rfftfreq(len(changes), ts)[np.argmax(spectrum)])


def excess(trace: Trace) -> float:
    """Return the overshoot of theta beyond a constant set-point [rad]; 0 if there is none."""
    return max(float(np.max((trace.theta - trace.r) * np.sign(trace.r))), 0.0)


def overshoot(trace: Trace) -> float:
    """Return the overshoot beyond a constant set-point, in percent of the jump."""
    return 100 * excess(trace) / trace.height


def settling(trace: Trace, band: float = SETTLING_BAND) -> float:
    """Return the time after the first sample from which |e| stays within `band` times the jump [s].

    The paper's k = 1 is its first sample after t = 0, so a part that starts with a jump at t = 0
    is timed from there. NaN if the error is not within the band for at least the last HOLD: a loop
    that still swings through the band at the end has not settled.
    """
    settled = settling_time(trace.t, trace.e, band * trace.height)
    if settled > trace.t[-1] - HOLD:
        return math.nan
    return settled - (trace.t[0] - trace.ts)


def response(trace: Trace) -> np.ndarray:
    """Return the share of a jump that theta has covered, 0 before and 1 at the set-point.

    The trace starts at the jump, and its set-point is constant.
    """
    before = trace.theta[0]
    return (trace.theta - before) / (trace.r[-1] - before)


def time_to(trace: Trace, share: float) -> float:
    """Return the time after a jump at which theta has covered a share of it [s]; NaN if never."""
    reached = np.flatnonzero(response(trace) >= share)
    return float(trace.t[reached[0]] - (trace.t[0] - trace.ts)) if reached.size else math.nan


def rise_time(trace: Trace) -> float:
    """Return the rise time of theta from 10 % to 90 % of a jump [s]; NaN if never reached."""
    return time_to(trace, 0.9) - time_to(trace, 0.1)


def peak_time(trace: Trace) -> float:
    """Return the time after a jump at which theta overshoots most [s]; NaN if it never does."""
    covered = response(trace)
    peak = int(np.argmax(covered))
    return float(trace.t[peak] - (trace.t[0] - trace.ts)) if covered[peak] > 1 else math.nan


def lag(trace: Trace, frequency: float) -> float:
    """Return by how much theta lags a sine of `frequency` [Hz], over whole periods from 10 s on."""
    late = trace.part((10.0, 20.0))
    wave = np.exp(-2j * np.pi * frequency * late.t)
    turned = np.angle(np.sum(late.r * wave) / np.sum(late.theta * wave))
    return float(turned / (2 * np.pi * frequency))


def drift(trace: Trace) -> float:
    """Return the rate at which the network's part of the force changes, without sign [N/s]."""
    return abs(float((trace.u_n[-1] - trace.u_n[0]) / (trace.t[-1] - trace.t[0])))


def falling_share(column: np.ndarray) -> float:
    """Return the share of samples at which the magnitude falls, without rounding residue."""
    size = np.abs(column)
    return float(np.mean((np.diff(size) < 0)[size[:-1] > RESIDUE]))


def bursts(t: np.ndarray, force: np.ndarray) -> list[float]:
    """Return the start times of the large adjustments of a force [s]."""
    large = t[np.abs(force) > BURST]
    if not large.size:
        return []
    begins = np.flatnonzero(np.diff(large) > BURST_GAP) + 1
    return [float(large[0]), *large[begins].tolist()]


def half_periods(trace: Trace) -> list[Trace]:
    """Return the segments of a 0.1 Hz square wave after its jumps at 5, 10 and 15 s.

    The sample of a jump still has the old set-point, so a segment starts one sample later.
    """
    return [trace.part((start + trace.ts, start + 5 + trace.ts)) for start in (5, 10, 15)]


def worst(measure: Callable[[Trace], float]) -> Callable[[Trace], float]:
    """Return the largest value after the square wave's jumps at 5, 10 and 15 s; NaN if one is."""
    return lambda trace: float(np.max([measure(part) for part in half_periods(trace)]))


def after(trace: Trace, start: float) -> Trace:
    """Return the trace from `start` [s] on."""
    return trace.part((start, 21.0))


def after_pulse(trace: Trace) -> Trace:
    """Return what follows the beginning of the pulse, up to the next jump."""
    return trace.part((PULSE[0] + 0.002, 10.0))


def deviation(trace: Trace) -> float:
    """Return the maximum deviation of theta from the reference from the pulse on [rad].

    The square wave jumps with the pulse, so that only what lies beyond the set-point counts.
    """
    part = after_pulse(trace)
    return excess(part) if trace.signal == "square" else largest(part.theta - part.r)


def swing(trace: Trace) -> float:
    """Return by how much theta exceeds a sine's amplitude from 1 s on [%]; 0 if it does not."""
    late = after(trace, 1)
    return 100 * max(largest(late.theta) / largest(late.r) - 1, 0.0)


def swing_back(trace: Trace) -> float:
    """Return the swing of theta to the other side after it has returned to -1 [rad].

    0 if it returns from below and stays there.
    """
    part = trace.part((PULSE[1], 10.0))
    off = part.theta - part.r
    return max(float(np.max(off[int(np.argmin(off)) :])), 0.0)


def roughness(trace: Trace) -> float:
    """Return the largest change of the force from one sample to the next, after a jump [N].

    The jump itself, which drives every controller to its limit, is left out.
    """
    return max(change(part.part((part.t[0] + 0.1, 99.0)).u) for part in half_periods(trace))


def energy_of(error: np.ndarray) -> np.ndarray:
    """Return V₁ of section 3.2 [unit of the error squared], shape (steps,)."""
    return np.cumsum(error**2) / 2


def loss(error: np.ndarray) -> float:
    """Return the share of samples at which V₁ falls."""
    return float(np.mean(np.diff(energy_of(error)) < 0))


def quiet(trace: Trace) -> Trace:
    """Return what lies outside the jumps at the start and at the disturbance."""
    return trace.part((1.0, 5.0), (5.6, 21.0))


def alike(a: np.ndarray, b: np.ndarray) -> float:
    """Return Pearson's correlation coefficient."""
    return float(np.corrcoef(a, b)[0, 1])


def apart(trace: Trace) -> float:
    """Return the difference of u_n and u relative to u (RMS)."""
    return rms(trace.u - trace.u_n) / rms(trace.u)


def opposed(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of samples with opposite signs."""
    return float(np.mean(np.sign(a) == -np.sign(b)))


def lost(data: Data, kind: str) -> float:
    """Return the time at which the pendulum is lost after a step, infinite if never [s]."""
    long = data.lasting(kind)
    found = np.flatnonzero((np.abs(long.e) > LOST) & (long.t > 20))
    return float(long.t[found[0]]) if found.size else math.inf


Swept = dict[str, dict[str, np.ndarray]]


@cache
def swept(variable: str, fmus: Path) -> Swept:
    """Return the metrics of all controllers over SCALES."""
    values, runs = NOMINAL[variable] * SCALES, {}
    for kind in KINDS:
        tried = {"variables": both_plants(kind, variable), "values": values.tolist()}
        found = sweep(alone(kind), [tried], fmus)
        # A loop that still swings through the band at the end has not settled
        found["settling_time"][found["settling_time"] > END - HOLD] = np.nan
        runs[kind] = found
    return runs


def growths(variable: str, fmus: Path) -> dict[str, float]:
    """Return by how much the integral of |e| exceeds the nominal one at worst, relative to it."""
    areas = {kind: metrics["iae"] for kind, metrics in swept(variable, fmus).items()}
    return {kind: float(np.max(a) / a[len(SCALES) // 2] - 1) for kind, a in areas.items()}


# --- the table ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measure:
    """A number for each controller."""

    name: str
    unit: str
    of: Callable[..., float]  # of a trace
    more: bool = False  # whether more is better
    jumps: bool = False  # of the slowest jump of a square wave, or the end of the pulse
    learns: bool = False  # only of controllers with a network

    def title(self, signal: str = "", amplitude: float = 0.0) -> str:
        """Return the name and the unit in a case; without a signal they are the same in all."""
        if not signal:
            return f"{self.name} [{self.unit}]"
        if "{" in self.name:
            return f"{self.name.format(amplitude)} [{self.unit}]"
        jump = " after the pulse" if amplitude else ", slowest jump" * (signal == "square")
        disturbed = f", d = {amplitude:g} rad" if amplitude else ""
        return f"{self.name}{jump * self.jumps}, {SIGNAL_NAMES[signal]}{disturbed} [{self.unit}]"

    def value(self, trace: Trace) -> float:
        """Measure a trace."""
        if self.jumps and trace.amplitude:
            return self.of(trace.part((PULSE[1], 10.0)))
        if self.jumps and trace.signal == "square":
            return worst(self.of)(trace)
        return self.of(trace)


class LoopMeasure(Measure):
    """A number for each controller, of all data and the controller: it does not have cases."""


def of_law(measure: Callable[[Law], float]) -> Callable[[Data, str], float]:
    """Return a measure of the control law."""
    return lambda _, kind: measure(LAWS[kind])


def of_response(measure: Callable[[np.ndarray], float]) -> Callable[[Data, str], float]:
    """Return a measure of the open loop's response at `stability.FREQUENCIES`."""
    return of_law(lambda law: measure(stability.open_loop(law, stability.FREQUENCIES)))


GROWTH = "rate of the fastest growing mode"

# fmt: off
MEASURES = {
    # speed
    "rise": Measure("rise time 10 % to 90 %", "s", rise_time, jumps=True),
    "half": Measure("delay time to 50 %", "s", lambda t: time_to(t, 0.5)),
    "most": Measure("time to 90 %", "s", lambda t: time_to(t, 0.9)),
    "lag": Measure("lag or lead", "s", lambda t: abs(lag(t, FREQUENCY["sine"]))),
    "peak": Measure("time of the largest overshoot", "s", peak_time),
    "rising": Measure("rise time", "s", rise_time),
    # settling: the two usual bands, and the band of the paper's 3.8 s
    "settling_5": Measure("settling time to ±5 %", "s", partial(settling, band=0.05), jumps=True),
    "settling_2": Measure("settling time to ±2 %", "s", partial(settling, band=0.02), jumps=True),
    "settling_03": Measure("settling time to ±0.3 %", "s", partial(settling, band=0.003),
                           jumps=True),
    # overshoot
    "overshoot": Measure("overshoot", "%", overshoot),
    "jump": Measure("largest overshoot of a jump", "%", worst(overshoot)),
    "swing": Measure("excess over the amplitude from 1 s on", "%", swing),
    "returning": Measure("swing to the other side of r, d = {:g} rad", "rad", swing_back),
    # accuracy
    "iae": Measure("integral of |e|", "rad s", iae),
    "ise": Measure("integral of e²", "rad² s", lambda t: integral(t.e**2, t.ts)),
    "itae": Measure("integral of t |e|", "rad s²", lambda t: integral(t.t * np.abs(t.e), t.ts)),
    "last": Measure("|e(20 s)|", "rad", lambda t: abs(float(t.e[-1]))),
    "late": Measure("max |e| from 19 s on", "rad", lambda t: largest(after(t, 19).e)),
    "late_rms": Measure("RMS of e from 19 s on", "rad", lambda t: rms(after(t, 19).e)),
    "rms_10": Measure("RMS of e from 10 s on", "rad", lambda t: rms(after(t, 10).e)),
    "after_start": Measure("max |e| from 1 s on", "rad", lambda t: largest(after(t, 1).e)),
    "sums": Measure("share of samples at which V falls", "1", lambda t: loss(t.e), learns=True),
    "force_sums": Measure("share of samples at which V falls, of u_n − u", "1",
                          lambda t: loss(t.u_n - t.u), learns=True),
    "falling": Measure("share of samples at which |e| falls", "1", lambda t: falling_share(t.e)),
    "force_falling": Measure("share of samples at which |u_n − u| falls", "1",
                             lambda t: falling_share(t.u_n - t.u), learns=True),
    "angle": Measure("largest |θ|", "°", lambda t: math.degrees(largest(t.theta))),
    # disturbance
    "deviation": Measure("largest deviation", "rad", deviation),
    "displaced": Measure("∫|θ − r| dt, 5 s to 10 s", "rad s",
                         lambda t: integral(np.abs((p := after_pulse(t)).theta - p.r), t.ts)),
    "returned": Measure("∫|e| dt, 5.5 s to 10 s", "rad s",
                        lambda t: iae(t.part((PULSE[1], 10.0)))),
    # force
    "variation": Measure("total variation of u", "N", lambda t: variation(t.u)),
    "energy": Measure("∫u² dt", "N² s", lambda t: integral(t.u**2, t.ts)),
    "roughness": Measure("largest change of u per sample from 0.1 s after a jump", "N", roughness),
    "share": Measure("RMS(u_p)/RMS(u)", "1",
                     lambda t: rms(after(t, 19).u_p) / rms(after(t, 19).u), learns=True),
    "feedback": Measure("RMS of u_p from 19 s on", "N", lambda t: rms(after(t, 19).u_p),
                        learns=True),
    "identified": Measure("change of u_n at r = 1 from 15 s on", "N/s",
                          lambda t: drift(after(t, 15)), learns=True),
    "learning": Measure("change of h · w from 19 s on", "N/s", lambda t: drift(after(t, 19)),
                        learns=True),
    # u_n and u_p beside u
    "unlimited": Measure("max |u − limited sum|", "N",
                         lambda t: largest(t.u - np.clip(t.u_p + t.u_n, -LIMIT, LIMIT))),
    "clipped": Measure("number of samples at the limit, of 20000", "1",
                       lambda t: int(np.sum(t.u != t.u_p + t.u_n))),
    "before": Measure("|u_n| just before the jump at 5 s", "N",
                      lambda t: abs(float(t.part((4.99, 5.0)).u_n[-1]))),
    "after": Measure("|u_n| just after it", "N",
                     lambda t: abs(float(t.part((5.001, 5.01)).u_n[0]))),
    "lowest": Measure("smallest u_n in the second after it", "N",
                      lambda t: float(np.min(t.part((5.0, 6.0)).u_n))),
    "later": Measure("u_n at 9.9 s", "N", lambda t: float(t.part((9.9, 10.0)).u_n[0])),
    "kick": Measure("u_p at the jump", "N", lambda t: float(np.min(t.part((5.0, 5.01)).u_p))),
    "alike": Measure("correlation of u_n and u", "1", lambda t: alike(t.u_n, t.u)),
    "apart": Measure("RMS(u − u_n)/RMS(u)", "1", apart),
    "quiet_alike": Measure("correlation of u_n and u", "1",
                           lambda t: alike(quiet(t).u_n, quiet(t).u)),
    "quiet_apart": Measure("RMS(u − u_n)/RMS(u)", "1", lambda t: apart(quiet(t))),
    "small": Measure("max |u_p|/max |u_n| from 1 s on", "1",
                     lambda t: largest(after(t, 1).u_p) / largest(after(t, 1).u_n)),
    "largest_u_p": Measure("max |u_p| from 0 s on", "N", lambda t: largest(t.u_p)),
    "gentle": Measure("largest change of u per sample from 1 s on", "N",
                      lambda t: change(after(t, 1).u)),
    "changes": Measure("largest change of u per sample from 0 s on", "N", lambda t: change(t.u)),
    "trend": Measure("correlation of u_n and r", "1",
                     lambda t: alike(after(t, 1).u_n, after(t, 1).r)),
    "against": Measure("share of samples at which one rises and one falls", "1",
                       lambda t: opposed(np.diff(after(t, 1).u_n), np.diff(after(t, 1).r))),
    "opposite": Measure("share of samples with opposite signs of u_n and r", "1",
                        lambda t: opposed(after(t, 1).u_n, after(t, 1).r)),
    # not of one trace
    "lost": LoopMeasure("time until the pendulum is lost, step", "s", lost, more=True),
    "cart": LoopMeasure("distance of the cart after 20 s, step", "m",
                        lambda data, kind: abs(float(data(kind).x[-1]))),
    "growth": LoopMeasure(GROWTH, "1/s", of_law(stability.growth)),
    "growth_1": LoopMeasure(f"{GROWTH}, one sample more", "1/s",
                            of_law(partial(stability.growth, samples=1))),
    "delay_margin": LoopMeasure("delay margin, from measurement to force", "samples",
                                of_law(stability.delay_margin), more=True),
    "gain_margin": LoopMeasure("gain margin", "1", of_law(stability.gain_margin), more=True),
    "phase_margin": LoopMeasure("phase margin", "°", of_response(stability.phase_margin),
                                more=True),
    "modulus_margin": LoopMeasure("modulus margin, min |1 + L|", "1",
                                  of_response(stability.modulus_margin), more=True),
    "mass": LoopMeasure("largest growth of ∫|e| dt for M from a quarter to four times", "%",
                        lambda data, kind: 100 * growths("M", data.fmus)[kind]),
    "length": LoopMeasure("largest growth of ∫|e| dt for l from a quarter to four times", "%",
                          lambda data, kind: 100 * growths("l", data.fmus)[kind]),
}
# fmt: on
"""All measures by key."""
