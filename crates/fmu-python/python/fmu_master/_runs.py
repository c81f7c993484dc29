"""The table of a sweep: what was varied, what failed, which run is the best."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

INDEX, FAILURE, DIVERGED = "index", "failure", "diverged"
"""Columns of the table: the number of the run, why it failed, and whether it diverged or failed."""

_EDGE = 0.02
"""The part of a range at its ends in which a value is at its edge."""

_FIRST_METRIC = "iae"
"""The column after the parameters."""


def is_table(table: Mapping[str, np.ndarray]) -> bool:
    """Return whether a table is one of a sweep."""
    return next(iter(table), None) == INDEX


class Values(NamedTuple):
    """A column as numbers, with the names of values that are none, by number."""

    numbers: np.ndarray
    names: dict[int, str]


def numbers(column: np.ndarray) -> Values:
    """Return a column as numbers; texts count in the order of their first appearance."""
    if column.dtype == bool:
        return Values(column.view(np.int8), {0: "false", 1: "true"})
    if column.dtype != object:
        return Values(column, {})
    cells = column.tolist()
    if not any(isinstance(cell, str | bytes) for cell in cells):
        return Values(np.array([np.nan if c is None else float(c) for c in cells]), {})
    # A number among names is an item that has none.
    codes = {cell: code for code, cell in enumerate(dict.fromkeys(cells)) if cell is not None}
    found = np.array([codes.get(cell, np.nan) for cell in cells])
    return Values(found, {code: str(cell) for cell, code in codes.items()})


def is_wide(values: np.ndarray) -> bool:
    """Return whether positive numbers need a logarithmic axis."""
    known = values[np.isfinite(values)]
    if not len(known) or known.min() <= 0:
        return False
    low, high = known.min(), known.max()
    return bool(high > 50 * low and np.median(known) < (low + high) / 4)


class Runs:
    """The runs in the table of a sweep."""

    def __init__(self, table: Mapping[str, np.ndarray]):
        self.table = table

    def __len__(self) -> int:
        return len(self.table[INDEX])

    @cached_property
    def failed(self) -> np.ndarray:
        """Whether each run has diverged or failed."""
        diverged = self.table.get(DIVERGED)
        return np.zeros(len(self), bool) if diverged is None else diverged.astype(bool)

    @property
    def failures(self) -> list[tuple[int, str]]:
        """The number of each run that has failed, and why."""
        texts = self.table.get(FAILURE, np.empty(0, object)).tolist()
        pairs = zip(self.table[INDEX].tolist(), texts, strict=False)
        return [(index, text) for index, text in pairs if text is not None]

    @cached_property
    def varied(self) -> dict[str, Values]:
        """The parameters that vary; those that are equal in all runs have a name together."""
        found: dict[str, Values] = {}
        for name in list(self.table)[1:]:
            if name == _FIRST_METRIC:
                break
            values = numbers(self.table[name])
            if not len(self) or np.all(values.numbers == values.numbers[0]):
                continue
            equal = (n for n, v in found.items() if np.array_equal(v.numbers, values.numbers))
            if (same := next(equal, None)) is not None:
                found[f"{same}, {name}"] = found.pop(same)
            else:
                found[name] = values
        return found

    @property
    def metrics(self) -> list[str]:
        """The metrics that are numbers."""
        names = list(self.table)
        start = names.index(_FIRST_METRIC) if _FIRST_METRIC in names else 1
        return [n for n in names[start:] if self.table[n].dtype.kind in "fiu"]

    def values(self, metric: str) -> np.ndarray:
        """Return a metric of each run, NaN for those that have failed; of an error, the size."""
        found = numbers(self.table[metric]).numbers.astype(float)
        found = np.abs(found) if metric == "final_e" else found
        return np.where(self.failed | ~np.isfinite(found), np.nan, found)

    def best(self, metric: str, count: int = 1) -> list[int]:
        """Return the rows of the runs with the smallest values of a metric, the best one first."""
        values = self.values(metric)
        return [
            row for row in np.argsort(values, kind="stable")[:count] if values[row] == values[row]
        ]

    def edges(self, metric: str) -> dict[str, str]:
        """Return the parameters whose best value is at an end of their range, with a hint."""
        found: dict[str, str] = {}
        for row in self.best(metric):
            for name, (values, names) in self.varied.items():
                scaled = np.log(values) if is_wide(values) else values
                part = (scaled[row] - scaled.min()) / np.ptp(scaled)
                if names or _EDGE < part < 1 - _EDGE:
                    continue
                end, other = ("start", "smaller") if part <= _EDGE else ("end", "larger")
                low, high = values.min(), values.max()
                text = f"the best run has {name} = {values[row]:.4g}, at the {end} of the range"
                found[name] = f"{text} ({low:.4g} to {high:.4g}): {other} values may be better"
        return found
