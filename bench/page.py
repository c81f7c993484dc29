"""The text and the pictures of docs/speed.md that depend on measurements."""

import json
import operator
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from engines import ENGINES, SIGNALS
from measure import BASELINE, IN_C, MODELS, REFERENCE, SOURCE, VERSIONS, Costs
from pendulum_fmus.report import printed
from pendulum_fmus.report.figure import Curve, Figure, Panel

INPUTS = ("constant", "changing")

SEVERAL = ("Pendulum, linear", "Pid", "PidRbf", REFERENCE.name)
"""The FMUs of which many instances are measured."""

# --- ratios of costs that were measured in the same rounds, and their aims -----------------

MISSED = ("missed", "unclear")

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
    def name(self) -> str:
        """What is compared with what."""
        return f"{self.what}, relative to {self.to}"

    def shown(self, cost: float) -> str:
        """Return a cost with its unit."""
        return megabytes(cost) if "memory" in self.what else ns(cost)

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
        """The last four cells of a row; empty for what is compared with itself."""
        if self.ours is self.other:
            return [""] * 4
        return [*map(number, self.both), self.aim, self.verdict]


Ratios = dict[Any, Ratio]


def ratios(costs: Costs) -> dict[str, Ratios]:
    """Return the ratios of ratios.toml by kind and by FMU and inputs, or by both costs."""
    tables = tomllib.loads(Path(__file__).with_name("ratios.toml").read_text(encoding="utf-8"))
    aims, found = tables.pop("aims"), {kind: {} for kind in tables}
    names = [REFERENCE.name, *MODELS, *(case.name for case in BASELINE), SOURCE.name]
    cases = {
        "cycles": product(names, INPUTS),
        "versions": product([case.name for case in VERSIONS], INPUTS),
        "sources": product([case.name for case in IN_C], [""]),
    }
    for kind, rows in tables.items():
        inner = list(cases.get(kind, [("", "")]))
        for (name, inputs), row in product(inner, rows):
            for n in range(2, len(costs)) if "{n}" in row["other"] else [0]:
                given = {"name": name, "code": code(name), "inputs": inputs, "n": n}
                what, ours, to, other = (
                    row[part].format_map(given) for part in ("what", "ours", "to", "other")
                )
                if ours in costs and other in costs:
                    aim = row.get("aim") or aims.get(f"{name} {inputs}", "")
                    ratio = Ratio(what, costs[ours], to, costs[other], aim)
                    found[kind].setdefault((name, inputs) if inputs else (ours, other), ratio)
    return found


def rate(time: float) -> str:
    """Return how many there are in a second, from the time of one in ns."""
    a_second = 1e9 / time
    return next(
        f"{a_second / size:.3g}{name}"
        for size, name in ((1e6, " million"), (1e3, " thousand"), (1, ""))
        if a_second >= size or size == 1
    )


def megabytes(size: float) -> str:
    """Return a size in bytes with a unit."""
    return f"{size / 1e6:.1f} MB"


def engine_cells(costs: Costs, name: str) -> list[str]:
    """Return the least costs of a cycle in each engine, and how many times the native one."""
    cells, native = [], costs.get(f"{ENGINES[0]}/{name}")
    for engine in ENGINES:
        times = costs.get(f"{engine}/{name}")
        cells.append(ns(min(times)) if times else "")
        if times and native and engine != ENGINES[0]:
            cells[-1] += f", {number(min(times) / min(native))} times"
    return cells


# --- earlier publications -------------------------------------------------------------------

EARLIER = Path(__file__).with_name("earlier.json")
"""The ratios of each publication, with the machine, one a line."""

WORSE = 1.03
"""A ratio that is worse by more than this factor is reported."""


def published(results: Mapping) -> dict[str, Any]:
    """Return what is kept of a publication. Ratios to threads only describe the machine."""
    machine, kinds = results["machine"], ratios(results["costs"]).values()
    kept = [ratio for kind in kinds for ratio in kind.values() if "thread" not in ratio.to]
    return {
        "processor": machine["processor"],
        "vectors": machine["vectors"],
        "ratios": {r.name: round(r.both[0], 3) for r in kept if r.ours is not r.other},
    }


def earlier() -> list[dict[str, Any]]:
    """Return the publications so far, the oldest first."""
    return [json.loads(line) for line in EARLIER.read_text(encoding="utf-8").splitlines()]


def last_before(now: Mapping[str, Any]) -> dict[str, Any]:
    """Return the last publication, of the same processor if it has one, as ratios differ."""
    publications, keys = earlier(), ("processor", "vectors")
    same = [of for of in publications if all(of[key] == now[key] for key in keys)]
    return (same or publications)[-1]


def worse(now: Mapping[str, Any], before: Mapping[str, Any]) -> list[str]:
    """Return which ratios are worse than those of an earlier publication."""
    found = []
    for name, ratio in now["ratios"].items():
        old = before["ratios"].get(name)
        # A speed should be high, a cost low.
        is_speed = (
            "FMPy, " in name or name.startswith("the speed of ") or name.endswith("processes")
        )
        if old and (old / ratio if is_speed else ratio / old) > WORSE:
            found.append(f"{name}: {number(ratio)}, before {number(old)}")
    return found


def node_costs(costs: Costs, inputs: str) -> list[tuple[int, float]]:
    """Return the cost (ns) of a sample, by number of nodes in ascending order."""
    names = [name.removeprefix("nodes/").split() for name in costs if name.startswith("nodes/")]
    counts = sorted(int(count) for count, kind in names if kind == inputs)
    return [(n, min(costs[f"nodes/{n} {inputs}"])) for n in counts]


# --- the page -----------------------------------------------------------------------------


def render(results: Mapping) -> str:
    """Return the page docs/speed.md."""
    costs, loader = results["costs"], FileSystemLoader(Path(__file__).parent)
    options = {"trim_blocks": True, "keep_trailing_newline": True}
    environment = Environment(loader=loader, undefined=StrictUndefined, **options)
    environment.filters |= {"code": code, "median": median, "ns": ns, "rate": rate, "row": row}
    kinds, now = ratios(costs), published(results)
    before = last_before(now)
    context: dict[str, Any] = kinds | {
        "missed": [r for kind in kinds.values() for r in kind.values() if r.verdict in MISSED],
        "engines": {name: engine_cells(results["wasm"]["costs"], name) for name in SIGNALS},
        "nodes": [],
        "python": None,
        "before": before,
        "worse": worse(now, before),
        "noise": [
            noise(costs, [f"cycle/{name}" for name in (REFERENCE.name, "PidRbf")], INPUTS),
            noise(costs, ["pair/own"], [""]),
        ],
        "spreads": [median(c) / min(c) for name, c in costs.items() if name.startswith("cycle/")],
    }
    if "python/Pid" in costs:
        context["python"] = Ratio("", costs["python/PythonPid"], "", costs["python/Pid"])
    if "loading/open" in costs:
        for kind in INPUTS[::-1]:
            (fewer, less), (more, cost) = node_costs(costs, kind)[-2:]
            context["nodes"].append(f"{(cost - less) / (more - fewer):.2g} ns")
    return environment.get_template("speed.md.j2").render(results | context)


def noise(costs: Costs, names: Sequence[str], inputs: Sequence[str]) -> dict[str, str]:
    """Return how far measurements of the same are apart: the most of them, and the limit."""
    ratios = [
        Ratio("", costs[f"{name} {kind}".strip()], "", costs[f"{name} again {kind}".strip()])
        for name, kind in product(names, inputs)
    ]
    limit = max(0.005, *(abs(value - 1) for ratio in ratios for value in ratio.both))
    single = quantiles((value for ratio in ratios for value in ratio.rounds), n=20)
    return {"text": f"{single[0]:.2f} to {single[-1]:.2f}", "limit": f"{limit:.1%}"}


def row(cells: Iterable[str]) -> str:
    """Return a row of a table."""
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)


def code(name: str) -> str:
    """Return a name with the name of the FMU at its beginning as code."""
    return re.sub(r"^(Pid|PidRbf|IpidRbf|Pendulum|Source)(_fmi3)?(?=,|$)", r"`\g<0>`", name)


def number(value: float) -> str:
    """Return a ratio with three digits."""
    return f"{value:.2f}" if value < 10 else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


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
        labels = {"changing set-point": "changing", "constant set-point": "constant"}
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
