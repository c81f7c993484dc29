"""Figures 5, 7, 9, 11, 13 and 15: the force, and the parts of the PID and the network."""

from collections.abc import Callable

import numpy as np

from ..claims import Claim, Finding, Row
from ..data import Data, Trace
from ..figure import Figure
from ..metrics import bursts, correlation, largest, rms, tone, variation
from ..numbers import listing
from ..scenarios import KINDS
from ..stability import RAMP, nodes
from .compare import COLUMNS, IPID, OTHERS, Values, better, by_signal, settles
from .curves import force_rows
from .entry import Entry, numbered
from .measures import DISTURBED, returns
from .tracking import DIFFERING, roughness

CONSISTENT = 0.8
"""Correlation above which curves have the same trend."""

CLOSE = 0.1
"""Relative RMS of a difference below which the trend is the same."""

SMOOTH = 1.0
"""Change between samples below which a force is gentle [N]."""

OPPOSITE = -0.9
"""Correlation below which curves have opposite trends."""

MOSTLY = 0.95
"""Share of the samples at which something holds that holds but for short times."""

VANISHED = 0.01
"""A u_p below this has vanished [N]."""

SETTLED = 0.01
"""Slope below which a force has settled [N/s]."""

Traces = dict[str, Trace]


def networks(data: Data, signal: str, amplitude: float, ipid: str) -> Traces:
    """Return the traces of the two controllers with a network."""
    return {kind: data(kind, signal, amplitude) for kind in ("PID-RBF", ipid)}


def both_amplitudes(data: Data, signal: str, ipid: str) -> Traces:
    """Return the traces of the two controllers with disturbances of 1 and of 2 rad."""
    return {
        f"{kind}, d = {a:g} rad": trace
        for a in (1.0, 2.0)
        for kind, trace in networks(data, signal, a, ipid).items()
    }


def each(traces: Traces, measure: Callable[[Trace], float]) -> list[float]:
    """Apply a measure to every trace."""
    return [measure(trace) for trace in traces.values()]


def all_below(name: str, values: list[float], bound: float) -> Row:
    """Return a row that holds if all values are below a bound."""
    return Row(name, values, max(values) < bound)


def consistency(traces: Traces, shown: Callable[[Trace], Trace]) -> Finding:
    """Compare u_n and u over the part selected by `shown`: correlation and difference."""
    parts = {kind: shown(trace) for kind, trace in traces.items()}
    alike = each(parts, lambda p: correlation(p.u_n, p.u))
    apart = each(parts, lambda p: rms(p.u - p.u_n) / rms(p.u))
    return Finding(
        list(traces),
        [
            Row("correlation of u_n and u [1]", alike, min(alike) > CONSISTENT),
            all_below("RMS(u − u_n)/RMS(u) [1]", apart, CLOSE),
        ],
    )


def quiet(trace: Trace) -> Trace:
    """Return what lies outside the jumps at the start and at the disturbance."""
    return trace.parts((1.0, 5.0), (5.6, 21.0))


CONSISTENCY = "u_n and u correlate by more than 0.8; their difference is below 10 % (RMS)"


def square(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 5."""

    def composed(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        limited = [np.clip(t.u_p + t.u_n, -100, 100) for t in traces.values()]
        off = [largest(t.u - c) for t, c in zip(traces.values(), limited, strict=True)]
        clipped = each(traces, lambda t: int(np.sum(t.u != t.u_p + t.u_n)))
        return Finding(
            list(traces),
            [
                Row("max |u − limited sum| [N]", off, max(off) == 0),
                Row("samples at the limit, of 20000", clipped, max(clipped) == 0),
            ],
            "The limit of ±100 N, which the paper does not mention, acts after every jump.",
        )

    def network(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        before = each(traces, lambda t: float(t.part(4.99, 5.0).u_n[-1]))
        after = each(traces, lambda t: float(t.part(5.001, 5.01).u_n[0]))
        lowest = each(traces, lambda t: float(np.min(t.part(5.0, 6.0).u_n)))
        later = each(traces, lambda t: float(t.part(9.9, 10.0).u_n[0]))
        return Finding(
            list(traces),
            [
                all_below("|u_n| just before the jump at 5 s [N]", np.abs(before).tolist(), SMOOTH),
                all_below("|u_n| just after it [N]", np.abs(after).tolist(), SMOOTH),
                Row("smallest u_n in the second after it [N]", lowest, min(lowest) > -SMOOTH),
                Row("u_n at 9.9 s [N]", later, min(later) > 0),
            ],
            "u_n starts from zero, as the nodes near r = −1 have not learnt yet, and ends"
            " positive; but first it follows u down to the limit.",
        )

    def kick(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        lowest = each(traces, lambda t: float(np.min(t.part(5.0, 5.01).u_p)))
        return Finding(list(traces), [Row("u_p at the jump [N]", lowest, max(lowest) < 0)])

    def smooth(ipid: str) -> Finding:
        traces = networks(data, "square", 0.0, ipid)
        total = each(traces, lambda t: variation(t.u))
        of_pid = data("PID", "square")
        pid = variation(of_pid.u)
        rough = each(traces, roughness)
        ringing = tone(traces["PID-RBF"].part(5.05, 5.35).u, of_pid.ts)
        own = each(traces, lambda t: variation(t.u_p))
        names = [*traces, "PID"]
        return Finding(
            names,
            [
                Row("total variation of u [N]", [*total, pid], max(total) <= pid),
                Row(
                    "total variation of u_p [N]",
                    [*own, variation(of_pid.u_p)],
                    all(a < b for a, b in zip(total, own, strict=True)),
                ),
                Row(
                    "largest change of u per sample from 0.1 s after a jump [N]",
                    [*rough, roughness(of_pid)],
                    max(rough) < SMOOTH,
                ),
            ],
            f"After a jump u rings at about {ringing:.0f} Hz. It varies less than u_p only"
            " because of the spikes of u_p at the jumps.",
        )

    return [
        Claim(
            "“superposed curves u are the sum of u_n and u_p”",
            "u is u_p + u_n, limited to ±100 N, at all samples; the limit is not reached",
            composed,
        ),
        Claim(
            "When the square wave goes from positive to negative, u_n “is changed from zero to"
            " positive”",
            "|u_n| is below 1 N before and after the jump at 5 s; it does not fall below −1 N in"
            " the second after it; it is positive in the end",
            network,
        ),
        Claim("u_p “is negative at the jump instant”", "u_p is negative at the jump at 5 s", kick),
        Claim(
            "“the variation of the superposition curve is relatively smooth”",
            "the total variation of u does not exceed that of u under PID; it is less than that of"
            " u_p; from 0.1 s after each jump u changes by less than 1 N per sample",
            smooth,
        ),
    ]


def vanishing(data: Data) -> Claim:
    """Return the statement that u_p tends to zero."""

    def late(trace: Trace) -> float:
        return rms(trace.part(19.0, 21.0).u_p)

    def finding(ipid: str) -> Finding:
        def holds(values: Values) -> bool:
            return max(values["PID-RBF"], values[ipid]) < VANISHED

        name = "RMS of u_p from 19 s on"
        return Finding(COLUMNS, by_signal(data, name, "N", late, holds, KINDS[1:]))

    return Claim(
        "Section 3.1: “adjust the weight of the network online, and make the feedback control input"
        " u_p(k) tend to zero”",
        "PID-RBF and IPID-RBF: the RMS of u_p from 19 s on is below 0.01 N, with each signal",
        finding,
    )


def step(data: Data) -> list[Claim]:
    """Return the statements about Figure 7, with that of section 3.1 on u_p."""
    return [
        Claim(
            "u_n “and superposition curve u change trend are basically consistent”",
            CONSISTENCY,
            lambda ipid: consistency(networks(data, "step", 0.0, ipid), lambda t: t),
        ),
        vanishing(data),
    ]


def sine(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 9."""
    nearest = min(float(nodes(r).min()) for r in np.linspace(-1, 1, 201))

    def whole(ipid: str) -> Traces:
        return networks(data, "sine", 0.0, ipid)

    def after_start(ipid: str) -> Traces:
        return {kind: trace.part(1.0, 21.0) for kind, trace in whole(ipid).items()}

    def small(ipid: str) -> Finding:
        late = after_start(ipid)
        share = each(late, lambda t: largest(t.u_p) / largest(t.u_n))
        kick = each(whole(ipid), lambda t: largest(t.u_p))
        return Finding(
            list(late),
            [
                all_below("max |u_p|/max |u_n| from 1 s on [1]", share, CLOSE),
                all_below("max |u_p| from 0 s on [N]", kick, SMOOTH),
            ],
            "Small, except in the first milliseconds.",
        )

    def gentle(ipid: str) -> Finding:
        late = each(after_start(ipid), lambda t: largest(np.diff(t.u)))
        first = each(whole(ipid), lambda t: largest(np.diff(t.u)))
        return Finding(
            list(whole(ipid)),
            [
                all_below("largest change of u per sample from 1 s on [N]", late, SMOOTH),
                all_below("largest change of u per sample from 0 s on [N]", first, SMOOTH),
            ],
        )

    def opposite(ipid: str) -> Finding:
        late = after_start(ipid)
        alike = each(late, lambda t: correlation(t.u_n, t.r))
        against = each(
            late, lambda t: float(np.mean(np.sign(np.diff(t.u_n)) == -np.sign(np.diff(t.r))))
        )
        return Finding(
            list(late),
            [
                Row("correlation of u_n and r [1]", alike, max(alike) < OPPOSITE),
                Row("samples at which one rises and one falls [1]", against, min(against) > MOSTLY),
            ],
        )

    def signs(ipid: str) -> Finding:
        late = after_start(ipid)
        against = each(late, lambda t: float(np.mean(np.sign(t.u_n) == -np.sign(t.r))))
        name = "samples with opposite signs of u_n and r [1]"
        return Finding(list(late), [Row(name, against, min(against) > MOSTLY)])

    return [
        Claim(
            "“the change of PID regulating curve u_p is small”",
            "from 1 s on max |u_p| is below 10 % of max |u_n|; it is below 1 N from the start",
            small,
        ),
        Claim(
            "“and the change of u in RBF network supervision control is gentle”",
            "u changes by less than 1 N per sample from 1 s on; also from the start",
            gentle,
        ),
        Claim(
            "u_n “and the input signal r show the opposite trend change under the input sine wave"
            " signal. As the input signal increases, the adjustment curve u_n decreases.”",
            "from 1 s on u_n and r correlate by less than −0.9; one rises while the other falls at"
            " more than 95 % of the samples",
            opposite,
        ),
        Claim(
            "“In the process of adjustment, the value of h is positive”",
            "the smallest output of a node for |r| ≤ 1 rad is positive",
            lambda _: Finding(["nodes"], [Row("smallest h_j [1]", [nearest], nearest > 0)]),
        ),
        Claim(
            "“When the value of the input signal is positive, […] the value is negative; when the"
            " value of the input signal is negative, […] the value is positive”, that is, u_n",
            "from 1 s on the signs are opposite at more than 95 % of the samples",
            signs,
        ),
    ]


def large_adjustments(traces: Traces, expected: int, until: float, *columns: str) -> Finding:
    """Count the large adjustments of some columns before `until` [s]."""
    rows = []
    for column in columns:
        found = [
            bursts(part.t, getattr(part, column))
            for part in (trace.part(0, until) for trace in traces.values())
        ]
        rows.append(
            Row(
                f"{column} exceeds 50 N at [s]",
                [listing(times, "") for times in found],
                all(len(times) == expected for times in found),
            )
        )
    return Finding(list(traces), rows)


THREE_CRITERION = (
    "u exceeds 50 N, half of the limit, exactly three times{} (gaps below 0.25 s do not count)"
)


def step_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 11."""

    def stable(ipid: str) -> Finding:
        traces = networks(data, "step", 1.0, ipid)
        slopes, rest = [], []
        for trace in traces.values():
            late = trace.part(15.0, 21.0)
            for force in (late.u_n, late.u):
                line = np.polyfit(late.t, force, 1)
                slopes.append(float(line[0]))
                rest.append(rms(force - np.polyval(line, late.t)))
        return Finding(
            [f"{name} of {kind}" for kind in traces for name in ("u_n", "u")],
            [
                Row("slope from 15 s on [N/s]", slopes, largest(np.array(slopes)) < SETTLED),
                Row("RMS off that line [N]", rest, max(rest) < SMOOTH),
            ],
            "They settle to a ramp, not to a value: to hold 1 rad the force must keep falling"
            f" by b g = {RAMP:.2f} N/s.",
        )

    return [
        Claim(
            "“There are three large-scale adjustments in total”: start, disturbance, readjustment",
            THREE_CRITERION.format(", and so does u_n"),
            lambda ipid: large_adjustments(networks(data, "step", 1.0, ipid), 3, 21.0, "u", "u_n"),
        ),
        Claim(
            "“the curves u_n and u tend to be stable after online learning”",
            "from 15 s on both have a slope below 0.01 N/s; both stay within 1 N (RMS) of a line",
            stable,
        ),
    ]


def square_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 13, for both amplitudes."""
    cases = [case for case in DISTURBED if case[0] != "sine"]
    times = returns(cases)
    return [
        Claim(
            "“there are three large-scale adjustments between 0 and 10 seconds”",
            THREE_CRITERION.format(", and so does u_n"),
            lambda ipid: large_adjustments(
                both_amplitudes(data, "square", ipid), 3, 10.0, "u", "u_n"
            ),
        ),
        settles(
            data,
            "“After 0.5 s, the stability of the system is adjusted to stable tracking signal.”",
            [*OTHERS, *IPID],
            times,
            "each controller settles to each band between the end of the pulse and 10 s",
        ),
        better(
            data,
            "“Among them, the IPID-RBF control had the least amount of speed to adjust”, read as:"
            " it settles soonest",
            times,
            IPID,
            OTHERS,
        ),
    ]


def sine_disturbed(data: Data) -> list[Claim]:
    """Return the statements of the text about Figure 15, for both amplitudes."""

    def larger(ipid: str) -> Finding:
        amplitudes = (0.0, 1.0, 2.0)
        rows = []
        for kind in ("PID-RBF", ipid):
            values = [largest(data(kind, "sine", a).u_n) for a in amplitudes]
            rows.append(Row(f"max |u_n|, {kind} [N]", values, min(values[1:]) > values[0]))
        return Finding([f"d = {a:g} rad" for a in amplitudes], rows)

    return [
        Claim(
            "“Compared with the unperturbed condition, the value of the online learning adjustment"
            " curve u_n […] is larger.”",
            "max |u_n| is larger with a disturbance of either amplitude",
            larger,
        ),
        Claim(
            "“There are three large pulse-type jumps of u_n and u_p superposed curves u”, that is,"
            " of their sum",
            THREE_CRITERION.format(""),
            lambda ipid: large_adjustments(both_amplitudes(data, "sine", ipid), 3, 21.0, "u"),
        ),
        Claim(
            "“The other time” u_n and u “change trend are basically consistent”",
            f"from 1 s to 5 s and from 5.6 s on {CONSISTENCY}",
            lambda ipid: consistency(both_amplitudes(data, "sine", ipid), quiet),
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
    """Return the figures with the paper's statements about them."""
    kick = largest(data("PID-RBF", "square").u_p)
    off_scale = OFF_SCALE.format(kick=kick)
    whose = "The paper does not state whose parameters it shows: both controllers are shown here."
    wave = "Square wave tracking RBF control parameter."
    sines = "Sine wave tracking RBF control parameter."
    both = (1.0, 2.0)
    return [
        numbered(
            5,
            wave,
            _figure(5, "square wave", force_rows(data, "square", 0.0, (4.9, 6.4), Y, Y)),
            square(data),
            (whose, off_scale),
        ),
        numbered(
            7,
            wave,
            _figure(7, "step", force_rows(data, "step", 0.0, (0, 1.5), Y, Y)),
            step(data),
            ("Caption and text disagree: the caption names a square wave, the text a step.",),
        ),
        numbered(
            9,
            sines,
            _figure(9, "sine", force_rows(data, "sine", 0.0, (0, 0.1), (-20, 105), (-20, 105))),
            sine(data),
        ),
        numbered(
            11,
            "Step signal tracking RBF control parameter.",
            _figure(11, "step", force_rows(data, "step", 1.0, (4.9, 6.4), Y, Y), disturbed=True),
            step_disturbed(data),
        ),
        numbered(
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
        numbered(
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
