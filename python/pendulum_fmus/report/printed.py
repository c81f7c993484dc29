"""Figures for print: the same panels drawn with Matplotlib, as SVG and PDF."""

from collections.abc import Sequence
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .browser import needed
from .figure import Figure, Panel
from .style import STYLES

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
"""Resolution of the layout, that of SVG and PDF in Matplotlib."""


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw one panel."""
    if panel.log_x:
        axes.set_xscale("log")
    if panel.log_y:
        axes.set_yscale("log")
    for index, curve in enumerate(panel.curves):
        style, kept, marks = STYLES[curve.style], needed(panel, curve), panel.markers(index)
        axes.plot(
            curve.x[kept],
            curve.y[kept],
            color=style.light,
            linewidth=style.width,
            linestyle=(0, style.dash) if style.dash else "-",
        )
        if style.marker:
            axes.plot(
                curve.x[marks],
                curve.y[marks],
                linestyle="",
                marker=style.marker,
                markersize=4,
                markerfacecolor="white",
                color=style.light,
            )
    if panel.frame:
        (left, right), (bottom, top) = panel.frame
        frame = Rectangle(
            (left, bottom), right - left, top - bottom, fill=False, color="0.3", linewidth=0.8
        )
        axes.add_patch(frame)
    axes.set(
        title=panel.title,
        xlabel=panel.x_label,
        ylabel=panel.y_label,
        xlim=panel.x_range(),
        ylim=panel.y_range(),
    )


def legend(figure: Figure) -> list[Line2D]:
    """Return one handle per kind of curve."""
    handles = []
    for key, name in figure.styles():
        style = STYLES[key]
        handles.append(
            Line2D(
                [],
                [],
                color=style.light,
                linewidth=style.width,
                linestyle=(0, style.dash) if style.dash else "-",
                marker=style.marker or None,
                markersize=4,
                markerfacecolor="white",
                label=name or style.name,
            )
        )
    return handles


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
    return drawn


def arrange(drawn: Sheet) -> None:
    """Compute the layout once, rather than for every file."""
    drawn.get_layout_engine().execute(drawn)
    drawn.set_layout_engine(None)


def write(figure: Figure, folder: Path) -> list[Path]:
    """Write a figure as SVG and PDF; return their paths."""
    paths = [folder / f"{figure.name}.{kind}" for kind in ("svg", "pdf")]
    with rc_context(RC):
        drawn = sheet(figure)
        arrange(drawn)
        drawn.savefig(paths[0], metadata={"Date": None, "Title": figure.title})
        drawn.savefig(paths[1], metadata={"CreationDate": None, "Title": figure.title})
    return paths


def start(figures: Sequence[Figure], folder: Path, pool: Pool) -> list[AsyncResult]:
    """Start writing the figures, largest first; each result is a list of paths."""
    folder.mkdir(parents=True, exist_ok=True)
    ordered = sorted(figures, key=lambda figure: -len(figure.rows))
    return [pool.apply_async(write, (figure, folder)) for figure in ordered]
