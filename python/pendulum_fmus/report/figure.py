"""The contents of figures, independent of page or print.

Three kinds of figures are the paper's Figures 4 to 21: a function of a kind returns the rows of
panels of one row of `zooms` in `statements.toml`, which has the amplitude `d` of the disturbance
[rad], the magnified part `x`, `y`, and the range `ylim` of all. The functions of other figures
return the curves of each of the `panels` there.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..loop import Loop
from .measures import energy_of
from .runs import ALONE, END, FACTORS, GAINS, KINDS, SHOWN, Data, Trace

ANGLE = "angle θ [rad]"
ERROR = "error e [rad]"
FORCE = "force [N]"
TIME = "time t [s]"

MARKERS = 9
"""Markers along a curve."""

RESOLUTION = 1000
"""Maximum error of a thinned curve, as a fraction of a panel's height of about 250 pixels."""

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
    "found": Style("gains found", "#202020", "#e8e8e8", (), 1.2),
    "LQR": Style("LQR", "#8a5fb0", "#c3a3e0", (9, 3), 1.5),
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
    along: bool = False  # whether x goes back and forth, as in a Nyquist plot


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
        if curve.along:
            return np.arange(len(curve.x))
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
        if curve.along:
            return (share * len(curve.x)).astype(int)
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
    """Return the indices of the samples of a curve to keep, increasing, shape (kept,).

    x and y have shape (n,), n >= 2; x increases, y is finite. Linear interpolation between the kept
    samples deviates by at most `tolerance`, in the unit of y. The sample with the largest deviation
    in each gap is kept first (Douglas-Peucker), so peaks are preserved.
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


# --- the paper's figures ------------------------------------------------------------------------

Rows = list[list[Panel]]


def panels(rows: Sequence[Sequence[Mapping[str, Any]]], curves: Iterable[list[Curve]]) -> Rows:
    """Return panels as described, with the curves of one after another."""
    given = iter(curves)

    def panel(described: Mapping[str, Any]) -> Panel:
        lims = {lim: tuple(described[lim]) for lim in ("xlim", "ylim") if lim in described}
        if "frame" in described:
            lims["frame"] = tuple(map(tuple, described["frame"]))
        logs = {f"log_{axis}": True for axis in described.get("log", "")}
        labels = described["title"], described["y"]
        weight = described.get("weight", 1.0)
        return Panel(*labels, next(given), described.get("x", TIME), **lims, **logs, weight=weight)

    return [[panel(described) for described in row] for row in rows]


def _zoomed(curves: Sequence[Curve], title: str, label: str, row: Mapping) -> list[Panel]:
    """Return a panel with all curves, and one that magnifies a framed part."""
    x, y, ylim = tuple(row["x"]), tuple(row["y"]), tuple(row.get("ylim", ())) or None
    whole = Panel(title, label, curves, xlim=(0, END), ylim=ylim, frame=(x, y), weight=1.7)
    return [whole, Panel("the framed part", label, curves, xlim=x, ylim=y)]


def tracking(traces: Mapping[str, Trace], case: str, row: Mapping[str, Any]) -> Rows:
    """Return the reference and the angles, or the measured angles."""
    curves = outputs(traces)
    if not row.get("measured"):
        return [_zoomed(curves, case, ANGLE, row)]
    curves[1:] = [Curve(f"{t.key}/y", t.t, t.theta + t.d, kind) for kind, t in traces.items()]
    return [_zoomed(curves, "measured angle θ + d", "θ + d [rad]", row)]


def errors(traces: Mapping[str, Trace], case: str, row: Mapping[str, Any]) -> Rows:
    """Return the errors, magnified and as absolute values."""
    curves = [curve(trace, "e", kind) for kind, trace in traces.items()]
    shown = {"xlim": (0, END), "ylim": (SMALLEST, 10), "log_y": True}
    logarithmic = Panel(f"{case}: magnitude", "|e| [rad]", magnitudes(traces), **shown)
    return [_zoomed(curves, case, ERROR, row), [logarithmic]]


def forces(traces: Mapping[str, Trace], _case: str, row: Mapping[str, Any]) -> Rows:
    """Return the forces of PID-RBF and IPID-RBF side by side, with magnified parts below."""
    x, y = tuple(row["x"]), tuple(row["y"])
    disturbed = f", d = {row['d']:g} rad" if row.get("d") else ""
    shown = {"xlim": (0, END), "ylim": tuple(row["ylim"]), "frame": (x, y)}
    above, below = [], []
    for kind in SHOWN[1:]:
        curves = [curve(traces[kind], name, name) for name in ("u_p", "u_n", "u")]
        above.append(Panel(f"{kind}{disturbed}", FORCE, curves, **shown))
        below.append(Panel(f"{kind}, the framed part", FORCE, curves, xlim=x, ylim=y))
    return [above, below]


DRAWN = {"tracking": tracking, "errors": errors, "forces": forces}


def zoomed(data: Data, kind: str, signal: str, zooms: Iterable[Mapping[str, Any]]) -> Rows:
    """Return the rows of panels of a figure of a kind."""
    rows = []
    for row in zooms:
        amplitude = row.get("d", 0.0)
        case = f"{signal}, disturbance {amplitude:g} rad" if amplitude else signal
        traces = {shown: data(shown, signal, amplitude) for shown in SHOWN}
        rows += DRAWN[kind](traces, case, row)
    return rows


def headline(data: Data) -> list[list[Curve]]:
    """Return a step's angles and errors, each twice, and the force with a sample more of delay."""
    step = {kind: data(kind) for kind in KINDS}
    errors = [curve(trace, "e", kind) for kind, trace in step.items()]
    kinds = ("PID-RBF", "PID")
    late = data.simulated([Loop(ALONE[kind], order="parallel") for kind in kinds])
    forces = [curve(trace, "u", kind) for kind, trace in zip(kinds, late, strict=True)]
    return [*(2 * [outputs(step)]), magnitudes(step), errors, *(2 * [forces])]


def response(data: Data) -> list[list[Curve]]:
    """Return the response to a step, twice, and force and angle of a step that is held for long."""
    angles = outputs({kind: data(kind) for kind in SHOWN})
    long = {kind: data.lasting(kind) for kind in SHOWN}
    held = [[curve(t, column, kind) for kind, t in long.items()] for column in ("u", "theta")]
    return [angles, angles, *held]


def gains(data: Data) -> list[list[Curve]]:
    """Return the step responses of the PID with other gains, one panel per gain, twice."""
    styles = dict(zip(FACTORS, ("half", "one", "double"), strict=True))
    return 2 * [
        [curve(data.gains(gain, factor), "theta", style) for factor, style in styles.items()]
        for gain in GAINS
    ]


def lyapunov(data: Data) -> list[list[Curve]]:
    """Return the magnitude of the error, and the sum of its squares."""
    traces = {kind: data(kind) for kind in SHOWN[1:]}
    sums = [Curve(f"V/{kind}", trace.t, energy_of(trace.e), kind) for kind, trace in traces.items()]
    return [magnitudes(traces), sums]
