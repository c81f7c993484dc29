"""What the paper prints wrongly, and what it leaves out: each with its evidence.

The numbers of the evidence are those of the runs with the mistakes.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...table1 import rounded
from ..numbers import number
from .objective import PRINTED, coefficients
from .traps import Case, Errors


@dataclass(frozen=True)
class Correction:
    """A misprint.

    Parameters
    ----------
    where, printed, correct, evidence
        Place in the paper, what it prints, what is correct, and how that is known.
    """

    where: str
    printed: str
    correct: str
    evidence: str


@dataclass(frozen=True)
class Setting:
    """Something that the paper does not give.

    Parameters
    ----------
    name, value, evidence
        What it is, the value that reproduces Table 1, and how that is known.
    """

    name: str
    value: str
    evidence: str


def corrections() -> list[Correction]:
    """Return the misprints in the order of the paper."""
    numerator, cubic, square, linear = PRINTED
    # s⁴ + 0.0883 s³ - 27.8285 s³ - 2.3094 s, without the s that cancels
    poles = np.roots([1, float(cubic) - float(square), 0, -float(linear)])
    return [
        Correction(
            "(2), (5)",
            "ml d²(cos φ)/dt², −mlφ'' sin φ − mlφ'² cos φ",
            "the same with the other sign",
            "φ is measured from below, so that the height is −l cos φ; with it (3) gives (8)",
        ),
        Correction(
            "before (9)", "sin φ = θ, φ² = θ² ≈ 0", "sin φ ≈ −θ, φ'² = θ'² ≈ 0", "(8) and (9)"
        ),
        Correction("(9)", "−mlθ", "−mlθ''", "follows from (7); (10) has s²"),
        Correction("(11)", "q = … − (ml²)", "− (ml)²", "the coefficients of (40)"),
        Correction(
            "(18), (24), (29), (37)",
            "−η ∂E/∂w h",
            "−η (u_n − u) h",
            "the derivative ∂E/∂w contains h already",
        ),
        Correction(
            "(21)",
            "“network input vector”, its rows run together",
            "x₁, x₂, x₃ are the terms of the PID, with (e(k) − e(k − 1))/ts and Σ e ts; the network"
            " reads r(k)",
            "(12) and (20)",
        ),
        Correction(
            "(29), Table 1",
            "IPID-RBF’s network learns its own force",
            "that of a PID-RBF loop beside it",
            "the static error of a step, see below",
        ),
        Correction("(35)", "… + ē₁²(i)) in the last line", "… + (Δē₁)²(i))", "the line before it"),
        Correction(
            "(40)",
            f"s⁴ + {cubic} s³ − {square} s³ − {linear} s",
            f"− {square} s²; one s cancels against the numerator’s {numerator} s²",
            f"(11) gives {coefficients()[2]:.4f} s²; (41) is of third order; as printed, the plant"
            f" has a pole at {poles.real.max():+.1f} 1/s",
        ),
        Correction("(42), (43)", "width c, centre b", "centre c, width b", "a width is positive"),
    ]


def settings(right: Errors, wrong: Mapping[str, Errors]) -> list[Setting]:
    """Return the settings, given the numbers of Table 1, and those by the start of a mistake."""

    def printed(errors: Errors, case: Case, digits: str) -> str:
        return f"{rounded(errors[case], digits)}".replace("-", "−")

    def mistake(start: str) -> Errors:
        return next(errors for name, errors in wrong.items() if name.startswith(start))

    pid, rbf = ("square", 0.0, "PID"), ("square", 0.0, "PID-RBF")
    sine, step = ("sine", 0.0, "PID"), ("step", 0.0, "IPID-RBF")
    fifty, double = mistake("force limited to ±50"), mistake("force limited to ±200")
    late, own = mistake("PID and PID-RBF with the terms"), mistake("IPID-RBF learns its own")
    two = mistake("disturbance of two")
    disturbed = ("square", 1.0, "IPID-RBF")
    jump = mistake("sign(0) = 0")
    return [
        Setting(
            "limit of the force",
            "±100 N",
            f"PID {printed(right, pid, '0.0001')} and PID-RBF {printed(right, rbf, '0.0001')} for"
            f" the square wave; ±50 N gives {printed(fifty, pid, '0.0001')} and"
            f" {printed(fifty, rbf, '0.0001')}, ±200 N {printed(double, pid, '0.0001')} and"
            f" {printed(double, rbf, '0.0001')}",
        ),
        Setting("sine", "sin(2π · 0.2 t) rad", "all three errors of row 3"),
        Setting(
            "square wave",
            "sign(sin(2π · 0.1 t)) rad; at a jump the value from before it",
            "all three errors of row 5; with sign(0) = 0 taken literally e(20000) is"
            f" {printed(jump, pid, '0.001')}",
        ),
        Setting(
            "disturbance",
            "+1 rad on the measured angle for 5 s ≤ t < 5.5 s, in all disturbed rows",
            f"IPID-RBF {printed(right, disturbed, '0.0001')} in row 6; two, as in the text, gives"
            f" {printed(two, disturbed, '0.0001')}",
        ),
        Setting(
            "order in the loop",
            "PID and PID-RBF: u(k) from the terms of sample k − 1; IPID-RBF: of sample k; both"
            " networks: r(k)",
            f"PID {printed(right, sine, '0.0001')} in row 3; with the terms of sample k"
            f" {printed(late, sine, '0.0001')}",
        ),
        Setting(
            "target of IPID-RBF’s network",
            "the force of a second PID-RBF loop",
            f"IPID-RBF {printed(right, step, '0.0001')} in row 1; its own force, as printed in"
            f" (29), gives {number(own[step], 3)}, and that error cannot become positive",
        ),
        Setting(
            "band of the settling times",
            "±0.3 % of the step",
            "3.8 s and 2.5 s come out together; other bands give other pairs",
        ),
        Setting("initial weights", "not known; 0 here", "see “Initial weights”"),
    ]
