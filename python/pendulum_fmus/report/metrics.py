"""Metrics for the verdicts. Columns have shape (steps,); angles are in rad, forces in N."""

import math

import numpy as np

from ..loop import SETTLING_BAND, settling_time
from .data import Trace

RESIDUE = 1e-9
"""An error below this is rounding residue [rad]."""

BURST = 50.0
"""A force beyond this, half of the limit, is a large adjustment [N]."""

HOLD = 0.1
"""Minimum time for which an error must stay within its band to count as settled [s]."""

BURST_GAP = 0.25
"""Large adjustments closer together than this count as one [s]."""


def iae(trace: Trace) -> float:
    """Return the integral of |e| [rad s], by the rectangle rule."""
    return float(np.sum(np.abs(trace.e)) * trace.ts)


def ise(trace: Trace) -> float:
    """Return the integral of e² [rad² s], by the rectangle rule."""
    return float(np.sum(trace.e**2) * trace.ts)


def itae(trace: Trace) -> float:
    """Return the integral of t |e| [rad s²], by the rectangle rule."""
    return float(np.sum(trace.t * np.abs(trace.e)) * trace.ts)


def final(trace: Trace) -> float:
    """Return the magnitude of the last error [rad]."""
    return abs(float(trace.e[-1]))


def rms(column: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(column**2)))


def largest(column: np.ndarray) -> float:
    """Return the maximum absolute value."""
    return float(np.max(np.abs(column)))


def variation(column: np.ndarray) -> float:
    """Return the total variation: the sum of the absolute changes between samples."""
    return float(np.sum(np.abs(np.diff(column))))


def tone(column: np.ndarray, ts: float) -> float:
    """Return the dominant frequency [Hz] of a column sampled every `ts` [s]."""
    changes = np.diff(column) * np.hanning(len(column) - 1)
    spectrum = np.abs(np.fft.rfft(changes))
    return float(np.fft.rfftfreq(len(changes), ts)[np.argmax(spectrum)])


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return Pearson's correlation coefficient."""
    return float(np.corrcoef(a, b)[0, 1])


def excess(trace: Trace) -> float:
    """Return the overshoot of theta beyond a constant set-point [rad]; 0 if there is none."""
    return max(float(np.max((trace.theta - trace.r) * np.sign(trace.r))), 0.0)


def overshoot(trace: Trace, height: float = 1.0) -> float:
    """Return the overshoot beyond a constant set-point, in percent of a jump of `height` [rad]."""
    return 100 * excess(trace) / height


def settling(trace: Trace, height: float = 1.0, band: float = SETTLING_BAND) -> float:
    """Return the time after the first sample from which |e| stays within `band` times the jump [s].

    The paper's k = 1 is its first sample after t = 0, so a part that starts with a jump at t = 0
    is timed from there. NaN if the error is not within the band for at least the last HOLD: a loop
    that still swings through the band at the end has not settled.
    """
    settled = settling_time(trace.t, trace.e, band * height)
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
    late = trace.part(10.0, 20.0)
    wave = np.exp(-2j * np.pi * frequency * late.t)
    turned = np.angle(np.sum(late.r * wave) / np.sum(late.theta * wave))
    return float(turned / (2 * np.pi * frequency))


def energy(column: np.ndarray, ts: float) -> float:
    """Return the integral of the square, by the rectangle rule."""
    return float(np.sum(column**2) * ts)


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
    return [trace.part(start + trace.ts, start + 5 + trace.ts) for start in (5, 10, 15)]
