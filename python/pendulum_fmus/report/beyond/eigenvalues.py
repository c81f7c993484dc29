"""Stability limit of the learning rate from the sampled closed loop at a constant set-point."""

import math
from dataclasses import dataclass

import numpy as np

from ...loop import TS
from ..scenarios import GAINS

ETA, ALPHA = 0.30, 0.05
"""The paper's learning rate and momentum."""

CENTRES, WIDTH = np.array([-2.0, -1.0, 1.0, 2.0]), 0.5
"""Centres and widths of the network's nodes."""

CONSTANT = 1e-6
"""An eigenvalue this close to 1 comes from the plant's zero at s = 0 and the integrator."""


@dataclass(frozen=True)
class Delay:
    """The delay from measurement to plant input.

    Parameters
    ----------
    previous_sample_terms
        Whether the controller uses the PID terms of the previous sample.
    parallel
        Whether the master steps in parallel.
    """

    previous_sample_terms: bool
    parallel: bool

    @property
    def samples(self) -> int:
        """Delay in samples."""
        return self.previous_sample_terms + self.parallel


DELAYS = (Delay(False, False), Delay(True, False), Delay(False, True), Delay(True, True))


def activation() -> float:
    """Return |h|² of the network's nodes at r = 1."""
    h = np.exp(-((1 - CENTRES) ** 2) / (2 * WIDTH**2))
    return float(h @ h)


def held_plant() -> tuple[np.ndarray, np.ndarray]:
    """Return the zero-order-hold discretization of (9), without x: A (3, 3), B (3,).

    The states are v, theta, omega.
    """
    M, m, l, g, I, b = 1.096, 0.109, 0.25, 9.8, 0.0034, 0.1  # noqa: E741
    mass = np.array([[M + m, -m * l], [-m * l, I + m * l**2]])
    rates = np.zeros((4, 4))  # the last row and column are the constant force
    rates[[0, 2]] = np.linalg.solve(mass, [[-b, 0, 0, 1], [0, m * g * l, 0, 0]])
    rates[1, 2] = 1
    series = [np.linalg.matrix_power(rates * TS, k) / math.factorial(k) for k in range(10)]
    return sum(series)[:3, :3], sum(series)[:3, 3]


def matrix(delay: Delay, eta: float) -> np.ndarray:
    """Return the matrix (9, 9) of the loop with PID-RBF at r = 1, without force limit.

    The states are v, theta, omega; e, x3, x2 of the previous sample; u_n of this and the previous
    sample, since only the weights along h learn; u of the previous sample.
    """
    Ad, Bd = held_plant()
    unit = np.eye(9)
    e = -unit[1]
    x2, x3 = (e - unit[3]) / TS, unit[4] + e * TS
    terms = (unit[3], unit[5], unit[4]) if delay.previous_sample_terms else (e, x2, x3)
    u_p = GAINS["kp"] * terms[0] + GAINS["kd"] * terms[1] + GAINS["ki"] * terms[2]
    u = u_p + unit[6]
    felt = unit[8] if delay.parallel else u
    A = np.zeros((9, 9))
    A[:3, :3] = Ad
    A[:3] += np.outer(Bd, felt)
    A[3], A[4], A[5] = e, x3, x2
    A[6] = unit[6] + eta * activation() * u_p + ALPHA * (unit[6] - unit[7])
    A[7], A[8] = unit[6], u
    return A


def spectral_radius(delay: Delay, eta: float) -> float:
    """Return the largest absolute eigenvalue, excluding the one at 1."""
    values = np.linalg.eigvals(matrix(delay, eta))
    return float(np.max(np.abs(values[np.abs(values - 1) > CONSTANT])))


def limit(delay: Delay) -> float:
    """Return the learning rate at which the spectral radius exceeds 1, by bisection."""
    stable, unstable = 0.05, 2.0
    for _ in range(40):
        middle = (stable + unstable) / 2
        if spectral_radius(delay, middle) < 1:
            stable = middle
        else:
            unstable = middle
    return stable


def printed_bound() -> float:
    """Return the bound of section 3.2, eta |h|² < 2, for G = h and u held fixed."""
    return 2 / activation()
