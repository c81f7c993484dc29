"""Figures for print, drawn with Matplotlib: each as SVG and PDF, and an overview as PNG."""

from collections.abc import Sequence
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .. import table1
from .figure import ANGLE, FORCE, STYLES, Figure, Panel, Style, curve, magnitudes, outputs
from .runs import END, SHOWN, SIGNALS, Data

RC = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.hashsalt": "report",  # makes the files reproducible
    "path.simplify": False,
}

WIDTH, ROW = 7.0, 2.1
"""Width of a figure, height of a row of panels [inch]."""

DPI = 72
"""Resolution of the layout, the same as for SVG and PDF in Matplotlib."""


def line(style: Style) -> dict[str, Any]:
    """Return the options of a line."""
    dash = (0, style.dash) if style.dash else "-"
    return {"color": style.light, "linewidth": style.width, "linestyle": dash}


def marks(style: Style) -> dict[str, Any]:
    """Return the options of markers."""
    return {"marker": style.marker or None, "markersize": 4, "markerfacecolor": "white"}


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw one panel."""
    if panel.log_x:
        axes.set_xscale("log")
    if panel.log_y:
        axes.set_yscale("log")
    for index, drawn in enumerate(panel.curves):
        style, kept, marked = STYLES[drawn.style], panel.needed(drawn), panel.markers(index)
        axes.plot(drawn.x[kept], drawn.y[kept], **line(style))
        if style.marker:
            options = line(style) | marks(style) | {"linestyle": ""}
            axes.plot(drawn.x[marked], drawn.y[marked], **options)
    if panel.frame:
        (left, right), (bottom, top) = panel.frame
        size = right - left, top - bottom
        axes.add_patch(Rectangle((left, bottom), *size, fill=False, color="0.3", linewidth=0.8))
    axes.set(
        title=panel.title,
        xlabel=panel.x_label,
        ylabel=panel.y_label,
        xlim=panel.x_range(),
        ylim=panel.y_range(),
    )


def legend(figure: Figure) -> list[Line2D]:
    """Return one handle per kind of curve."""
    named = [(STYLES[key], name) for key, name in figure.styles()]
    return [Line2D([], [], **line(s), **marks(s), label=name or s.name) for s, name in named]


def sheet(figure: Figure) -> Sheet:
    """Draw a figure."""
    size = (WIDTH, ROW * len(figure.rows) + 0.3)
    drawn = Sheet(figsize=size, dpi=DPI, layout="constrained")
    rows = drawn.subfigures(len(figure.rows), 1, squeeze=False)[:, 0]
    for row, panels in zip(rows, figure.rows, strict=True):
        weights = [panel.weight for panel in panels]
        axes = row.subplots(1, len(panels), width_ratios=weights, squeeze=False)[0]
        for one, panel in zip(axes, panels, strict=True):
            draw_panel(one, panel)
    handles = legend(figure)
    if len(handles) > 1:
        drawn.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5))
    # The layout is computed once, rather than for every file
    drawn.get_layout_engine().execute(drawn)
    drawn.set_layout_engine(None)
    return drawn


def write(figure: Figure, folder: Path, kinds: Sequence[str] = ("svg", "pdf")) -> list[Path]:
    """Write a figure as files of some kinds; return their paths."""
    paths = [folder / f"{figure.name}.{kind}" for kind in kinds]
    with rc_context(RC):
        drawn = sheet(figure)
        for path in paths:
            date = "Date" if path.suffix == ".svg" else "CreationDate"
            drawn.savefig(path, dpi=150, metadata={date: None, "Title": figure.title})
    return paths


def start(figures: Sequence[Figure], folder: Path, pool: Pool) -> list[AsyncResult]:
    """Start writing the figures, largest first; each result is a list of paths."""
    folder.mkdir(parents=True, exist_ok=True)
    ordered = sorted(figures, key=lambda figure: -len(figure.rows))
    return [pool.apply_async(write, (figure, folder)) for figure in ordered]


# --- the overview -------------------------------------------------------------------------------


def write_overview(results: table1.Results, folder: Path) -> list[Path]:
    """Write table1.txt to a folder, and closed-loop.png: angles, errors, forces and positions."""
    folder.mkdir(parents=True, exist_ok=True)
    table, data = folder / "table1.txt", Data(results)
    table.write_text(table1.report(results)[0] + "\n", encoding="utf-8")
    traces = {s: {kind: data(kind, s) for kind in SHOWN} for s in SIGNALS}
    above = {"xlim": (0, END), "ylim": (-1.6, 1.6)}
    below = {"xlim": (0, END), "ylim": (1e-6, 5), "log_y": True}
    further = [
        ("u", FORCE, {"xlim": (0, END), "ylim": (-150, 150)}),
        ("x", "cart x [m]", {"xlim": (0, END)}),
    ]
    rows = [
        [Panel(s, ANGLE, outputs(traces[s]), **above) for s in SIGNALS],
        [Panel("", "|e| [rad]", magnitudes(traces[s]), **below) for s in SIGNALS],
        *(
            [
                Panel("", label, [curve(t, column, kind) for kind, t in traces[s].items()], **span)
                for s in SIGNALS
            ]
            for column, label, span in further
        ),
    ]
    return [table, *write(Figure("closed-loop", "The loops of Table 1", "", rows), folder, ["png"])]
