"""The text and the pictures of docs/speed.md that depend on measurements."""

import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median, quantiles

import numpy as np

from measure import MODELS, REFERENCE, SOURCE, VERSIONS, Costs
from pendulum_fmus.report import printed
from pendulum_fmus.report.figure import Curve, Figure, Panel

INPUTS = ("stand", "move")

SEVERAL = ("Pendulum, linear", "Pid", "PidRbf", REFERENCE.name)
"""The FMUs of which many instances are measured."""

# --- ratios of costs that were measured in the same rounds, and their aims -----------------

AIMS = {
    "Pid stand": "at most 1.3",
    "Pid move": "at most 1.3",
    "PidRbf move": "at most 2.5",
    "IpidRbf move": "at most 2.5",
    "Pendulum, linear stand": "at most 2",
    "Pendulum, linear move": "at most 2",
}
"""Limits of a cycle, as multiples of a cycle of the bare PID in C."""

MET = {"most": operator.le, "least": operator.ge}


@dataclass(frozen=True)
class Ratio:
    """What costs something, relative to what, and the aim."""

    what: str
    ours: Sequence[float]  # costs in the same rounds
    to: str
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


Ratios = dict[str, Ratio]


def cycle_ratios(costs: Costs) -> Ratios:
    """Return the costs of cycles relative to the bare PID in C."""
    found = {}
    for name, inputs in product((REFERENCE.name, *MODELS, SOURCE.name), INPUTS):
        what, key = f"a cycle of {code(name)} whose inputs {inputs}", f"{name} {inputs}"
        ours, other = costs[f"cycle/{key}"], costs[f"cycle/{REFERENCE.name} {inputs}"]
        found[key] = Ratio(what, ours, "the bare PID", other, AIMS.get(key, ""))
    return found


def version_ratios(costs: Costs) -> Ratios:
    """Return the costs of cycles in FMI 3.0 relative to FMI 2.0."""
    found = {}
    for name, inputs in product([case.name for case in VERSIONS], INPUTS):
        new, old = (costs[f"cycle/{name}{version} {inputs}"] for version in (", FMI 3.0", ""))
        what = f"a cycle in FMI 3.0 of {code(name)} whose inputs {inputs}"
        found[f"{name} {inputs}"] = Ratio(what, new, "FMI 2.0", old, "at most 1.2")
    return found


def host_ratios(costs: Costs) -> Ratios:
    """Return the costs of the native master, by what it is compared with."""
    step, loop = "a step of the coupled pair, natively", "a loop of the sweep, 1 process"
    cycle, own = "a cycle of `PidRbf` from C, 1 thread", "cycles of its two FMUs"
    rows = [
        (step, "pair/native", own, "pair/own", "at most 1.3"),
        (step, "pair/native", "a master in C", "pair/C", ""),
        ("the same step in FMPy", "pair/FMPy", "the native one", "pair/native", "at least 150"),
        (loop, "sweep/1", "the bare loop in C", "sweep/C", "at most 1.5"),
    ]
    for n in range(2, sum(name.startswith("sweep/") for name in costs)):
        rows.append((loop, "sweep/1", f"{n} processes", f"sweep/{n}", "at least 1.85" * (n == 2)))
        # what the machine's cores can bring
        threads = "threads/PidRbf/"
        rows.append((cycle, f"{threads}1", f"{n} threads", f"{threads}{n}", ""))
    return {
        other: Ratio(what, costs[ours], to, costs[other], aim)
        for what, ours, to, other, aim in rows
    }


def node_costs(costs: Costs, inputs: str) -> list[tuple[int, float]]:
    """Return the cost (ns) of a sample, by number of nodes in ascending order."""
    names = [name.removeprefix("nodes/").split() for name in costs if name.startswith("nodes/")]
    counts = sorted(int(count) for count, kind in names if kind == inputs)
    return [(n, min(costs[f"nodes/{n} {inputs}"])) for n in counts]


# --- tables -------------------------------------------------------------------------------


def blocks(results: Mapping) -> dict[str, str]:
    """Return all texts by the name of their place in the page."""
    costs = results["costs"]
    ratios = [find(costs) for find in (cycle_ratios, version_ratios, host_ratios)]
    return {
        "care": care(costs, *ratios),
        "missed": missed(*ratios),
        "cycle": cycles(costs, ratios[0]),
        "versions": versions(ratios[1]),
        "host": host(ratios[2]),
        "counts": counts(results["counts"]),
        "other": once(results),
        "noise": noise(costs),
        "machine": machine(results),
    }


def care(costs: Costs, cycles: Ratios, versions: Ratios, host: Ratios) -> str:
    """Return the figures that matter to each reader."""
    cycle = "a cycle of `{}` whose inputs all move, relative to a PID in plain C"
    step = "a native step of two coupled FMUs, relative to the cycles of these FMUs"
    newer = "the same cycle in FMI 3.0, relative to FMI 2.0"
    rows = [
        ("import one FMU", cycle.format("Pid"), cycles["Pid move"]),
        ("", cycle.format("PidRbf"), cycles["PidRbf move"]),
        ("", newer, versions["PidRbf move"]),
        ("run co-simulations natively", step, host["pair/own"]),
        ("", "the speed of the same run, relative to FMPy", host["pair/native"]),
        ("sweep", "a loop with its metrics, relative to the same loop in C", host["sweep/C"]),
        ("", "the speed with two processes, relative to one", host.get("sweep/2")),
    ]
    found = [(*words, f"{r.cells[0]} times", r.aim, r.verdict) for *words, r in rows if r]
    if "loading/open" in costs:
        last = [node_costs(costs, kind)[-2:] for kind in INPUTS[::-1]]
        each = [(cost - less) / (more - fewer) for (fewer, less), (more, cost) in last]
        figure = "one more node of a large network, while the set-point moves; while it stands"
        shown = "; ".join(f"{cost:.2g} ns" for cost in each)
        found.append(("enlarge the network", figure, shown, "", ""))
    return markdown("You | What counts | Measured | Aim |", found)


def missed(*kinds: Ratios) -> str:
    """Return what misses its aim, at least by one of both ratios."""
    items = [
        f"- {r.what}, relative to {r.to}: {r.cells[0]}, of minima {r.cells[1]}; aim: {r.aim}"
        for ratios in kinds
        for r in ratios.values()
        if r.verdict in ("missed", "unclear")
    ]
    return "\n".join(items) or "All aims are met."


def cycles(costs: Costs, ratios: Ratios) -> str:
    """Return the table of cycles."""
    rows = []
    for key, ratio in ratios.items():
        name, _, inputs = key.rpartition(" ")
        inside = costs.get(f"in process/{key}")
        last = ratio.cells if name != REFERENCE.name else [""] * 4
        rows.append([code(name), inputs, *times(ratio.ours), inside and ns(min(inside)), *last])
    head = "FMU | Inputs | Minimum | Median | In process | Times the bare PID | Of minima | Aim |"
    return markdown(head, rows)


def versions(ratios: Ratios) -> str:
    """Return the table of cycles in both versions of FMI."""
    rows = []
    for key, ratio in ratios.items():
        name, _, inputs = key.rpartition(" ")
        medians = (ns(median(costs)) for costs in (ratio.other, ratio.ours))
        rows.append([code(name), inputs, *medians, *ratio.cells])
    return markdown("FMU | Inputs | FMI 2.0 | FMI 3.0 | Ratio | Of minima | Aim |", rows)


def host(ratios: Ratios) -> str:
    """Return the table of the native master."""
    rows = [
        [ratio.what, ns(median(ratio.ours)), ratio.to, ns(median(ratio.other)), *ratio.cells]
        for ratio in ratios.values()
    ]
    return markdown("What | Median | Against | Median | Ratio | Of minima | Aim |", rows)


def counts(counts: Mapping[str, Mapping[str, float]]) -> str:
    """Return the table of instructions."""
    rows = [
        [code(name), f"{n['instructions']:.0f}", f"{n['accesses']:.0f}", f"{n['misses']:.2f}"]
        for name, n in counts.items()
    ]
    table = markdown("A cycle or step of | Instructions | Reads and writes | Cache misses", rows)
    return table if rows else "Not counted: valgrind is not installed."


def once(results: Mapping) -> str:
    """Return the table of what happens once, and of PythonFMU."""
    costs, rows = results["costs"], []
    for name, size in results["bytes"].items():
        lives = times(costs[f"life/{name}"])
        rows.append([f"{code(name)}, instantiate to free", *lives, f"{size:.0f} B"])
    if "python/Pid" in costs:
        python = costs["python/PythonPid"]
        slower = Ratio("", python, "", costs["python/Pid"]).cells[0]
        rows.append(["a cycle of a PID in PythonFMU", *times(python), f"{slower} times `Pid`"])
    if "loading/open" in costs:
        rows.append(["open and unpack an FMU", *times(costs["loading/open"]), ""])
    name, largest = max(results["sizes"].items(), key=lambda item: item[1])
    rows.append([f"largest file, {code(name)}", "", "", f"{largest / 1000:.0f} KB"])
    return markdown("What | Minimum | Median |", rows)


def noise(costs: Costs) -> str:
    """Return how far measurements of the same FMU are apart."""
    pairs = [
        [
            (f"cycle/{n} {i}", f"cycle/{n} again {i}")
            for n in (REFERENCE.name, "PidRbf")
            for i in INPUTS
        ],
        [("pair/own again", "pair/own")],
    ]
    parts, limits = [], []
    for names in pairs:
        ratios = [Ratio("", costs[one], "", costs[other]) for one, other in names]
        limits.append(max(0.005, *(abs(value - 1) for ratio in ratios for value in ratio.both)))
        single = quantiles((value for ratio in ratios for value in ratio.rounds), n=20)
        parts.append(f"{single[0]:.2f} to {single[-1]:.2f}")
    cycles = [rounds for name, rounds in costs.items() if name.startswith("cycle/")]
    spreads = [median(rounds) / min(rounds) for rounds in cycles]
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
    return text + quick * results["quick"]


# --- text ---------------------------------------------------------------------------------


def markdown(head: str, rows: Iterable[Sequence[str | None]]) -> str:
    """Return a table with a head of cells between bars."""
    names = [name.strip() for name in head.split("|")]
    lines = [names, ["---"] * len(names), *rows]
    return "\n".join(
        "|" + "".join(f" {cell} |" if cell else " |" for cell in line) for line in lines
    )


def code(name: str) -> str:
    """Return a name with the name of the FMU at its beginning as code."""
    return re.sub(r"^(Pid|PidRbf|IpidRbf|Pendulum|Source)(_fmi3)?(?=,|$)", r"`\g<0>`", name)


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

STYLES = ("PID", "PID-RBF", "IPID-RBF own", "u")
"""Styles of the first curve, the second, ..."""


def panel(
    title: str, x: str, y: str, curves: Mapping[str, Mapping[float, float]], **options: bool
) -> Panel:
    """Return axes from 0 with curves, which map x to y, by their name."""
    found = []
    for (name, points), style in zip(curves.items(), STYLES, strict=False):
        xs, ys = (np.array([*values], float) for values in (points.keys(), points.values()))
        found.append(Curve(f"{title}/{name}", xs, ys, style, name))
        if not options:  # twice the cores, twice the speed
            found.append(Curve(f"{title}/{name}/ideal", xs, xs * ys[0] / xs[0], "limit", "ideal"))
    highest = max(max(one.y) for one in found)
    ylim = None if "log_y" in options else (0.0, 1.1 * highest)
    return Panel(title, y, found, x, ylim=ylim, **options)


def points(costs: Costs, prefix: str, of: Callable[[list[float]], float]) -> dict[float, float]:
    """Summarize the costs whose names are a prefix and a number."""
    ends = [name.removeprefix(prefix) for name in costs if name.startswith(prefix)]
    return {float(n): of(costs[f"{prefix}{n}"]) for n in ends if n.isdecimal()}


def pictures(costs: Costs) -> list[Figure]:
    """Return all pictures."""
    log, cycle = {"log_x": True}, "time per cycle from C [ns]"
    many = {name: points(costs, f"instances/{name}/", min) for name in SEVERAL}
    threads = {name: points(costs, f"threads/{name}/", per_second(1e6)) for name in SEVERAL[1:]}
    loops = {"sweep": points(costs, "sweep/", per_second(1))}

    def both(prefix: str, unit: float = 1.0) -> dict[str, dict[float, float]]:
        kinds = {"median": median, "minimum": min}
        return {
            name: points(costs, prefix, lambda rounds, of=of: of(rounds) / unit)
            for name, of in kinds.items()
        }

    million, run = "million cycles a second, from C", "time of a run of one step [ms]"
    step, pair = "time per FMU and step [ns]", "time per step of the coupled pair [ns]"
    found = {
        "instances": [
            panel("What do many instances cost?", "instances, stepped in turn", cycle, many, **log)
        ],
        "cores": [
            panel("What do more cores bring?", "threads, each with an instance", million, threads),
            panel("", "processes", "loops of 2000 steps a second", loops),
        ],
        "length": [
            panel("What does a long run cost?", "steps of the run", pair, both("length/"), **log)
        ],
        "systems": [
            panel("What does a large system cost?", "FMUs", step, both("step/"), **log),
            panel("", "FMUs", run, both("load/", 1e6), **log),
        ],
    }
    if "loading/open" in costs:
        labels = {"set-point moves": "move", "set-point stands": "stand"}
        each = {label: dict(node_costs(costs, kind)) for label, kind in labels.items()}
        per_node = {label: {n: c / n for n, c in ns.items()} for label, ns in each.items()}
        title, sample = "What does a larger network cost?", "time per sample in process [ns]"
        found["nodes"] = [
            panel(title, "nodes", sample, each, log_x=True, log_y=True),
            panel("", "nodes", "time per sample and node [ns]", per_node, **log),
        ]
    return [
        Figure(f"speed-{name}", panels[0].title, "", [panels]) for name, panels in found.items()
    ]


def per_second(unit: float) -> Callable[[list[float]], float]:
    """Return a function of costs that returns how many there are in a second, in some unit."""
    return lambda rounds: 1e9 / unit / median(rounds)


def draw(results: Mapping, folder: Path) -> list[Path]:
    """Draw all pictures; return their files."""
    return [printed.write(figure, folder, ["svg"])[0] for figure in pictures(results["costs"])]
