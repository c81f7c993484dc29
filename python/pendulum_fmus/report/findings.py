"""Findings of the paper's statements that are more than measures of the controllers.

Each is a function of the table of the statement that names it in `statements.toml`, and returns its
rows.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from .claims import Row, number
from .measures import MEASURES, bursts, largest, rms, roughness, variation
from .runs import FACTORS, GAINS, TRANSFER_FUNCTION, WEIGHTS
from .stability import (
    CENTRES,
    LAWS,
    NOMINAL,
    RAMP,
    held_plant,
    limit,
    nodes,
    printed_bound,
    radius,
)

if TYPE_CHECKING:
    from .statements import Table

SMALL = math.radians(20)
"""Angle up to which section 2 considers the linear model valid [rad]."""

CLOSE = 0.1
"""Relative difference below which two quantities are approximately equal."""

PRINTED = ("2.3566", "0.0883", "27.8285", "2.3094")
"""Coefficients of (40)."""

POWERS = ("4, 3, 3, 1", "4, 3, 2, 1")
"""Powers of s in the denominator, as printed in (40) and of (11) times the s that cancels."""

SAME = 1e-3
"""Angles that differ by less agree to within the width of a drawn line [rad]."""

ELIMINATED = 1e-6
"""Error below which it counts as eliminated [rad]."""

GENTLE = 1.0
"""Change between samples, or deviation, below which a force is gentle [N]."""

LARGE_ADJUSTMENTS = 3
"""Number of large adjustments that the paper counts."""


# --- the plant ----------------------------------------------------------------------------------


def coefficients() -> list[float]:
    """Return the coefficients of (11) for the paper's plant, in the order of PRINTED."""
    M, m, l, g, I, b = NOMINAL.values()  # noqa: E741
    q = (M + m) * (I + m * l**2) - (m * l) ** 2
    return [m * l / q, b * (I + m * l**2) / q, (M + m) * m * g * l / q, b * m * g * l / q]


def poles() -> np.ndarray:
    """Return the poles of the plant, without the one at 0 that cancels [1/s], shape (3,)."""
    _, friction, gravity, constant = coefficients()
    return np.roots([1, friction, -gravity, -constant])


def unstable(_: "Table") -> list[Row]:
    """Return the fastest pole of the plant."""
    fastest = float(np.max(poles().real))
    doubling = math.log(2) / fastest
    return [
        Row("fastest growing mode [1/s]", [fastest], fastest > 0),
        Row("time in which a deviation doubles [s]", [doubling]),
    ]


def sine_error(angle: float) -> float:
    """Return the error of sin φ ≈ −θ at θ [rad], in percent; φ = θ + π, so that sin φ = −sin θ."""
    return 100 * (angle / math.sin(angle) - 1)


def cosine_error(angle: float) -> float:
    """Return the error of cos φ ≈ −1 at θ [rad], in percent."""
    return 100 * (1 / math.cos(angle) - 1)


def linearized(_: "Table") -> list[Row]:
    """Return the errors of the linearized terms, which are judged where section 2 assumes θ."""
    rows = []
    for name, angle in (("20°", SMALL), ("1 rad, the set-point", 1.0)):
        for term, error in (("sin φ ≈ −θ", sine_error), ("cos φ ≈ −1", cosine_error)):
            judged = error(angle) < 100 * CLOSE if angle == SMALL else None
            rows.append(Row(f"{term} at {name} [%]", [error(angle)], judged))
    return rows


def printed_coefficients(_: "Table") -> list[Row]:
    """Compare the coefficients of (40) and (11)."""
    names = ("numerator, s²", "s³", "s², printed as s³", "s")
    return [
        *(
            Row(name, [printed, number(value, 6)], float(printed) == round(value, 4))
            for name, printed, value in zip(names, PRINTED, coefficients(), strict=True)
        ),
        Row("powers of the denominator", POWERS),
    ]


def discretized(table: "Table") -> list[Row]:
    """Compare (41) with the discretized plant."""
    apart = largest(table.data("PID").theta - table.data.loop(TRANSFER_FUNCTION).theta)
    return [Row("largest difference of θ, (41) against (9) [rad]", [apart], apart < SAME)]


# --- gains of the PID ---------------------------------------------------------------------------

SETTINGS = {
    "nominal" if factor == 1 else f"{'½' if factor < 1 else '2'} {gain}": (gain, factor)
    for gain in GAINS
    for factor in FACTORS
}
"""The gain and its factor of each setting of Figure 2."""


def measured(table: "Table", key: str) -> tuple[str, dict[str, float]]:
    """Return the title of a measure, and its value for each setting."""
    measure = MEASURES[key]
    values = {name: measure.of(table.data.gains(*setting)) for name, setting in SETTINGS.items()}
    return f"{measure.name} [{measure.unit}]", values


def residual(table: "Table") -> list[Row]:
    """Return the static errors, also by the closed form."""
    static = [float(trace.e[-1]) for trace in table.traces]
    size = [abs(value) for value in static]
    closed = [-RAMP / (factor * GAINS["ki"] - RAMP) for factor in FACTORS]
    return [
        Row("|e(20 s)| with 2 ki, below 1e-6 [rad]", size, size[-1] < ELIMINATED),
        Row("e(20 s) [rad]", static),
        Row("−b g / (ki − b g) [rad]", closed),
    ]


def damping(table: "Table") -> list[Row]:
    """Return whether more kd helps, and whether another kd does."""
    falling, smaller = [], []
    for key in ("overshoot", "settling_2"):
        name, values = measured(table, key)
        less, nominal, more = shown = [values[column] for column in table.columns]
        falling.append(Row(name.replace(" [", ", falling ["), shown, less > nominal > more))
        name = name.replace(" [", ", less than nominal [")
        smaller.append(Row(name, shown, min(less, more) < nominal))
    return falling + smaller


def best(table: "Table") -> list[Row]:
    """Compare the paper's gains with the best other setting."""
    rows = []
    for key in ("rising", "settling_2", "overshoot", "iae"):
        name, values = measured(table, key)
        nominal = values.pop("nominal")
        setting = min(values, key=values.__getitem__)
        rows.append(Row(name, [nominal, values[setting], setting], nominal <= values[setting]))
    return rows


def rule(table: "Table", key: str, *settings: str) -> list[Row]:
    """Return whether a measure is smaller after each of some changes."""
    name, values = measured(table, key)
    pairs = [(s, [values["nominal"], values[s]]) for s in (s.replace("_", " ") for s in settings)]
    return [Row(name.replace(" [", f", {s} ["), pair, pair[1] < pair[0]) for s, pair in pairs]


def bands(table: "Table") -> list[Row]:
    """Return the bands [%] in which the settling times of a step round to those of the text."""
    found = []
    for kind, printed in (("PID-RBF", 3.8), (table.ipid, 2.5)):
        trace = table.data(kind)
        # The largest error from each sample on: the loop settles there in bands of at least that
        later = 100 * np.maximum.accumulate(np.abs(trace.e[::-1]))[::-1]
        rounds = np.flatnonzero(np.abs(trace.t - printed) < 0.05 - 1e-9)
        found.append((later[rounds[-1]], later[rounds[0] - 1]))
    low, high = max(a for a, _ in found), min(b for _, b in found)
    shown = [f"{number(a, 3)} to {number(b, 3)}" for a, b in found]
    both = f"{number(low, 3)} to {number(high, 3)}" if low < high else "none"
    return [
        Row("bands that give the printed time [%]", ["", *shown]),
        Row("bands that give both [%]", ["", both, both], low < high),
    ]


# --- the network --------------------------------------------------------------------------------


def linear(_: "Table") -> list[Row]:
    """Double the weights, and double the input."""
    by_weights = float(nodes() @ np.full(4, 2.0) / nodes().sum())
    by_input = float(nodes(2.0).sum() / nodes(1.0).sum())
    return [
        Row("all weights doubled [1]", [by_weights], abs(by_weights - 2) < CLOSE),
        Row("input doubled, from 1 rad to 2 rad [1]", [by_input], abs(by_input - 2) < CLOSE),
    ]


def convex(_: "Table") -> list[Row]:
    """Return the curvature of the performance indicator for a fixed force."""
    smallest = round(float(np.linalg.eigvalsh(np.outer(nodes(), nodes())).min()), 12) + 0.0
    return [Row("smallest eigenvalue of ∂²E/∂w² = h hᵀ [1]", [smallest], smallest >= 0)]


def derivatives(table: "Table") -> list[Row]:
    """Return the approximation (17), from two runs whose initial weights differ."""
    base, moved = (table.data.loop(loop) for loop in WEIGHTS)
    rows = []
    for k, name in enumerate(("the same sample", "one sample later", "two samples later")):
        share = float((moved.u_p[k] - base.u_p[k]) / (moved.u_n[0] - base.u_n[0]))
        title = f"∂u_p/∂w, {name}, relative to ∂u_n/∂w [1]"
        rows.append(Row(title, [share], abs(share - 1) < CLOSE))
    return rows


def performance(table: "Table") -> list[Row]:
    """Compare the two performance indicators if the error is that of the angle."""
    trace, rows = table.data("PID-RBF"), []
    for time in (0.01, 0.5, 5.0):
        k = int(np.searchsorted(trace.t, time - 1e-9))
        share = float((trace.u_n[k] - trace.u[k]) ** 2 / trace.e[k] ** 2)
        rows.append(Row(f"E/(½ e²) at {time:g} s [N²/rad²]", [share], abs(share - 1) < CLOSE))
    return rows


def bound(_: "Table", error: str) -> list[Row]:
    """Compare the printed bound with the eigenvalues of the loop, by what the error is.

    Its derivative with respect to the weights is h for the force, while u is held fixed, and h
    times the response of the angle after one sample for the angle.
    """
    law, rows = LAWS["PID-RBF"], []
    printed = printed_bound()
    if error == "angle":
        printed /= float(held_plant()[1][1]) ** 2
    for eta in (share * printed for share in (0.15, 0.25, 0.5, 0.99)):
        rho = radius(law, eta)
        rows.append(Row(f"spectral radius at η = {number(eta, 3)} [1]", [rho], rho < 1))
    return [*rows, Row("largest stable η [1]", [limit(law)])]


def positive(_: "Table") -> list[Row]:
    """Return the smallest output of a node for |r| up to 1 rad."""
    smallest = min(float(nodes(r).min()) for r in np.linspace(-1, 1, 201))
    return [Row("smallest h_j [1]", [smallest], smallest > 0)]


def simple(table: "Table") -> list[Row]:
    """Count what IPID-RBF needs beside itself."""
    network = 3 + 2 * len(CENTRES) + 2  # gains; centres and widths; learning rate and momentum
    beside = {
        "controllers beside it": [0, 0, 1, 0],
        "models of the plant beside it": [0, 0, 1, 0],
    }
    at = 2 if table.ipid == "IPID-RBF" else 3
    return [
        *(Row(name, values, values[at] == 0) for name, values in beside.items()),
        Row("parameters to choose", [3, network, network, network]),
    ]


# --- the force ----------------------------------------------------------------------------------


def smooth(table: "Table") -> list[Row]:
    """Return how much the force varies, beside the PID's."""
    pid = table.data("PID", "square")
    traces = [*table.traces, pid]
    table.columns.append("PID")
    total, own = ([variation(getattr(t, name)) for t in traces] for name in ("u", "u_p"))
    less = all(a < b for a, b in zip(total[:-1], own[:-1], strict=True))
    rough = [roughness(trace) for trace in traces]
    return [
        Row("total variation of u_p [N]", own, less),
        Row("total variation of u [N]", total),
        Row(MEASURES["roughness"].title(), rough, max(rough[:-1]) < GENTLE),
    ]


def adjustments(table: "Table", until: str, *columns: str) -> list[Row]:
    """Count the large adjustments of some columns before a time [s]."""
    rows = []
    for column in columns:
        parts = [trace.part((0, float(until))) for trace in table.traces]
        found = [bursts(part.t, getattr(part, column)) for part in parts]
        shown = [", ".join(map(number, times)) or "none" for times in found]
        holds = all(len(times) == LARGE_ADJUSTMENTS for times in found)
        rows.append(Row(f"times at which {column} exceeds 50 N [s]", shown, holds))
    return rows


def ramps(table: "Table") -> list[Row]:
    """Return how far u_n and u stay off a line, and its slope, beside the PID's u."""
    slopes, rest, columns = [], [], []
    pid = table.data("PID", table.traces[0].signal, table.traces[0].amplitude)
    for trace, kind in zip([*table.traces, pid], [*table.columns, "PID"], strict=True):
        late = trace.part((15.0, 21.0))
        for name in ("u",) if trace is pid else ("u_n", "u"):
            line = np.polyfit(late.t, getattr(late, name), 1)
            columns.append(f"{name} of {kind}")
            slopes.append(float(line[0]))
            rest.append(rms(getattr(late, name) - np.polyval(line, late.t)))
    table.columns[:] = columns
    return [
        Row("RMS off a line from 15 s on [N]", rest, max(rest[:-1]) < GENTLE),
        Row("slope of this line [N/s]", slopes),
    ]


def larger(table: "Table") -> list[Row]:
    """Compare u_n with u_n of the undisturbed sine."""
    rows = []
    for kind in ("PID-RBF", table.ipid):
        values = [largest(table.data(kind, "sine", a).u_n) for a in (0.0, 1.0, 2.0)]
        rows.append(Row(f"max |u_n|, {kind} [N]", values, values[1] > values[0]))
    return rows
