"""Pictures of results, by Matplotlib."""

from __future__ import annotations

import io
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ._runs import INDEX, Runs, Values, is_table, is_wide, numbers
from ._values import one_or_more

if TYPE_CHECKING:
    from .comparison import Comparison
    from .result import Result

_BUCKETS = 1000
"""In each of so many parts of a line, a picture shows the smallest and the largest value."""

_MOST = 24
"""The most pictures that are drawn without being asked for."""

_MARKED = 200
"""The most values of a clocked variable that have a mark each."""

_DASHES = ("-", "--", "-.", ":")
"""The dashes of the runs that are compared."""

_WINDOWS = {"gtk3agg", "gtk4agg", "macosx", "qtagg", "tkagg", "wxagg"}
"""The backends of Matplotlib that show windows."""

_REFERENCE: dict[str, Any] = {
    "color": "0.5",
    "linestyle": (0, (4, 2)),
    "linewidth": 1.1,
    "zorder": 1.9,
}
"""The look of a set-point, in light and dark styles."""


class Picture(Figure):
    """A figure that a notebook shows when it is the value of a cell, without pyplot, too."""

    def _repr_png_(self) -> bytes:
        return _png(self)


def blank(width: float, height: float) -> Figure:
    """Return an empty figure [in], which `pyplot.show` shows if the program uses windows."""
    settings: dict[str, Any] = {"figsize": (width, height), "layout": "constrained"}
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None and pyplot.get_backend().lower() in _WINDOWS:
        figure: Figure = pyplot.figure(FigureClass=Picture, **settings)
        return figure
    return Picture(**settings)


def extremes(values: np.ndarray, buckets: int = _BUCKETS) -> np.ndarray:
    """Return the rows that draw a line: the extremes of each bucket, and the ends.

    A gap (NaN) is a row of its bucket, too. A line of few rows keeps all.
    """
    count = len(values)
    size = count // buckets
    if size <= 4:
        return np.arange(count)
    whole = size * buckets
    blocks = values[:whole].reshape(buckets, size)
    starts = np.arange(0, whole, size)
    chosen = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)]
    if values.dtype.kind == "f":
        # NumPy takes NaN for the smallest and the largest number.
        for start in starts[np.isnan(values[chosen[0]])]:
            block = values[start : start + size]
            if not np.isnan(block).all():
                chosen.append(start + np.array([np.nanargmin(block), np.nanargmax(block)]))
    return np.unique(np.concatenate([[0], *chosen, np.arange(whole, count), [count - 1]]))


def png(result: Result) -> bytes:
    """Return the picture of a result as a PNG, of at most eight signals."""
    return _png(draw(result, most=8))


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


class _Panel(NamedTuple):
    """One picture: the signals in it, and the set-points that they follow."""

    title: str
    names: list[str]
    references: list[str]
    is_band: bool
    height: float


def draw(
    result: Result,
    names: Sequence[str | Sequence[str]] | None = None,
    over: Any = None,
    label: str = "",
    most: int = _MOST,
) -> Figure:
    """Draw a result; see `Result.plot`. Without names, it has no more than so many pictures."""
    if is_table(result):
        if over is not None:
            raise TypeError("over: the runs of a sweep are in one picture, expected None")
        return _draw_sweep(Runs(result), None if names is None else one_or_more(names))
    runs = {label: result} | _others(over)
    panels, count = _panels(result, names, len(runs), most)
    columns = 1 if len(panels) <= 5 else 2
    rows = max(-(-len(panels) // columns), 1)
    heights = [
        max((panel.height for panel in panels[row * columns : (row + 1) * columns]), default=1.7)
        for row in range(rows)
    ]
    figure = blank(7.0 if columns == 1 else 11.0, 0.5 + sum(heights))
    grid = figure.add_gridspec(rows, columns, height_ratios=heights)
    first: Axes | None = None
    for place, panel in enumerate(panels):
        axis = figure.add_subplot(grid[divmod(place, columns)], sharex=first)
        first = first or axis
        _draw_panel(axis, panel, runs)
        is_last = place + columns >= len(panels)
        axis.tick_params(labelbottom=is_last)
        axis.set_xlabel(_label(result) if is_last else "")
    if len(runs) > 1 and first is not None:
        lines = [first.plot([], [], **_style(place, True))[0] for place in range(len(runs))]
        for line in lines:
            line.remove()
        figure.legend(lines, list(runs), loc="outside upper center", ncols=4, frameon=False)
    if count > len(panels):
        figure.suptitle(f"{len(panels)} of {count} signals; `names` chooses others", fontsize=9)
    return figure


def _others(over: Any) -> dict[str, Result]:
    """Return the results to compare with, by name."""
    if over is None:
        return {}
    if hasattr(over, "units"):
        return {"other run": over}
    if isinstance(over, Mapping):
        return dict(over)
    return {f"run {number}": result for number, result in enumerate(over, 2)}


def _label(result: Result) -> str:
    """Return the label of the x axis."""
    first = next(iter(result), "time")
    unit = "s" if first == "time" else result.units.get(first)
    return f"{first} [{unit}]" if unit else first


def _elements(result: Result, name: str) -> list[str]:
    """Return the columns of a variable, which are those of its elements if it is an array."""
    if name in set(result):
        return [name]
    found = [n for n in result if re.fullmatch(rf"{re.escape(name)}\[[\d,]+\]", n)]
    if not found:
        result[name]  # raises an error that tells what there is
    return found


def _panels(
    result: Result, names: Sequence[str | Sequence[str]] | None, runs: int, most: int
) -> tuple[list[_Panel], int]:
    """Return the pictures to draw, and how many there would be."""
    groups: dict[str, list[str]] = {}
    if names is None:
        recorded = list(result)[1:]
        drawn = {result.set_points[n] for n in recorded if n in result.set_points}
        for name in recorded:
            column = result[name]
            is_binary = column.dtype == object and any(isinstance(v, bytes) for v in column[:1])
            if name not in drawn and not is_binary:
                groups.setdefault(re.sub(r"\[[\d,]+\]$", "", name), []).append(name)
    else:
        for given in one_or_more(names):
            parts = one_or_more(given)
            groups[", ".join(parts)] = [n for part in parts for n in _elements(result, part)]
    panels = []
    for title, members in list(groups.items())[: most if names is None else None]:
        found = dict.fromkeys(result.set_points.get(name, name) for name in members)
        references = [name for name in found if name in result and name not in members]
        is_band = all(result[name].dtype == bool for name in members)
        count = len(members) * runs
        height = 0.45 + 0.2 * count if is_band else 1.7
        panels.append(_Panel(title, members, references, is_band, height))
    return panels, len(groups)


def _style(run: int, is_compared: bool) -> dict[str, Any]:
    """Return the look of a line; runs that are compared have their own colours and dashes."""
    dashes = {"color": f"C{run}", "linestyle": _DASHES[run % len(_DASHES)]} if is_compared else {}
    return {"linewidth": 1.3, **dashes}


def _draw_panel(axis: Axes, panel: _Panel, runs: Mapping[str, Result]) -> None:
    title = textwrap.fill(panel.title, 70, break_on_hyphens=False)
    axis.set_title(title, loc="left", fontsize="medium")
    axis.margins(x=0)
    if panel.is_band:
        _draw_bands(axis, panel, runs)
        return
    axis.grid(alpha=0.3)
    first_run = next(iter(runs.values()))
    for name in panel.references:
        _line(axis, first_run, name, _REFERENCE)
    names_of_values: dict[int, str] = {}
    for place, run in enumerate(runs.values()):
        colours = _colours(axis, len(panel.names))
        for name, colour in zip(panel.names, colours, strict=False):
            if name in run:
                style = _style(place, len(runs) > 1)
                names_of_values |= _line(axis, run, name, {"color": colour} | style)
    if names_of_values:
        ticks = sorted(names_of_values)
        axis.set_yticks(ticks, [textwrap.shorten(names_of_values[t], 30) for t in ticks])
        axis.margins(y=0.15)
    elif units := {first_run.units.get(name, "") for name in panel.names} - {""}:
        axis.set_ylabel(" ".join(f"[{unit}]" for unit in sorted(units)))
    _key(axis, panel, len(runs) > 1)


def _colours(axis: Axes, count: int) -> Any:
    """Return a colour for each signal of a picture."""
    if count <= 10:
        return (f"C{number}" for number in range(count))
    import matplotlib

    return cycle(matplotlib.colormaps["viridis"](np.linspace(0, 0.9, count)))


def _key(axis: Axes, panel: _Panel, is_compared: bool) -> None:
    """Name the lines of a picture beside its title, unless the title is the name of its line."""
    lines, names = axis.get_legend_handles_labels()
    shown = dict(zip(names, lines, strict=True))
    if is_compared:
        # The figure names the runs.
        shown = {name: line for name, line in shown.items() if name in panel.references}
    elif len(shown) > 6:
        first, *_, last = shown
        shown = {first: shown[first], f"… {last}": shown[last]}
    if len(shown) > 1 or panel.references:
        # Of an array, which is the title, the indices.
        texts = [re.sub(rf"{re.escape(panel.title)}(?=\[)", "", name) for name in shown]
        place: dict[str, Any] = {
            "loc": "lower right",
            "bbox_to_anchor": (1.0, 1.0),
            "borderaxespad": 0.1,
        }
        look: dict[str, Any] = {
            "ncols": 6,
            "frameon": False,
            "fontsize": "small",
            "handlelength": 1.6,
        }
        axis.legend(list(shown.values()), texts, **place, **look)


def _present(result: Result, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the first column and another one, without the rows in which a value is absent."""
    first, column = result[next(iter(result))], result[name]
    if not np.ma.isMaskedArray(column):
        return first, column
    return first[~np.ma.getmaskarray(column)], column.compressed()


def _values(result: Result, name: str, column: np.ndarray) -> Values:
    """Return a column as numbers, with the names of enumerations and texts."""
    items = result.enumerations.get(name)
    if items is None:
        return numbers(column)
    used = set(np.unique(column).tolist())
    known = items if len(items) <= 8 else {n: text for n, text in items.items() if n in used}
    return Values(column, {n: str(n) for n in used} | known)


def _line(axis: Axes, result: Result, name: str, style: Mapping[str, Any]) -> dict[int, str]:
    """Draw a column over the first one; return the names of its values."""
    times, column = _present(result, name)
    values, names = _values(result, name, column)
    rows = extremes(values)
    is_held = name in result.held or bool(names) or values.dtype.kind in "iu"
    steps = "steps-post" if is_held else "default"
    # Of a variable with few values, each is seen.
    is_sparse = np.ma.isMaskedArray(result[name]) and len(values) <= _MARKED
    marker = "." if is_sparse else ""
    axis.plot(times[rows], values[rows], drawstyle=steps, marker=marker, label=name, **style)
    return names


def _draw_bands(axis: Axes, panel: _Panel, runs: Mapping[str, Result]) -> None:
    """Draw a band for each Boolean, where it is true."""
    ticks: list[str] = []
    for place, (label, run) in enumerate(runs.items()):
        for number, name in enumerate(panel.names):
            if name not in run:
                continue
            times, column = _present(run, name)
            if not len(column):
                continue
            values = column.view(np.int8)
            rows = extremes(values)
            time, is_true = times[rows], values[rows]
            edges = np.diff(is_true, prepend=np.int8(0), append=np.int8(0))
            begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
            ends = np.minimum(ends, len(time) - 1)
            spans = list(zip(time[begins], time[ends] - time[begins], strict=True))
            colour = f"C{place if len(runs) > 1 else number}"
            look: dict[str, Any] = {
                "facecolor": colour,
                "edgecolor": colour,
                "linewidth": 0.5,
                "alpha": 0.7,
            }
            axis.broken_barh(spans, (len(ticks) - 0.4, 0.8), label=name, **look)
            axis.update_datalim([(time[0], len(ticks)), (time[-1], len(ticks))])
            names = [name] * (len(panel.names) > 1) + [label] * (len(runs) > 1)
            ticks.append(", ".join(names) or "true")
    axis.set_yticks(range(len(ticks)), ticks)
    axis.set_ylim(len(ticks) - 0.4, -0.6)
    axis.autoscale_view(scaley=False)


def _draw_sweep(runs: Runs, names: Sequence[str] | None) -> Figure:
    """Draw metrics over the runs and over each parameter that varies; of two, also a map."""
    metrics = runs.metrics[:1] if names is None else list(names)
    varied = runs.varied
    index = {INDEX: Values(runs.table[INDEX], {})}
    panels = [(metric, x) for metric in metrics for x in (index | varied).items()]
    has_map = len(varied) == 2 and len(metrics) == 1
    count = len(panels) + has_map
    columns = min(count, 2) or 1
    rows = max(-(-count // columns), 1)
    figure = blank(4.0 + 3.0 * columns, 0.5 + 2.6 * rows)
    grid = figure.add_gridspec(rows, columns)
    for place, (metric, (name, x)) in enumerate(panels):
        _draw_metric(figure.add_subplot(grid[divmod(place, columns)]), runs, metric, name, x)
    if has_map:
        cell = grid[divmod(len(panels), columns)]
        _draw_map(figure, figure.add_subplot(cell), runs, metrics[0])
    failed = int(runs.failed.sum())
    about = f"{len(runs)} run{'s' * (len(runs) != 1)}"
    lines = [f"{about}, {failed} diverged or failed (red)" if failed else about]
    for metric in metrics:
        for row in runs.best(metric):
            value, run = runs.values(metric)[row], runs.table[INDEX][row]
            lines[0] += f"; best {metric} {value:.4g}: run {run} (star)"
        lines += runs.edges(metric).values()
    text = "\n".join(textwrap.fill(line, 55 * columns) for line in lines)
    figure.suptitle(text, fontsize="medium")
    return figure


def _draw_metric(axis: Axes, runs: Runs, metric: str, name: str, x: Values) -> None:
    """Draw a metric over the runs or over a parameter, with the best of each value of it."""
    places, values = x.numbers.astype(float), runs.values(metric)
    count = len(runs)
    size = 7.0 if count <= 1000 else 3.5
    dots: dict[str, Any] = {
        "linestyle": "none",
        "marker": ".",
        "markersize": size,
        "markeredgewidth": 0,
    }
    alpha = min(0.9, max(0.2, 1000 / max(count, 1)))
    axis.plot(places, values, alpha=alpha, rasterized=count > 2000, label=metric, **dots)
    if name != INDEX and not x.names and count:
        axis.plot(*_lowest(places, values), color="C0", linewidth=1.2, label="best of each value")
    failed = np.unique(places[runs.failed])
    if len(failed):
        failed = failed[:: max(len(failed) // _BUCKETS, 1)]
        above: dict[str, Any] = {
            "transform": axis.get_xaxis_transform(),
            "color": "tab:red",
            "clip_on": False,
        }
        axis.plot(failed, np.full(len(failed), 1.0), "|", label="diverged or failed", **above)
    for row in runs.best(metric):
        axis.plot(places[row], values[row], "*", color="C1", markersize=11, label="best")
    axis.set_xlabel(name if name != INDEX else "run")
    axis.set_ylabel(metric)
    axis.grid(alpha=0.3)
    if is_wide(values):
        axis.set_yscale("log")
    _scale(axis.xaxis, axis.set_xscale, x)
    if name == INDEX:
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if name in runs.edges(metric):
        axis.set_title("best at the edge", loc="right", fontsize="small", color="C1")


def _lowest(places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest value at each place, or in each of many parts of the range."""
    distinct, group = np.unique(places, return_inverse=True)
    if len(distinct) > 60:
        low, high = distinct[0], distinct[-1]
        group = np.minimum((places - low) / (high - low) * 40, 39).astype(int)
    found = np.full(group.max() + 1, np.inf)
    np.fmin.at(found, group, values)
    rows = np.flatnonzero(np.isfinite(found))
    if len(distinct) <= 60:
        return distinct[rows], found[rows]
    order = np.lexsort((values, group))
    heads = order[np.unique(group[order], return_index=True)[1]]
    heads = heads[np.isfinite(values[heads])]
    return places[heads], values[heads]


def _scale(axis: Any, set_scale: Any, x: Values) -> None:
    """Give an axis the names of values, or a logarithmic scale."""
    if x.names:
        axis.set_ticks(list(x.names), [textwrap.shorten(text, 20) for text in x.names.values()])
    elif is_wide(x.numbers):
        set_scale("log")


def _draw_map(figure: Figure, axis: Axes, runs: Runs, metric: str) -> None:
    """Draw a metric in colours over two parameters."""
    (across, x), (up, y) = runs.varied.items()
    values = runs.values(metric)
    known = values[np.isfinite(values)]
    if not len(known):
        return
    norm = "log" if is_wide(values) else "linear"
    order = np.argsort(-values, kind="stable")  # the best are on top
    xs, ys = np.unique(x.numbers), np.unique(y.numbers)
    is_grid = len(xs) * len(ys) == len(runs) and min(len(xs), len(ys)) > 1
    if is_grid:
        cells = np.full((len(ys), len(xs)), np.nan)
        cells[np.searchsorted(ys, y.numbers), np.searchsorted(xs, x.numbers)] = values
        drawn: Any = axis.pcolormesh(xs, ys, cells, norm=norm, shading="nearest", rasterized=True)
    else:
        size = 25 if len(runs) <= 500 else 6
        look: dict[str, Any] = {"norm": norm, "linewidths": 0, "rasterized": len(runs) > 2000}
        drawn = axis.scatter(x.numbers[order], y.numbers[order], size, values[order], **look)
    failed = runs.failed
    axis.plot(x.numbers[failed], y.numbers[failed], "x", color="tab:red", markersize=3)
    for row in runs.best(metric):
        axis.plot(
            x.numbers[row], y.numbers[row], "*", color="C1", markersize=13, markeredgecolor="w"
        )
    axis.set_xlabel(across)
    axis.set_ylabel(up)
    _scale(axis.xaxis, axis.set_xscale, x)
    _scale(axis.yaxis, axis.set_yscale, y)
    figure.colorbar(drawn, ax=axis, label=metric)


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw the variables that differ, and below each how far; see `Comparison.plot`."""
    reference, results = comparison.reference, comparison.results
    shown = comparison.differences[: _MOST // 2]
    gaps = [_gap(reference, results, difference.name) for difference in shown]
    heights = [h for gap in gaps for h in ([1.8] if gap is None else [1.8, 1.1])] or [1.8]
    figure = blank(7.0, 0.5 + sum(heights))
    axes = figure.subplots(len(heights), sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    free = iter(axes)
    for (name, time, _, _), gap in zip(shown, gaps, strict=True):
        panel = _Panel(name, [name], [], False, 1.8)
        axis = next(free)
        _draw_panel(axis, panel, {"reference": reference, "results": results})
        lines = dict(zip(("reference", "results"), axis.lines, strict=False))
        place: dict[str, Any] = {
            "loc": "lower right",
            "bbox_to_anchor": (1.0, 1.0),
            "borderaxespad": 0.1,
        }
        axis.legend(lines.values(), lines, ncols=2, frameon=False, fontsize="small", **place)
        axis.axvline(time, color="tab:red", linewidth=0.8)
        if gap is not None:
            rows, axis = extremes(gap), next(free)
            axis.plot(reference["time"][rows], gap[rows], color="tab:red", linewidth=1.0)
            axis.set_title("results - reference", loc="left", fontsize="small")
            unit = reference.units.get(name)
            axis.set_ylabel(f"[{unit}]" if unit else "")
            axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    if count := len(comparison.differences) - len(shown):
        figure.suptitle(f"{count} more variables differ", fontsize="medium")
    return figure


def _gap(reference: Result, results: Result, name: str) -> np.ndarray | None:
    """Return results - reference at the times of the reference; None of what has no distance."""
    one, other = reference[name], results[name]
    kinds = {one.dtype.kind, other.dtype.kind}
    if kinds & {"O", "b"} or name in reference.enumerations:
        return None
    found = np.interp(reference["time"], results["time"], other.astype(float))
    return np.asarray(found - one)
