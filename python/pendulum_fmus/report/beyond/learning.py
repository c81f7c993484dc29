"""The limit of the learning rate: printed bound, eigenvalues, and FMUs."""

from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Claim, Finding, Row
from ..data import Data
from ..figure import ERROR, FORCE, Curve, Figure, Panel
from ..metrics import largest, tone
from ..paper.curves import curve
from ..parts import Part
from ..stability import DELAYS, ETA, Delay, limit, printed_bound, radius
from .section import section, statement

BELOW, ABOVE = 0.98, 1.02
"""Fractions of the limit at which the FMUs are run."""

RINGING = 1.0
"""A force that changes by more than this per sample, long after the step, is ringing [N]."""

LATE = 0.5
"""Length of the end of a run that is checked for ringing [s]."""

RATES = np.geomspace(0.05, 2.5, 120)

NAMES = dict(zip(DELAYS, ("0 samples", "1 sample", "1, parallel", "2 samples"), strict=True))


def loop(delay: Delay, eta: float, steps: int = 12000) -> Loop:
    """Return the step response of PID-RBF with a delay and a learning rate."""
    return Loop(
        "PidRbf",
        "step",
        0.0,
        overrides=(("controller.rbf.eta", eta),),
        steps=steps,
        order="parallel" if delay.parallel else "sequential",
        previous_sample_terms=delay.previous_sample_terms,
    )


CYCLE = loop(DELAYS[3], ETA, 20000)


def loops() -> list[Loop]:
    """Return the loops just below and above the limits, and the limit cycle."""
    return [CYCLE] + [loop(d, share * limit(d)) for d in DELAYS for share in (BELOW, ABOVE)]


def ringing(data: Data, loop: Loop) -> float:
    """Return the change of u per sample at the end [N]."""
    trace = data.loop(loop)
    return largest(np.diff(trace.part(trace.t[-1] - LATE, np.inf).u))


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    limits = {delay: limit(delay) for delay in DELAYS}
    bound = printed_bound()
    below = {d: ringing(data, loop(d, BELOW * limits[d])) for d in DELAYS}
    above = {d: ringing(data, loop(d, ABOVE * limits[d])) for d in DELAYS}
    heads = [NAMES[delay] for delay in DELAYS]
    falls = limits[DELAYS[0]] > limits[DELAYS[1]] > limits[DELAYS[3]]
    return section(
        "beyond-learning",
        "Limit of the learning rate",
        figure(data, limits, bound),
        [
            statement(
                "The closed loop limits the learning rate far below the bound printed in section"
                " 3.2, 0 < η h < 2 (G Gᵀ)⁻¹, and the limit falls further with the delay",
                "eigenvalues of the sampled loop at r = 1: the largest stable rate falls with the"
                " delay, and is below 2/|h|², the bound with G = h and u held fixed",
                Finding(
                    heads,
                    [
                        Row("largest stable η [1]", list(limits.values()), falls),
                        Row(
                            "share of the printed bound [1]",
                            [value / bound for value in limits.values()],
                            max(limits.values()) < bound,
                        ),
                        Row(
                            "spectral radius at η = 0.30 [1]",
                            [radius(delay, ETA) for delay in DELAYS],
                        ),
                    ],
                    f"The printed bound is {bound:.3f}.",
                ),
            ),
            statement(
                "The FMUs ring above these limits and not below",
                "change of u per sample in the last 0.5 s of 12 s, below 1 N at 0.98 of each limit"
                " and above 1 N at 1.02",
                Finding(
                    heads,
                    [
                        Row(
                            "change of u at 0.98 of the limit [N]",
                            list(below.values()),
                            max(below.values()) < RINGING,
                        ),
                        Row(
                            "change of u at 1.02 of the limit [N]",
                            list(above.values()),
                            min(above.values()) > RINGING,
                        ),
                    ],
                ),
            ),
            cycle(data),
        ],
        (
            "The terms of the previous sample, as in Table 1, cause a delay of one sample, and so"
            " does a master that steps in parallel; together they delay by two.",
        ),
    )


def cycle(data: Data) -> Claim:
    """Return the statement about the limit cycle."""
    trace = data.loop(CYCLE)
    spans = [trace.part(5.0, 10.0), trace.part(15.0, 20.0)]
    swings = [float(np.ptp(span.u)) for span in spans]
    errors = [largest(span.e) for span in spans]
    tones = [tone(span.u, trace.ts) for span in spans]
    grows = abs(swings[1] / swings[0] - 1)
    return statement(
        "With the paper’s η = 0.30 and a delay of two samples the loop ends in a limit cycle: it"
        " neither settles nor falls",
        "step; u still rings at the end, and its swing differs by less than 5 % from that ten"
        " seconds earlier",
        Finding(
            ["5 s to 10 s", "15 s to 20 s"],
            [
                Row("swing of u, peak to peak [N]", swings, swings[1] > RINGING and grows < 0.05),
                Row("frequency [Hz]", tones),
                Row("max |e| [rad]", errors),
            ],
        ),
    )


def figure(data: Data, limits: dict[Delay, float], bound: float) -> Figure:
    """Return the figure of the spectral radius over the learning rate and of the limit cycle."""
    styles = {DELAYS[0]: "one", DELAYS[1]: "half", DELAYS[3]: "double"}
    radii = [
        Curve(
            f"radius/{delay.samples}",
            RATES,
            np.array([radius(delay, eta) for eta in RATES]),
            style,
            f"delay of {NAMES[delay]}",
        )
        for delay, style in styles.items()
    ]
    ends = np.array([0.0, 10.0])
    walls = [
        Curve("stable", RATES[[0, -1]], np.ones(2), "limit", "limit of stability"),
        Curve("bound", bound + 1e-9 * ends, 0.8 + 0.05 * ends, "r", "printed bound"),
    ]
    trace = data.loop(CYCLE)
    span = (19.8, 20.0)
    return Figure(
        "learning",
        "Learning rate",
        "Spectral radius of the closed loop over the learning rate for delays of 0, 1 and 2"
        " samples, with the printed bound; below, force and error of the limit cycle over 0.2 s.",
        [
            [
                Panel(
                    "eigenvalues of the sampled loop",
                    "spectral radius [1]",
                    [*walls, *radii],
                    x_label="learning rate η [1]",
                    xlim=(0.05, 2.5),
                    ylim=(0.98, 1.2),
                    log_x=True,
                )
            ],
            [
                Panel("limit cycle, two samples", FORCE, [curve(trace, "u", "u")], xlim=span),
                Panel(
                    "limit cycle, two samples",
                    ERROR,
                    [Curve(f"{trace.key}/e", trace.t, trace.e, "u", "e")],
                    xlim=span,
                ),
            ],
        ],
    )
