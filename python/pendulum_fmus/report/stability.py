"""The sampled closed loop at r = 1, linear and without force limit: eigenvalues and margins."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..loop import TS
from .runs import GAINS

ETA, ALPHA = 0.30, 0.05
"""The paper's learning rate and momentum."""

CENTRES, WIDTH = np.array([-2.0, -1.0, 1.0, 2.0]), 0.5
"""Centres and widths of the network's nodes."""

NOMINAL = {"M": 1.096, "m": 0.109, "l": 0.25, "g": 9.8, "I": 0.0034, "b": 0.1}
"""The paper's plant: masses [kg], length [m], gravity [m/s²], inertia [kg m²], friction [N s/m]."""

RAMP = NOMINAL["b"] * NOMINAL["g"]
"""b g: the rate at which the force that holds 1 rad falls, since the cart accelerates by -g theta
and its friction b grows with its speed [N/s]."""

CONSTANT = 1e-7
"""An eigenvalue this close to 1 comes from the plant's zero at s = 0 and an integrator."""

SLOW = 5e-6
"""Growth per sample below which the margins leave a mode out, as in the supervised IPID-RBF."""


@dataclass(frozen=True)
class Law:
    """A controller in the loop."""

    eta: float = 0.0  # learning rate of the network; 0 without one
    leaks: bool = False  # whether the sum of the error leaks, as in (25)
    previous_sample_terms: bool = False  # whether u(k) has the PID terms of sample k - 1
    samples: int = 0  # delay of the measured angle; a master that steps in parallel adds 1


LAWS = {
    "PID": Law(previous_sample_terms=True),
    "PID-RBF": Law(ETA, previous_sample_terms=True),
    "IPID-RBF": Law(leaks=True),
    "IPID-RBF own": Law(ETA, leaks=True),
}
"""The controllers of Table 1. The network of IPID-RBF learns from the supervisor's loop, and so is
outside its own, which is the loop of a PID whose sum leaks."""

DELAYS = {
    "0 samples": Law(ETA),
    "1 sample": Law(ETA, previous_sample_terms=True),
    "1, parallel": Law(ETA, samples=1),
    "2 samples": Law(ETA, previous_sample_terms=True, samples=1),
}
"""PID-RBF by the delay from measurement to force, by its terms or by the master."""


def nodes(r: float = 1.0) -> np.ndarray:
    """Return the outputs (12) of the network's nodes at a set-point [rad], shape (4,)."""
    return np.exp(-((r - CENTRES) ** 2) / (2 * WIDTH**2))


def activation(r: float = 1.0) -> float:
    """Return |h|² at a set-point [rad]."""
    return float(nodes(r) @ nodes(r))


def held_cart(plant: dict[str, float] = NOMINAL) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero-order-hold discretization of (9) with x: A (4, 4), B (4, 1).

    The states are x, v, theta, omega.
    """
    M, m, l, g, I, b = (plant[name] for name in NOMINAL)  # noqa: E741
    mass = np.array([[M + m, -m * l], [-m * l, I + m * l**2]])
    from scipy import linalg  # here, since the demo draws figures without SciPy

    rates = np.zeros((5, 5))  # the last row and column are the constant force
    rates[[1, 3]] = np.linalg.solve(mass, [[0, -b, 0, 0, 1], [0, 0, m * g * l, 0, 0]])
    rates[0, 1] = rates[2, 3] = 1
    held = linalg.expm(TS * rates)
    return held[:4, :4], held[:4, 4:]


def held_plant(plant: dict[str, float] = NOMINAL) -> tuple[np.ndarray, np.ndarray]:
    """Return the same without x, on which nothing else depends: A (3, 3), B (3,)."""
    A, B = held_cart(plant)
    return A[1:, 1:], B[1:, 0]


def matrix(law: Law, gain: float = 1.0, plant: dict[str, float] = NOMINAL) -> np.ndarray:
    """Return the matrix (8 + samples, 8 + samples) of the closed loop.

    The states are v, theta, omega; e, x3, x2 of the previous sample; u_n of this and the previous
    sample, since only the weights along h learn; theta of the last samples. `gain` is a factor of
    the force.
    """
    samples = law.samples
    Ad, Bd = held_plant(plant)
    unit = np.eye(8 + samples)
    e = -unit[7 + samples] if samples else -unit[1]
    x2, x3 = (e - unit[3]) / TS, unit[4] + e * TS
    if law.leaks:
        x3 = (unit[4] + e) * TS
    terms = (unit[3], unit[5], unit[4]) if law.previous_sample_terms else (e, x2, x3)
    u_p = GAINS["kp"] * terms[0] + GAINS["kd"] * terms[1] + GAINS["ki"] * terms[2]
    A = np.zeros((8 + samples, 8 + samples))
    A[:3, :3] = Ad
    A[:3] += np.outer(gain * Bd, u_p + unit[6])
    A[3], A[4], A[5] = e, x3, x2
    A[6] = unit[6] + law.eta * activation() * u_p + ALPHA * (unit[6] - unit[7])
    A[7] = unit[6]
    for k in range(samples):
        A[8 + k] = unit[7 + k] if k else unit[1]
    return A


def spectral_radius(A: np.ndarray) -> float:
    """Return the largest absolute eigenvalue, without those at 1."""
    values = np.linalg.eigvals(A)
    return float(np.max(np.abs(values[np.abs(values - 1) > CONSTANT])))


def growth(law: Law, samples: int = 0) -> float:
    """Return the rate of the mode that grows fastest, or decays most slowly [1/s]."""
    return math.log(spectral_radius(matrix(replace(law, samples=samples)))) / TS


def last_true(holds: Callable[[float], bool], true: float, false: float) -> float:
    """Return where a condition ends, by bisection between two values."""
    for _ in range(50):
        middle = (true + false) / 2
        if holds(middle):
            true = middle
        else:
            false = middle
    return true


@cache
def limit(law: Law, mass: float = NOMINAL["M"]) -> float:
    """Return the learning rate beyond which the loop is unstable, 0 if it always is."""
    return last_true(lambda eta: radius(law, eta, mass) < 1, 0.0, 4.0)


def radius(law: Law, eta: float = ETA, mass: float = NOMINAL["M"]) -> float:
    """Return the spectral radius with another learning rate, and mass of the cart [kg]."""
    return spectral_radius(matrix(replace(law, eta=eta), plant=NOMINAL | {"M": mass}))


def printed_bound() -> float:
    """Return the bound of section 3.2, eta |h|² < 2, for G = h and u held fixed."""
    return 2 / activation()


def bearable(law: Law, samples: int = 0, gain: float = 1.0) -> bool:
    """Return whether no mode grows by more than SLOW per sample."""
    return spectral_radius(matrix(replace(law, samples=samples), gain)) < 1 + SLOW


def delay_margin(law: Law) -> int:
    """Return the delay from measurement to force that the loop tolerates [samples]."""
    samples = next(n for n in itertools.count() if not bearable(law, n + 1))
    return samples + law.previous_sample_terms


def gain_margin(law: Law) -> float:
    """Return the factor of the loop gain up to which the loop is stable."""
    return last_true(lambda gain: bearable(law, gain=gain), 1.0, 100.0)


def open_loop(law: Law, frequency: np.ndarray) -> np.ndarray:
    """Return the frequency response of the open loop at some frequencies [rad/s]."""
    Ad, Bd = held_plant()
    z = np.exp(1j * TS * frequency)
    angle = np.linalg.solve(z[:, None, None] * np.eye(3) - Ad, Bd[:, None])[:, 1, 0]
    total = TS / (1 - TS / z) if law.leaks else TS / (1 - 1 / z)
    u_p = GAINS["kp"] + GAINS["kd"] * (1 - 1 / z) / TS + GAINS["ki"] * total
    if law.previous_sample_terms:
        u_p = u_p / z
    return u_p * (1 + law.eta * activation() * z / ((z - 1) * (z - ALPHA))) * angle


FREQUENCIES = np.geomspace(0.1, math.pi / TS, 40_000)
"""Frequencies at which the margins are sought [rad/s]."""


def modulus_margin(response: np.ndarray) -> float:
    """Return the smallest distance from -1 of an open loop's response at `FREQUENCIES`."""
    return float(np.min(np.abs(1 + response)))


def crossings(response: np.ndarray) -> np.ndarray:
    """Return the indices of `FREQUENCIES` at which the gain of an open loop crosses 1."""
    return np.flatnonzero(np.diff(np.abs(response) > 1))


def phase_margin(response: np.ndarray) -> float:
    """Return the smallest angle by which an open loop misses -1 where its gain is 1 [°]."""
    return float(np.degrees(np.min(np.abs(np.angle(-response[crossings(response)])))))
