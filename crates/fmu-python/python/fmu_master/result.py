"""What a run returns: typed columns by name; and the error if an FMU fails."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, overload

import numpy as np

from . import _native
from ._names import similar_variables
from ._values import array
from .summary import Summary, statistics_of

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure


class FmuError(RuntimeError):
    """An FMU cannot be used, fails or ends its process, or a system is invalid.

    An exception raised by a component in Python is the `__cause__`.

    Attributes
    ----------
    component, function : str or None
        The component, and the function of FMI that was called, if it was a call that failed.
    time : float or None
        The communication point [s].
    result : Result or None
        The rows up to then, or the table of a sweep if all its runs failed and no file has it.
    """

    def __init__(
        self,
        text: str,
        component: str | None = None,
        function: str | None = None,
        time: float | None = None,
        result: Result | None = None,
    ):
        super().__init__(text)
        self.component, self.function, self.time = component, function or None, time
        self.result = result


class Message(NamedTuple):
    """A log message of an FMU."""

    instance: str
    level: str
    """"info", "warning", "error" or "fatal", by the status of the message and its category."""
    text: str
    times: int
    """How many times it was logged."""
    category: str
    """Its log category, such as "logModel"; empty if the FMU passes none."""

    @property
    def warning(self) -> bool:
        """Whether it reports a problem: its level is not "info"."""
        return self.level != "info"


class FunctionTime(NamedTuple):
    """The time of all calls of a function of a component."""

    component: str
    """The name of the component."""
    function: str
    """The function of FMI."""
    calls: int
    """How often it was called."""
    failed: int
    """How many calls returned something else than success."""
    total: float
    """The time of all calls [s]."""
    mean: float
    """The time of a call on average [s]."""
    longest: float
    """The time of the longest call [s]."""


class Messages(list[Message]):
    """Log messages of FMUs, which a notebook shows as a table."""

    def __repr__(self) -> str:
        texts = ",\n ".join(map(repr, self))
        return f"[{texts}]"

    def _repr_html_(self) -> str:
        from .display import messages_html

        return messages_html(self)


class RealTime(NamedTuple):
    """How well a run in real time has kept the time; a moment is a communication point."""

    factor: float
    """Simulated seconds per second."""
    steps: int
    """How many steps the run took."""
    overruns: int
    """How many steps ended after the next communication point was due."""
    largest_overrun: tuple[float, float] | None
    """By how much the latest step was too late, and the moment from which it began [s]."""
    jitter: dict[float, float]
    """How late the run woke up at most in 50, 99, 99.9 and 100 % of the cases [s]; empty if it
    never had to wait."""
    latest_wake_up: tuple[float, float] | None
    """The largest delay of a wake-up, and its moment [s]."""
    longest_step: tuple[float, float, str, float] | None
    """The duration and the moment of the longest step [s], the component that took the longest
    in it, and how long [s]."""
    not_allowed: list[str]
    """What the system did not allow: "SCHED_FIFO", "locked memory", each with the reason."""


class AdaptiveSteps(NamedTuple):
    """The steps of a run with a `step_tolerance`."""

    accepted: int
    """How many steps were accepted."""
    rejected: int
    """How many steps were repeated, because their error was too large."""
    smallest: tuple[float, float] | None
    """The size of the smallest accepted step, and the time from which it was taken [s]."""
    missed: int
    """How many accepted steps had a larger error than allowed, as `min_step` was reached."""


class Result(Mapping[str, np.ndarray]):
    """The results of a run: NumPy arrays by name, "time" [s] first, in the types of the variables.

    The table of a sweep has "index" first, the number of the run. An array variable has a column
    for each element, such as `result["q[2]"]`; `result["q"]` has all of them, one row for each
    time. `result[["theta", "q"]]` is the result with the time and these columns. Results are equal
    if they have the same columns with the same values and units.

    The column of a clocked variable is a masked array: its value is masked (absent) in rows since
    whose last one none of its clocks has ticked. `column.compressed()` has the others,
    `result["time"][~column.mask]` their times. The column of a clock is True if it has ticked.

    Attributes
    ----------
    units : dict
        Units by name; empty texts for variables without unit.
    enumerations : dict
        For each recorded enumeration, whose values are numbers, the names of its items by number.
        In results that are read from a file, the values are the names.
    held : set of str
        Variables that keep their value from one row to the next, such as the outputs of sampled
        components.
    messages : list of Message
        What the FMUs have logged; changes of their states (category "logEvents") only with
        `debug_logging`.
    notes : list of str
        Choices of the master that the user may want to override.
    alarms : list of str
        What is probably wrong: numbers that are not finite or beyond their bounds, that oscillate
        or diverge.
    ended : str or None
        Which FMU has ended the run before the stop time, and why.
    real_time : RealTime or None
        How well the run has kept the time, if `real_time` was given.
    adaptive_steps : AdaptiveSteps or None
        The steps of the run, if `step_tolerance` was given.
    duration : float
        Time that the run took, without loading and initializing the FMUs [s].
    profile : list of FunctionTime
        With `profile=True`, where the time went, those functions first that took longest; the last
        one is the master itself, without names.
    """

    def __init__(self, columns: Sequence[tuple[str, str, str, Any, Any]], **about: Any):
        self._columns = {name: _array(*values) for name, _, *values in columns}
        self.units = {name: unit for name, unit, *_ in columns}
        self.enumerations: dict[str, dict[int, str]] = about.get("enumerations", {})
        self.held: set[str] = set(about.get("held", ()))
        self._set_points: dict[str, str] | None = about.get("set_points")
        self.messages = Messages(Message(*message) for message in about.get("messages", ()))
        self.notes: list[str] = about.get("notes", [])
        self.alarms: list[str] = about.get("alarms", [])
        self.ended: str | None = about.get("ended")
        kept = about.get("real_time")
        self.real_time: RealTime | None = RealTime(**kept) if kept else None
        taken = about.get("adaptive_steps")
        self.adaptive_steps: AdaptiveSteps | None = AdaptiveSteps(*taken) if taken else None
        self.duration: float = about.get("duration", 0.0)
        self.profile = [
            FunctionTime(*names, *counts, *times)
            for *names, counts, times in about.get("profile") or ()
        ]
        self._summary: dict[str, dict[str, float]] | None = about.get("summary")
        self._incomplete: set[str] = set()
        """Columns of a file in which NaN stands for a number that is missing."""

    @classmethod
    def of(cls, columns: Mapping[str, Any], units: Mapping[str, str]) -> Self:
        """Return a result of columns of numbers by name, "time" first."""
        result = cls(())
        result._columns = {name: array(column) for name, column in columns.items()}
        result.units = dict(units)
        return result

    @overload
    def __getitem__(self, name: str) -> np.ndarray: ...
    @overload
    def __getitem__(self, name: list[str]) -> Self: ...
    def __getitem__(self, name: str | list[str]) -> np.ndarray | Self:
        if isinstance(name, list | tuple):
            return self._of_columns(name)
        elements = self._elements(name)
        if elements == [name]:
            return self._columns[name]
        columns = [self._columns[n] for n in elements]
        stack = np.ma.stack if any(map(np.ma.isMaskedArray, columns)) else np.stack
        return stack(columns, axis=1)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self._columns or bool(self._elements(name, ())))

    def _elements(self, name: str, default: Sequence[str] | None = None) -> Sequence[str]:
        """Return the column of this name, or those of an array."""
        if not isinstance(name, str):
            example = next(reversed(self._columns), "theta")
            raise TypeError(
                f"result[{name!r}], expected the name of a column or a list of names; "
                f'result["{example}"][0] is the first value of {example}'
            )
        if name in self._columns:
            return [name]
        elements = [n for n in self._columns if re.fullmatch(rf"{re.escape(name)}\[[\d,]+\]", n)]
        if elements or default is not None:
            return elements
        known = similar_variables(name, self) or f"recorded are {', '.join(self)}"
        raise KeyError(f"{name} is not recorded; {known}")

    def _of_columns(self, names: Sequence[str]) -> Self:
        """Return the result with the first column, such as the time, and these."""
        kept = {n: None for name in [*list(self)[:1], *names] for n in self._elements(name)}
        result = copy.copy(self)
        result._columns = {n: self._columns[n] for n in kept}
        result.units = {n: self.units[n] for n in kept if n in self.units}
        result.enumerations = {n: items for n, items in self.enumerations.items() if n in kept}
        result.held = self.held & kept.keys()
        result._set_points = {
            n: point for n, point in self.set_points.items() if n in kept and point in kept
        }
        if self._summary is not None:
            result._summary = {n: s for n, s in self._summary.items() if n in kept}
        return result

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Result):
            return NotImplemented
        return (
            self._columns.keys() == other._columns.keys()
            and all(self.units.get(n, "") == other.units.get(n, "") for n in self)
            and all(_is_equal(self.names(n), other.names(n)) for n in self)
        )

    __hash__ = None  # type: ignore[assignment] # as of all that is compared by its values

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        from .display import result_line

        return result_line(self)

    def __str__(self) -> str:
        from .display import result_text

        return result_text(self)

    def _repr_html_(self) -> str:
        from .display import result_html

        return result_html(self)

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, Any]:
        from .display import result_bundle

        return result_bundle(self)

    def names(self, name: str) -> np.ndarray:
        """Return a column in which the values of an enumeration are the names of its items."""
        column, items = self[name], self.enumerations.get(name)
        if items is None:
            return column
        named = np.array([items.get(number, number) for number in column.tolist()], object)
        is_masked = np.ma.isMaskedArray(column)
        return np.ma.MaskedArray(named, np.ma.getmaskarray(column)) if is_masked else named

    @property
    def set_points(self) -> dict[str, str]:
        """For each signal that follows a recorded set-point, the name of that set-point.

        A set-point has the name of one, such as `r`, `setpoint` or `speed_ref`. Which signal
        follows it is found by the connections, the names and the units.
        """
        if self._set_points is None:
            columns = [(n, self.units.get(n, ""), c.dtype.kind == "f") for n, c in self.items()]
            self._set_points = _native.set_points(columns[1:])
        return self._set_points

    @property
    def summary(self) -> Summary:
        """Minimum, maximum, RMS and last value of each column of numbers, and the alarms."""
        statistics = self._summary
        if statistics is None:
            statistics = statistics_of(dict(list(self.items())[1:]))
        return Summary(statistics, self.units, self.alarms, self.ended)

    def write(self, filename: str | os.PathLike[str]) -> None:
        """Write the columns to a file, CSV or Parquet by its name, which `read` reads.

        The file is the same as the one of `cargo fmu simulate --csv`: names with units in brackets,
        the types of the variables, and enumerations by their names (CSV) or with them (Parquet). It
        replaces an existing file when it is complete.

        Raises
        ------
        FmuError
            The name does not end in .csv or .parquet, or the file cannot be written.
        """
        table, about = [], []
        for name, column in self.items():
            kind, values = _kind(column), column.tolist()
            if items := self.enumerations.get(name, {}):
                numbers = {item: number for number, item in items.items()}
                kind, values = "Enumeration", [numbers.get(value, value) for value in values]
            elif name in self._incomplete:
                values = [None if value != value else value for value in values]
            table.append((name, self.units.get(name, ""), values))
            about.append((kind, items, np.ma.isMaskedArray(column)))
        _native.write(Path(filename), table, about)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame of pandas whose index is the first column, such as the time [s].

        `to_pandas().reset_index()` has it as its first column. The units are in `attrs["units"]`.
        """
        import pandas

        frame = pandas.DataFrame(self._columns).set_index(next(iter(self)))
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_polars(self) -> polars.DataFrame:
        """Return a data frame of Polars, whose first column is the time [s]."""
        import polars

        frame = polars.DataFrame({n: np.ma.getdata(column) for n, column in self.items()})
        absent = {n: np.ma.getmaskarray(c) for n, c in self.items() if np.ma.isMaskedArray(c)}
        columns = [polars.when(~polars.Series(mask)).then(n).alias(n) for n, mask in absent.items()]
        return frame.with_columns(columns)

    def plot(
        self,
        names: Sequence[str | Sequence[str]] | None = None,
        *,
        over: Mapping[str, Result] | Sequence[Result] | Result | None = None,
        label: str = "this run",
    ) -> Figure:
        """Draw signals over the time [s], by default all: a picture each, with its set-point.

        The table of a sweep is drawn as metrics over the runs and over each parameter that varies.
        A picture of more than 4000 rows shows the smallest and largest value of each of 1000 parts.

        Parameters
        ----------
        names
            The signals, of arrays all elements; those of a tuple share a picture. Of a sweep, the
            metrics, by default "iae".
        over
            Other results to draw into the same pictures, by the names of their runs, such as
            `{"kp = 0.5": other}`.
        label
            The name of this run, if it is compared.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, which a notebook shows as the value of a cell. A program saves it by its
            `savefig`.
        """
        from .plots import draw

        return draw(self, names, over, label)


def read(filename: str | os.PathLike[str]) -> Result:
    """Read results from a file, CSV or Parquet.

    Values that are missing are masked, and in the table of a sweep NaN for numbers.

    Raises
    ------
    FmuError
        The file cannot be read, or has no table.
    """
    result = Result(())
    for name, unit, items, kind, data in _native.read(Path(filename)):
        result.units[name] = unit
        if kind:
            result._columns[name] = _array(kind, data)
        elif "time" in result and None in data:
            result._columns[name] = _with_absent(data)
        else:
            result._columns[name] = _column(name, data)
        if items:
            result.enumerations[name] = items
        if not kind and result._columns[name].dtype.kind == "f":
            result._incomplete.add(name)
    return result


def _column(name: str, cells: Sequence[Any]) -> np.ndarray:
    # Of the columns that may have no values, only that of the failures has texts.
    if any(isinstance(cell, str | bytes) for cell in cells) or name == "failure":
        column = np.empty(len(cells), object)
        column[:] = cells
        return column
    return array([np.nan if cell is None else cell for cell in cells])


def _with_absent(cells: Sequence[Any]) -> np.ndarray:
    """Return the masked array of a column of a run in which values are missing."""
    mask = [cell is None for cell in cells]
    known = array([cell for cell in cells if cell is not None])
    found = np.zeros(len(cells), known.dtype)
    found[~np.array(mask)] = known
    return np.ma.MaskedArray(found, mask)


def _kind(column: np.ndarray) -> str:
    """Return the type of FMI of the values of a column."""
    kinds = {"b": "Boolean", "i": "Int", "u": "UInt", "f": "Float", "U": "String", "S": "Binary"}
    kind = kinds.get(column.dtype.kind, "")
    if kind in ("Int", "UInt", "Float"):
        return f"{kind}{min(max(8 * column.itemsize, 32 * (kind == 'Float')), 64)}"
    if kind:
        return kind
    values = [value for value in column.tolist() if value is not None]
    for of_type, kind in ((bytes, "Binary"), (bool, "Boolean"), (int, "Int64"), (float, "Float64")):
        if values and all(isinstance(value, of_type) for value in values):
            is_large = kind == "Int64" and max(values) >= 2**63
            return "UInt64" if is_large else kind
    return "String"


def _is_equal(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether columns have the same values; NaN equals NaN."""
    if len(a) != len(b):
        return False
    if object in (a.dtype, b.dtype) or np.ma.isMaskedArray(a) or np.ma.isMaskedArray(b):
        pairs = zip(a.tolist(), b.tolist(), strict=True)
        return all(x == y or (x != x and y != y) for x, y in pairs)
    return bool(np.all((a == b) | ((a != a) & (b != b))))


def _array(kind: str, data: Any, absent: Any = None) -> np.ndarray:
    """Return the array of a column of a type of FMI; numbers are not copied.

    It is masked if the values may be absent, which `absent` tells of each.
    """
    if kind in ("String", "Binary"):
        array = np.empty(len(data), object)
        array[:] = data
    else:
        names = {"Boolean": "bool", "Clock": "bool", "Enumeration": "int64"}
        array = np.frombuffer(data, names.get(kind, kind.lower()))
    return array if absent is None else np.ma.MaskedArray(array, np.frombuffer(absent, bool))
