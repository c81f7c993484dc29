"""Sweeps: many runs of a system with different start values, on all cores or by Dask."""

from __future__ import annotations

import contextlib
import os
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _native
from ._command import COMMAND
from ._keys import TABLE, WHOLE, check, check_sweep, is_number, sweep_keys
from ._values import document, one_or_more
from .progress import bar
from .result import FmuError, Result, read
from .system import System

if TYPE_CHECKING:
    from distributed import Client

    from .components import PythonComponent


class Sweep:
    """A sweep that is ready to run.

    Parameters
    ----------
    plan
        A sweep file, a dict with its keys, or a mapping or data frame that has an array for each
        `component.variable`, with a start value for each run.
    system
        A `System` or a description of one; a sweep file names its own. Each run has its own copy of
        components in Python, whose exceptions are its `failure`.
    out
        The table to write, `.csv` or `.parquet`. An interrupted sweep resumes if it has a table,
        unless it has components in Python.
    signals
        The variables from which the metrics are computed: `reference`, `output`, `error` and
        `control`; they replace those of the plan.
    **keys
        Other keys of a sweep file, such as `stop` [s], `seed` or `metrics`, which replace those of
        the plan.
    """

    def __init__(
        self,
        plan: Any,
        system: Any = None,
        out: str | os.PathLike[str] | None = None,
        *,
        signals: Mapping[str, str] | None = None,
        **keys: Any,
    ):
        check({"out": out}, {"out": TABLE})
        self.out = None if out is None else Path(out).absolute()
        self.file: Path | None = None
        self.plan: dict[str, Any] = {}
        if signals is not None:
            keys["signals"] = signals
        if not isinstance(plan, str | os.PathLike):
            self.plan = sweep_keys(plan) | keys
        elif keys:
            self.plan = _opened(Path(plan)) | keys
        else:
            self.file = Path(plan).absolute()
        if system is None and "system" in self.plan:
            system = self.plan.pop("system")
        if self.file is None:
            if system is None:
                example = 'sweep(plan, system="loop.toml", signals={...})'
                expected = f"a `System`, its file or its keys, as in {example}"
                raise TypeError(f"the argument system is missing, expected {expected}")
            check_sweep(self.plan)
        self.system = system if system is None or isinstance(system, System) else System(system)

    def __repr__(self) -> str:
        from .display import listed

        if self.file is not None:
            return f"<Sweep: {self.file.name}>"
        tables = [table for table in self.plan.get("parameter", ()) if isinstance(table, Mapping)]
        names = [n for t in tables for n in one_or_more(t.get("variables", t.get("variable", ())))]
        return listed("<Sweep: ", names, ">")

    @contextlib.contextmanager
    def files(self) -> Iterator[list[str]]:
        """Write the files to a temporary folder; yield the arguments that name them."""
        with tempfile.TemporaryDirectory(prefix="fmu-master-") as folder:
            file, system = self.file, []
            if self.system is not None:
                path = self.system.file
                if self.system.description is not None:
                    path = Path(folder, "system.toml")
                    path.write_text(self.system.toml, encoding="utf-8")
                system = ["--system", str(path)]
            if file is None:
                file = Path(folder, "sweep.toml")
                file.write_text(self._text(), encoding="utf-8")
            yield [str(file), *system]

    @contextlib.contextmanager
    def table(self) -> Iterator[Path]:
        """Yield the table to write, a temporary one if none is given."""
        if self.out is not None:
            yield self.out
            return
        with tempfile.TemporaryDirectory(prefix="fmu-master-") as folder:
            yield Path(folder, "out.csv")

    def _error(self, text: str, out: Path) -> FmuError:
        """Return an error, with the table if all runs failed and it is kept nowhere else."""
        return FmuError(text, result=read(out) if self.out is None and out.exists() else None)

    def run(self, processes: int = 0, *, progress: bool = False) -> Result:
        """Run the sweep in worker processes, by default one for each core; return the table."""
        if is_number(processes) and processes < 0:
            raise ValueError(f"processes = {processes}, expected at least 0")
        check({"processes": processes}, {"processes": WHOLE})
        system, functions = None, []
        if self.system is not None:
            is_file = self.system.description is None
            system = (self.system.file, None if is_file else self.system._text())
            functions = self.system._functions()
        are_apart = [self._runs_apart(name, function) for name, function in functions]
        processes = processes if all(are_apart) else 1
        signatures = [(name, function.signature()) for name, function in functions]

        def begin() -> list[Callable[..., Any]]:
            pairs = zip(functions, are_apart, strict=True)
            return [function._begin_run(is_apart) for (_, function), is_apart in pairs]

        source = (Path("sweep.toml"), self._text()) if self.file is None else (self.file, None)
        with self.table() as out:
            with bar(progress) as shown:
                parts, workers = (signatures, begin), (processes, COMMAND)
                done = _native.sweep(source, system, parts, out, workers, shown)
            texts, failure = done
            for text in texts:
                warnings.warn(text, stacklevel=2)
            if failure is not None:
                raise self._error(failure, out)
            return read(out)

    @staticmethod
    def _runs_apart(name: str, function: PythonComponent) -> bool:
        """Return whether runs of a component may be at the same time."""
        try:
            return function._can_run_apart()
        except TypeError as error:
            raise FmuError(f"{name}: {error}") from error

    def _text(self) -> str:
        """Return the text of a sweep file."""
        # The program reads the key, but uses the system that it is given.
        return document({"system": "system.toml"} | self.plan, "parameter")

    def dask(self, client: Client) -> Result:
        """Run the sweep on the workers of a Dask cluster, which do not need this package.

        They must have the platform of this machine and Python 3.11 or newer.
        """
        from ._dask import distribute

        if self.system is not None and (functions := self.system._functions()):
            name = functions[0][0]
            raise FmuError(f"{name} is a function of Python, expected `run`, as Dask has only FMUs")
        with self.files() as arguments, self.table() as out:
            arguments = [*arguments, "--out", str(out)]
            code, _, errors = distribute(arguments, lambda: contextlib.nullcontext(client))
            if code:
                raise self._error(errors.strip().removeprefix("error: "), out)
            return read(out)


def sweep(
    plan: Any,
    system: Any = None,
    out: str | os.PathLike[str] | None = None,
    *,
    signals: Mapping[str, str] | None = None,
    processes: int = 0,
    progress: bool = False,
    **keys: Any,
) -> Result:
    """Run a system many times, on all cores; see `Sweep`.

    Returns columns by name, one row for each run: its index, parameters and metrics, and why it
    failed. A run that fails or crashes does not end the sweep.

    Parameters
    ----------
    plan, system, out, signals, **keys
        As for `Sweep`.
    processes
        The number of worker processes, by default one for each core.
    progress
        Show a progress bar with the runs that are done and that have failed.

    Raises
    ------
    FmuError
        The plan or the system does not fit, the table belongs to another sweep, or all runs failed.

    Examples
    --------
    >>> runs = sweep(
    ...     {"controller.pid.kp": [200.0, 300.0, 400.0]},
    ...     system="examples/closed-loop/pid.toml",
    ...     signals={
    ...         "reference": "source.r",
    ...         "output": "plant.theta",
    ...         "error": "controller.e",
    ...         "control": "controller.u",
    ...     },
    ... )
    >>> best = runs["controller.pid.kp"][runs["iae"].argmin()]
    """
    return Sweep(plan, system, out, signals=signals, **keys).run(processes, progress=progress)


def _opened(file: Path) -> dict[str, Any]:
    """Return the keys of a sweep file, with the system relative to the current folder."""
    plan = tomllib.loads(file.read_text(encoding="utf-8"))
    return plan | ({"system": file.parent / plan["system"]} if "system" in plan else {})
