"""The text of docs/speed.md that depends on measurements, by the name of its place in the page."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median, quantiles

from subjects import MODELS, REFERENCE, SOURCE, VERSIONS, in_fmi3

FMU_NAMES = {case.model for case in MODELS}


# --- ratios of costs that were measured in the same rounds, and their aims -----------------

AIMS = {
    ("Pid", "stand"): 1.3,
    ("Pid", "move"): 1.3,
    ("PidRbf", "move"): 2.5,
    ("IpidRbf", "move"): 2.5,
    ("Pendulum, linear", "stand"): 2.0,
    ("Pendulum, linear", "move"): 2.0,
}
"""Upper limits of a cycle, as multiples of a cycle of the bare PID in C."""

VERSIONS_AIM = 1.2
"""Upper limit of a cycle in FMI 3.0, as a multiple of that in FMI 2.0."""


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
        """The median of the ratios of the rounds."""
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
        """Whether the ratio is as aimed for; unclear if median and minima disagree."""
        ratios = (self.median, self.of_minima)
        if self.most is not None:
            met = {ratio <= self.most for ratio in ratios}
        elif self.least is not None:
            met = {ratio >= self.least for ratio in ratios}
        else:
            return ""
        return "unclear" if len(met) > 1 else "met" if met.pop() else "missed"


def lines_of(results: Mapping, name: str, inputs: str) -> list[list[float]]:
    """Return the measurements of a cycle; two if it was measured twice, for the noise."""
    key = (name, inputs)
    return [line["ns"] for line in results["cycle"] if (line["fmu"], line["inputs"]) == key]


def cycle_ratio(results: Mapping, name: str, inputs: str) -> Ratio:
    """Return the cost of a cycle relative to the bare PID in C."""
    ours, reference = (lines_of(results, n, inputs)[0] for n in (name, REFERENCE.name))
    return Ratio(ours, reference, most=AIMS.get((name, inputs)))


def version_ratios(results: Mapping) -> dict[tuple[str, str], Ratio]:
    """Return the costs of cycles in FMI 3.0 relative to FMI 2.0, by FMU and inputs."""
    ratios = {}
    for case in VERSIONS:
        for inputs in ("stand", "move"):
            new, old = (lines_of(results, c.name, inputs)[0] for c in (in_fmi3(case), case))
            ratios[case.name, inputs] = Ratio(new, old, most=VERSIONS_AIM)
    return ratios


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


def thread_times(results: Mapping, threads: int) -> list[float]:
    """Return the times of a cycle of PID-RBF, which show what the machine's cores can bring."""
    lines = {(line["fmu"], line["threads"]): line["ns"] for line in results["threads"]}
    return lines["PidRbf", threads]


# --- tables -------------------------------------------------------------------------------


def blocks(results: Mapping) -> dict[str, str]:
    """Return all texts by their name."""
    return {
        "care": care(results),
        "missed": missed(results),
        "cycle": cycle(results),
        "versions": versions(results),
        "host": host(results),
        "counts": counts(results),
        "other": other(results),
        "noise": noise(results),
        "machine": machine(results),
    }


def care(results: Mapping) -> str:
    """Return the figures that matter to each reader."""
    host = host_ratios(results)
    rows = [["You", "What counts", "Measured", "Aim", ""]]

    def add(reader: str, figure: str, ratio: Ratio) -> None:
        rows.append([reader, figure, f"{number(ratio.median)} times", ratio.aim, ratio.verdict])

    for reader, name in (("import one FMU", "Pid"), ("", "PidRbf")):
        text = f"a cycle of `{name}` whose inputs all move, relative to a PID in plain C"
        add(reader, text, cycle_ratio(results, name, "move"))
    text = "the same cycle in FMI 3.0, relative to FMI 2.0"
    add("", text, version_ratios(results)["PidRbf", "move"])
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
    """Return what misses its aim, at least by one of both ratios."""
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
    ratios += [
        (f"a cycle in FMI 3.0 relative to FMI 2.0, {code(name)}, inputs {inputs}", ratio)
        for (name, inputs), ratio in version_ratios(results).items()
    ]
    host = host_ratios(results)
    ratios += [(text, host[name]) for name, text in names.items() if name in host]
    items = [
        f"- {name}: {number(ratio.median)}, of minima {number(ratio.of_minima)}; aim: {ratio.aim}"
        for name, ratio in ratios
        if ratio.verdict != "met"
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
                    *(last_cells(ratio) if model != REFERENCE else [""] * 4),
                ]
            )
    return markdown(rows)


def versions(results: Mapping) -> str:
    """Return the table of cycles in both versions of FMI."""
    rows = [["FMU", "Inputs", "FMI 2.0", "FMI 3.0", "Ratio", "Of minima", "Aim", ""]]
    for (name, inputs), ratio in version_ratios(results).items():
        medians = [ns(median(ratio.other)), ns(median(ratio.ours))]
        rows.append([code(name), inputs, *medians, *last_cells(ratio)])
    return markdown(rows)


def host(results: Mapping) -> str:
    """Return the table of the native master."""
    ratios = host_ratios(results)
    pair, sweeps = results["pair"], results["sweeps"]
    rows = [["What", "Median", "Against", "Median", "Ratio", "Of minima", "Aim", ""]]

    def add(what: str, ours: Sequence[float], to: str, other: Sequence[float], name: str) -> None:
        cells = last_cells(ratios[name])
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


def counts(results: Mapping) -> str:
    """Return the table of instructions."""
    rows = [["A cycle or step of", "Instructions", "Reads and writes", "Cache misses"]]
    for name, of in results["counts"].items():
        fmu, comma, rest = name.partition(", ")
        shown = f"{code(fmu)}{comma}{rest}" if fmu in FMU_NAMES else name
        cells = [f"{of['instructions']:.0f}", f"{of['accesses']:.0f}", f"{of['misses']:.2f}"]
        rows.append([shown, *cells])
    return markdown(rows) if results["counts"] else "Not counted: valgrind is not installed."


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
    pair = Ratio(results["pair"]["own again"], results["pair"]["own"])
    limits = [noise_limit(ratios), noise_limit([pair])]
    spreads = [median(line["ns"]) / min(line["ns"]) for line in results["cycle"]]
    items = [
        f"- Cycles: from {single_rounds(ratios)} in nine of ten rounds. Ratios that differ from",
        f"  each other or from an aim by less than {limits[0]:.1%} are noise. The median of a",
        f"  cycle is {min(spreads):.2f} to {max(spreads):.2f} times its minimum.",
        "- The native master, where each measurement is a process of its own: from",
        f"  {single_rounds([pair])} in nine of ten rounds; less than {limits[1]:.1%} is noise.",
    ]
    return "\n".join(items)


def noise_limit(ratios: Sequence[Ratio]) -> float:
    """Return how far the ratios of FMUs to themselves are from 1."""
    values = [value for ratio in ratios for value in (ratio.median, ratio.of_minima)]
    return max(0.005, *(abs(value - 1) for value in values))


def single_rounds(ratios: Sequence[Ratio]) -> str:
    """Return the range of nine of ten rounds."""
    single = quantiles((value for ratio in ratios for value in ratio.rounds), n=20)
    return f"{single[0]:.2f} to {single[-1]:.2f}"


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


def last_cells(ratio: Ratio) -> list[str]:
    """Return the last four cells of a row."""
    return [number(ratio.median), number(ratio.of_minima), ratio.aim, ratio.verdict]


def code(name: str) -> str:
    """Return the name of a case with the name of its FMU as code."""
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
