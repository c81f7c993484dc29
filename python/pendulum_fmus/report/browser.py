"""Figures for the page: curves thinned to screen resolution, as JSON for plotly."""

import base64
from collections.abc import Iterable
from typing import Any

import numpy as np

from .figure import Curve, Figure, Panel
from .style import STYLES
from .thin import thinned

RESOLUTION = 2000
"""Maximum error of a thinned curve, as a fraction of a panel's height of about 250 pixels."""


class Columns:
    """The samples of each curve, by key, that its panels need."""

    def __init__(self):
        self.curves: dict[str, Curve] = {}
        self.kept: dict[str, np.ndarray] = {}

    def add(self, panel: Panel, curve: Curve) -> None:
        """Keep the samples of a curve that another panel needs."""
        kept = needed(panel, curve)
        if curve.key in self.kept:
            kept = np.union1d(self.kept[curve.key], kept)
        self.kept[curve.key] = kept
        self.curves[curve.key] = curve

    def packed(self) -> dict[str, dict[str, str]]:
        """Return {key: {x, y}} with full-precision doubles in base64."""
        return {
            key: {"x": pack(curve.x[self.kept[key]]), "y": pack(curve.y[self.kept[key]])}
            for key, curve in self.curves.items()
        }


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


def pack(column: np.ndarray) -> str:
    """Return a column as base64 of little-endian doubles."""
    return base64.b64encode(np.ascontiguousarray(column, dtype="<f8").tobytes()).decode()


def figure_json(figure: Figure) -> dict[str, Any]:
    """Return the data from which the page's script draws a figure."""
    return {
        "name": figure.name,
        "rows": [[panel_json(panel) for panel in row] for row in figure.rows],
        "legend": [[style, name or STYLES[style].name] for style, name in figure.styles()],
    }


def panel_json(panel: Panel) -> dict[str, Any]:
    """Return the data of a panel."""
    return {
        "title": panel.title,
        "xLabel": panel.x_label,
        "yLabel": panel.y_label,
        "x": panel.x_range(),
        "y": panel.y_range(),
        "logX": panel.log_x,
        "logY": panel.log_y,
        "frame": panel.frame,
        "weight": panel.weight,
        "curves": [
            {
                "key": curve.key,
                "style": curve.style,
                "name": curve.name or STYLES[curve.style].name,
                "marks": [[float(curve.x[k]), float(curve.y[k])] for k in panel.markers(index)],
            }
            for index, curve in enumerate(panel.curves)
        ],
    }


def styles_json() -> dict[str, Any]:
    """Return the styles of the curves."""
    return {
        key: {
            "light": style.light,
            "dark": style.dark,
            "dash": ",".join(f"{part * style.width:g}px" for part in style.dash) or "solid",
            "width": style.width,
            "symbol": style.symbol,
        }
        for key, style in STYLES.items()
    }


def page_json(figures: Iterable[Figure]) -> dict[str, Any]:
    """Return all data for the page's script."""
    figures, columns = list(figures), Columns()
    for figure in figures:
        for row in figure.rows:
            for panel in row:
                for curve in panel.curves:
                    columns.add(panel, curve)
    return {
        "columns": columns.packed(),
        "figures": [figure_json(figure) for figure in figures],
        "styles": styles_json(),
    }
