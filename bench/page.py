"""The text and the pictures of docs/speed.md that depend on measurements."""

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median, quantiles
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from measure import MODELS, REFERENCE, SOURCE, VERSIONS, in_fmi3

FMU_NAMES = {case.model for case in MODELS}
INPUTS = ("stand", "move")

# --- ratios of costs that were measured in the same rounds, and their aims -----------------

AIMS = {
    ("Pid", "stand"): "at most 1.3",
    ("Pid", "move"): "at most 1.3",
    ("PidRbf", "move"): "at most 2.5",
    ("IpidRbf", "move"): "at most 2.5",
    ("Pendulum, linear", "stand"): "at most 2",
    ("Pendulum, linear", "move"): "at most 2",
}
"""Limits of a cycle, as multiples of a cycle of the bare PID in C."""

VERSIONS_AIM = "at most 1.2"
"""Limit of a cycle in FMI 3.0, as a multiple of that in FMI 2.0."""

MET = {"most": operator.le, "least": operator.ge}


@dataclass(frozen=True)
class Ratio:
    """Two costs that were measured in the same rounds, and the aim of their ratio."""

    ours: Sequence[float]
    other: Sequence[float]
    aim: str = ""

    @property
    def rounds(self) -> list[float]:
        """The ratio in each round."""
        return [a / b for a, b in zip(self.ours, self.other, strict=True)]

    @property
    def both(self) -> tuple[float, float]:
        """The median of the ratios of the rounds, and the ratio of the minima."""
        return median(self.rounds), min(self.ours) / min(self.other)

    @property
    def times(self) -> str:
        """The median as text."""
        return number(self.both[0])

    @property
    def verdict(self) -> str:
        """Whether the ratio is as aimed for; unclear if median and minima disagree."""
        if not self.aim:
            return ""
        _, bound, limit = self.aim.split()
        met = {MET[bound](ratio, float(limit)) for ratio in self.both}
        return "unclear" if len(met) > 1 else "met" if met.pop() else "missed"

    @property
    def cells(self) -> list[str]:
        """The last four cells of a row."""
        return [*map(number, self.both), self.aim, self.verdict]


def times_of(results: Mapping, name: str, inputs: str) -> list[list[float]]:
    """Return the measurements of a cycle; two if it was measured twice, for the noise."""
    key = (name, inputs)
    return [line["ns"] for line in results["cycle"] if (line["fmu"], line["inputs"]) == key]


def cycle_ratio(results: Mapping, name: str, inputs: str) -> Ratio:
    """Return the cost of a cycle relative to the bare PID in C."""
    ours, reference = (times_of(results, n, inputs)[0] for n in (name, REFERENCE.name))
    return Ratio(ours, reference, AIMS.get((name, inputs), ""))


def version_ratios(results: Mapping) -> dict[tuple[str, str], Ratio]:
    """Return the costs of cycles in FMI 3.0 relative to FMI 2.0, by FMU and inputs."""
    ratios = {}
    for case, inputs in product(VERSIONS, INPUTS):
        new, old = (times_of(results, c.name, inputs)[0] for c in (in_fmi3(case), case))
        ratios[case.name, inputs] = Ratio(new, old, VERSIONS_AIM)
    return ratios


def host_ratios(results: Mapping) -> dict[str, tuple[str, str, Ratio]]:
    """Return what the native master does, what this is compared with, and the ratio, by key."""
    pair, sweeps = results["pair"], results["sweeps"]
    cycle = {line["threads"]: line["ns"] for line in results["threads"] if line["fmu"] == "PidRbf"}
    step, loop = "a step of the coupled pair, natively", "a loop of the sweep, 1 process"
    own, fmpy = (Ratio(pair["native"], pair["own"], "at most 1.3"), pair["FMPy"])
    ratios = {
        "own": (step, "cycles of its two FMUs", own),
        "C": (step, "a master in C", Ratio(pair["native"], pair["C"])),
        "FMPy": ("the same step in FMPy", "natively", Ratio(fmpy, pair["native"], "at least 150")),
        "sweep": (loop, "the bare loop in C", Ratio(sweeps["1"], sweeps["C"], "at most 1.5")),
    }
    for n in range(2, results["machine"]["cores"] + 1):
        aim = "at least 1.85" if n == 2 else ""
        ratios[str(n)] = (loop, f"{n} processes", Ratio(sweeps["1"], sweeps[str(n)], aim))
        # what the machine's cores can bring
        threads = "a cycle of `PidRbf` from C, 1 thread", f"{n} threads", Ratio(cycle[1], cycle[n])
        ratios[threads[1]] = threads
    return ratios


def node_costs(results: Mapping, inputs: str) -> list[tuple[int, float]]:
    """Return the cost (ns) of a sample, by number of nodes in ascending order."""
    names = (name.removeprefix("nodes/").split() for name in results["rust"] if "nodes/" in name)
    counts = sorted(int(count) for count, kind in names if kind == inputs)
    return [(n, results["rust"][f"nodes/{n} {inputs}"]["min"]) for n in counts]


# --- tables -------------------------------------------------------------------------------


def blocks(results: Mapping) -> dict[str, str]:
    """Return all texts by the name of their place in the page."""
    tables = (care, missed, cycle, versions, host, counts, other, noise, machine)
    return {table.__name__: table(results) for table in tables}


def care(results: Mapping) -> str:
    """Return the figures that matter to each reader."""
    host = {key: ratio for key, (_, _, ratio) in host_ratios(results).items()}
    cycle = "a cycle of `{}` whose inputs all move, relative to a PID in plain C"
    pid, rbf = (cycle_ratio(results, name, "move") for name in ("Pid", "PidRbf"))
    newer = version_ratios(results)["PidRbf", "move"]
    step = "a native step of two coupled FMUs, relative to the cycles of these FMUs"
    rows = [
        ("import one FMU", cycle.format("Pid"), pid),
        ("", cycle.format("PidRbf"), rbf),
        ("", "the same cycle in FMI 3.0, relative to FMI 2.0", newer),
        ("run co-simulations natively", step, host["own"]),
        ("", "the speed of the same run, relative to FMPy", host["FMPy"]),
        ("sweep", "a loop with its metrics, relative to the same loop in C", host["sweep"]),
        ("", "the speed with two processes, relative to one", host.get("2")),
    ]
    found = [(*words, f"{r.times} times", r.aim, r.verdict) for *words, r in rows if r]
    if "rust" in results:
        costs = []
        for kind in ("move", "stand"):
            (fewer, less), (more, cost) = node_costs(results, kind)[-2:]
            costs.append(f"{(cost - less) / (more - fewer):.2g} ns")
        figure = "one more node of a large network, while the set-point moves; while it stands"
        found.append(("enlarge the network", figure, "; ".join(costs), "", ""))
    return markdown("You | What counts | Measured | Aim |", found)


def missed(results: Mapping) -> str:
    """Return what misses its aim, at least by one of both ratios."""
    host, newer = host_ratios(results), "a cycle in FMI 3.0 relative to FMI 2.0"
    names = {
        "own": "a native step of the coupled pair, relative to the cycles of its FMUs",
        "FMPy": "the native master, relative to FMPy",
        "sweep": "a loop of the sweep, relative to the bare loop",
        "2": "two processes, relative to one",
    }
    ratios = [
        (f"a cycle of {code(n)} whose inputs {i}", cycle_ratio(results, n, i)) for n, i in AIMS
    ]
    for (name, inputs), ratio in version_ratios(results).items():
        ratios.append((f"{newer}, {code(name)}, inputs {inputs}", ratio))
    ratios += [(text, host[name][-1]) for name, text in names.items() if name in host]
    items = [
        f"- {name}: {ratio.times}, of minima {number(ratio.both[1])}; aim: {ratio.aim}"
        for name, ratio in ratios
        if ratio.verdict != "met"
    ]
    return "\n".join(items) or "All aims are met."


def cycle(results: Mapping) -> str:
    """Return the table of cycles."""
    rows = []
    for model, inputs in product((REFERENCE, *MODELS, SOURCE), INPUTS):
        ratio = cycle_ratio(results, model.name, inputs)
        inside = results.get("rust", {}).get(f"in process/{model.name} {inputs}")
        cells = [*times(ratio.ours), ns(inside["min"]) if inside else ""]
        last = ratio.cells if model != REFERENCE else [""] * 4
        rows.append([code(model.name), inputs, *cells, *last])
    head = "FMU | Inputs | Minimum | Median | In process | Times the bare PID | Of minima | Aim |"
    return markdown(head, rows)


def versions(results: Mapping) -> str:
    """Return the table of cycles in both versions of FMI."""
    rows = [
        [code(name), inputs, ns(median(ratio.other)), ns(median(ratio.ours)), *ratio.cells]
        for (name, inputs), ratio in version_ratios(results).items()
    ]
    return markdown("FMU | Inputs | FMI 2.0 | FMI 3.0 | Ratio | Of minima | Aim |", rows)


def host(results: Mapping) -> str:
    """Return the table of the native master."""
    rows = [
        [what, ns(median(ratio.ours)), to, ns(median(ratio.other)), *ratio.cells]
        for what, to, ratio in host_ratios(results).values()
    ]
    return markdown("What | Median | Against | Median | Ratio | Of minima | Aim |", rows)


def counts(results: Mapping) -> str:
    """Return the table of instructions."""
    rows = []
    for name, of in results["counts"].items():
        cells = [f"{of['instructions']:.0f}", f"{of['accesses']:.0f}", f"{of['misses']:.2f}"]
        rows.append([code(name) if name.partition(",")[0] in FMU_NAMES else name, *cells])
    table = markdown("A cycle or step of | Instructions | Reads and writes | Cache misses", rows)
    return table if rows else "Not counted: valgrind is not installed."


def other(results: Mapping) -> str:
    """Return the table of what happens once, and of PythonFMU."""
    rows = []
    for line in results["life"]:
        memory = f"{line['initialized_bytes']:.0f} B"
        rows.append([f"{code(line['fmu'])}, instantiate to free", *times(line["ns"]), memory])
    if results["python"]:
        ours, theirs = (line["ns"] for line in results["python"])
        slower = f"{Ratio(theirs, ours).times} times `Pid`"
        rows.append(["a cycle of a PID in PythonFMU", *times(theirs), slower])
    if "rust" in results:
        opened = results["rust"]["loading/open"]
        rows.append(["open and unpack an FMU", ns(opened["min"]), ns(opened["median"]), ""])
    name, largest = max(results["sizes"].items(), key=lambda item: item[1])
    rows.append([f"largest file, {code(name)}", "", "", f"{largest / 1000:.0f} KB"])
    return markdown("What | Minimum | Median |", rows)


def noise(results: Mapping) -> str:
    """Return how far measurements of the same FMU are apart."""
    same = product((REFERENCE.name, "PidRbf"), INPUTS)
    cycles = [Ratio(*times_of(results, name, inputs)) for name, inputs in same]
    kinds = (cycles, [Ratio(results["pair"]["own again"], results["pair"]["own"])])
    parts, limits = [], []
    for ratios in kinds:
        limits.append(max(0.005, *(abs(value - 1) for ratio in ratios for value in ratio.both)))
        single = quantiles((value for ratio in ratios for value in ratio.rounds), n=20)
        parts.append(f"{single[0]:.2f} to {single[-1]:.2f}")
    spreads = [median(line["ns"]) / min(line["ns"]) for line in results["cycle"]]
    return (
        f"- Cycles: from {parts[0]} in nine of ten rounds. Ratios that differ from\n"
        f"  each other or from an aim by less than {limits[0]:.1%} are noise. The median of a\n"
        f"  cycle is {min(spreads):.2f} to {max(spreads):.2f} times its minimum.\n"
        "- The native master, where each measurement is a process of its own: from\n"
        f"  {parts[1]} in nine of ten rounds; less than {limits[1]:.1%} is noise."
    )


def machine(results: Mapping) -> str:
    """Return where the numbers come from."""
    m = results["machine"]
    cores = f"{m['cores']} core{'s' * (m['cores'] > 1)}"
    text = (
        f"Measured on: {m['processor']}, {cores}, {m['system']};\n"
        f"{m['rustc']}, {m['cc']}, Python {m['python']}."
    )
    quick = "\nMeasured with `--quick`: these numbers only show that the script works."
    return text + quick * ("rust" not in results)


# --- text ---------------------------------------------------------------------------------


def markdown(head: str, rows: Iterable[Sequence[str]]) -> str:
    """Return a table with a head of cells between bars."""
    names = [name.strip() for name in head.split("|")]
    lines = [names, ["---"] * len(names), *rows]
    return "\n".join(
        "|" + "".join(f" {cell} |" if cell else " |" for cell in line) for line in lines
    )


def code(name: str) -> str:
    """Return the name of a case with the name of its FMU as code."""
    fmu, comma, rest = name.partition(",")
    return name if name == REFERENCE.name else f"`{fmu}`{comma}{rest}"


def number(value: float) -> str:
    """Return a ratio with three digits."""
    return f"{value:.2f}" if value < 10 else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def times(rounds: Sequence[float]) -> list[str]:
    """Return minimum and median."""
    return [ns(min(rounds)), ns(median(rounds))]


def ns(time: float) -> str:
    """Return a time in ns with a suitable unit."""
    for unit, factor in (("ns", 1.0), ("µs", 1e3), ("ms", 1e6)):
        if time < 999.5 * factor:
            return f"{time / factor:.3g} {unit}"
    return f"{time / 1e9:.3g} s"


# --- pictures: each answers the question in its title ---------------------------------------

# Okabe and Ito's colours, which colour-blind people can tell apart.
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00"]

STYLE = {
    "axes.prop_cycle": mpl.cycler(color=COLOURS) + mpl.cycler(marker=list("osd^vP")),
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


class Panel(NamedTuple):
    """Axes with labelled curves; linear ones, without a base, also show ideal speeds."""

    x: str
    y: str
    curves: list[Curve]
    base: int | None = 10
    log_y: bool = False


def pictures(results: Mapping) -> dict[str, tuple[str | Panel, ...]]:
    """Return the title and the panels of each picture."""
    found = {}
    if "rust" in results:
        labels = {"move": "set-point moves", "stand": "set-point stands"}
        nodes = [(label, node_costs(results, kind)) for kind, label in labels.items()]
        per_node = [(label, [(n, time / n) for n, time in curve]) for label, curve in nodes]
        found["nodes"] = (
            "What does a larger network cost?",
            Panel("nodes of the network", "time per sample in process [ns]", nodes, 2, True),
            Panel("nodes of the network", "time per sample and node [ns]", per_node, 2),
        )
    many = curves_of(results["many"], "instances", min)
    threads = curves_of(results["threads"], "threads", lambda ns: 1e3 / median(ns))
    counts = range(1, results["machine"]["cores"] + 1)
    loops = [("sweep", [(n, 1e9 / median(results["sweeps"][str(n)])) for n in counts])]
    step, load = ({n: of[key] for n, of in results["systems"].items()} for key in ("step", "load"))
    cycles = "million cycles a second, from C"
    return found | {
        "instances": (
            "What does a cycle cost if there are many instances?",
            Panel("instances, stepped in turn", "time per cycle from C [ns]", many),
        ),
        "cores": (
            "What do more cores bring?",
            Panel("threads, each with its own instance", cycles, threads, None),
            Panel("processes", "loops of 2000 steps a second", loops, None),
        ),
        "length": (
            "Does a step cost more in a long run?",
            Panel(
                "steps of the run",
                "time per step of the coupled pair [ns]",
                curves_by(results["lengths"]),
            ),
        ),
        "systems": (
            "What does a large system cost?",
            Panel("FMUs of the system", "time per FMU and step [ns]", curves_by(step)),
            Panel("FMUs of the system", "time of a run of one step [ms]", curves_by(load, 1e6)),
        ),
    }


def draw(results: Mapping, folder: Path) -> list[Path]:
    """Draw all pictures; return their files."""
    files = []
    with mpl.rc_context(STYLE):
        for name, (title, *panels) in pictures(results).items():
            size = (8.4 if len(panels) > 1 else 5.6, 3.4)
            figure, (grid,) = plt.subplots(
                1, len(panels), figsize=size, layout="constrained", squeeze=False
            )
            figure.suptitle(title)
            for axes, panel in zip(grid, panels, strict=True):
                plot(axes, panel)
            if name == "cores":
                axes.plot([], [], "k:", marker="", label="twice the cores, twice the speed")
                axes.legend(loc="lower right")
            files.append(folder / f"speed-{name}.svg")
            figure.savefig(files[-1], dpi=120, metadata={"Date": None})
            plt.close(figure)
    return files


def plot(axes: Axes, panel: Panel) -> None:
    """Plot labelled curves."""
    for label, points in panel.curves:
        axes.plot(*zip(*points, strict=True), label=label)
    axes.set(xlabel=panel.x, ylabel=panel.y, ylim=(0, None))
    lines = axes.get_lines()
    if len(lines) > 1:
        axes.legend()
    ticks = sorted({x for _, points in panel.curves for x, _ in points})
    if not panel.base:
        for line in lines:
            ideal = [n * line.get_ydata()[0] for n in ticks]
            axes.plot(ticks, ideal, ":", marker="", color=line.get_color())
        highest = max(max(line.get_ydata()) for line in axes.get_lines())
        axes.set(xticks=ticks, ylim=(0, 1.05 * highest))
        axes.margins(x=0.1)
        return
    axes.set_xscale("log", base=panel.base)
    axes.set_xticks(ticks, [plain(tick) for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    if panel.log_y:
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
    """Return the curves of the C host's lines, one for each FMU, the reference last."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for line in lines:
        curves.setdefault(line["fmu"], []).append((line[x], summary(line["ns"])))
    return sorted(curves.items(), key=lambda curve: curve[0] == REFERENCE.name)


def curves_by(rounds: Mapping[str, Sequence[float]], unit: float = 1.0) -> list[Curve]:
    """Return the curves of median and minimum, in a unit [ns]."""
    return [
        (name, [(float(x), summary(times) / unit) for x, times in rounds.items()])
        for name, summary in (("median", median), ("minimum", min))
    ]
