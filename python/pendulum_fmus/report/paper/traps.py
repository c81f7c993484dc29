"""What Table 1 becomes with the mistakes that its text suggests."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np

from ...loop import Columns, Loop
from ..native import simulate_all
from ..numbers import number
from ..scenarios import SIGNALS, loops_of
from ..stability import NOMINAL
from . import literal
from .curves import SHOWN
from .literal import Reading
from .objective import PRINTED, coefficients

AMPLITUDES = (0.0, 1.0)
"""Disturbances of Table 1 [rad]."""

SAME = "="
"""Stands for an error that a mistake does not change."""

UNCHANGED = 1e-3
"""Relative change of an error that four printed digits may hide."""

DIVERGED = 1e3
"""A pendulum with a larger error has long fallen [rad]."""

VANISHED = 1e-9
"""Errors below this have decayed to rounding residue, and are not compared [rad]."""

Change = Callable[[Loop], Loop]
Case = tuple[str, float, str]
"""Signal, disturbance [rad] and controller of a number of Table 1."""


def last(e: np.ndarray, _: np.ndarray) -> float:
    """Return e(20000)."""
    return float(e[-1])


@dataclass(frozen=True)
class Trap:
    """A mistake.

    Parameters
    ----------
    name
        The mistake.
    instead
        What reproduces Table 1.
    change
        Function that puts the mistake into a loop.
    read
        Function of the error and the set-point that reads the number.
    signals
        The signals that it can affect.
    reading
        How the paper is read, for a mistake that no parameter of the FMUs can make.
    """

    name: str
    instead: str
    change: Change = lambda loop: loop
    read: Callable[[np.ndarray, np.ndarray], float] = last
    signals: Sequence[str] = SIGNALS
    reading: Reading | None = None


def override(loop: Loop, names: Sequence[str], settings: Mapping[str, Any]) -> Loop:
    """Set variables of those of some components that a loop has."""
    present = [name for name in names if name in loop.models()]
    pairs = tuple((f"{name}.{key}", value) for name in present for key, value in settings.items())
    return replace(loop, overrides=(*loop.overrides, *pairs))


def controllers(**settings: Any) -> Change:
    """Change all controllers; a period in a name is written as two underscores."""
    named = {name.replace("__", "."): value for name, value in settings.items()}
    return lambda loop: override(loop, ["controller", "supervisor"], named)


def networks(settings: Mapping[str, Any]) -> Change:
    """Change all controllers that have a network."""

    def change(loop: Loop) -> Loop:
        names = [n for n, model in loop.models().items() if model in ("PidRbf", "IpidRbf")]
        return override(loop, names, settings)

    return change


def plants(settings: Mapping[str, Any]) -> Change:
    """Change all plants."""
    return lambda loop: override(loop, ["plant", "supervisor_plant"], settings)


def source(**settings: Any) -> Change:
    """Change the set-point."""
    return lambda loop: override(loop, ["source"], settings)


def disturbed_by_two(loop: Loop) -> Loop:
    """Double the disturbance."""
    return replace(loop, disturbance=2 * loop.disturbance)


def own_target(loop: Loop) -> Loop:
    """Let IPID-RBF learn its own force; PID-RBF is then its own loop."""
    own = {"rbf.target": "own"}
    return override(loop, ["controller"], own) if loop.target == "supervisor" else loop


def vector(name: str, values: Sequence[float]) -> dict[str, float]:
    """Return the elements of an array by name."""
    return {f"rbf.{name}[{j}]": value for j, value in enumerate(values, start=1)}


def equivalent(a: float, b: float, c: float, d: float) -> dict[str, float]:
    """Return parameters of a plant with G(s) = a s / (s³ + b s² - c s - d).

    Any such plant is a pendulum on a cart, though of other masses. g and l are those of the paper.
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


TRAPS = (
    Trap(
        "sign(0) = 0 at k = 20000, where the sine of the square wave crosses zero",
        "the value from before the jump holds",
        read=lambda e, r: float(e[-1] - r[-1]),
        signals=("square",),
    ),
    Trap(
        "new value of the square wave at k = 20000, where it jumps",
        "the value from before the jump holds",
        read=lambda e, r: float(e[-1] - 2 * r[-1]),
        signals=("square",),
    ),
    Trap("force not limited", "±100 N", controllers(u_max=1e9)),
    Trap("force limited to ±50 N", "±100 N", controllers(u_max=50.0)),
    Trap("force limited to ±200 N", "±100 N", controllers(u_max=200.0)),
    Trap("sine of 0.1 Hz", "0.2 Hz", source(frequency=0.1), signals=("sine",)),
    Trap("sin(t)", "sin(2π · 0.2 t)", source(frequency=1 / (2 * np.pi)), signals=("sine",)),
    Trap("sine of 1 Hz", "0.2 Hz", source(frequency=1.0), signals=("sine",)),
    Trap("square wave of 0.2 Hz", "0.1 Hz", source(frequency=0.2), signals=("square",)),
    Trap(
        "disturbance of two, as the text says for sine and square wave",
        "of one, in all rows",
        disturbed_by_two,
    ),
    Trap(
        "first sample at t = 0, so that k = 20000 is at 19.999 s",
        "first sample at t = 0.001 s",
        read=lambda e, _: float(e[-2]),
    ),
    Trap(
        "PID and PID-RBF with the terms of sample k, as printed in (20)",
        "of sample k − 1",
        lambda loop: replace(loop, previous_sample_terms=False),
    ),
    Trap(
        "IPID-RBF with the terms of sample k − 1",
        "of sample k, as printed in (25)",
        lambda loop: replace(loop, previous_sample_terms=True),
    ),
    Trap(
        "parallel (Jacobi) stepping, one sample of delay more",
        "sequential, controller first",
        lambda loop: replace(loop, order="parallel"),
    ),
    Trap(
        "IPID-RBF learns its own force, as printed in (29)",
        "it learns that of a PID-RBF loop",
        own_target,
    ),
    Trap(
        "difference and sum of e without the sample time, as printed in (21)",
        "(e(k) − e(k − 1))/ts and Σ e ts",
        controllers(pid__kd=0.1, pid__ki=5e5),
    ),
    Trap(
        "widths c and centres b, as printed in (42), (43)",
        "centres c and widths b",
        networks(vector("c", [0.5] * 4) | vector("b", [2.0, 1.0, 1.0, 2.0])),
    ),
    Trap(
        "learning rate and momentum interchanged",
        "η = 0.30, α = 0.05",
        networks({"rbf.eta": 0.05, "rbf.alpha": 0.3}),
    ),
    Trap("no momentum", "α = 0.05", networks({"rbf.alpha": 0.0})),
    Trap(
        "initial weights 0.8147, 0.9058, 0.1270, 0.9134, the first of rand in MATLAB",
        "small ones; 0 here",
        networks(vector("w0", [0.8147, 0.9058, 0.1270, 0.9134])),
    ),
    Trap(
        "initial weights 0.5377, 1.8339, −2.2588, 0.8622, the first of randn in MATLAB",
        "small ones; 0 here",
        networks(vector("w0", [0.5377, 1.8339, -2.2588, 0.8622])),
    ),
    Trap("(9) as printed, with θ", "with θ''", plants(literal_9())),
    Trap("q as printed in (11), with ml²", "with (ml)²", plants(literal_11())),
    Trap(
        "coefficients as printed in (40), rounded",
        "those of (11)",
        plants(equivalent(*map(float, PRINTED))),
    ),
    Trap(
        "(40) as printed, with two terms in s³",
        "the second in s²",
        reading=Reading(printed_powers=True),
    ),
    Trap(
        "update with h², the second line of (18) as printed",
        "with h",
        reading=Reading(squared=True),
    ),
    Trap(
        "the network reads the vector (21), as printed",
        "it reads r(k)",
        reading=Reading(terms_as_input=True),
    ),
    Trap("g = 9.81", "9.8", plants({"g": 9.81})),
    Trap("nonlinear plant (7), (8)", "the linear one", plants({"model": "nonlinear"})),
)


def changed(trap: Trap) -> dict[Case, tuple[Loop, str]]:
    """Return the loop of each number that a mistake can affect, and the variable to read."""
    found = {}
    for signal in trap.signals:
        for amplitude in AMPLITUDES:
            loops = loops_of(signal, amplitude)
            for kind in SHOWN:
                loop, controller, _ = loops[kind]
                found[signal, amplitude, kind] = (trap.change(loop), f"{controller}.e")
    return found


RIGHT = Trap("none", "")
"""No mistake."""

Errors = dict[Case, float]


def errors(trap: Trap, results: Mapping[Loop, Columns]) -> Errors:
    """Return the numbers of Table 1 with a mistake [rad]; NaN if the loop diverges."""
    found = {}
    for case, (loop, variable) in changed(trap).items():
        columns = results[loop]
        found[case] = trap.read(columns[variable], columns["source.r"]) if columns else np.nan
    return found


def same(value: float, right: float) -> bool:
    """Return whether an error is the one without the mistake."""
    if max(abs(value), abs(right)) < VANISHED:
        return True
    return abs(value - right) <= UNCHANGED * abs(right)


@dataclass(frozen=True)
class Lookup:
    """The numbers of one signal, by mistake.

    Parameters
    ----------
    signal
        The signal.
    right
        The six numbers without a mistake, of AMPLITUDES times SHOWN.
    rows
        The mistake, and a number or SAME for each of the six; only mistakes that change one.
    """

    signal: str
    right: Sequence[str]
    rows: Sequence[tuple[Trap, Sequence[str]]]


@dataclass(frozen=True)
class Traps:
    """The numbers of Table 1 without and with each mistake.

    Parameters
    ----------
    right
        Without a mistake [rad].
    wrong
        With each mistake [rad].
    """

    right: Errors
    wrong: Mapping[Trap, Errors]

    def lookup(self, signal: str) -> Lookup:
        """Return the table of a signal."""
        cases = [case for case in self.right if case[0] == signal]
        rows = []
        for trap, values in self.wrong.items():
            if signal not in trap.signals:
                continue
            cells = [SAME if same(values[c], self.right[c]) else shown(values[c]) for c in cases]
            if set(cells) != {SAME}:
                rows.append((trap, cells))
        return Lookup(signal, [shown(self.right[case]) for case in cases], rows)

    def lookups(self) -> list[Lookup]:
        """Return the tables of all signals."""
        return [self.lookup(signal) for signal in SIGNALS]

    def named(self) -> dict[str, Errors]:
        """Return the numbers by name of the mistake."""
        return {trap.name: values for trap, values in self.wrong.items()}


def shown(value: float) -> str:
    """Return an error as text."""
    return number(value) if abs(value) < DIVERGED else "diverges"


def run(fmus: Path, pool: Pool) -> Traps:
    """Simulate all mistakes."""
    started = {
        trap: pool.apply_async(read_literally, (trap.reading,)) for trap in TRAPS if trap.reading
    }
    coupled = [trap for trap in (RIGHT, *TRAPS) if not trap.reading]
    loops = {loop for trap in coupled for loop, _ in changed(trap).values()}
    results = simulate_all(loops, fmus, pool, only=("e", "r"), last=2, may_diverge=True)
    return Traps(
        errors(RIGHT, results),
        {trap: started[trap].get() if trap.reading else errors(trap, results) for trap in TRAPS},
    )


def read_literally(reading: Reading) -> Errors:
    """Return the numbers of Table 1 as read from the paper [rad]."""
    return {
        (signal, amplitude, controller): e
        for signal in SIGNALS
        for amplitude in AMPLITUDES
        for controller, e in literal.errors(reading, signal, amplitude).items()
    }
