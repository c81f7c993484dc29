"""Figures for the page: curves thinned to screen resolution, as JSON for its script."""

import base64
from collections.abc import Iterable
from typing import Any

import numpy as np

from .figure import Curve, Figure, Panel
from .style import STYLES
from .thin import thinned

RESOLUTION = 1000
"""Maximum error of a thinned curve, as a fraction of a panel's height of about 250 pixels."""


class Columns:
    """The samples of each curve, by key, that its panels need."""

    def __init__(self):
        self.curves: dict[str, Curve] = {}
        self.kept: dict[str, np.ndarray] = {}

    def add(self, panel: Panel, index: int) -> None:
        """Keep the samples of curve `index` that another panel needs."""
        curve = panel.curves[index]
        kept = np.union1d(needed(panel, curve), panel.markers(index))
        if curve.key in self.kept:
            kept = np.union1d(self.kept[curve.key], kept)
        self.kept[curve.key] = kept.astype(int)
        self.curves[curve.key] = curve

    def number(self, curve: Curve) -> int:
        """Return the position of a curve in the page's list of columns."""
        return list(self.curves).index(curve.key)

    def marks(self, panel: Panel, index: int) -> list[int]:
        """Return the positions of the markers among the kept samples of curve `index`."""
        kept = self.kept[panel.curves[index].key]
        return np.searchsorted(kept, panel.markers(index)).tolist()

    def packed(self) -> dict[str, list]:
        """Return the columns in full precision, and the clocks that most of them share.

        A clock holds the x of all samples that any curve keeps; each curve has positions in it.
        """
        clocks: dict[bytes, list[str]] = {}
        for key, curve in self.curves.items():
            clocks.setdefault(curve.x.tobytes(), []).append(key)
        times, columns = [], {}
        for clock, keys in enumerate(clocks.values()):
            kept = np.unique(np.concatenate([self.kept[key] for key in keys]))
            times.append(pack(self.curves[keys[0]].x[kept], "<f8"))
            for key in keys:
                at, y = np.searchsorted(kept, self.kept[key]), self.curves[key].y[self.kept[key]]
                columns[key] = {"clock": clock, "at": pack(at, "<u4"), "y": pack(y, "<f8")}
        return {"clocks": times, "columns": [columns[key] for key in self.curves]}


def needed(panel: Panel, curve: Curve) -> np.ndarray:
    """Return the samples of a curve that a panel needs, including its extremes.

    They include one sample on each side of the visible range.
    """
    left, right = panel.x_range()
    inside = np.flatnonzero((curve.x >= left) & (curve.x <= right))
    part = slice(max(inside[0] - 1, 0), inside[-1] + 2)
    bottom, top = panel.y_range()
    x, y = curve.x[part], curve.y[part]
    if panel.log_y:
        y, bottom, top = np.log10(np.abs(y)), np.log10(bottom), np.log10(top)
    # Far off the scale, only the course of the curve through the panel matters
    height = top - bottom
    y = np.clip(y, bottom - height, top + height)
    kept = np.union1d(thinned(x, y, height / RESOLUTION), [np.argmin(y), np.argmax(y)])
    return part.start + kept


def pack(column: np.ndarray, kind: str) -> str:
    """Return a column as base64 of little-endian numbers."""
    return base64.b64encode(np.ascontiguousarray(column, dtype=kind).tobytes()).decode()


def panel_json(panel: Panel, columns: Columns) -> dict[str, Any]:
    """Return the data from which the page's script draws a panel."""
    return {
        "xLabel": panel.x_label,
        "yLabel": panel.y_label,
        "x": panel.x_range(),
        "y": panel.y_range(),
        "logX": panel.log_x,
        "logY": panel.log_y,
        "frame": panel.frame,
        "curves": [
            {
                "column": columns.number(curve),
                "style": curve.style,
                "name": curve.name or STYLES[curve.style].name,
                "marks": columns.marks(panel, index) if STYLES[curve.style].marker else [],
            }
            for index, curve in enumerate(panel.curves)
        ],
    }


def styles_json() -> dict[str, Any]:
    """Return the styles of the curves, with dashes in pixels."""
    return {
        key: {
            "light": style.light,
            "dark": style.dark,
            "dash": [round(part * style.width, 2) for part in style.dash],
            "width": style.width,
            "marker": style.marker,
        }
        for key, style in STYLES.items()
    }


def page_json(figures: Iterable[Figure]) -> dict[str, Any]:
    """Return all data for the page's script; the panels in the order of the page."""
    panels = [panel for figure in figures for row in figure.rows for panel in row]
    columns = Columns()
    for panel in panels:
        for index in range(len(panel.curves)):
            columns.add(panel, index)
    return {
        **columns.packed(),
        "panels": [panel_json(panel, columns) for panel in panels],
        "styles": styles_json(),
    }
