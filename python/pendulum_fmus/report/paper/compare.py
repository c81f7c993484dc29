"""Comparisons of the controllers, and tables of them."""

import math
from collections.abc import Callable, Mapping, Sequence

from ..claims import Table
from ..data import Data, Trace
from ..scenarios import KINDS

Values = Mapping[str, float]
"""A number for each kind of controller."""

COLUMNS = ("PID", "PID-RBF", "IPID-RBF", "own target")
"""Column headings of the tables; the last is IPID-RBF with its own force as target (29)."""


def by_kind(
    data: Data, signal: str, amplitude: float, measure: Callable[[Trace], float]
) -> dict[str, float]:
    """Apply a measure to all controllers in the same loop."""
    return {kind: measure(data(kind, signal, amplitude)) for kind in KINDS}


def table(quantities: Mapping[str, Values]) -> Table:
    """Return a table with one column per controller; quantities by name and unit."""
    rows = {name: [values.get(kind, "") for kind in KINDS] for name, values in quantities.items()}
    return Table(COLUMNS, rows)


def least(values: Values, kind: str, others: Sequence[str]) -> bool:
    """Return whether a kind has the smallest value; NaN (never) counts as the largest."""
    return all(_finite(values[kind]) < _finite(values[other]) for other in others)


def _finite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def both_below_pid(values: Values, ipid: str) -> bool:
    """Return whether PID-RBF and IPID-RBF both have smaller values than PID."""
    return all(least(values, kind, ["PID"]) for kind in ("PID-RBF", ipid))
