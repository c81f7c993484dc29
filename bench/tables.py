"""The text of docs/speed.md that depends on measurements, by the name of its place in the page."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median, quantiles

from subjects import MODELS, REFERENCE, SOURCE

AIMS = {
    ("Pid", "stand"): 1.3,
    ("Pid", "move"): 1.3,
    ("PidRbf", "move"): 2.5,
    ("IpidRbf", "move"): 2.5,
    ("Pendulum, linear", "stand"): 2.0,
    ("Pendulum, linear", "move"): 2.0,
}
"""Upper limits of a cycle, as multiples of that of the bare PID in C."""


@dataclass(frozen=True)
class Ratio:
    """Two costs that were measured in the same rounds."""

    ours: Sequence[float]
    other: Sequence[float]
    most: float | None = None
    """The aim, if the ratio has an upper limit."""
    least: float | None = None
    """The aim, if it has a lower limit."""

    @property
    def rounds(self) -> list[float]:
        """The ratio in each round."""
        return [a / b for a, b in zip(self.ours, self.other, strict=True)]

    @property
    def median(self) -> float:
        """The median of the ratios of the rounds, which is compared with the aim."""
        return median(self.rounds)

    @property
    def of_minima(self) -> float:
        """The ratio of the minima."""
        return min(self.ours) / min(self.other)

    @property
    def aim(self) -> str:
        """The aim as text."""
        if self.most is not None:
            return f"at most {self.most:g}"
        return f"at least {self.least:g}" if self.least is not None else ""

    @property
    def verdict(self) -> str:
        """Whether the ratio is as aimed for."""
        if self.most is not None:
            return "met" if self.median <= self.most else "missed"
        if self.least is not None:
            return "met" if self.median >= self.least else "missed"
        return ""

    def cells(self) -> list[str]:
        """Return the last four cells of a row."""
        return [number(self.median), number(self.of_minima), self.aim, self.verdict]


def blocks(results: Mapping) -> dict[str, str]:
    """Return all texts by their name."""
    return {
        "care": care(results),
        "missed": missed(results),
        "cycle": cycle(results),
        "host": host(results),
        "other": other(results),
        "noise": noise(results),
        "machine": machine(results),
    }


# --- ratios -------------------------------------------------------------------------------


def lines_of(results: Mapping, name: str, inputs: str) -> list[list[float]]:
    """Return the measurements of a cycle; two if it was measured twice, for the noise."""
    key = (name, inputs)
    return [line["ns"] for line in results["cycle"] if (line["fmu"], line["inputs"]) == key]


def cycle_ratio(results: Mapping, name: str, inputs: str) -> Ratio:
    """Return the cost of a cycle relative to the bare PID in C."""
    ours, reference = (lines_of(results, n, inputs)[0] for n in (name, REFERENCE.name))
    return Ratio(ours, reference, most=AIMS.get((name, inputs)))


def host_ratios(results: Mapping) -> dict[str, Ratio]:
    """Return the costs of the native master relative to others."""
    pair, sweeps = results["pair"], results["sweeps"]
    ratios = {
        "own": Ratio(pair["native"], pair["own"], most=1.3),
        "C": Ratio(pair["native"], pair["C"]),
        "FMPy": Ratio(pair["FMPy"], pair["native"], least=150),
        "sweep": Ratio(sweeps["1"], sweeps["C"], most=1.5),
    }
    for processes in map(str, range(2, results["machine"]["cores"] + 1)):
        aim = 1.85 if processes == "2" else None
        ratios[processes] = Ratio(sweeps["1"], sweeps[processes], least=aim)
    return ratios


def again(results: Mapping) -> Iterator[Ratio]:
    """Yield the ratios of FMUs to themselves."""
    for name in (REFERENCE.name, "PidRbf"):
        for inputs in ("stand", "move"):
            yield Ratio(*lines_of(results, name, inputs))


def slope(results: Mapping, inputs: str) -> float:
    """Return the cost (ns) of one more node of a large network."""
    nodes = node_costs(results, inputs)
    (fewer, less), (more, cost) = list(pairwise(nodes))[-1]
    return (cost - less) / (more - fewer)


def node_costs(results: Mapping, inputs: str) -> list[tuple[float, float]]:
    """Return the cost (ns) of a sample, by number of nodes in ascending order."""
    names = (name.split("/") for name in results["rust"] if name.startswith("nodes/"))
    counts = sorted(int(name.split()[0]) for _, name in names if name.endswith(inputs))
    return [(n, results["rust"][f"nodes/{n} {inputs}"]["min"]) for n in counts]


# --- tables -------------------------------------------------------------------------------


def care(results: Mapping) -> str:
    """Return the figures that matter to each reader."""
    host = host_ratios(results)
    rows = [["You", "What counts", "Measured", "Aim", ""]]

    def add(reader: str, figure: str, ratio: Ratio) -> None:
        rows.append([reader, figure, f"{number(ratio.median)} times", ratio.aim, ratio.verdict])

    for reader, name in (("import one FMU", "Pid"), ("", "PidRbf")):
        text = f"a cycle of `{name}` whose inputs all move, relative to a PID in plain C"
        add(reader, text, cycle_ratio(results, name, "move"))
    text = "a native step of two coupled FMUs, relative to the cycles of these FMUs"
    add("run co-simulations natively", text, host["own"])
    add("", "the speed of the same run, relative to FMPy", host["FMPy"])
    add("sweep", "a loop with its metrics, relative to the same loop in C", host["sweep"])
    if "2" in host:
        add("", "the speed with two processes, relative to one", host["2"])
    if "rust" in results:
        moving, standing = (f"{slope(results, kind):.2g} ns" for kind in ("move", "stand"))
        figure = "one more node of a large network, while the set-point moves; while it stands"
        rows.append(["enlarge the network", figure, f"{moving}; {standing}", "", ""])
    return markdown(rows)


def missed(results: Mapping) -> str:
    """Return what misses its aim."""
    names = {
        "own": "a native step of the coupled pair, relative to the cycles of its FMUs",
        "FMPy": "the native master, relative to FMPy",
        "sweep": "a loop of the sweep, relative to the bare loop",
        "2": "two processes, relative to one",
    }
    ratios = [
        (f"a cycle of {code(name)} whose inputs {inputs}", cycle_ratio(results, name, inputs))
        for name, inputs in AIMS
    ]
    host = host_ratios(results)
    ratios += [(text, host[name]) for name, text in names.items() if name in host]
    items = [
        f"- {name}: {number(ratio.median)} instead of {ratio.aim}"
        for name, ratio in ratios
        if ratio.verdict == "missed"
    ]
    return "\n".join(items) or "All aims are met."


def cycle(results: Mapping) -> str:
    """Return the table of cycles."""
    head = ["FMU", "Inputs", "Minimum", "Median", "In process"]
    rows = [[*head, "Times the bare PID", "Of minima", "Aim", ""]]
    for model in (REFERENCE, *MODELS, SOURCE):
        for inputs in ("stand", "move"):
            ratio = cycle_ratio(results, model.name, inputs)
            inside = results.get("rust", {}).get(f"in process/{model.name} {inputs}")
            rows.append(
                [
                    code(model.name),
                    inputs,
                    ns(min(ratio.ours)),
                    ns(median(ratio.ours)),
                    ns(inside["min"]) if inside else "",
                    *(ratio.cells() if model != REFERENCE else [""] * 4),
                ]
            )
    return markdown(rows)


def host(results: Mapping) -> str:
    """Return the table of the native master."""
    ratios = host_ratios(results)
    pair, sweeps = results["pair"], results["sweeps"]
    rows = [["What", "Median", "Against", "Median", "Ratio", "Of minima", "Aim", ""]]

    def add(what: str, ours: Sequence[float], to: str, other: Sequence[float], name: str) -> None:
        cells = ratios[name].cells()
        rows.append([what, ns(median(ours)), to, ns(median(other)), *cells])

    step = "a step of the coupled pair, natively"
    add(step, pair["native"], "cycles of its two FMUs", pair["own"], "own")
    add(step, pair["native"], "a master in C", pair["C"], "C")
    add("the same step in FMPy", pair["FMPy"], "natively", pair["native"], "FMPy")
    add("a loop of the sweep, 1 process", sweeps["1"], "the bare loop in C", sweeps["C"], "sweep")
    for n in map(str, range(2, results["machine"]["cores"] + 1)):
        add("a loop of the sweep, 1 process", sweeps["1"], f"{n} processes", sweeps[n], n)
        one, more = thread_times(results, 1), thread_times(results, int(n))
        ratios["threads"] = Ratio(one, more)
        add("a cycle of `PidRbf` from C, 1 thread", one, f"{n} threads", more, "threads")
    return markdown(rows)


def thread_times(results: Mapping, threads: int) -> list[float]:
    """Return the times of a cycle of PID-RBF, which show what the machine's cores can bring."""
    lines = {(line["fmu"], line["threads"]): line["ns"] for line in results["threads"]}
    return lines["PidRbf", threads]


def other(results: Mapping) -> str:
    """Return the table of what happens once, and of PythonFMU."""
    rows = [["What", "Minimum", "Median", ""]]
    for line in results["life"]:
        memory = f"{line['initialized_bytes']:.0f} B"
        rows.append([f"{code(line['fmu'])}, instantiate to free", *times(line["ns"]), memory])
    if results["python"]:
        ours, theirs = (line["ns"] for line in results["python"])
        slower = f"{number(Ratio(theirs, ours).median)} times `Pid`"
        rows.append(["a cycle of a PID in PythonFMU", *times(theirs), slower])
    if "rust" in results:
        opened = results["rust"]["loading/open"]
        rows.append(["open and unpack an FMU", ns(opened["min"]), ns(opened["median"]), ""])
    name, largest = max(results["sizes"].items(), key=lambda item: item[1])
    rows.append([f"largest file, {code(name)}", "", "", f"{largest / 1000:.0f} KB"])
    return markdown(rows)


def noise(results: Mapping) -> str:
    """Return how far measurements of the same FMU are apart."""
    ratios = list(again(results))
    all_ratios = [value for ratio in ratios for value in (ratio.median, ratio.of_minima)]
    single = quantiles((value for ratio in ratios for value in ratio.rounds), n=20)
    limit = max(abs(value - 1) for value in all_ratios)
    spreads = [median(line["ns"]) / min(line["ns"]) for line in results["cycle"]]
    return (
        f"The same FMU, measured twice in the same {len(ratios[0].ours)} rounds, has ratios from "
        f"{min(all_ratios):.3f} to\n{max(all_ratios):.3f} to itself, and in nine of ten single "
        f"rounds from {single[0]:.2f} to {single[-1]:.2f}. Ratios of cycles that\ndiffer from "
        f"another, or from an aim, by less than {max(limit, 0.005):.1%} are noise. The median of "
        f"a cycle is {min(spreads):.2f}\nto {max(spreads):.2f} times its minimum."
    )


def machine(results: Mapping) -> str:
    """Return where the numbers come from."""
    m = results["machine"]
    cores = f"{m['cores']} core{'s' * (m['cores'] > 1)}"
    text = (
        f"Measured on: {m['processor']}, {cores}, {m['system']};\n"
        f"{m['rustc']}, {m['cc']}, Python {m['python']}."
    )
    if "rust" not in results:
        text += "\nMeasured with `--quick`: these numbers only show that the script works."
    return text


# --- text ---------------------------------------------------------------------------------


def markdown(rows: Iterable[Sequence[str]]) -> str:
    """Return a table; the first row is its head."""
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(
        "|" + "".join(f" {cell} |" if cell else " |" for cell in line) for line in lines
    )


def code(name: str) -> str:
    """Return the name of a case with that of its FMU as code."""
    if name == REFERENCE.name:
        return name
    fmu, comma, rest = name.partition(",")
    return f"`{fmu}`{comma}{rest}"


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
