"""An independent implementation of the paper's loop in NumPy and SciPy, without FMI.

It is written from the equations, not from the Rust code. Variables have the same names as in the
FMUs, so that results can be compared column by column. SI units, angles in rad.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete

M, m, l, g, I, b = 1.096, 0.109, 0.25, 9.8, 0.0034, 0.1  # noqa: E741
"""Cart [kg], rod [kg], pivot to centre of mass [m], gravity [m/s²], inertia [kg m²], friction
[N s/m]."""

TS = 0.001
"""Sample time [s]."""

EDGE = 1e-9
"""Times this close to a jump count as the time of the jump [s], since sums of steps are rounded."""


# --- plant --------------------------------------------------------------------------------------


def derivatives(state: np.ndarray, u: float) -> np.ndarray:
    """Return the derivative of the state (x, v, theta, omega), shape (4,), by (7) and (8).

    `u` is the force [N].
    """
    _, v, theta, omega = state
    s, c = math.sin(theta), math.cos(theta)
    mass = np.array([[M + m, -m * l * c], [-m * l * c, I + m * l**2]])
    force = np.array([u - b * v - m * l * omega**2 * s, m * g * l * s])
    x2, theta2 = np.linalg.solve(mass, force)
    return np.array([v, x2, omega, theta2])


def integrate(state: np.ndarray, u: float, h: float) -> np.ndarray:
    """Hold the force u [N] for h [s] on the nonlinear model; states are (x, v, theta, omega)."""
    solution = solve_ivp(
        lambda _, y: derivatives(y, u), (0, h), state, method="DOP853", rtol=1e-12, atol=1e-14
    )
    return solution.y[:, -1]


@cache
def linear_model() -> tuple[np.ndarray, np.ndarray]:
    """Return A (4, 4) and B (4,) of (9), solved for x'' and theta''; state (x, v, theta, omega)."""
    mass = np.array([[M + m, -m * l], [-m * l, I + m * l**2]])
    # Columns: contributions of v, theta and u to the right-hand sides
    right = np.array([[-b, 0, 1], [0, m * g * l, 0]])
    by_v, by_theta, by_u = np.linalg.solve(mass, right).T
    A, B = np.zeros((4, 4)), np.zeros(4)
    A[0, 1] = A[2, 3] = 1
    A[[1, 3], 1], A[[1, 3], 2], B[[1, 3]] = by_v, by_theta, by_u
    return A, B


@cache
def hold(h: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero-order hold of the linear model over h [s]: Ad (4, 4), Bd (4,)."""
    A, B = linear_model()
    augmented = np.zeros((5, 5))
    augmented[:4, :4], augmented[:4, 4] = A, B
    phi = expm(augmented * h)
    return phi[:4, :4], phi[:4, 4]


def linear_response(state: Sequence[float], u: float, t: float) -> np.ndarray:
    """Return the state (x, v, theta, omega) of the linear model after t [s] of constant u [N]."""
    Ad, Bd = hold(t)
    return Ad @ np.asarray(state, float) + Bd * u


def difference_equation(ts: float = TS) -> tuple[np.ndarray, np.ndarray]:
    """Return num and den, each (4,), of (41): the zero-order hold of (40), without its s = 0."""
    q = (M + m) * (I + m * l**2) - (m * l) ** 2
    num = [m * l / q, 0]
    den = [1, b * (I + m * l**2) / q, -(M + m) * m * g * l / q, -b * m * g * l / q]
    numd, dend, _ = cont2discrete((num, den), ts, method="zoh")
    return numd.ravel(), dend


class Plant:
    """Cart and pendulum, initially at rest and upright, with the input held over each step."""

    def __init__(self, model: str = "linear"):
        self.model = model
        self.state = np.zeros(4)

    @property
    def theta(self) -> float:
        """Angle from the upright [rad]."""
        return float(self.state[2])

    def step(self, u: float, h: float) -> None:
        """Hold the force u [N] for h [s]."""
        respond = integrate if self.model == "nonlinear" else linear_response
        self.state = respond(self.state, u, h)


# --- controllers --------------------------------------------------------------------------------


class Controller:
    """Pid, PidRbf or IpidRbf, sampling at start + k ts.

    Attributes after a sample: e [rad], u, u_p, u_n [N], h (4,), w (4,) [N].
    """

    c = np.array([-2.0, -1.0, 1.0, 2.0])
    b = np.array([0.5, 0.5, 0.5, 0.5])

    def __init__(
        self,
        kind: str,
        *,
        previous_sample_terms: bool = False,
        anti_windup: bool = False,
        target: str = "own",
        w0: Sequence[float] = (0, 0, 0, 0),
        start: float = 0.0,
    ):
        self.kind = kind
        self.previous_sample_terms = previous_sample_terms
        self.anti_windup = anti_windup
        self.target = target
        self.start = start
        self.kp, self.ki, self.kd = 300.0, 500.0, 100.0
        self.u_max, self.eta, self.alpha = 100.0, 0.3, 0.05
        self.e = self.u = self.u_p = self.u_n = 0.0
        self.terms = (0.0, 0.0, 0.0)
        self.h = np.zeros(4)
        self.w = self.w_before = np.array(w0, float)

    def step(self, t: float, h: float, inputs: Sequence[float]) -> None:
        """Take the samples due in t <= start + k ts < t + h; inputs (r, y, d, u_supervisor)."""
        for _ in range(self._samples_before(t + h) - self._samples_before(t)):
            self.sample(*inputs)

    def _samples_before(self, t: float) -> int:
        return math.ceil((t - self.start) / TS - 1e-6)

    def sample(self, r: float, y: float, d: float = 0.0, u_supervisor: float = 0.0) -> None:
        """Take one sample: angles [rad] in, force `self.u` [N] out."""
        e = r - (y + d)
        now = (e, (e - self.e) / TS, self._sum(e))
        x1, x2, x3 = self.terms if self.previous_sample_terms else now
        sum_before = self.terms[2]
        self.terms, self.e = now, e
        self.u_p = self.kp * x1 + self.kd * x2 + self.ki * x3
        if self.kind != "Pid":
            self.h = np.exp(-((r - self.c) ** 2) / (2 * self.b**2))
            self.u_n = float(self.w @ self.h)
        self.u = min(max(self.u_p + self.u_n, -self.u_max), self.u_max)
        excess = self.u_p + self.u_n - self.u
        if self.anti_windup and (excess > 0 < e or excess < 0 > e):
            self.terms = (*now[:2], sum_before)
        if self.kind != "Pid":
            self._learn(u_supervisor if self.target == "supervisor" else self.u)

    def _sum(self, e: float) -> float:
        """Return the integral term [rad s]; the term of IPID-RBF leaks, (25)."""
        x3 = self.terms[2]
        return (x3 + e) * TS if self.kind == "IpidRbf" else x3 + e * TS

    def _learn(self, target: float) -> None:
        dw = -self.eta * (self.u_n - target) * self.h
        self.w, self.w_before = self.w + dw + self.alpha * (self.w - self.w_before), self.w


# --- signals ------------------------------------------------------------------------------------


def reference(signal: str, t: float, frequency: float) -> float:
    """Return r [rad] at t [s]; frequency [Hz]."""
    if signal == "step":
        return 1.0
    if signal == "sine":
        return math.sin(2 * math.pi * frequency * t)
    # At a jump the old value still applies: sin(4 pi) of the paper's last sample is rounded below
    # zero, and its errors are those before the jump. At t = 0 the sign is 0.
    half_periods = 2 * frequency * t
    jump = round(half_periods)
    if abs(half_periods - jump) < 2 * frequency * EDGE:
        return 0.0 if jump == 0 else math.copysign(1, jump % 2 - 0.5)
    return math.copysign(1, math.sin(math.pi * half_periods))


def disturbance(t: float, amplitude: float) -> float:
    """Return d [rad] at t [s]: a pulse from 5 s to 5.5 s."""
    return amplitude if 5 - EDGE <= t < 5.5 - EDGE else 0.0


# --- closed loop --------------------------------------------------------------------------------


def closed_loop(
    controller: str,
    signal: str = "step",
    amplitude: float = 0.0,
    *,
    target: str = "own",
    order: str = "sequential",
    start: float = TS,
    step: float = TS,
    steps: int = 20000,
    plant_model: str = "linear",
    w0: Sequence[float] = (0, 0, 0, 0),
    supervisor_w0: Sequence[float] = (0, 0, 0, 0),
    previous_sample_terms: bool | None = None,
) -> dict[str, np.ndarray]:
    """Run a loop of the paper; `amplitude` is the disturbance's [rad].

    Returns columns of shape (steps,), named as in the FMU loop.
    """

    def law(kind: str, target: str, w0: Sequence[float]) -> Controller:
        late = kind != "IpidRbf" if previous_sample_terms is None else previous_sample_terms
        return Controller(kind, previous_sample_terms=late, target=target, w0=w0, start=start)

    loops = [("controller", law(controller, target, w0), "plant", Plant(plant_model))]
    if target == "supervisor":
        supervisor = law("PidRbf", "own", supervisor_w0)
        loops.insert(0, ("supervisor", supervisor, "supervisor_plant", Plant(plant_model)))
    columns, frequency = defaultdict(list), 0.2 if signal == "sine" else 0.1
    for t in (start + step * np.arange(steps)).tolist():
        r, d = reference(signal, t, frequency), disturbance(t, amplitude)
        row = {"time": t, "source.r": r, "source.d": d}
        latched = [(law.u, plant.theta) for _, law, _, plant in loops]
        u_supervisor = latched[0][0]
        for (name, law, plant_name, plant), (u, theta) in zip(loops, latched, strict=True):
            law.step(t, step, (r, theta, d, u_supervisor))
            if order == "sequential":
                u = u_supervisor = law.u
            plant.step(u, step)
            parts = ["e", "u", "u_p"] + ["u_n"] * (law.kind != "Pid")
            row |= {f"{plant_name}.theta": theta, **{f"{name}.{p}": getattr(law, p) for p in parts}}
        for name, value in row.items():
            columns[name].append(value)
    return {name: np.array(values) for name, values in columns.items()}
