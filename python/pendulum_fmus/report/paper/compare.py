"""Comparisons of the controllers: measures, and statements that one is better than another."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from ..claims import OWN, Claim, Finding, Row
from ..data import Data, Trace
from ..scenarios import KINDS

Values = Mapping[str, float]
"""A number for each kind of controller."""

COLUMNS = ("PID", "PID-RBF", "IPID-RBF", OWN)
"""Column headings of the tables; the last is IPID-RBF with its own force as target (29)."""

PID, RBF, IPID = ("PID",), ("PID-RBF",), ("IPID-RBF",)
NETWORKS = (*RBF, *IPID)
OTHERS = (*PID, *RBF)
"""The usual groups of controllers: those with a network, and the others of IPID-RBF."""

SIGNAL_NAMES = {"step": "step", "sine": "sine", "square": "square wave"}


@dataclass(frozen=True)
class Measure:
    """A number for each controller.

    Parameters
    ----------
    name
        What is measured, with its unit.
    of
        Function of the data and the kind of controller.
    more
        Whether more is better.
    """

    name: str
    of: Callable[[Data, str], float]
    more: bool = False

    def values(self, data: Data) -> Values:
        """Measure all controllers."""
        return _values(self, data)

    def better(self, data: Data, kind: str, others: Sequence[str]) -> bool:
        """Return whether a controller is better than each of some others."""
        values = self.values(data)
        if self.more:
            return all(values[kind] > values[other] for other in others)
        return least(values, kind, others)


@cache
def _values(measure: Measure, data: Data) -> Values:
    return {kind: measure.of(data, kind) for kind in KINDS}


def measured(
    name: str, unit: str, of: Callable[[Trace], float], signal: str = "step", amplitude: float = 0.0
) -> Measure:
    """Return a measure of a trace, less being better."""
    case = SIGNAL_NAMES[signal] + (f", d = {amplitude:g} rad" if amplitude else "")
    return Measure(f"{name}, {case} [{unit}]", lambda data, kind: of(data(kind, signal, amplitude)))


def row(name: str, values: Values, holds: bool | None = None) -> Row:
    """Return a row with one column per controller."""
    return Row(name, [values.get(kind, "") for kind in KINDS], holds)


def split(name: str, values: Values, holds: Mapping[str, bool]) -> list[Row]:
    """Return a row, or one for each controller if a statement holds for some of them only."""
    if len(set(holds.values())) == 1:
        return [row(name, values, all(holds.values()))]
    shown = dict(zip(KINDS, COLUMNS, strict=True))
    return [
        row(f"{name}: {'IPID-RBF' if shown[kind] == OWN else kind}", values, one)
        for kind, one in holds.items()
    ]


def variants(kinds: Sequence[str], ipid: str) -> list[str]:
    """Replace IPID-RBF by one of its variants."""
    return [ipid if kind == "IPID-RBF" else kind for kind in kinds]


def better(
    data: Data,
    says: str,
    measures: Sequence[Measure],
    winners: Sequence[str],
    others: Sequence[str],
    remark: str = "",
    also: Sequence[Measure] = (),
) -> Claim:
    """Return the statement that some controllers are better than others, by every measure.

    The measures of `also` are shown, but decide nothing.
    """

    def finding(ipid: str) -> Finding:
        first, second = variants(winners, ipid), variants(others, ipid)
        rows = []
        for measure in measures:
            values = measure.values(data)
            if len({values[kind] for kind in (*first, *second)}) == 1:
                rows.append(row(measure.name, values))  # a tie decides nothing
                continue
            rows += split(
                measure.name,
                values,
                {kind: measure.better(data, kind, second) for kind in first},
            )
        rows += [row(m.name, m.values(data)) for m in also]
        return Finding(COLUMNS, rows, remark)

    larger = {measure.more for measure in measures}
    sense = "larger margins" if larger == {True} else "smaller values"
    if len(larger) > 1:
        sense += ", or larger margins,"
    has = "has" if len(winners) == 1 else "have"
    return Claim(says, f"{_and(winners)} {has} {sense} than {_and(others)}, in each row", finding)


def settles(
    data: Data, says: str, kinds: Sequence[str], measures: Sequence[Measure], criterion: str
) -> Claim:
    """Return the statement that some controllers settle, in every case."""

    def finding(ipid: str) -> Finding:
        judged = variants(kinds, ipid)
        rows = []
        for measure in measures:
            values = measure.values(data)
            rows.append(
                row(measure.name, values, not any(math.isnan(values[kind]) for kind in judged))
            )
        return Finding(COLUMNS, rows)

    return Claim(says, criterion, finding)


def limited(
    data: Data, says: str, kinds: Sequence[str], bounds: Sequence[tuple[Measure, float]]
) -> Claim:
    """Return a statement that holds by a measure if all of some controllers stay below a bound."""

    def finding(ipid: str) -> Finding:
        judged = variants(kinds, ipid)
        rows = []
        for measure, bound in bounds:
            values = measure.values(data)
            name = f"{measure.name}, below {bound:g}".replace("e-0", "e-")
            rows += split(name, values, {kind: _finite(values[kind]) < bound for kind in judged})
        return Finding(COLUMNS, rows)

    stays = "stays" if len(kinds) == 1 else "stay"
    return Claim(says, f"{_and(kinds)} {stays} below the bound of each row", finding)


def _and(words: Sequence[str]) -> str:
    return " and ".join(words)


def by_kind(
    data: Data, signal: str, amplitude: float, measure: Callable[[Trace], float]
) -> dict[str, float]:
    """Apply a measure to all controllers in the same loop."""
    return {kind: measure(data(kind, signal, amplitude)) for kind in KINDS}


def by_signal(
    data: Data,
    name: str,
    unit: str,
    of: Callable[[Trace], float],
    holds: Callable[[Values], bool],
    kinds: Sequence[str] = KINDS,
) -> list[Row]:
    """Return a row for each signal, without disturbance."""
    rows = []
    for signal, shown in SIGNAL_NAMES.items():
        values = {kind: of(data(kind, signal)) for kind in kinds}
        rows.append(row(f"{name}, {shown} [{unit}]", values, holds(values)))
    return rows


def least(values: Values, kind: str, others: Sequence[str]) -> bool:
    """Return whether a kind has the smallest value; NaN (never) counts as the largest."""
    return all(_finite(values[kind]) < _finite(values[other]) for other in others)


def _finite(value: float) -> float:
    return math.inf if math.isnan(value) else value
