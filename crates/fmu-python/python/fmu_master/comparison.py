"""Whether two results are the same within tolerances."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from . import _native
from ._names import suggests
from ._values import columns, one_or_more
from .result import FmuError, Result, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Table = Result | Mapping[str, Any] | str | os.PathLike[str]
"""Results: a `Result`, a mapping or data frame of columns with "time" [s], or a file."""


class Difference(NamedTuple):
    """The first difference of a variable."""

    name: str
    time: float
    """The time [s]."""
    values: tuple[Any, Any]
    """The value in the reference and in the results, in the unit of the variable."""
    text: str
    """The difference as a sentence."""


@dataclass(frozen=True, repr=False)
class Comparison:
    """The outcome of `compare`: `is_same`, and as text the first difference.

    Attributes
    ----------
    differences : list of Difference
        The first difference of each variable that differs, in the order of their times.
    reference, results : Result
        What was compared.
    """

    differences: list[Difference]
    reference: Result
    results: Result

    @property
    def is_same(self) -> bool:
        """Whether no variable differs."""
        return not self.differences

    def __repr__(self) -> str:
        from .display import listed

        if self.is_same:
            return f"<Comparison: {self}>"
        names = [difference.name for difference in self.differences]
        about = f"<Comparison: {len(names)} of {len(self.reference) - 1} variables differ: "
        return listed(about, names, ">")

    def _repr_html_(self) -> str:
        from .display import comparison_html

        return comparison_html(self)

    def __str__(self) -> str:
        if self.is_same:
            return "the same within the tolerance"
        text, count = self.differences[0].text, len(self.reference) - 1
        names = ", ".join(difference.name for difference in self.differences)
        return f"{text}\ndifferent: {len(self.differences)} of {count} variables: {names}"

    def plot(self) -> Figure:
        """Draw the variables that differ over the time [s], and below each the difference.

        A vertical line is at the first difference beyond the tolerance. Returns the figure of
        Matplotlib.
        """
        from .plots import draw_comparison

        return draw_comparison(self)


@suggests
def compare(
    reference: Table,
    results: Table,
    *,
    absolute: float = 1e-12,
    relative: float = 1e-6,
    hold: Sequence[str] = (),
) -> Comparison:
    """Compare the variables of a reference, at its times, with those of other results.

    Between two rows of the results, numbers are interpolated; whole numbers, Booleans and texts
    keep their value until the next row. `cargo fmu compare` does the same with files.

    Parameters
    ----------
    reference, results
        What to compare; the results have all variables of the reference.
    absolute
        Absolute tolerance of numbers, in the unit of the variable.
    relative
        Relative tolerance, which is added, of the largest magnitude of the variable in the
        reference.
    hold
        Sampled variables, whose numbers are not interpolated.

    Raises
    ------
    FmuError
        The results lack a variable, or have it in another unit, or end at another time.

    Examples
    --------
    >>> a = simulate("target/fmu/Pendulum.fmu", start_values={"theta0": 0.1})
    >>> b = simulate("target/fmu/Pendulum_fmi3.fmu", start_values={"theta0": 0.1})
    >>> comparison = compare(a, b)
    >>> assert comparison.is_same, comparison
    """
    tables, hold = [_result(reference), _result(results)], one_or_more(hold)
    if unknown := set(hold) - set(tables[0]):
        raise FmuError(f"hold: the reference has no variable {min(unknown)}")
    named = [{n for n in table if table.names(n).dtype == object} for table in tables]
    compared = [
        [
            # Of an enumeration, a file has the names of items, and another program the numbers.
            (n, table.units.get(n, ""), (table.names(n) if n in others else table[n]).tolist())
            for n in table
        ]
        for table, others in zip(tables, reversed(named), strict=True)
    ]
    names = ("the reference", "the results")
    found = _native.compare(compared, names, absolute, relative, hold)
    differences = [Difference(name, time, tuple(two), text) for name, time, two, text in found]
    return Comparison(differences, *tables)


def _result(table: Table) -> Result:
    if isinstance(table, Result):
        return table
    if isinstance(table, str | os.PathLike):
        return read(table)
    found = columns(table)
    first = {"time": found["time"]} | found
    return Result.of(first, {"time": "s"})
