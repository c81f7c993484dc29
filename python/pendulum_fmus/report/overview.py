"""closed-loop.png: the three controllers at a glance, without disturbance."""

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure as Sheet

from .. import table1
from .data import Data
from .figure import ANGLE, Figure, Panel
from .paper.curves import END, SHOWN, absolute_errors, outputs
from .printed import RC, draw_panel, legend
from .scenarios import SIGNALS


def panels(data: Data) -> list[list[Panel]]:
    """Return angles above absolute errors, one column per signal."""
    traces = {s: {kind: data(kind, s) for kind in SHOWN} for s in SIGNALS}
    return [
        [Panel(s, ANGLE, outputs(traces[s]), xlim=(0, END), ylim=(-1.6, 1.6)) for s in SIGNALS],
        [
            Panel(
                "",
                "|e| [rad]",
                absolute_errors(traces[s]),
                xlim=(0, END),
                ylim=(1e-6, 5),
                log_y=True,
            )
            for s in SIGNALS
        ],
    ]


def write(results: table1.Results, folder: Path) -> list[Path]:
    """Write table1.txt and closed-loop.png to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    table, picture = folder / "table1.txt", folder / "closed-loop.png"
    table.write_text(table1.report(results)[0] + "\n", encoding="utf-8")
    draw(Data(results), picture)
    return [table, picture]


def draw(data: Data, path: Path) -> None:
    """Draw the overview."""
    rows = panels(data)
    with rc_context(RC | {"savefig.dpi": 150, "font.size": 9, "axes.titlesize": 10}):
        sheet = Sheet(figsize=(10, 4.4), layout="constrained")
        grid = sheet.subplots(2, 3, sharex="col", sharey="row")
        for axes, row in zip(grid, rows, strict=True):
            for one, panel in zip(axes, row, strict=True):
                draw_panel(one, panel)
        for one in [*grid[:, 1:].flat]:
            one.set_ylabel("")
        for one in grid[0]:
            one.set_xlabel("")
        handles = legend(Figure("overview", "", "", rows))
        sheet.legend(handles=handles, loc="outside upper center", ncols=4)
        sheet.savefig(path)
