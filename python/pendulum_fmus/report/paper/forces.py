"""Figures 5, 7, 9, 11, 13 and 15: the force, and the parts of the PID and the network."""

import numpy as np

from ..claims import Claim, Finding, Table, judge
from ..data import Data, Trace
from ..figure import Figure
from ..metrics import bursts, correlation, largest, rms, tone, variation
from ..numbers import listing
from .curves import force_rows
from .entry import Entry
from .tracking import DIFFERING, JUMP, recovery

CONSISTENT = 0.8
"""Correlation above which curves have the same trend."""

CLOSE = 0.1
"""Relative RMS of a difference below which the trend is the same."""

SMOOTH = 1.0
"""Change between samples below which a force is gentle [N]."""

Traces = dict[str, Trace]


def networks(data: Data, signal: str, amplitude: float, ipid: str) -> Traces:
    """Return the traces of the two controllers with a network."""
    return {kind: data(kind, signal, amplitude) for kind in ("PID-RBF", ipid)}


def table(traces: Traces, rows: dict[str, list]) -> Table:
    """Return a table with one column per trace."""
    return Table(list(traces), rows)


def each(traces: Traces, measure) -> list[float]:
    """Apply a measure to every trace."""
    return [measure(trace) for trace in traces.values()]


def consistency(traces: Traces, shown) -> Finding:
    """Compare u_n and u over the part selected by `shown`: correlation and difference."""
    parts = {kind: shown(trace) for kind, trace in traces.items()}
    alike = each(parts, lambda p: correlation(p.u_n, p.u))
    apart = each(parts, lambda p: rms(p.u - p.u_n) / rms(p.u))
    return Finding(
        judge(min(alike) > CONSISTENT, max(apart) < CLOSE),
        table(traces, {"correlation of u_n and u [1]": alike, "RMS(u − u_n)/RMS(u) [1]": apart}),
    )


def square(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 5."""

    def composed(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        limited = [np.clip(t.u_p + t.u_n, -100, 100) for t in traces.values()]
        off = [largest(t.u - c) for t, c in zip(traces.values(), limited, strict=True)]
        clipped = each(traces, lambda t: int(np.sum(t.u != t.u_p + t.u_n)))
        return Finding(
            judge(max(off) == 0, max(clipped) == 0),
            table(
                traces,
                {"max |u − limited sum| [N]": off, "samples at the limit, of 20000": clipped},
            ),
            "The limit of ±100 N, which the paper does not mention, acts after every jump.",
        )

    def jump(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        after = each(traces, lambda t: float(t.part(5.001, 5.01).u_n[0]))
        lowest = each(traces, lambda t: float(np.min(t.part(5.0, 6.0).u_n)))
        later = each(traces, lambda t: float(t.part(9.9, 10.0).u_n[0]))
        kick = each(traces, lambda t: float(np.min(t.part(5.0, 5.01).u_p)))
        return Finding(
            judge(max(kick) < 0 < min(later), min(lowest) > -SMOOTH),
            table(
                traces,
                {
                    "u_n just after the jump at 5 s [N]": after,
                    "smallest u_n in the second after it [N]": lowest,
                    "u_n at 9.9 s [N]": later,
                    "u_p at the jump [N]": kick,
                },
            ),
            "u_n starts from zero, as the nodes near r = −1 have not learnt yet, and ends"
            " positive; but first it follows u down to the limit.",
        )

    def smooth(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        total = each(traces, lambda t: variation(t.u))
        pid = variation(data("PID", "square").u)
        tones = sorted({tone(t.part(5.05, 5.35).u, t.ts) for t in traces.values()})
        return Finding(
            judge(
                all(v < variation(t.u_p) for v, t in zip(total, traces.values(), strict=True)),
                max(total) <= pid,
            ),
            table(
                traces,
                {
                    "total variation of u [N]": total,
                    "of u_p [N]": each(traces, lambda t: variation(t.u_p)),
                    "of u_n [N]": each(traces, lambda t: variation(t.u_n)),
                    "of u under PID [N]": [pid, pid],
                },
            ),
            f"After a jump u rings at {listing(tones, 'Hz')}.",
        )

    return [
        Claim(
            "“superposed curves u are the sum of” u_n and u_p",
            "u is u_p + u_n, limited to ±100 N, at all samples; fully if the limit is not reached",
            composed,
        ),
        Claim(
            "When the square wave goes from positive to negative, u_n “is changed from zero to"
            " positive”, u_p “is negative at the jump instant”",
            "after the jump at 5 s u_p is negative and u_n finally positive; fully if u_n does"
            " not fall below −1 N in between",
            jump,
        ),
        Claim(
            "“the variation of the superposition curve is relatively smooth”",
            "the total variation of u is smaller than that of u_p; fully if it does not exceed"
            " that of u under PID",
            smooth,
        ),
    ]


def step(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 7."""
    return [
        Claim(
            "The “adjustment curve u_n and superposition curve u change trend are basically"
            " consistent”",
            "u_n and u correlate by more than 0.8; fully if their difference is below 10 % (RMS)",
            lambda ipid: consistency(networks(data, "step", 0.0, ipid), lambda t: t),
        ),
        Claim(
            "Section 3.1: the weights are adjusted to “make the feedback control input u_p(k) tend"
            " to zero”",
            "from 19 s on the RMS of u_p is below 10 % of that of u; fully if below 0.01 N",
            lambda ipid: _vanishing(networks(data, "step", 0.0, ipid)),
        ),
    ]


def _vanishing(traces: Traces) -> Finding:
    late = {kind: trace.part(19.0, 21.0) for kind, trace in traces.items()}
    rest = each(late, lambda t: rms(t.u_p))
    total = each(late, lambda t: rms(t.u))
    small = all(a < CLOSE * b for a, b in zip(rest, total, strict=True))
    return Finding(
        judge(small, max(rest) < 0.01),
        table(traces, {"RMS of u_p [N]": rest, "RMS of u [N]": total}),
        "" if max(rest) < 0.01 else "The remaining u_p of IPID-RBF is its static error times kp.",
    )


def sine(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 9."""

    def after_start(ipid: str) -> Traces:
        traces = networks(data, "sine", 0.0, ipid)
        return {kind: trace.part(1.0, 21.0) for kind, trace in traces.items()}

    def small(ipid: str) -> Finding:
        late = after_start(ipid)
        share = each(late, lambda t: largest(t.u_p) / largest(t.u_n))
        kick = each(networks(data, "sine", 0.0, ipid), lambda t: largest(t.u_p))
        return Finding(
            judge(max(share) < CLOSE, max(kick) < SMOOTH),
            table(late, {"max |u_p|/max |u_n| from 1 s on [1]": share, "max |u_p| [N]": kick}),
            "Small except in the first milliseconds.",
        )

    def gentle(ipid: str) -> Finding:
        late = after_start(ipid)
        change = each(late, lambda t: largest(np.diff(t.u)))
        first = each(networks(data, "sine", 0.0, ipid), lambda t: largest(np.diff(t.u)))
        return Finding(
            judge(max(change) < SMOOTH, max(first) < SMOOTH),
            table(
                late,
                {
                    "largest change per sample from 1 s on [N]": change,
                    "largest change per sample in total [N]": first,
                },
            ),
            "Gentle after the start.",
        )

    def opposite(ipid: str) -> Finding:
        late = after_start(ipid)
        alike = each(late, lambda t: correlation(t.u_n, t.r))
        against = each(late, lambda t: float(np.mean(np.sign(t.u_n) == -np.sign(t.r))))
        return Finding(
            judge(max(alike) < -0.9, min(against) > 0.95),
            table(
                late,
                {
                    "correlation of u_n and r [1]": alike,
                    "share of samples with opposite signs [1]": against,
                },
            ),
        )

    return [
        Claim(
            "“the change of PID regulating curve u_p is small”",
            "from 1 s on max |u_p| is below 10 % of max |u_n|; fully if |u_p| stays below 1 N"
            " from the start",
            small,
        ),
        Claim(
            "“the change of u in RBF network supervision control is gentle”",
            "from 1 s on u changes by less than 1 N per sample; fully if so from the start",
            gentle,
        ),
        Claim(
            "u_n “and the input signal r show the opposite trend change under the input sine wave"
            " signal”; where r is positive, Σ h w “is negative”",
            "from 1 s on u_n and r correlate by less than −0.9; fully if their signs are opposite"
            " at more than 95 % of the samples",
            opposite,
        ),
    ]


def large_adjustments(traces: Traces, expected: int, until: float) -> Finding:
    """Count the large adjustments of u and u_n before `until` [s]."""
    of_u = [bursts(t.part(0, until).t, t.part(0, until).u) for t in traces.values()]
    of_u_n = [bursts(t.part(0, until).t, t.part(0, until).u_n) for t in traces.values()]
    rows = {
        "u exceeds 50 N at [s]": [listing(found, "") for found in of_u],
        "u_n exceeds 50 N at [s]": [listing(found, "") for found in of_u_n],
    }
    return Finding(
        judge(
            all(len(found) == expected for found in of_u),
            all(len(found) == expected for found in of_u_n),
        ),
        table(traces, rows),
    )


THREE = "“There are three large-scale adjustments in total”: start, disturbance, readjustment"

THREE_CRITERION = (
    "u exceeds 50 N, half of its limit, three times (gaps below 0.25 s do not count); fully"
    " if u_n does too"
)


def step_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 11."""

    def stable(ipid: str) -> Finding:
        traces = networks(data, "step", 1.0, ipid)
        slopes, rest = [], []
        for trace in traces.values():
            late = trace.part(15.0, 21.0)
            for force in (late.u_n, late.u):
                line = np.polyfit(late.t, force, 1)
                slopes.append(float(line[0]))
                rest.append(rms(force - np.polyval(line, late.t)))
        columns = [f"{name} of {kind}" for kind in traces for name in ("u_n", "u")]
        return Finding(
            judge(max(rest) < SMOOTH, largest(np.array(slopes)) < 0.01),
            Table(columns, {"slope [N/s]": slopes, "RMS off the line [N]": rest}),
            "They settle to a ramp, not to a value: to hold 1 rad the force must keep falling"
            " by b g = 0.98 N/s.",
        )

    return [
        Claim(
            THREE,
            THREE_CRITERION,
            lambda ipid: large_adjustments(networks(data, "step", 1.0, ipid), 3, 21.0),
        ),
        Claim(
            "“the curves” u_n and u “tend to be stable after online learning”",
            "from 15 s on both stay within 1 N (RMS) of a line; fully if its slope is below"
            " 0.01 N/s",
            stable,
        ),
    ]


def square_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 13, for both amplitudes."""

    def least_time(ipid: str) -> Finding:
        cases = [("step", 1.0, 1.0), ("square", 1.0, JUMP), ("square", 2.0, JUMP)]
        kinds = ["PID", "PID-RBF", ipid]
        rows, first = {}, []
        for signal, amplitude, height in cases:
            times = [recovery(data(kind, signal, amplitude), height) for kind in kinds]
            rows[f"{signal}, d = {amplitude:g} rad [s]"] = times
            first.append(times[2] < min(times[:2]))
        return Finding(judge(any(first), all(first)), Table(kinds, rows))

    return [
        Claim(
            "“three large-scale adjustments between 0 and 10 seconds”",
            THREE_CRITERION,
            lambda ipid: large_adjustments(
                {
                    f"{kind}, d = {a:g} rad": trace
                    for a in (1.0, 2.0)
                    for kind, trace in networks(data, "square", a, ipid).items()
                },
                3,
                10.0,
            ),
        ),
        Claim(
            "After the pulse “the IPID-RBF control had the least amount of speed to adjust”, read"
            " as: it settles soonest",
            "the settling time (±0.3 % of the jump) from 5.5 s on is the shortest in one of three"
            " cases; fully if in all",
            least_time,
        ),
    ]


def sine_disturbed(data: Data) -> list[Claim]:
    """Return the claims of the text about Figure 15, for both amplitudes."""

    def larger(ipid: str) -> Finding:
        amplitudes = (0.0, 1.0, 2.0)
        kinds = ("PID-RBF", ipid)
        values = [[largest(data(k, "sine", a).u_n) for a in amplitudes] for k in kinds]
        rows = {f"max |u_n|, {k} [N]": v for k, v in zip(kinds, values, strict=True)}
        return Finding(
            judge(all(v[1] > v[0] and v[2] > v[0] for v in values)),
            Table([f"d = {a:g} rad" for a in amplitudes], rows),
        )

    def disturbed(ipid: str) -> Traces:
        return {
            f"{kind}, d = {a:g} rad": trace
            for a in (1.0, 2.0)
            for kind, trace in networks(data, "sine", a, ipid).items()
        }

    return [
        Claim(
            "“Compared with the unperturbed condition, the value of […] u_n […] is larger.”",
            "max |u_n| is larger with a disturbance of either amplitude",
            larger,
        ),
        Claim(
            "“There are three large pulse-type jumps of” u_n and u",
            THREE_CRITERION,
            lambda ipid: large_adjustments(disturbed(ipid), 3, 21.0),
        ),
        Claim(
            "At “the other time” u_n and u “change trend are basically consistent”",
            "from 7 s on u_n and u correlate by more than 0.8; fully if their difference is below"
            " 10 % (RMS)",
            lambda ipid: consistency(disturbed(ipid), lambda t: t.part(7.0, 21.0)),
        ),
    ]


# --- the figures --------------------------------------------------------------------------------


OFF_SCALE = (
    "u_p exceeds the scale at the jumps, where the error difference over 1 ms raises it to"
    " {kick:.0f} N for one sample; double-click a panel to see all of it."
)

Y = (-115.0, 115.0)


def _figure(number: int, signal: str, rows: list, disturbed: bool = False) -> Figure:
    pulse = ", the measured angle disturbed from 5 s to 5.5 s" if disturbed else ""
    title = f"{signal.capitalize()}{' with disturbance' if disturbed else ''}: parameters"
    alt = (
        f"Force u, the network’s part u_n and the PID’s part u_p for PID-RBF and IPID-RBF over"
        f" 20 s, for a {signal}{pulse}; with magnified parts."
    )
    return Figure(f"figure-{number}", title, alt, rows)


def entries(data: Data) -> list[Entry]:
    """Return the figures with the paper's claims about them."""
    kick = largest(data("PID-RBF", "square").u_p)
    off_scale = OFF_SCALE.format(kick=kick)
    whose = "The paper does not state whose parameters it shows: both controllers are shown here."
    wave = "Square wave tracking RBF control parameter."
    sines = "Sine wave tracking RBF control parameter."
    both = (1.0, 2.0)
    return [
        Entry(
            5,
            wave,
            _figure(5, "square wave", force_rows(data, "square", 0.0, (4.9, 6.4), Y, Y)),
            square(data),
            (whose, off_scale),
        ),
        Entry(
            7,
            wave,
            _figure(7, "step", force_rows(data, "step", 0.0, (0, 1.5), Y, Y)),
            step(data),
            ("Caption and text disagree: the caption names a square wave, the text a step.",),
        ),
        Entry(
            9,
            sines,
            _figure(9, "sine", force_rows(data, "sine", 0.0, (0, 0.1), (-20, 105), (-20, 105))),
            sine(data),
        ),
        Entry(
            11,
            "Step signal tracking RBF control parameter.",
            _figure(11, "step", force_rows(data, "step", 1.0, (4.9, 6.4), Y, Y), disturbed=True),
            step_disturbed(data),
        ),
        Entry(
            13,
            wave,
            _figure(
                13,
                "square wave",
                [row for a in both for row in force_rows(data, "square", a, (4.9, 6.4), Y, Y)],
                disturbed=True,
            ),
            square_disturbed(data),
            (DIFFERING,),
        ),
        Entry(
            15,
            sines,
            _figure(
                15,
                "sine",
                [row for a in both for row in force_rows(data, "sine", a, (4.9, 6.4), Y, Y)],
                disturbed=True,
            ),
            sine_disturbed(data),
            ("The text states an amplitude of one here and of two for Figure 14: both are shown.",),
        ),
    ]
