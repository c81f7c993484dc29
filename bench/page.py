"""The text of docs/speed.md that depends on measurements."""

import json
import operator
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from engines import ENGINES, SIGNALS
from hosts import BASELINE, IN_C, MODELS, REFERENCE, VERSIONS, Costs
from measure import SIZES

INPUTS = ("constant", "changing")

# --- ratios of costs that were measured in the same rounds, and their aims -----------------

MISSED = ("missed", "unclear")

MET = {"most": operator.le, "least": operator.ge}

UNITS = {"µs": 1e3, "ms": 1e6}
"""The units of aims that are times, in ns."""


@dataclass(frozen=True)
class Ratio:
    """What costs something, relative to what, and the aim."""

    what: str
    ours: Sequence[float]  # costs in the same rounds
    to: str
    other: Sequence[float]
    aim: str = ""
    fmu: str = ""

    @property
    def name(self) -> str:
        """What is compared with what."""
        return f"{self.what}, relative to {self.to}"

    @property
    def time(self) -> str:
        """What it costs."""
        return ns(median(self.ours))

    @property
    def other_time(self) -> str:
        """What the other costs."""
        return ns(median(self.other))

    @property
    def rounds(self) -> list[float]:
        """The ratio in each round."""
        return [a / b for a, b in zip(self.ours, self.other, strict=True)]

    @property
    def both(self) -> tuple[float, float]:
        """The median of the ratios of the rounds, and the ratio of the minima."""
        return median(self.rounds), min(self.ours) / min(self.other)

    @property
    def limited(self) -> tuple[float, float]:
        """What the aim limits, median and minimum: the ratio, or the cost in the aim's unit."""
        unit = UNITS.get(self.aim.rpartition(" ")[2])
        return (median(self.ours) / unit, min(self.ours) / unit) if unit else self.both

    @property
    def verdict(self) -> str:
        """Whether the aim is met; unclear if median and minima disagree."""
        if not self.aim:
            return ""
        _, bound, limit, *_ = self.aim.split()
        met = {MET[bound](value, float(limit)) for value in self.limited}
        return "unclear" if len(met) > 1 else "met" if met.pop() else "missed"

    @property
    def ratio(self) -> str:
        """The ratio; empty for what is compared with itself."""
        return "" if self.ours is self.other else number(self.both[0])

    @property
    def speed(self) -> str:
        """How many times as fast ours is as the other."""
        return "" if self.ours is self.other else number(1 / self.both[0])

    @property
    def with_aim(self) -> str:
        """The ratio with the aim, and whether it is missed."""
        missed = f": {self.verdict}" if self.verdict in MISSED else ""
        return f"{self.ratio} ({self.aim}{missed})" if self.aim else self.ratio

    @property
    def measured(self) -> str:
        """What the aim limits, the time or the ratio."""
        if self.limited != self.both:
            return ns(median(self.ours))
        return f"{self.ratio} times"

    @property
    def goal(self) -> str:
        """The aim, and whether it is met."""
        return f"{self.aim}: {self.verdict}" if self.aim else ""


Ratios = dict[Any, Ratio]


def ratios(costs: Costs) -> dict[str, Ratios]:
    """Return the ratios of ratios.toml by kind and by FMU and inputs, or by both costs."""
    tables = tomllib.loads(Path(__file__).with_name("ratios.toml").read_text(encoding="utf-8"))
    aims, found = tables.pop("aims"), {kind: {} for kind in tables}
    names = [REFERENCE.name, *MODELS, BASELINE.name]
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
                    ratio = Ratio(what, costs[ours], to, costs[other], aim, name)
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
        is_speed = "FMPy, " in name or name.endswith("processes")
        if old and (old / ratio if is_speed else ratio / old) > WORSE:
            found.append(f"{name}: {number(ratio)}, before {number(old)}")
    return found


# --- the page -----------------------------------------------------------------------------


def render(results: Mapping) -> str:
    """Return the page docs/speed.md."""
    costs = results["costs"]
    kinds = ratios(costs)
    context: dict[str, Any] = kinds | {
        "by": side_by_side(kinds["calls"], kinds["masters"]),
        "names": list(dict.fromkeys(name for name, _ in kinds["cycles"])),
        "missed": [r for kind in kinds.values() for r in kind.values() if r.verdict in MISSED],
        "engines": {name: engine_cells(results["wasm"]["costs"], name) for name in SIGNALS},
        "vectors": vectors(costs),
        "nodes": [node(costs, kind) for kind in INPUTS[::-1] if f"sample/256 {kind}" in costs],
        "noise": [
            noise(costs, [f"cycle/{name}" for name in (REFERENCE.name, "PidRbf")], INPUTS),
            noise(costs, ["pair/own"], [""]),
        ],
    }
    return environment().get_template("speed.md.j2").render(results | context)


def render_abilities(costs: Costs) -> str:
    """Return the text on what the abilities of the master cost."""
    return environment().get_template("abilities.md.j2").render(costs=costs)


def environment() -> Environment:
    """Return the environment of the templates."""
    options = {"trim_blocks": True, "keep_trailing_newline": True}
    loader = FileSystemLoader(Path(__file__).parent)
    found = Environment(loader=loader, undefined=StrictUndefined, **options)
    found.filters |= {"code": code, "median": median, "ns": ns, "row": row}
    found.filters |= {"error": "{:.1e}".format, "megabytes": megabytes, "of": of, "span": span}
    return found


def side_by_side(*kinds: Ratios) -> list[list[Any]]:
    """Return rows with time, aim and speed of each kind, by what is measured."""
    by_name = [{ratio.what: ratio for ratio in kind.values()} for kind in kinds]
    rows = []
    for what in dict.fromkeys(name for kind in by_name for name in kind):
        found = [kind.get(what) for kind in by_name]
        rows.append([what, *([r.time, r.goal, r.speed] if r else [""] * 3 for r in found)])
    return rows


def node(costs: Costs, kind: str) -> str:
    """Return the time of one more node of a large network."""
    fewer, more = (min(costs[f"sample/{nodes} {kind}"]) for nodes in (128, 256))
    return f"{(more - fewer) / 128:.2g} ns"


def vectors(costs: Costs) -> dict[str, list[str]]:
    """Return, by environment, the steps a second of all together for each size, and the reset.

    What is measured on one and on two cores has two numbers.
    """
    columns = [*map(str, (1, *SIZES)), "reset"]
    found: dict[str, list[str]] = {}
    for name, times in sorted(costs.items(), key=lambda item: ("/`" not in item[0], item[0])):
        if name.startswith("environment/"):
            _, environment, column = name.split("/")
            cells = found.setdefault(re.sub(", . cores?$", "", environment), [""] * len(columns))
            cell = (ns if column == "reset" else rate)(median(times))
            place = columns.index(column)
            cells[place] = f"{cells[place]}; {cell}" if cells[place] else cell
    return found


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


def span(ratios: Iterable[Ratio]) -> str:
    """Return the least and the greatest of some ratios, nothing if there are none."""
    values = sorted(ratio.both[0] for ratio in ratios)
    return " to ".join(dict.fromkeys(map(number, [*values[:1], *values[-1:]])))


def of(kind: Ratios, fmu: str) -> list[Ratio]:
    """Return the ratios of an FMU, in both versions of FMI."""
    return [ratio for ratio in kind.values() if ratio.fmu.removesuffix(", FMI 3.0") == fmu]


def number(value: float) -> str:
    """Return a ratio with three digits."""
    return f"{value:.2f}" if value < 10 else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def ns(time: float) -> str:
    """Return a time in ns with a suitable unit."""
    for unit, factor in (("ns", 1.0), ("µs", 1e3), ("ms", 1e6)):
        if time < 999.5 * factor:
            return f"{time / factor:.3g} {unit}"
    return f"{time / 1e9:.3g} s"
