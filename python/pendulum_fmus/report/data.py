"""The results of all loops, looked up by controller, signal and disturbance."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..loop import Columns, Loop
from ..project import FMUS
from .scenarios import gain_loop, lasting_loop, loops_of


@dataclass(frozen=True)
class Trace:
    """The results of one controller in one loop; all columns have shape (steps,).

    Parameters
    ----------
    key
        Unique name, for the columns of the page.
    t
        Time [s].
    r, d, theta, e
        Reference, disturbance, angle of the pendulum, and the controller's error r - (theta + d)
        [rad].
    u, u_p, u_n
        Force, and the parts of the PID and the network [N]; u_n is None for a PID.
    """

    key: str
    t: np.ndarray
    r: np.ndarray
    d: np.ndarray
    theta: np.ndarray
    e: np.ndarray
    u: np.ndarray
    u_p: np.ndarray
    u_n: np.ndarray | None

    @property
    def ts(self) -> float:
        """Time between two samples [s]."""
        return float(self.t[1] - self.t[0])

    def part(self, start: float, stop: float) -> "Trace":
        """Return the samples with start <= t < stop [s], times rounded to the microsecond."""
        return self.parts((start, stop))

    def parts(self, *spans: tuple[float, float]) -> "Trace":
        """Return the samples in some spans, which are as in `part`."""
        t = np.round(self.t, 6)
        inside = np.logical_or.reduce([(t >= start) & (t < stop) for start, stop in spans])
        cut = {
            name: None if column is None else column[inside]
            for name, column in vars(self).items()
            if name != "key"
        }
        return Trace(key=f"{self.key}, {np.count_nonzero(inside)} samples", **cut)


def trace_of(key: str, columns: Columns, controller: str = "controller", plant: str = "plant"):
    """Select one controller's columns from a run."""
    return Trace(
        key=key,
        t=columns["time"],
        r=columns["source.r"],
        d=columns["source.d"],
        theta=columns[f"{plant}.theta"],
        e=columns[f"{controller}.e"],
        u=columns[f"{controller}.u"],
        u_p=columns[f"{controller}.u_p"],
        u_n=columns.get(f"{controller}.u_n"),
    )


class Data:
    """Results by loop, and their traces."""

    def __init__(self, results: Mapping[Loop, Columns], fmus: Path = FMUS):
        self.results = results
        self.fmus = fmus

    def __call__(self, kind: str, signal: str, amplitude: float = 0.0) -> Trace:
        """Return the trace of a controller for a signal and a disturbance of `amplitude` [rad]."""
        loop, controller, plant = loops_of(signal, amplitude)[kind]
        key = f"{kind}/{signal}/{amplitude:g}"
        return trace_of(key, self.results[loop], controller, plant)

    def gains(self, gain: str, factor: float) -> Trace:
        """Return the step response of the PID with one gain multiplied by `factor`."""
        return trace_of(f"{gain}*{factor:g}", self.results[gain_loop(gain, factor)])

    def lasting(self, kind: str) -> dict[str, np.ndarray]:
        """Return t [s], theta [rad], e [rad] and u [N] of a long step."""
        loop, controller, plant = lasting_loop(kind)
        columns = self.results[loop]
        return {
            "t": columns["time"],
            "theta": columns[f"{plant}.theta"],
            "e": columns[f"{controller}.e"],
            "u": columns[f"{controller}.u"],
        }

    def x_end(self, kind: str) -> float:
        """Return the last position of the cart after a step [m]."""
        loop, _, plant = loops_of("step", 0.0)[kind]
        return float(self.results[loop][f"{plant}.x"][-1])

    def loop(self, loop: Loop) -> Trace:
        """Return the trace of the controller of any loop."""
        return trace_of(repr(loop), self.results[loop])
