"""Figures 16 to 21: the errors of the three controllers."""

import math

from ..claims import Claim, Finding, judge
from ..data import Data, Trace
from ..figure import Figure
from ..metrics import iae, ise, itae, settling
from .compare import both_below_pid, by_kind, least, table
from .curves import Span, error_rows
from .entry import Entry
from .tracking import slowest

SINE_BAND = 0.003
"""Settling band relative to the sine's amplitude, as for the step [rad]."""


def adjustment(signal: str) -> tuple[str, callable]:
    """Return the name of a signal's adjustment time and the function that measures it."""
    if signal == "square":
        return "slowest settling ±0.3 % after a jump at 5, 10, 15 s [s]", slowest
    if signal == "sine":
        return "|e| < 0.003 rad for good from [s]", lambda t: settling(t, band=SINE_BAND)
    return "settling ±0.3 % [s]", settling


def disturbed_adjustment(trace: Trace, signal: str) -> float:
    """Return the settling time after the pulse, up to the next jump of a square wave [s]."""
    after = trace.part(5.5, 10.0 if signal == "square" else 21.0)
    return settling(after, 2.0 if signal == "square" else 1.0)


def claims(data: Data, signal: str, amplitudes: tuple[float, ...]) -> list[Claim]:
    """Return the claims of section 4 about the error figures of one signal."""
    measured = []
    for a in amplitudes:
        note = f", d = {a:g} rad" if len(amplitudes) > 1 else ""
        name, measure = adjustment(signal)
        if a:
            name = "settling ±0.3 % after the pulse [s]"
            measure = lambda trace: disturbed_adjustment(trace, signal)  # noqa: E731
        measured.append(
            (
                note,
                name,
                by_kind(data, signal, a, measure),
                by_kind(data, signal, a, iae),
                by_kind(data, signal, a, lambda trace: abs(float(trace.e[-1]))),
            )
        )

    def worst(ipid: str) -> Finding:
        rows, greater, longer = {}, [], []
        for note, name, times, areas, finals in measured:
            rows |= {f"IAE{note} [rad s]": areas, f"{name}{note}": times}
            rows |= {f"|e(20 s)|{note} [rad]": finals}
            greater.append(both_below_pid(areas, ipid))
            longer.append(both_below_pid(times, ipid) and both_below_pid(finals, ipid))
        return Finding(judge(all(greater), all(longer)), table(rows))

    def short(ipid: str) -> Finding:
        rows = {f"{name}{note}": times for note, name, times, _, _ in measured}
        stable = [not math.isnan(times[ipid]) for _, _, times, _, _ in measured]
        first = [least(times, ipid, ["PID", "PID-RBF"]) for _, _, times, _, _ in measured]
        return Finding(judge(all(stable), all(first)), table(rows))

    def integral(ipid: str) -> Finding:
        others, rows, by_area, by_all = ["PID", "PID-RBF"], {}, [], []
        for a, (note, _, _, areas, _) in zip(amplitudes, measured, strict=True):
            squares, timed = by_kind(data, signal, a, ise), by_kind(data, signal, a, itae)
            rows |= {f"IAE{note} [rad s]": areas}
            rows |= {f"ISE{note} [rad² s]": squares, f"ITAE{note} [rad s²]": timed}
            by_area.append(least(areas, ipid, others))
            by_all += [least(squares, ipid, others), least(timed, ipid, others)]
        return Finding(judge(all(by_area), all(by_all)), table(rows))

    return [
        Claim(
            "“the traditional PID control has the worst effect, long adjustment time, and greater"
            " error than the other two control algorithms”",
            "PID has the largest integral of |e|; fully if it also has the longest settling time"
            " and the largest last error",
            worst,
        ),
        Claim(
            "“The IPID-RBF control can reach a stable state in a short time no matter whether there"
            " is no interference or interference.”",
            "IPID-RBF settles; fully if sooner than PID and PID-RBF",
            short,
        ),
        Claim(
            "Section 5: “the IPID-RBF control has the best tracking effect”",
            "it has the smallest integral of |e|; fully if those of e² and t |e| are the smallest"
            " too",
            integral,
        ),
    ]


def _entry(
    data: Data,
    number: int,
    caption: str,
    signal: str,
    amplitudes: tuple[float, ...],
    zoom: tuple[Span, Span],
) -> Entry:
    disturbed = bool(amplitudes[0])
    pulse = ", the measured angle disturbed from 5 s to 5.5 s" if disturbed else ""
    figure = Figure(
        f"figure-{number}",
        f"{signal.capitalize()}{' with disturbance' if disturbed else ''}: errors",
        f"Error of PID, PID-RBF and IPID-RBF over 20 s, for a {signal}{pulse}; with a magnified"
        " part, and the absolute values on a logarithmic axis.",
        [row for a in amplitudes for row in error_rows(data, signal, a, *zoom)],
    )
    notes = ["The logarithmic panel was added, as the final errors of Table 1 span ten decades."]
    if len(amplitudes) > 1:
        notes.append(
            "The paper does not state the amplitude of the disturbance here: both are shown."
        )
    return Entry(number, caption, figure, claims(data, signal, amplitudes), notes)


def entries(data: Data) -> list[Entry]:
    """Return the figures with the paper's claims about them."""
    quiet = (0.0,)
    return [
        _entry(
            data, 16, "Step signal tracking error without interference.",
            "step", quiet, ((0, 6), (-0.05, 0.05)),
        ),
        _entry(
            data, 17, "Step signal tracking error under interference.",
            "step", (1.0,), ((4.8, 8), (-1.2, 1.2)),
        ),
        _entry(
            data, 18, "Sinusoidal signal tracking error without interference.",
            "sine", quiet, ((0, 2), (-0.03, 0.03)),
        ),
        _entry(
            data, 19, "Sinusoidal signal tracking error under interference.",
            "sine", (1.0, 2.0), ((4.8, 8), (-2.2, 2.2)),
        ),
        _entry(
            data, 20, "Wave signal tracking error without interference.",
            "square", quiet, ((4.8, 10), (-0.1, 0.1)),
        ),
        _entry(
            data, 21, "Tracking error of wave signal under interference.",
            "square", (1.0, 2.0), ((4.8, 8), (-3.2, 2.2)),
        ),
    ]  # fmt: skip
