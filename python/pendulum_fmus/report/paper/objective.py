"""Section 2 and (40), (41): the plant, and how far its linear model is valid."""

import math

import numpy as np

from ..claims import Claim, Finding, Row
from ..data import Data, Trace
from ..metrics import largest
from ..numbers import number
from ..scenarios import TRANSFER_FUNCTION
from ..stability import NOMINAL
from .compare import COLUMNS, Values, by_signal
from .entry import Entry

SMALL = math.radians(20)
"""Angle up to which the paper considers the linear model valid [rad]."""

CLOSE = 0.1
"""Relative error below which a term counts as linearized."""

PRINTED = ("2.3566", "0.0883", "27.8285", "2.3094")
"""Coefficients of (40)."""

SAME = 1e-3
"""Angles that differ by less agree to within the width of a drawn line [rad]."""


def coefficients() -> list[float]:
    """Return the coefficients of (11) for the paper's plant, in the order of PRINTED."""
    M, m, l, g, I, b = NOMINAL.values()  # noqa: E741
    q = (M + m) * (I + m * l**2) - (m * l) ** 2
    return [m * l / q, b * (I + m * l**2) / q, (M + m) * m * g * l / q, b * m * g * l / q]


def poles() -> np.ndarray:
    """Return the poles of the plant, without the one at 0 that cancels [1/s], shape (3,)."""
    _, friction, gravity, constant = coefficients()
    return np.roots([1, friction, -gravity, -constant])


def unstable(_: str) -> Finding:
    """Return the fastest pole of the plant."""
    fastest = float(np.max(poles().real))
    doubling = math.log(2) / fastest
    return Finding(
        ["plant"],
        [
            Row("fastest growing mode [1/s]", [fastest], fastest > 0),
            Row("time in which a deviation doubles [s]", [doubling]),
        ],
    )


def small(data: Data) -> Claim:
    """Return the statement that the angle stays small enough to linearize."""

    def degrees(trace: Trace) -> float:
        return math.degrees(largest(trace.theta))

    def finding(ipid: str) -> Finding:
        def holds(values: Values) -> bool:
            return max(values[kind] for kind in ("PID", "PID-RBF", ipid)) <= math.degrees(SMALL)

        return Finding(
            COLUMNS,
            by_signal(data, "largest |θ|", "°", degrees, holds),
            "All simulations of the paper leave the range of its linearization. The section"
            " “The nonlinear pendulum” shows the difference.",
        )

    return Claim(
        "Section 2: “Suppose that θ ≤ 20° is within the error range of keeping stability.”",
        "|θ| of PID, PID-RBF and IPID-RBF stays within 20°, with each signal",
        finding,
    )


def linearized(_: str) -> Finding:
    """Return the errors of the linearized terms; φ = θ + π, so that sin φ = -sin θ."""
    rows = []
    for name, angle in (("20°", SMALL), ("1 rad, the set-point", 1.0)):
        sine, cosine = angle / math.sin(angle), 1 / math.cos(angle) - 1
        rows += [
            Row(f"sin φ = θ at {name} [%]", [100 * (sine + 1)], sine + 1 < CLOSE),
            Row(f"sin φ ≈ −θ, as (8) and (9) need it, at {name} [%]", [100 * (sine - 1)]),
            Row(f"cos φ ≈ −1 at {name} [%]", [100 * cosine], cosine < CLOSE),
        ]
    return Finding(["error"], rows, "The sign of sin φ is a misprint: (9) has the correct one.")


def printed_coefficients(_: str) -> Finding:
    """Compare the coefficients of (40) with those of (11)."""
    rows = [
        Row(name, [printed, number(value, 6)], float(printed) == round(value, 4))
        for name, printed, value in zip(
            ("numerator, s²", "s³", "s², printed as s³", "s"), PRINTED, coefficients(), strict=True
        )
    ]
    rows.append(Row("powers of the denominator", ["4, 3, 3, 1", "4, 3, 2, 1"], False))
    return Finding(
        ["printed", "from (11)"],
        rows,
        "The second s³ is a misprint for s². One s cancels, so that (41) is of third order.",
    )


def discretized(data: Data) -> Claim:
    """Return the statement that (41) is the discretized plant."""

    def finding(_: str) -> Finding:
        held, difference = data("PID", "step"), data.loop(TRANSFER_FUNCTION)
        apart = largest(held.theta - difference.theta)
        return Finding(
            ["PID, step"],
            [Row("largest difference of θ, (41) against (9) [rad]", [apart], apart < SAME)],
        )

    return Claim(
        "Section 4: “The discretized object after z transformation is” (41)",
        "the loop with the difference equation (41) and that with the state space of (9), under a"
        " zero-order hold, differ by less than 0.001 rad over 20 s",
        finding,
    )


def entry(data: Data) -> Entry:
    """Return the statements about the plant."""
    return Entry(
        "plant",
        "Sections 2 and 4: the plant",
        "",
        None,
        [
            Claim(
                "Introduction: “it is an unstable […] system”",
                "a pole of (11) has a positive real part",
                unstable,
            ),
            small(data),
            Claim(
                "Section 2: “therefore, cos φ ≈ −1, sin φ = θ”",
                "the errors of both terms are below 10 %, at 20° and at the set-point",
                linearized,
            ),
            Claim(
                "Section 4: “The transfer function can be expressed as” (40)",
                "each coefficient is that of (11), rounded to the printed digits, at its power",
                printed_coefficients,
            ),
            discretized(data),
        ],
    )
