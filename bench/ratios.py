"""Ratios of costs that were measured in the same rounds, and their aims."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from subjects import REFERENCE, VERSIONS, in_fmi3

AIMS = {
    ("Pid", "stand"): 1.3,
    ("Pid", "move"): 1.3,
    ("PidRbf", "move"): 2.5,
    ("IpidRbf", "move"): 2.5,
    ("Pendulum, linear", "stand"): 2.0,
    ("Pendulum, linear", "move"): 2.0,
}
"""Upper limits of a cycle, as multiples of that of the bare PID in C."""

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
