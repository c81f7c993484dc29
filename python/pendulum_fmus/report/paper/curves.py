"""Curves and panels shared by several figures."""

from collections.abc import Callable, Sequence

import numpy as np

from ..data import Data, Trace
from ..figure import ANGLE, ERROR, FORCE, Curve, Panel

SHOWN = ("PID", "PID-RBF", "IPID-RBF")
"""The controllers compared in the paper's figures."""

END = 20.0
"""End time of all figures [s]."""

SMALLEST = 1e-7
"""Smaller errors are drawn at the bottom of a logarithmic axis [rad]."""

Span = tuple[float, float]


def curve(trace: Trace, column: str, style: str) -> Curve:
    """Return a column of a trace as a curve."""
    return Curve(f"{trace.key}/{column}", trace.t, getattr(trace, column), style)


def outputs(traces: dict[str, Trace]) -> list[Curve]:
    """Return the reference and the angle under each controller."""
    first = next(iter(traces.values()))
    reference = Curve(f"r/{first.key}", first.t, first.r, "r")
    return [reference, *(curve(trace, "theta", kind) for kind, trace in traces.items())]


def errors(traces: dict[str, Trace]) -> list[Curve]:
    """Return the error of each controller."""
    return [curve(trace, "e", kind) for kind, trace in traces.items()]


def absolute_errors(traces: dict[str, Trace]) -> list[Curve]:
    """Return |e| of each controller, for a logarithmic axis."""
    return [
        Curve(f"{trace.key}/|e|", trace.t, np.maximum(np.abs(trace.e), SMALLEST), kind)
        for kind, trace in traces.items()
    ]


def forces(trace: Trace) -> list[Curve]:
    """Return the parts of a controller's force, with their sum in front."""
    return [curve(trace, name, name) for name in ("u_p", "u_n", "u")]


def with_zoom(
    curves: Sequence[Curve], title: str, y_label: str, x_zoom: Span, y_zoom: Span, ylim: Span | None
) -> list[Panel]:
    """Return a panel with all curves, and one that magnifies a framed part."""
    whole = Panel(
        title, y_label, curves, xlim=(0, END), ylim=ylim, frame=(x_zoom, y_zoom), weight=1.7
    )
    return [whole, Panel("the framed part", y_label, curves, xlim=x_zoom, ylim=y_zoom)]


def tracking_row(
    data: Data, signal: str, amplitude: float, x_zoom: Span, y_zoom: Span, ylim: Span | None = None
) -> list[Panel]:
    """Return panels of the reference and the angles under the three controllers."""
    traces = {kind: data(kind, signal, amplitude) for kind in SHOWN}
    title = named(signal, amplitude)
    return with_zoom(outputs(traces), title, ANGLE, x_zoom, y_zoom, ylim)


def error_rows(
    data: Data, signal: str, amplitude: float, x_zoom: Span, y_zoom: Span
) -> list[list[Panel]]:
    """Return panels of the errors of the three controllers, magnified and as absolute values."""
    traces = {kind: data(kind, signal, amplitude) for kind in SHOWN}
    title = named(signal, amplitude)
    logarithmic = Panel(
        f"{title}: magnitude",
        "|e| [rad]",
        absolute_errors(traces),
        xlim=(0, END),
        ylim=(SMALLEST, 10),
        log_y=True,
    )
    return [with_zoom(errors(traces), title, ERROR, x_zoom, y_zoom, None), [logarithmic]]


def force_rows(
    data: Data, signal: str, amplitude: float, x_zoom: Span, y_zoom: Span, ylim: Span
) -> list[list[Panel]]:
    """Return the forces of PID-RBF and IPID-RBF side by side, with magnified parts below."""
    kinds = ("PID-RBF", "IPID-RBF")
    disturbed = f", d = {amplitude:g} rad" if amplitude else ""

    def row(make: Callable[[str, Sequence[Curve]], Panel]) -> list[Panel]:
        return [make(kind, forces(data(kind, signal, amplitude))) for kind in kinds]

    return [
        row(
            lambda kind, curves: Panel(
                f"{kind}{disturbed}",
                FORCE,
                curves,
                xlim=(0, END),
                ylim=ylim,
                frame=(x_zoom, y_zoom),
            )
        ),
        row(
            lambda kind, curves: Panel(
                f"{kind}, the framed part", FORCE, curves, xlim=x_zoom, ylim=y_zoom
            )
        ),
    ]


def named(signal: str, amplitude: float) -> str:
    """Describe the signal and the disturbance of a loop."""
    return f"{signal}, disturbance {amplitude:g} rad" if amplitude else signal
