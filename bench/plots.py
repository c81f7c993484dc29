"""The pictures of docs/speed.md: each answers the question in its title."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import median

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from subjects import REFERENCE
from tables import node_costs

# Okabe and Ito's colours, which colour-blind people can tell apart.
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00"]
MARKERS = "osd^vP"

STYLE = {
    "axes.prop_cycle": mpl.cycler(color=COLOURS) + mpl.cycler(marker=list(MARKERS)),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.grid": True,
    "axes.titlesize": "medium",
    "figure.facecolor": "white",
    "figure.titlesize": "large",
    "font.size": 10,
    "grid.alpha": 0.3,
    "legend.edgecolor": "none",
    "legend.framealpha": 0.8,
    "lines.markersize": 5,
    "svg.hashsalt": "speed",  # the same picture gives the same file
}

Curve = tuple[str, list[tuple[float, float]]]


def draw(results: Mapping, folder: Path) -> list[Path]:
    """Draw all pictures; return their files."""
    files = []
    pictures: dict[str, Callable[[Mapping], plt.Figure]] = {
        "nodes": nodes,
        "instances": instances,
        "cores": cores,
        "length": length,
        "systems": systems,
    }
    if "rust" not in results:
        del pictures["nodes"]
    with mpl.rc_context(STYLE):
        for name, picture in pictures.items():
            figure, file = picture(results), folder / f"speed-{name}.svg"
            figure.savefig(file, dpi=120, metadata={"Date": None})
            plt.close(figure)
            files.append(file)
    return files


def nodes(results: Mapping) -> plt.Figure:
    """Draw the cost of a sample over the number of nodes."""
    figure, (left, right) = new("What does a larger network cost?", 2)
    labels = {"move": "set-point moves", "stand": "set-point stands"}
    curves = [(label, node_costs(results, kind)) for kind, label in labels.items()]
    plot(left, curves, "nodes of the network", "time per sample in process [ns]")
    logarithmic(left, 2, y=True)
    per_node = [(label, [(n, time / n) for n, time in curve]) for label, curve in curves]
    plot(right, per_node, "nodes of the network", "time per sample and node [ns]")
    logarithmic(right, 2)
    return figure


def instances(results: Mapping) -> plt.Figure:
    """Draw the cost of a cycle over the number of instances."""
    figure, (axes,) = new("What does a cycle cost if there are many instances?")
    plot(
        axes,
        curves_of(results["many"], "instances", min),
        "instances, stepped in turn",
        "time per cycle from C [ns]",
    )
    logarithmic(axes, 10)
    return figure


def cores(results: Mapping) -> plt.Figure:
    """Draw the speed over the number of threads and processes."""
    figure, (left, right) = new("What do more cores bring?", 2)
    speeds = [
        (name, [(n, 1e3 / time) for n, time in curve])
        for name, curve in curves_of(results["threads"], "threads", median)
    ]
    plot(left, speeds, "threads, each with its own instance", "million cycles a second, from C")
    counts = range(1, results["machine"]["cores"] + 1)
    loops = [(n, 1e9 / median(results["sweeps"][str(n)])) for n in counts]
    plot(right, [("sweep", loops)], "processes", "loops of 2000 steps a second")
    for axes in (left, right):
        for line in axes.get_lines():
            ideal = line.get_ydata()[0]
            axes.plot(counts, [n * ideal for n in counts], ":", marker="", color=line.get_color())
        highest = max(max(line.get_ydata()) for line in axes.get_lines())
        axes.set(xticks=list(counts), ylim=(0, 1.05 * highest))
        axes.margins(x=0.1)
    right.plot([], [], "k:", marker="", label="twice the cores, twice the speed")
    right.legend(loc="lower right")
    return figure


def length(results: Mapping) -> plt.Figure:
    """Draw the cost of a step over the length of the run."""
    figure, (axes,) = new("Does a step cost more in a long run?")
    curves = curves_by(results["lengths"])
    plot(axes, curves, "steps of the run", "time per step of the coupled pair [ns]")
    logarithmic(axes, 10)
    return figure


def systems(results: Mapping) -> plt.Figure:
    """Draw the cost of a step, and of loading, over the number of FMUs."""
    figure, (left, right) = new("What does a large system cost?", 2)
    rounds = results["systems"]
    step = curves_by({size: times["step"] for size, times in rounds.items()})
    plot(left, step, "FMUs of the system", "time per FMU and step [ns]")
    logarithmic(left, 10)
    load = curves_by({size: [t / 1e6 for t in r["load"]] for size, r in rounds.items()})
    plot(right, load, "FMUs of the system", "time of a run of one step [ms]")
    logarithmic(right, 10)
    return figure


# --- axes ---------------------------------------------------------------------------------


def new(title: str, columns: int = 1) -> tuple[plt.Figure, list[Axes]]:
    """Return a figure with axes beside each other."""
    width = 8.4 if columns > 1 else 5.6
    figure, axes = plt.subplots(1, columns, figsize=(width, 3.4), layout="constrained")
    figure.suptitle(title)
    return figure, [axes] if columns == 1 else list(axes)


def plot(axes: Axes, curves: Iterable[Curve], x: str, y: str) -> None:
    """Plot labelled curves."""
    for label, points in curves:
        axes.plot(*zip(*points, strict=True), label=label)
    axes.set(xlabel=x, ylabel=y, ylim=(0, None))
    if len(axes.get_lines()) > 1:
        axes.legend()


def logarithmic(axes: Axes, base: int, y: bool = False) -> None:
    """Make the horizontal axis logarithmic, and on request the vertical one."""
    axes.set_xscale("log", base=base)
    ticks = sorted({x for line in axes.get_lines() for x in line.get_xdata()})
    axes.set_xticks(ticks, [plain(tick) for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    if not y:
        return
    axes.set_ylim(None, None)
    axes.set_yscale("log")
    axes.autoscale(axis="y")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axes.yaxis.set_minor_locator(NullLocator())


def plain(value: float) -> str:
    """Return a number without an exponent, with spaces between thousands."""
    return f"{value:,.10g}".replace(",", "\N{THIN SPACE}")


def curves_of(
    lines: Iterable[Mapping], x: str, summary: Callable[[list[float]], float]
) -> list[Curve]:
    """Return the curves of the C host's lines, one for each FMU."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for line in lines:
        curves.setdefault(line["fmu"], []).append((line[x], summary(line["ns"])))
    names = sorted(curves, key=lambda name: name == REFERENCE.name)
    return [(name, curves[name]) for name in names]


def curves_by(rounds: Mapping[str, list[float]]) -> list[Curve]:
    """Return the curves of minimum and median."""
    return [
        (name, [(float(x), summary(times)) for x, times in rounds.items()])
        for name, summary in (("median", median), ("minimum", min))
    ]
