"""Figures 4, 6, 8, 10, 12 and 14: tracking of the reference."""

import numpy as np

from ... import table1
from ..claims import Claim, Finding
from ..data import Data, Trace
from ..figure import Curve, Figure
from ..metrics import half_periods, largest, rms
from .compare import COLUMNS, IPID, NETWORKS, OTHERS, PID, better, by_kind, measured, row
from .curves import SHOWN, tracking_row, with_zoom
from .entry import LOST, Entry, numbered
from .measures import (
    ADJUSTMENT,
    AFTER_START,
    EFFORT,
    GROWTH,
    OVERSHOOT,
    PULSE,
    accuracy,
    adjustment,
    deviations,
    returns,
)

RING = 0.01
"""Swing beyond the set-point below which a pendulum does not oscillate [rad]."""


def square(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 4."""
    settled = adjustment(["square"])
    over, effort = OVERSHOOT[1], EFFORT[2]
    changes = measured("largest change of u per sample", "N", roughness, "square")
    return [
        better(
            data,
            "“the amplitude oscillation of the neural network supervision control is smaller than"
            " that of the traditional PID controller”",
            [over],
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“The IPID-RBF supervision control tends to be stable, fastest”",
            settled,
            IPID,
            OTHERS,
        ),
        better(
            data,
            "“and more gentle”",
            [over, changes, effort],
            IPID,
            OTHERS,
        ),
        better(
            data,
            "“PID-RBF and IPID-RBF supervision control have stable speed […] compared with pure PID"
            " control”",
            settled,
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“and high accuracy compared with pure PID control”",
            accuracy(["square"]),
            NETWORKS,
            PID,
        ),
    ]


def roughness(trace: Trace) -> float:
    """Return the largest change of the force from one sample to the next, after a jump [N].

    The jump itself, which drives every controller to its limit, is left out.
    """
    return max(largest(np.diff(part.part(part.t[0] + 0.1, 99.0).u)) for part in half_periods(trace))


def step(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 6."""
    _, wide, close, *_ = ADJUSTMENT

    def after(printed: str, kind: str) -> Finding:
        settled = close.values(data)
        return Finding(
            COLUMNS,
            [
                row(close.name, settled, table1.agrees(settled[kind], printed)),
                row(wide.name, wide.values(data)),
            ],
        )

    return [
        better(
            data,
            "“the amplitude oscillation of the RBF network supervisory control is smaller than that"
            " of the conventional PID control”",
            OVERSHOOT[:1],
            NETWORKS,
            PID,
        ),
        Claim(
            "“PID-RBF supervision control is stable after 3.8 s.”",
            "its settling time rounds to 3.8 s, in the band for which both printed times come out",
            lambda _: after("3.8", "PID-RBF"),
        ),
        Claim(
            "“IPID-RBF supervision control is stable after 2.5 s.”",
            "its settling time rounds to 2.5 s, in the band for which both printed times come out",
            lambda ipid: after("2.5", ipid),
        ),
        better(
            data,
            "“Obviously, IPID-RBF supervision control is more stable”",
            [*adjustment(["step"]), OVERSHOOT[0], GROWTH],
            IPID,
            OTHERS,
        ),
        better(
            data,
            "“and accurate”",
            accuracy(["step"]),
            IPID,
            OTHERS,
            "Its last error is larger than that of PID-RBF in the paper’s Table 1, too.",
        ),
    ]


def sine(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 8."""
    late = measured("RMS of e from 10 s on", "rad", lambda t: rms(t.part(10.0, 21.0).e), "sine")
    area, _, _, last = accuracy(["sine"])
    return [
        better(
            data,
            "“the amplitude oscillation of the RBF network supervision control is smaller than that"
            " of the pure PID”",
            [AFTER_START, OVERSHOOT[2]],
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“the effect of the RBF neural network supervision control is better than that of pure"
            " PID control in the time period from 0 s to 20 s”",
            accuracy(["sine"])[:3],
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“the RBF neural network supervision control has less error and better accuracy than"
            " the pure PID control”",
            [area, AFTER_START, late, last],
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“It can be clearly observed […] that the IPID-RBF control has the highest coincidence"
            " and the best tracking effect.”",
            [area, AFTER_START, late, last],
            IPID,
            OTHERS,
            "By the integral of |e| it is the closest. But its error has higher peaks than that of"
            " PID-RBF, and with them a larger RMS.",
        ),
    ]


def step_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 10."""
    case = [("step", 1.0)]
    return [
        better(
            data,
            "“the amplitude oscillation of the RBF network supervision control is smaller than that"
            " of the pure PID control when the disturbance appears”",
            deviations(case),
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“Then, the system can adjust to the stable state quickly after the disturbance"
            " disappears”",
            returns(case),
            NETWORKS,
            PID,
        ),
    ]


def swing_back(trace: Trace) -> float:
    """Return the swing of theta to the other side after it has returned to -1 [rad].

    0 if it returns from below and stays there.
    """
    after = trace.part(PULSE[1], 10.0)
    deviation = after.theta - after.r
    lowest = int(np.argmin(deviation))
    return max(float(np.max(deviation[lowest:])), 0.0)


def square_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 12, for both amplitudes."""
    cases = [("square", 2.0), ("square", 1.0)]
    calm = {a: by_kind(data, "square", a, swing_back) for _, a in cases}

    def without_oscillation(ipid: str) -> Finding:
        rows = [
            row(f"swing to the other side of r, d = {a:g} rad [rad]", v, v[ipid] < RING)
            for a, v in calm.items()
        ]
        return Finding(COLUMNS, rows)

    return [
        better(
            data,
            "“When the disturbance appears, the amplitude oscillation of RBF network supervision"
            " control is smaller than that of the pure PID.”",
            deviations(cases),
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“the system quickly adjusts to the stable state […] under the IPID-RBF control”",
            returns(cases),
            IPID,
            OTHERS,
        ),
        Claim(
            "“without oscillation”",
            "after the pulse θ does not swing to the other side of r by 0.01 rad",
            without_oscillation,
        ),
    ]


def sine_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 14, for both amplitudes."""
    cases = [("sine", 2.0), ("sine", 1.0)]
    late = [
        measured("RMS of e from 10 s on", "rad", lambda t: rms(t.part(10.0, 21.0).e), *case)
        for case in cases
    ]
    return [
        better(
            data,
            "“the deviation of y₁ or y₂ from r is less than that of the pure PID”",
            deviations(cases),
            NETWORKS,
            PID,
        ),
        better(
            data,
            "“the curve of RBF neural network supervision control has a higher coincidence with the"
            " given sine signal after the disturbance disappears”",
            [*late, *returns(cases)],
            NETWORKS,
            PID,
        ),
    ]


# --- the figures --------------------------------------------------------------------------------


DIFFERING = (
    "The text states a disturbance amplitude of two here, an amplitude of one reproduces Table 1:"
    " both are shown."
)


def measured_row(data: Data) -> list:
    """Return the measured angle, including the disturbance, after the step."""
    curves = []
    for kind in SHOWN:
        trace = data(kind, "step", 1.0)
        curves.append(Curve(f"{trace.key}/y", trace.t, trace.theta + trace.d, kind))
    reference = data("PID", "step", 1.0)
    curves.insert(0, Curve(f"r/{reference.key}", reference.t, reference.r, "r"))
    title = "measured angle θ + d"
    return with_zoom(curves, title, "θ + d [rad]", (4.8, 8), (-0.1, 2.1), (-0.1, 2.1))


def _figure(number: int, signal: str, rows: list, disturbed: bool = False) -> Figure:
    pulse = ", the measured angle disturbed from 5 s to 5.5 s" if disturbed else ""
    title = f"{signal.capitalize()}{' with disturbance' if disturbed else ''}: tracking"
    alt = (
        f"Reference and angle of the pendulum with PID, PID-RBF and IPID-RBF over 20 s, for a"
        f" {signal}{pulse}; with a magnified part."
    )
    return Figure(f"figure-{number}", title, alt, rows)


def entries(data: Data) -> list[Entry]:
    """Return the figures with the paper's statements about them."""
    both = (1.0, 2.0)
    return [
        numbered(
            4,
            LOST,
            _figure(
                4,
                "square wave",
                [tracking_row(data, "square", 0.0, (5, 10), (-1.06, -0.94), (-1.7, 1.7))],
            ),
            square(data),
        ),
        numbered(
            6,
            "Step signal tracking.",
            _figure(6, "step", [tracking_row(data, "step", 0.0, (0, 5), (0.95, 1.05), (0, 1.3))]),
            step(data),
        ),
        numbered(
            8,
            "Sine wave tracking.",
            _figure(8, "sine", [tracking_row(data, "sine", 0.0, (0.9, 1.6), (0.95, 1.04))]),
            sine(data),
            ("The paper has a “partially enlarged view” here.",),
        ),
        numbered(
            10,
            "Step signal tracking.",
            _figure(
                10,
                "step",
                [
                    tracking_row(data, "step", 1.0, (4.8, 8), (-0.1, 1.3), (-0.1, 1.4)),
                    measured_row(data),
                ],
                disturbed=True,
            ),
            step_disturbed(data),
            (
                "The paper does not state whether its picture shows the angle θ or the measured"
                " θ + d: both are drawn. The controllers see θ + d, and so drive θ away from r.",
            ),
        ),
        numbered(
            12,
            "Square wave tracking.",
            _figure(
                12,
                "square wave",
                [
                    tracking_row(data, "square", a, (4.8, 8), (-1.2 - a, 1.2), (-1.3 - a, 1.7))
                    for a in both
                ],
                disturbed=True,
            ),
            square_disturbed(data),
            (DIFFERING,),
        ),
        numbered(
            14,
            LOST,
            _figure(
                14,
                "sine",
                [
                    tracking_row(data, "sine", a, (4.8, 8), (-0.5 - a / 2, 1.2), (-1.6, 1.4))
                    for a in both
                ],
                disturbed=True,
            ),
            sine_disturbed(data),
            (DIFFERING, "The text on Figure 15, its parameters, states one again."),
        ),
    ]
