"""What Table 1 becomes with the mistakes that its text suggests.

`statements.toml` lists the mistakes. Most are start values of the FMUs. Three misprints are not:
the update (18) with the factor h twice, the terms (21) as the network's input, and the powers of
(40). They are read literally, in plain Python.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from ..loop import FREQUENCY, STEPS, TS, Columns, Loop
from .claims import number
from .findings import PRINTED, coefficients
from .measures import LIMIT
from .runs import GAINS, SHOWN, SIGNALS, loop_of, simulate_all
from .stability import ALPHA, CENTRES, ETA, NOMINAL, WIDTH

AMPLITUDES = (0.0, 1.0)
"""Disturbances of Table 1 [rad]."""

SAME = "="
"""Stands for an error that a mistake does not change."""

UNCHANGED = 1e-3
"""Relative change of an error that four printed digits may hide."""

DIVERGED = 1e3
"""A pendulum with a larger error has long fallen [rad]."""

CYCLE = math.inf
"""Stands for an error in a limit cycle: the last bit of a coefficient changes its second digit."""

RINGING = 1.0
"""A force that often changes by more than this per sample at the end is in a limit cycle [N]."""

LATE = 1500
"""Samples at the end in which a limit cycle is sought: a sine's last maximum is among them."""

VANISHED = 1e-9
"""Errors below this have decayed to rounding residue, and are not compared [rad]."""

Case = tuple[str, float, str]
"""Signal, disturbance [rad] and controller of a number of Table 1."""

Errors = dict[Case, float]

Trap = Mapping[str, Any]
"""A mistake, as in the file."""

RIGHT: Trap = {}
"""No mistake."""

COMPONENTS = {
    "controllers": ("Pid", "PidRbf", "IpidRbf"),
    "networks": ("PidRbf", "IpidRbf"),
    "IPID-RBF": ("IpidRbf",),
    "plants": ("Pendulum",),
    "source": ("Source",),
}
"""The FMUs whose start values a mistake changes."""


# --- plants -------------------------------------------------------------------------------------


def equivalent(a: float, b: float, c: float, d: float) -> dict[str, float]:
    """Return parameters of a plant with G(s) = a s / (s³ + b s² - c s - d).

    Any such plant is a pendulum on a cart, though of other masses. g and l are the paper's.
    """
    gravity, length = NOMINAL["g"], NOMINAL["l"]
    total, friction = c / (a * gravity), d / (a * gravity)
    q = (total * b / friction - 1) / a**2
    inertia, mass = b / friction * q, a * q / length
    return {"M": total - mass, "m": mass, "I": inertia - mass * length**2, "b": friction}


def literal_9() -> dict[str, float]:
    """Return a plant with (9) as printed, with theta in place of its second derivative."""
    M, m, l, g, I, b = NOMINAL.values()  # noqa: E741
    total, inertia, moment = M + m, I + m * l**2, m * l
    q = total * inertia
    return equivalent(
        moment / q, b / total, (total * moment * g + moment**2) / q, b * moment * g / q
    )


def literal_11() -> dict[str, float]:
    """Return a plant with q as printed in (11)."""
    M, m, l, _, I, _ = NOMINAL.values()  # noqa: E741
    q = (M + m) * (I + m * l**2)
    share = (q - (m * l) ** 2) / (q - m * l**2)
    return equivalent(*(share * value for value in coefficients()))


def rounded_40() -> dict[str, float]:
    """Return a plant with the rounded coefficients of (40)."""
    return equivalent(*map(float, PRINTED))


PLANTS = {"(9)": literal_9, "(11)": literal_11, "(40)": rounded_40}


# --- mistakes in the FMUs -----------------------------------------------------------------------


def changed(trap: Trap, loop: Loop) -> Loop:
    """Put a mistake into a loop."""
    settings = PLANTS[trap["plant"]]() if "plant" in trap else trap.get("set", {})
    fmus = COMPONENTS[trap.get("of", "plants")]
    scalars = []
    for name, value in settings.items():
        listed = isinstance(value, list)
        scalars += (
            [(f"{name}[{j}]", x) for j, x in enumerate(value, 1)] if listed else [(name, value)]
        )
    components = [component for component, fmu in loop.models().items() if fmu in fmus]
    pairs = [(f"{c}.{name}", value) for c in components for name, value in scalars]
    disturbance = trap.get("disturbed", 1.0) * loop.disturbance
    return replace(loop, overrides=tuple(pairs), disturbance=disturbance, **trap.get("loop", {}))


def cases(trap: Trap) -> dict[Case, Loop]:
    """Return the loop of each number that a mistake can affect."""
    return {
        (signal, amplitude, kind): changed(trap, loop_of(kind, signal, amplitude))
        for signal in trap.get("signals", SIGNALS)
        for amplitude in AMPLITUDES
        for kind in SHOWN
    }


def errors(trap: Trap, results: Mapping[Loop, Columns]) -> Errors:
    """Return the numbers of Table 1 with a mistake [rad]; NaN if the loop diverges, or CYCLE."""
    found = {}
    for case, loop in cases(trap).items():
        columns, controller = results[loop], "supervisor" if case[2] == "PID-RBF" else "controller"
        found[case] = np.nan
        if columns:
            e, r = columns[f"{controller}.e"], columns["source.r"]
            found[case] = float(e[trap.get("sample", -1)] - trap.get("jump", 0) * r[-1])
            # A jump of the set-point is a single large change
            if np.mean(np.abs(np.diff(columns[f"{controller}.u"])) > RINGING) > 0.05:
                found[case] = CYCLE
    return found


# --- mistakes that are read literally -----------------------------------------------------------


def set_point(signal: str, k: int) -> float:
    """Return r(k) [rad]; at a jump the value from before it."""
    if signal == "step":
        return 1.0
    sine = math.sin(2 * math.pi * FREQUENCY[signal] * k * TS)
    if signal == "sine":
        return sine
    return 1.0 if round(2 * FREQUENCY[signal] * TS * (k - 0.5) - 0.5) % 2 == 0 else -1.0


def nodes(inputs: Sequence[np.ndarray]) -> np.ndarray:
    """Return the outputs (12) of the nodes for the components of an input, in the first axis."""
    centres = CENTRES.reshape(-1, *(1 for _ in inputs[0].shape))
    squares = sum((value - centres) ** 2 for value in inputs)
    exp = np.vectorize(math.exp)  # whose last bits do not depend on the processor
    return exp(-squares / (2 * WIDTH**2))


@np.errstate(over="ignore", invalid="ignore")
def read_literally(reading: str) -> Errors:
    """Return the numbers of Table 1 [rad] by a reading of the paper; huge or NaN without control.

    The readings are "powers": the plant is (40) as printed; "squared": the weights are updated by
    the second line of (18), with h² in place of h; "vector": the network's input is (21) in place
    of r. Arrays have a row for each signal and disturbance, and a column for each controller.
    """
    cases = [(signal, amplitude) for signal in SIGNALS for amplitude in AMPLITUDES]
    r = np.array([[[set_point(s, k)] for s, _ in cases] for k in range(1, STEPS + 1)])
    d, h = np.array([[amplitude] for _, amplitude in cases]), nodes([r])
    a, b, c, last = coefficients()
    if reading == "powers":
        a, cubic, other, last = map(float, PRINTED)
        b, c = cubic - other, 0.0
    # G(s) = a s / (s³ + b s² - c s - d) under a zero-order hold; the last column is the force
    rates = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [last, c, -b, 1], [0, 0, 0, 0]])
    plant = expm(TS * rates)[:3]
    x, y, z, e, x2, x3, total = np.zeros((7, len(cases), 3))
    w = before = np.zeros((len(CENTRES), len(cases), 3))
    leaks, learns = np.array([False, False, True]), np.array([0.0, 1.0, 1.0])
    for k in range(STEPS):
        previous, terms = e, (e, x2, x3)
        e = r[k] - (a * y + d * (4999 <= k < 5499))
        x2 = (e - previous) / TS
        x3 = np.where(leaks, (x3 + e) * TS, x3 + e * TS)
        total = total + e
        # IPID-RBF, whose sum leaks (25), has the terms of this sample
        x1_, x2_, x3_ = (np.where(leaks, *pair) for pair in zip((e, x2, x3), terms, strict=True))
        u_p = GAINS["kp"] * x1_ + GAINS["kd"] * x2_ + GAINS["ki"] * x3_
        now = nodes((e, total, e - previous)) if reading == "vector" else h[:, k]
        u_n = sum(weight * node for weight, node in zip(w, now, strict=True))
        u = np.clip(u_p + u_n, -LIMIT, LIMIT)
        # Both networks learn the force of PID-RBF
        step, power = -ETA * (u_n - u[:, [1]]) * learns, 2 if reading == "squared" else 1
        before, w = w, w + step * now**power + ALPHA * (w - before)
        x, y, z = (row[0] * x + row[1] * y + row[2] * z + row[3] * u for row in plant)
    found = dict(zip(cases, np.where(np.isfinite(e), e, np.nan).tolist(), strict=True))
    return {
        (*case, kind): e for case, es in found.items() for kind, e in zip(SHOWN, es, strict=True)
    }


# --- the tables ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Traps:
    """The numbers of Table 1 [rad] without a mistake, and with each."""

    right: Errors
    wrong: Sequence[tuple[Trap, Errors]]

    def tables(self) -> list[dict[str, Any]]:
        """Return for each signal the right numbers, and the mistakes that change one of them."""
        found = []
        for signal in SIGNALS:
            cases = [case for case in self.right if case[0] == signal]
            rows = []
            for trap, values in self.wrong:
                cells = [
                    self._cell(values[case], self.right[case]) for case in cases if case in values
                ]
                if set(cells) - {SAME}:
                    rows.append((trap, cells))
            right = [shown(self.right[case]) for case in cases]
            found.append({"signal": signal, "right": right, "rows": rows})
        return found

    @staticmethod
    def _cell(value: float, right: float) -> str:
        vanished = max(abs(value), abs(right)) < VANISHED
        return SAME if vanished or abs(value - right) <= UNCHANGED * abs(right) else shown(value)

    def facts(self) -> dict[str, dict[str, float]]:
        """Return the numbers by the key of the mistake, "right" without one, and the case."""
        named = {"right": self.right} | {t["key"]: values for t, values in self.wrong if "key" in t}
        return {
            key: {f"{s} {a:g} {kind}": value for (s, a, kind), value in values.items()}
            for key, values in named.items()
        }


def shown(value: float) -> str:
    """Return an error as text."""
    if value == CYCLE:
        return "limit cycle"
    return number(value) if abs(value) < DIVERGED else "diverges"


def run(traps: Sequence[Trap], fmus: Path, pool: Pool) -> Traps:
    """Simulate all mistakes."""
    readings = {trap["reading"] for trap in traps if "reading" in trap}
    literal = {one: pool.apply_async(read_literally, (one,)) for one in readings}
    coupled = [RIGHT, *(trap for trap in traps if "reading" not in trap)]
    loops = {loop for trap in coupled for loop in cases(trap).values()}
    results = simulate_all(loops, fmus, pool, only=("e", "r", "u"), last=LATE, may_diverge=True)

    def wrong(trap: Trap) -> Errors:
        return literal[trap["reading"]].get() if "reading" in trap else errors(trap, results)

    return Traps(errors(RIGHT, results), [(trap, wrong(trap)) for trap in traps])
