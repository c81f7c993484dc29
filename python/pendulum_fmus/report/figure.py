"""The contents of a figure, independent of page or print; curves that several figures share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .runs import Trace

ANGLE = "angle θ [rad]"
ERROR = "error e [rad]"
FORCE = "force [N]"
TIME = "time t [s]"

MARKERS = 9
"""Markers along a curve."""

RESOLUTION = 1000
"""Maximum error of a thinned curve, as a fraction of a panel's height of about 250 pixels."""

SHOWN = ("PID", "PID-RBF", "IPID-RBF")
"""The controllers compared in the paper's figures."""

END = 20.0
"""End time of all figures [s]."""

SMALLEST = 1e-7
"""Smaller errors are drawn at the bottom of a logarithmic axis [rad]."""

Span = tuple[float, float]


@dataclass(frozen=True)
class Style:
    """The style of one kind of curve; all differ in greyscale prints, too."""

    name: str
    light: str  # colour on white; both are safe for the colour-blind
    dark: str  # colour on black
    dash: tuple[float, ...]  # lengths of dashes and gaps [pt]; empty for a solid line
    width: float  # [pt]
    marker: str = ""  # of Matplotlib


STYLES = {
    "r": Style("reference r", "#a0a0a0", "#7d7d7d", (), 3.4),
    "PID": Style("PID", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "PID-RBF": Style("PID-RBF", "#0072b2", "#56b4e9", (1.6, 1.4), 1.6, "o"),
    "IPID-RBF": Style("IPID-RBF", "#7a0f3c", "#f29bc0", (), 1.3, "^"),
    "IPID-RBF own": Style("IPID-RBF, own target", "#00805a", "#3fd3a4", (7, 2, 1.5, 2), 1.5, "D"),
    "u": Style("u", "#202020", "#e8e8e8", (), 1.2),
    "u_n": Style("u_n", "#0072b2", "#56b4e9", (5, 2), 1.5, "o"),
    "u_p": Style("u_p", "#d07a00", "#f0a030", (1.6, 1.4), 1.5, "s"),
    "half": Style("half", "#0072b2", "#56b4e9", (1.6, 1.4), 1.6, "o"),
    "one": Style("as in the paper", "#202020", "#e8e8e8", (), 1.3),
    "double": Style("double", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "winding": Style("without anti-windup", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "held": Style("with anti-windup", "#0072b2", "#56b4e9", (), 1.4, "o"),
    "limit": Style("limit", "#a0a0a0", "#7d7d7d", (), 1.4),
}


@dataclass(frozen=True)
class Curve:
    """One curve of a panel; columns have shape (n,)."""

    key: str  # shared by curves with the same columns
    x: np.ndarray
    y: np.ndarray
    style: str
    name: str = ""  # in the legend; by default the name of its style


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    title: str
    y_label: str  # with its unit
    curves: Sequence[Curve]  # the first at the back
    x_label: str = TIME
    xlim: Span | None = None  # the visible range; None for everything
    ylim: Span | None = None
    log_x: bool = False
    log_y: bool = False
    frame: tuple[Span, Span] | None = None  # the part magnified in another panel: x, y
    weight: float = 1.0  # width relative to the other panels of the row

    def x_range(self) -> Span:
        """Return the visible range of the x axis."""
        if self.xlim:
            return self.xlim
        return min(c.x[0] for c in self.curves), max(c.x[-1] for c in self.curves)

    def y_range(self) -> Span:
        """Return the visible range of the y axis: all curves and a margin, or `ylim`."""
        if self.ylim:
            return self.ylim
        low, high = self.x_range()
        shown = np.concatenate([c.y[(c.x >= low) & (c.x <= high)] for c in self.curves])
        bottom, top = float(shown.min()), float(shown.max())
        if self.log_y:
            return bottom / 1.5, top * 1.5
        margin = 0.05 * (top - bottom or 1)
        return bottom - margin, top + margin

    def needed(self, curve: Curve) -> np.ndarray:
        """Return the samples of a curve that the panel needs, including its extremes.

        They include one sample on each side of the visible range.
        """
        left, right = self.x_range()
        inside = np.flatnonzero((curve.x >= left) & (curve.x <= right))
        part = slice(max(inside[0] - 1, 0), inside[-1] + 2)
        bottom, top = self.y_range()
        x, y = curve.x[part], curve.y[part]
        if self.log_y:
            y, bottom, top = np.log10(np.abs(y)), np.log10(bottom), np.log10(top)
        # Far off the scale, only the course of the curve through the panel matters
        height = top - bottom
        y = np.clip(y, bottom - height, top + height)
        kept = np.union1d(thinned(x, y, height / RESOLUTION), [np.argmin(y), np.argmax(y)])
        return part.start + kept

    def markers(self, index: int) -> np.ndarray:
        """Return the samples of curve `index` with a marker; staggered from curve to curve."""
        curve, (low, high) = self.curves[index], self.x_range()
        offset = (index + 0.5) / len(self.curves)
        share = (np.arange(MARKERS) + offset) / MARKERS
        at = low * (high / low) ** share if self.log_x else low + (high - low) * share
        found = np.searchsorted(curve.x, at)
        return np.unique(found[found < len(curve.x)])


@dataclass(frozen=True)
class Figure:
    """Rows of panels."""

    name: str  # of its files, and its anchor in the page
    title: str
    alt: str  # for screen readers
    rows: Sequence[Sequence[Panel]]

    def styles(self) -> dict[tuple[str, str], None]:
        """Return the distinct (style, name) pairs of all curves, in order."""
        return {
            (curve.style, curve.name): None
            for row in self.rows
            for panel in row
            for curve in panel.curves
        }


def thinned(x: np.ndarray, y: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the indices of the samples to keep, increasing, shape (kept,).

    Linear interpolation between them deviates by at most `tolerance`, in the unit of y. The sample
    with the largest deviation in each gap is kept first (Douglas-Peucker), so peaks are preserved.

    Parameters
    ----------
    x, y
        The curve, shape (n,) each, n >= 2; x increases, y is finite.
    tolerance
        Maximum deviation.
    """
    keep = np.array([0, len(x) - 1])
    while True:
        deviation = np.abs(y - np.interp(x, x[keep], y[keep]))
        gap = np.searchsorted(keep, np.arange(len(x)), side="right")
        worst = np.maximum.reduceat(deviation, keep)
        candidates = np.flatnonzero((deviation == worst[gap - 1]) & (deviation > tolerance))
        if not candidates.size:
            return keep
        _, first = np.unique(gap[candidates], return_index=True)
        keep = np.union1d(keep, candidates[first])


# --- curves and panels --------------------------------------------------------------------------


def curve(trace: Trace, column: str, style: str) -> Curve:
    """Return a column of a trace as a curve."""
    return Curve(f"{trace.key}/{column}", trace.t, getattr(trace, column), style)


def outputs(traces: Mapping[str, Trace]) -> list[Curve]:
    """Return the reference and the angle under each controller."""
    first = next(iter(traces.values()))
    reference = Curve(f"r/{first.key}", first.t, first.r, "r")
    return [reference, *(curve(trace, "theta", kind) for kind, trace in traces.items())]


def magnitudes(traces: Mapping[str, Trace], smallest: float = SMALLEST) -> list[Curve]:
    """Return |e| of each controller, for a logarithmic axis."""
    return [
        Curve(f"{trace.key}/|e|", trace.t, np.maximum(np.abs(trace.e), smallest), kind)
        for kind, trace in traces.items()
    ]
