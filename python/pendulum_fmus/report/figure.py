"""The contents of a figure, independent of page or print."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

ANGLE = "angle θ [rad]"
ERROR = "error e [rad]"
FORCE = "force [N]"
TIME = "time t [s]"

MARKERS = 9
"""Markers along a curve."""


@dataclass(frozen=True)
class Curve:
    """One curve of a panel.

    Parameters
    ----------
    key
        Name shared by curves with the same columns.
    x, y
        Columns, shape (n,) each.
    style
        Key of STYLES.
    name
        Name in the legend; by default that of its style.
    """

    key: str
    x: np.ndarray
    y: np.ndarray
    style: str
    name: str = ""


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Parameters
    ----------
    title
        Its heading.
    x_label, y_label
        Titles of the axes, with units.
    curves
        The curves, the first at the back.
    xlim, ylim
        Visible range; None for everything.
    log_x, log_y
        Whether an axis is logarithmic.
    frame
        Part magnified in another panel: ((left, right), (bottom, top)).
    weight
        Width relative to the other panels of the row.
    """

    title: str
    y_label: str
    curves: Sequence[Curve]
    x_label: str = TIME
    xlim: tuple[float, float] | None = None
    ylim: tuple[float, float] | None = None
    log_x: bool = False
    log_y: bool = False
    frame: tuple[tuple[float, float], tuple[float, float]] | None = None
    weight: float = 1.0

    def x_range(self) -> tuple[float, float]:
        """Return the visible range of the x axis."""
        if self.xlim:
            return self.xlim
        return min(c.x[0] for c in self.curves), max(c.x[-1] for c in self.curves)

    def y_range(self) -> tuple[float, float]:
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
    """Rows of panels.

    Parameters
    ----------
    name
        Name of its files and its anchor in the page.
    title
        Its heading.
    alt
        Text alternative for screen readers.
    rows
        Rows of panels.
    """

    name: str
    title: str
    alt: str
    rows: Sequence[Sequence[Panel]]

    def styles(self) -> dict[tuple[str, str], None]:
        """Return the distinct (style, name) pairs of all curves, in order."""
        return {
            (curve.style, curve.name): None
            for row in self.rows
            for panel in row
            for curve in panel.curves
        }
