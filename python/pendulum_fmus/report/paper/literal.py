"""The loops of Table 1 in plain Python, read literally where the FMUs cannot be wrong.

Three misprints are no parameters of the FMUs: the update (18) with the factor h twice, the terms
(21) as the network's input, and the powers of (40).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...loop import FREQUENCY, STEPS, TS
from ..scenarios import GAINS
from ..stability import ALPHA, CENTRES, ETA, WIDTH, exponential
from .objective import PRINTED, coefficients

LIMIT = 100.0
"""Limit of the force [N]."""

PULSE = range(5000, 5500)
"""Samples of the disturbance."""


@dataclass(frozen=True)
class Reading:
    """How the paper is read.

    Parameters
    ----------
    squared
        Whether the weights are updated by the second line of (18), with h² in place of h.
    terms_as_input
        Whether the network's input is the vector (21) in place of r.
    printed_powers
        Whether the plant is (40) as printed.
    """

    squared: bool = False
    terms_as_input: bool = False
    printed_powers: bool = False


class Plant:
    """G(s) = a s / (s³ + b s² - c s - d) under a zero-order hold, initially at rest."""

    def __init__(self, a: float, b: float, c: float, d: float):
        rates = np.zeros((4, 4))  # the last row and column are the constant force
        rates[:3, :3] = [[0, 1, 0], [0, 0, 1], [d, c, -b]]
        rates[2, 3] = 1
        self.rows = exponential(rates)[:3].tolist()
        self.state = (0.0, 0.0, 0.0)
        self.gain = a

    @property
    def theta(self) -> float:
        """The angle [rad]."""
        return self.gain * self.state[1]

    def step(self, u: float) -> None:
        """Hold the force u [N] for one sample."""
        x, y, z = self.state
        self.state = tuple(p * x + q * y + r * z + s * u for p, q, r, s in self.rows)


class Controller:
    """PID, or PID with a network, whose sum may leak (25)."""

    def __init__(self, reading: Reading, *, network: bool, leaks: bool):
        self.reading, self.network, self.leaks = reading, network, leaks
        self.e = self.x2 = self.x3 = self.total = 0.0
        self.w = self.before = [0.0] * len(CENTRES)

    def sample(self, r: float, y: float) -> float:
        """Return the force [N] for a set-point and a measured angle [rad]."""
        previous, terms = self.e, (self.e, self.x2, self.x3)
        self.e = r - y
        self.x2 = (self.e - previous) / TS
        self.x3 = (self.x3 + self.e) * TS if self.leaks else self.x3 + self.e * TS
        self.total += self.e
        if self.leaks:  # IPID-RBF, with the terms of this sample
            terms = (self.e, self.x2, self.x3)
        x1, x2, x3 = terms
        self.u_p = GAINS["kp"] * x1 + GAINS["kd"] * x2 + GAINS["ki"] * x3
        inputs = (r,)
        if self.reading.terms_as_input:
            inputs = (self.e, self.total, self.e - previous)
        self.h = [node(inputs, float(c)) for c in CENTRES] if self.network else []
        self.u_n = sum(w * h for w, h in zip(self.w, self.h, strict=False))
        return min(max(self.u_p + self.u_n, -LIMIT), LIMIT)

    def learn(self, target: float) -> None:
        """Update the weights for a target force [N]."""
        step = -ETA * (self.u_n - target)
        power = 2 if self.reading.squared else 1
        moved = [
            w + step * h**power + ALPHA * (w - old)
            for w, old, h in zip(self.w, self.before, self.h, strict=True)
        ]
        self.before, self.w = self.w, moved


def node(inputs: Sequence[float], centre: float) -> float:
    """Return the output (12) of a node."""
    # Products, as a power of a number that has diverged would be an error
    distance = sum((value - centre) * (value - centre) for value in inputs)
    return math.exp(-distance / (2 * WIDTH**2))


def set_point(signal: str, k: int) -> float:
    """Return r(k) [rad]; at a jump the value from before it."""
    if signal == "step":
        return 1.0
    sine = math.sin(2 * math.pi * FREQUENCY[signal] * k * TS)
    if signal == "sine":
        return sine
    return 1.0 if round(2 * FREQUENCY[signal] * TS * (k - 0.5) - 0.5) % 2 == 0 else -1.0


def errors(reading: Reading, signal: str, amplitude: float) -> dict[str, float]:
    """Return e(20000) [rad] of the three controllers of Table 1; huge or NaN if a loop diverges."""
    plant = coefficients()
    if reading.printed_powers:
        a, cubic, other, last = map(float, PRINTED)
        plant = [a, cubic - other, 0.0, last]
    pid = Controller(reading, network=False, leaks=False)
    rbf = Controller(reading, network=True, leaks=False)
    ipid = Controller(reading, network=True, leaks=True)
    loops = [(controller, Plant(*plant)) for controller in (pid, rbf, ipid)]
    for k in range(1, STEPS + 1):
        r, d = set_point(signal, k), amplitude if k in PULSE else 0.0
        forces = [controller.sample(r, pendulum.theta + d) for controller, pendulum in loops]
        rbf.learn(forces[1])
        ipid.learn(forces[1])  # IPID-RBF learns the supervisor's force
        for (_, pendulum), force in zip(loops, forces, strict=True):
            pendulum.step(force)
    return {"PID": pid.e, "PID-RBF": rbf.e, "IPID-RBF": ipid.e}
