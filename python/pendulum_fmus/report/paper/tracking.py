"""Figures 4, 6, 8, 10, 12 and 14: tracking of the reference."""

import numpy as np

from ... import table1
from ..claims import Claim, Finding, judge
from ..data import Data, Trace
from ..figure import Curve, Figure
from ..metrics import excess, half_periods, iae, largest, overshoot, rms, settling
from .compare import both_below_pid, by_kind, least, table
from .curves import SHOWN, tracking_row, with_zoom
from .entry import LOST, Entry

JUMP = 2.0
"""Height of the square wave's jumps [rad]."""

PULSE = (5.0, 5.5)
"""Interval of the disturbance [s]."""

RING = 0.01
"""Swing beyond the set-point below which a pendulum does not oscillate [rad]."""


def worst_overshoot(trace: Trace) -> float:
    """Return the largest overshoot after the jumps of a square wave, in percent of the jump."""
    return max(overshoot(part, JUMP) for part in half_periods(trace))


def slowest(trace: Trace) -> float:
    """Return the longest settling time after the jumps of a square wave [s]."""
    return float(np.max([settling(part, JUMP) for part in half_periods(trace)]))


def square(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 4."""
    over = by_kind(data, "square", 0.0, worst_overshoot)
    settled = by_kind(data, "square", 0.0, slowest)
    area = by_kind(data, "square", 0.0, iae)
    rows = {"overshoot, of the jump [%]": over, "settling ±0.3 % [s]": settled}

    def fastest(ipid: str) -> Finding:
        others = ["PID", "PID-RBF"]
        return Finding(judge(least(settled, ipid, others), least(over, ipid, others)), table(rows))

    def accurate(ipid: str) -> Finding:
        slower = settled["PID-RBF"] >= settled["PID"]
        return Finding(
            judge(both_below_pid(area, ipid), both_below_pid(settled, ipid)),
            table({"IAE [rad s]": area, "settling ±0.3 % [s]": settled}),
            "PID-RBF settles later than PID." if slower else "",
        )

    return [
        Claim(
            "“the amplitude oscillation of the neural network supervision control is smaller than"
            " that of the traditional PID controller”",
            "PID-RBF and IPID-RBF overshoot less than PID after every jump at 5, 10 and 15 s",
            lambda ipid: Finding(judge(both_below_pid(over, ipid)), table(rows)),
        ),
        Claim(
            "“The IPID-RBF supervision control tends to be stable, fastest, and more gentle.”",
            "the slowest of its settling times (±0.3 % of the jump) is the shortest of the three;"
            " fully if its overshoot is the smallest too",
            fastest,
        ),
        Claim(
            "“PID-RBF and IPID-RBF supervision control have stable speed and high accuracy compared"
            " with pure PID control”",
            "both have a smaller integral of |e| than PID; fully if both settle sooner too",
            accurate,
        ),
    ]


def step(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 6."""
    over = by_kind(data, "step", 0.0, overshoot)
    settled = by_kind(data, "step", 0.0, settling)
    wide = by_kind(data, "step", 0.0, lambda trace: settling(trace, band=0.02))
    area = by_kind(data, "step", 0.0, iae)
    final = by_kind(data, "step", 0.0, lambda trace: abs(float(trace.e[-1])))
    times = {"settling ±0.3 % [s]": settled, "settling ±2 % [s]": wide}

    def after(printed: str, kind: str) -> Finding:
        return Finding(judge(table1.agrees(settled[kind], printed)), table(times))

    def best(ipid: str) -> Finding:
        others = ["PID", "PID-RBF"]
        accurate = least(final, ipid, others)
        return Finding(
            judge(least(settled, ipid, others) and least(area, ipid, others), accurate),
            table({"settling ±0.3 % [s]": settled, "IAE [rad s]": area, "|e(20 s)| [rad]": final}),
            ""
            if accurate
            else "Its final error is not the smallest, nor is it in the paper’s Table 1.",
        )

    return [
        Claim(
            "“the amplitude oscillation of the RBF network supervisory control is smaller than that"
            " of the conventional PID control”",
            "PID-RBF and IPID-RBF overshoot less than PID",
            lambda ipid: Finding(judge(both_below_pid(over, ipid)), table({"overshoot [%]": over})),
        ),
        Claim(
            "“PID-RBF supervision control is stable after 3.8 s.”",
            "the settling time (±0.3 %) rounds to 3.8 s",
            lambda _: after("3.8", "PID-RBF"),
        ),
        Claim(
            "“IPID-RBF supervision control is stable after 2.5 s.”",
            "the settling time (±0.3 %) rounds to 2.5 s",
            lambda ipid: after("2.5", ipid),
        ),
        Claim(
            "“Obviously, IPID-RBF supervision control is more stable and accurate.”",
            "it has the shortest settling time and the smallest integral of |e|; fully if its final"
            " error is also the smallest",
            best,
        ),
    ]


def sine(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 8."""

    def after_start(trace: Trace) -> float:
        return largest(trace.part(1.0, 21.0).e)

    peak = by_kind(data, "sine", 0.0, after_start)
    area = by_kind(data, "sine", 0.0, iae)
    late = by_kind(data, "sine", 0.0, lambda trace: rms(trace.part(10.0, 21.0).e))
    final = by_kind(data, "sine", 0.0, lambda trace: abs(float(trace.e[-1])))
    rows = {
        "IAE [rad s]": area,
        "max |e| from 1 s on [rad]": peak,
        "RMS of e from 10 s on [rad]": late,
        "|e(20 s)| [rad]": final,
    }

    def closest(ipid: str) -> Finding:
        others = ["PID", "PID-RBF"]
        measures = {"max |e|": peak, "RMS": late, "|e(20 s)|": final}
        worse = [name for name, values in measures.items() if not least(values, ipid, others)]
        remark = f"It is not the closest in {', '.join(worse)}." if worse else ""
        return Finding(judge(least(area, ipid, others), not worse), table(rows), remark)

    return [
        Claim(
            "“the amplitude oscillation of the RBF network supervision control is smaller than that"
            " of the pure PID”",
            "from 1 s on PID-RBF and IPID-RBF have smaller maximum errors than PID",
            lambda ipid: Finding(judge(both_below_pid(peak, ipid)), table(rows)),
        ),
        Claim(
            "“the RBF neural network supervision control has less error and better accuracy than"
            " the pure PID control” from 0 s to 20 s",
            "both have a smaller integral of |e| than PID; fully if the RMS from 10 s on is too",
            lambda ipid: Finding(
                judge(both_below_pid(area, ipid), both_below_pid(late, ipid)), table(rows)
            ),
        ),
        Claim(
            "“the IPID-RBF control has the highest coincidence and the best tracking effect”",
            "it has the smallest integral of |e|; fully if also the smallest maximum error from"
            " 1 s on, RMS from 10 s on, and final error",
            closest,
        ),
    ]


def peak_after_pulse(trace: Trace) -> float:
    """Return the maximum deviation of theta from the reference from the pulse on [rad]."""
    after = trace.part(PULSE[0] + 0.002, 10.0)
    return largest(after.theta - after.r)


def recovery(trace: Trace, height: float) -> float:
    """Return the settling time after the end of the pulse, up to the next jump [s]."""
    return settling(trace.part(PULSE[1], 10.0), height)


def step_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 10."""
    peak = by_kind(data, "step", 1.0, peak_after_pulse)
    back = by_kind(data, "step", 1.0, lambda trace: recovery(trace, 1.0))

    def quickly(ipid: str) -> Finding:
        slower = [k for k in ("PID-RBF", ipid) if not least(back, k, ["PID"])]
        settled = all(back[kind] == back[kind] for kind in ("PID-RBF", ipid))  # not NaN
        return Finding(
            judge(settled, not slower),
            table({"settling ±0.3 % after the pulse [s]": back}),
            f"Not faster than PID: {', '.join(slower)}." if slower else "",
        )

    return [
        Claim(
            "“the amplitude oscillation of the RBF network supervision control is smaller than that"
            " of the pure PID control when the disturbance appears”",
            "the largest deviation of θ from r after 5 s is smaller for both than for PID",
            lambda ipid: Finding(
                judge(both_below_pid(peak, ipid)), table({"max |θ − r| [rad]": peak})
            ),
        ),
        Claim(
            "“the system can adjust to the stable state quickly after the disturbance disappears”",
            "PID-RBF and IPID-RBF settle (±0.3 %) before 10 s; fully if both do sooner than PID",
            quickly,
        ),
    ]


def beyond(trace: Trace) -> float:
    """Return the overshoot of theta beyond the set-point -1 between 5 s and 10 s [rad]."""
    after = trace.part(PULSE[0] + 0.002, 10.0)
    return excess(after)


def swing_back(trace: Trace) -> float:
    """Return the swing of theta to the other side after it has returned to -1 [rad].

    0 if it returns from below and stays there.
    """
    after = trace.part(PULSE[1], 10.0)
    deviation = after.theta - after.r
    lowest = int(np.argmin(deviation))
    return max(float(np.max(deviation[lowest:])), 0.0)


def square_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 12, for both amplitudes."""
    far = {a: by_kind(data, "square", a, beyond) for a in (1.0, 2.0)}
    back = {a: by_kind(data, "square", a, lambda t: recovery(t, JUMP)) for a in (1.0, 2.0)}
    swing = {a: by_kind(data, "square", a, swing_back) for a in (1.0, 2.0)}

    def smaller(ipid: str) -> Finding:
        hold = [both_below_pid(far[a], ipid) for a in (2.0, 1.0)]
        rows = {f"beyond r, d = {a:g} rad [rad]": far[a] for a in far}
        return Finding(judge(hold[0], all(hold)), table(rows))

    def gently(ipid: str) -> Finding:
        others = ["PID", "PID-RBF"]
        quick = all(least(back[a], ipid, others) for a in back)
        calm = all(swing[a][ipid] < RING for a in swing)
        rows = {f"settling ±0.3 % after 5.5 s, d = {a:g} rad [s]": back[a] for a in back}
        rows |= {f"swing to the other side, d = {a:g} rad [rad]": swing[a] for a in swing}
        return Finding(judge(quick, calm), table(rows))

    return [
        Claim(
            "“When the disturbance appears, the amplitude oscillation of RBF network supervision"
            " control is smaller than that of the pure PID.”",
            "θ overshoots r less between 5 s and 10 s for both than for PID, with the text’s"
            " amplitude of 2 rad; fully if also with Table 1’s of 1 rad",
            smaller,
        ),
        Claim(
            "“the system quickly adjusts to the stable state without oscillation […] under the"
            " IPID-RBF control”",
            "after the pulse IPID-RBF settles first, with both amplitudes; fully if θ never"
            " swings to the other side of r by 0.01 rad",
            gently,
        ),
    ]


def sine_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 14, for both amplitudes."""

    def deviation(trace: Trace) -> float:
        after = trace.part(PULSE[0], 21.0)
        return float(np.sum(np.abs(after.theta - after.r)) * trace.ts)

    area = {a: by_kind(data, "sine", a, deviation) for a in (1.0, 2.0)}
    peak = {a: by_kind(data, "sine", a, peak_after_pulse) for a in (1.0, 2.0)}
    late = {a: by_kind(data, "sine", a, lambda t: rms(t.part(10.0, 21.0).e)) for a in (1.0, 2.0)}

    def less(ipid: str) -> Finding:
        rows = {f"∫|θ − r| dt from 5 s on, d = {a:g} rad [rad s]": area[a] for a in area}
        rows |= {f"max |θ − r|, d = {a:g} rad [rad]": peak[a] for a in peak}
        exceeds = [a for a in peak if not both_below_pid(peak[a], ipid)]
        remark = "".join(
            f"With d = {a:g} rad the peak is not smaller for both than for PID." for a in exceeds
        )
        return Finding(
            judge(all(both_below_pid(area[a], ipid) for a in area), not exceeds),
            table(rows),
            remark,
        )

    def coincide(ipid: str) -> Finding:
        rows = {f"RMS of e from 10 s on, d = {a:g} rad [rad]": late[a] for a in late}
        return Finding(judge(all(both_below_pid(late[a], ipid) for a in late)), table(rows))

    return [
        Claim(
            "“the deviation of y1 or y2 from r is less than that of the pure PID”",
            "the integral of |θ − r| from 5 s on is smaller for both than for PID, with both"
            " amplitudes; fully if the largest |θ − r| is too",
            less,
        ),
        Claim(
            "RBF control “has a higher coincidence with the given sine signal after the disturbance"
            " disappears”",
            "from 10 s on the RMS of e is smaller for both than for PID, with both amplitudes",
            coincide,
        ),
    ]


# --- the figures --------------------------------------------------------------------------------


DIFFERING = (
    "The text states a disturbance amplitude of two here, one reproduces Table 1: both are shown."
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
    """Return the figures with the paper's claims about them."""
    both = (1.0, 2.0)
    return [
        Entry(
            4,
            LOST,
            _figure(
                4,
                "square wave",
                [tracking_row(data, "square", 0.0, (5, 10), (-1.06, -0.94), (-1.7, 1.7))],
            ),
            square(data),
        ),
        Entry(
            6,
            "Step signal tracking.",
            _figure(6, "step", [tracking_row(data, "step", 0.0, (0, 5), (0.95, 1.05), (0, 1.3))]),
            step(data),
        ),
        Entry(
            8,
            "Sine wave tracking.",
            _figure(8, "sine", [tracking_row(data, "sine", 0.0, (0.9, 1.6), (0.95, 1.04))]),
            sine(data),
            ("The paper has a “partially enlarged view” here.",),
        ),
        Entry(
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
        Entry(
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
        Entry(
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
