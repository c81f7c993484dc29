"""The summary of a run: the statistics of its columns, and what is probably wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._names import similar_variables


class Summary(dict[str, dict[str, float]]):
    """The statistics of each column of numbers by name, such as `summary["theta"]["max"]`.

    "min", "max", "rms" and "last" are in the unit of the variable. As a text, the summary is a
    table with the alarms below.

    Attributes
    ----------
    units : dict
        Units by name.
    alarms : list of str
        What is probably wrong: numbers that are not finite or beyond their bounds, that oscillate
        or diverge.
    ended : str or None
        Which FMU has ended the run before the stop time, and why.
    """

    def __init__(
        self,
        statistics: Mapping[str, dict[str, float]],
        units: Mapping[str, str],
        alarms: Sequence[str] = (),
        ended: str | None = None,
    ):
        super().__init__(statistics)
        self.units = {name: units.get(name, "") for name in statistics}
        self.alarms, self.ended = list(alarms), ended

    def __missing__(self, key: str) -> Any:
        if key in ("alarms", "ended"):
            return getattr(self, key)
        known = similar_variables(key, self) or f"those that have are {', '.join(self)}"
        raise KeyError(f"{key} has no statistics; {known}")

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of a table of texts, its header first."""
        header = ("", "min", "max", "rms", "last", "unit")
        cells = [(n, *(f"{s[k]:.4g}" for k in header[1:5]), self.units[n]) for n, s in self.items()]
        return [header, *cells] if cells else []

    def remarks(self) -> list[str]:
        """Return the alarms, and why the run has ended, as lines."""
        ended = [] if self.ended is None else [f"ended: {self.ended}"]
        return [f"alarm: {alarm}" for alarm in self.alarms] + ended

    def __repr__(self) -> str:
        rows = self.rows()
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(
                cell.rjust(width) if 0 < place < 5 else cell.ljust(width)
                for place, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        return "\n".join([*lines, *self.remarks()]) or "no columns of numbers"


def statistics_of(columns: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Return the statistics of columns; Booleans and texts have none, nor have absent values."""
    numbers = {
        n: c.astype(float) for n, c in columns.items() if c.dtype.kind in "iuf" and np.ma.count(c)
    }
    return {
        name: {
            "min": float(column.min()),
            "max": float(column.max()),
            "rms": float(np.sqrt(np.mean(column**2))),
            "last": float(np.ma.filled(column, np.nan)[-1]),
        }
        for name, column in numbers.items()
    }
