"""Runs of FMUs and of systems of them."""

from __future__ import annotations

import contextlib
import copy
import os
import threading
import tomllib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from . import _keys, _native
from ._command import COMMAND
from ._inputs import Given, inputs
from ._names import suggests
from ._values import document, one_or_more, plain_starts
from .components import PythonComponent
from .progress import bar
from .result import FmuError, Messages, Result

Input = Any
"""Inputs: a file (CSV or Parquet), a `Result`, a structured array, a data frame, or a mapping from
names to values: a constant such as `1.0`, a function of the time [s], or an array with a value for
each time of the column "time" [s]. Values of an array variable have its shape, over time with a row
for each time. Values of an enumeration are names of items, those of a Binary are `bytes`."""


class System:
    """FMUs and their connections. Paths are relative to the file, or to the current folder.

    Parameters
    ----------
    description
        A system file (TOML), a package or system of SSP (`.ssp`, `.ssd`), an FMU, or a dict with
        the keys of a system file.
    **keys
        The same keys as keyword arguments. `components` maps names to files, or to dicts with the
        keys `fmu`, `start`, `parameters` (the name of a parameter set of the FMU, or a file),
        `interface`, `step`, `inputs`, `event_mode`, `sampled`, `tolerance` and `solver`, or to a
        `python_component`; `connections` has pairs (output, input), texts "component.output ->
        component.input" or dicts; `start`, `stop`, `step` and `output_step` are in s; `order` is
        "sequential", "parallel" or "implicit", `solver` "explicit" or "implicit".

    Examples
    --------
    >>> loop = System(
    ...     components={"controller": "target/fmu/Pid.fmu", "plant": "target/fmu/Pendulum.fmu"},
    ...     connections=[("plant.theta", "controller.y"), ("controller.u", "plant.u")],
    ...     step=0.001,
    ...     stop=2.0,
    ... )
    >>> result = loop.simulate(start_values={"plant.theta0": 0.1})
    """

    def __init__(
        self, description: Mapping[str, Any] | str | os.PathLike[str] | None = None, /, **keys: Any
    ):
        self._describe(description, keys)

    def _describe(self, description: Any, keys: dict[str, Any]) -> None:
        """Take the file of a system, or its keys, or both."""
        self.file: Path = Path("system.toml").absolute()
        self.description: dict[str, Any] | None = None
        self._runners: dict[bool, _native.Runner] | None = None
        self._turn: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
        if not isinstance(description or keys or None, Mapping | str | os.PathLike):
            given, expected = _keys.shown(description), "the file of a system, or its keys"
            hint = ", such as `components`; a `System` runs by its own `simulate`"
            hint = hint if isinstance(description, System) else ""
            raise TypeError(f"{given}, expected {expected}{hint}")
        if isinstance(description, str | os.PathLike):
            self.file = Path(description).absolute()
            if keys:
                description = self.keys()
        if description is None or isinstance(description, Mapping):
            self.description = _keys.system_keys({**(description or {}), **keys}, self.file.parent)

    def __repr__(self) -> str:
        from .display import system_line

        return system_line(self)

    def __str__(self) -> str:
        from .display import system_text

        return system_text(self)

    def _repr_html_(self) -> str:
        from .display import system_html

        return system_html(self)

    @property
    def toml(self) -> str:
        """The text of the system file; a system with a component in Python has none."""
        if functions := self._functions():
            name, _ = functions[0]
            raise FmuError(f"{name} is a function of Python, expected an FMU in a system file")
        return self._text()

    def keys(self) -> dict[str, Any]:
        """Return the keys of the system file, whose paths are relative to its folder."""
        return tomllib.loads(self._text()) if self.description is None else self.description

    def changed(self, **keys: Any) -> Self:
        """Return the system with other values of its keys, such as `connections`."""
        changed = copy.copy(self)
        changed._describe(self.file if self.description is None else self.description, keys)
        return changed

    def _functions(self) -> list[tuple[str, PythonComponent]]:
        """Return the components in Python and their names."""
        tables = (self.description or {}).get("component", ())
        pairs = [(table["name"], table.get("fmu")) for table in tables]
        return [(name, part) for name, part in pairs if isinstance(part, PythonComponent)]

    def _text(self, defaults: Mapping[str, Any] = MappingProxyType({})) -> str:
        """Return the text of a system file, in which functions have no file."""
        if self.description is None:
            if self.file.suffix != ".toml":
                raise FmuError(f"{self.file} has no keys, expected a system file (.toml) or a dict")
            return self.file.read_text(encoding="utf-8")
        named = {name: "Python" for name, _ in self._functions()}
        tables = self.description["component"]
        tables = [
            {**table, "fmu": named[table["name"]]} if table["name"] in named else table
            for table in tables
        ]
        description = {k: v for k, v in self.description.items() if v is not None}
        return document({**defaults, **description, "component": tables}, "component")

    def times(self) -> tuple[float, float, float]:
        """Return the start time, the stop time and the communication step [s]."""
        return self._check({})

    def _check(self, start_values: Mapping[str, Any], **changes: Any) -> tuple[float, float, float]:
        """Raise what a run would before its first step; return the times."""
        changes["outputs"] = one_or_more(changes.get("outputs") or ())
        return _native.times(self._source(changes, start_values))

    def _points(self, changes: Mapping[str, Any] | None = None) -> np.ndarray:
        """Return the communication points [s], and the one after the stop time."""
        return np.frombuffer(_native.points(self._source(changes)))

    def _bounds(self, names: Sequence[str]) -> list[tuple[float | None, float | None]]:
        """Return the smallest and the largest value of variables, or None where there is none."""
        return _native.bounds(self._source({"outputs": names}))

    def _source(
        self,
        changes: Mapping[str, Any] | None = None,
        start_values: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Return what the native module needs of the system."""
        text = None
        if self.description is not None:
            # What a run replaces may be missing.
            given = {key: (changes or {}).get(key) for key in ("stop", "step")}
            for key, value in given.items():
                if value is None and self.description.get(key) is None:
                    name = {"stop": "stop time", "step": "communication step"}[key]
                    raise FmuError(f"missing field `{key}`, expected the {name} in s, as {key}=0.1")
            text = self._text(given)
        functions = [(name, function.signature()) for name, function in self._functions()]
        source = {"file": self.file, "text": text, "functions": functions}
        return {**source, **(changes or {}), "starts": plain_starts(start_values)}

    @contextlib.contextmanager
    def loaded(self) -> Iterator[Self]:
        """Yield this system for many runs, between which processes and FMUs stay loaded.

        A run with other start values then takes little more than its steps. Several threads may run
        it at the same time; with components in Python, they take turns. An FMU that keeps global
        state after it is freed carries it into the next run. After a failed run, the FMUs are
        loaded again.

        Examples
        --------
        >>> with System("examples/closed-loop/pid.toml").loaded() as loop:
        ...     runs = [loop.simulate({"controller.pid.kp": kp}) for kp in (200.0, 300.0)]
        """
        system = copy.copy(self)
        if self._functions():
            system._turn = threading.RLock()
        system._runners = {is_here: _runner(is_here, True) for is_here in (False, True)}
        try:
            yield system
        finally:
            for runner in system._runners.values():
                runner.free()

    def pack(
        self,
        out: str | os.PathLike[str],
        *,
        fmi: str = "2.0",
        targets: Sequence[str] = (),
        binaries: Mapping[str, str | os.PathLike[str]] = MappingProxyType({}),
    ) -> list[str]:
        """Write the system as one FMU, a container with the master inside, and return notes.

        Notes say what is missing, and what hosts of the FMU cannot do. The master is built by
        cargo once, which needs a Rust toolchain, unless `binaries` has libraries of the crate
        `fmu-container` that were built elsewhere.

        Parameters
        ----------
        out
            The FMU.
        fmi
            Version of FMI, "2.0" or "3.0".
        targets
            Rust targets to build the master for; by default, this machine.
        binaries
            Libraries by their platforms, such as `{"linux64": "libfmu_container.so"}`.

        Raises
        ------
        FmuError
            The system is invalid or cannot be packed, or a build fails.
        """
        given = [f"{platform}={os.fspath(file)}" for platform, file in binaries.items()]
        text = self.toml if self.description is not None else None
        return _native.pack(self.file, text, Path(out), fmi, list(targets), given)

    @suggests
    def simulate(
        self,
        start_values: Mapping[str, Any] | None = None,
        *,
        start_time: float | None = None,
        stop_time: float | None = None,
        step_size: float | None = None,
        output_step: float | None = None,
        input: Input | None = None,
        output: Sequence[str] | None = None,
        order: str | None = None,
        algebraic_loops: str | None = None,
        loop_tolerance: float | None = None,
        loop_iterations: int | None = None,
        parameters: str | os.PathLike[str] | None = None,
        experiment: str | None = None,
        step_tolerance: float | None = None,
        min_step: float | None = None,
        tolerance: float | None = None,
        solver: str | None = None,
        interface: str | None = None,
        event_mode: bool | None = None,
        save_state: str | os.PathLike[str] | None = None,
        load_state: str | os.PathLike[str] | None = None,
        compile: bool = False,
        real_time: float | None = None,
        threads: int | None = None,
        trace: str | os.PathLike[str] | None = None,
        profile: bool = False,
        in_process: bool = False,
        progress: bool = False,
        debug_logging: bool = False,
    ) -> Result:
        """Run the system; the arguments replace keys of the description.

        Parameters
        ----------
        start_values
            Start values by `component.variable`; enumerations by the names of their items.
        order
            "sequential", "parallel" or "implicit".
        algebraic_loops
            How algebraic loops are handled: "refuse", "delay" or "iterate".
        loop_tolerance, loop_iterations
            The relative tolerance of iterated loops, and the largest number of iterations.
        step_tolerance, min_step
            Divide each step so that its relative error is at most the tolerance, but not into steps
            smaller than `min_step` [s]; the result then has `adaptive_steps`.
        start_time, stop_time, step_size, output_step, input, output
            As for `simulate`.
        tolerance, solver, interface, event_mode, compile
            As for `simulate`, for all components.
        parameters, experiment
            As for `simulate`, if the system is an FMU; a component has the key `parameters`.
        save_state, load_state, real_time, trace, profile, in_process, progress, debug_logging
            As for `simulate`.

        Raises
        ------
        FmuError
            As for `simulate`.
        """
        _keys.check({"output": output}, {"output": _keys.TEXTS})
        named = {"parameters": parameters, "experiment": experiment}
        _keys.check(named, {"parameters": _keys.SET, "experiment": _keys.TEXT})
        flags = {"compile": compile, "in_process": in_process, "debug_logging": debug_logging}
        flags["profile"] = profile
        _keys.check(flags, dict.fromkeys(flags, _keys.FLAG))
        _keys.check({"threads": threads}, {"threads": _keys.COUNT})
        _keys.check({"trace": trace}, {"trace": _keys.FILE})
        adaptive = {"step_tolerance": step_tolerance, "min_step": min_step}
        _keys.check(adaptive, _keys.ADAPTIVE)
        loops = {
            "algebraic_loops": algebraic_loops,
            "loop_tolerance": loop_tolerance,
            "loop_iterations": loop_iterations,
        }
        _keys.check(loops, _keys.LOOPS)
        changes: dict[str, Any] = {
            "start": start_time,
            "stop": stop_time,
            "step": step_size,
            "output_step": output_step,
            "order": order,
            **loops,
            "parameters": None if parameters is None else os.fspath(parameters),
            "experiment": experiment,
            **adaptive,
            "tolerance": tolerance,
            "solver": solver,
            "outputs": one_or_more(output or ()),
            "interface": interface,
            "event_mode": event_mode,
            "compile": compile,
            "real_time": real_time,
            "threads": threads,
            "profile": profile,
            "trace": None if trace is None else Path(trace).absolute(),
        }
        states = {"save_state": save_state, "load_state": load_state}
        changes |= {k: Path(file).absolute() for k, file in states.items() if file is not None}
        if load_state is not None and start_time is not None:
            raise FmuError(f"start_time = {start_time}, but the state has a time; give only one")
        runner = self._runners[in_process] if self._runners else _runner(in_process, False)
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._turn)
            if input is not None:
                changes["input"] = self._input(input, changes)
            shown = stack.enter_context(bar(progress))
            functions = [function for _, function in self._functions()]
            for function in functions:
                function.begin()
            source = self._source(changes, start_values)
            done = runner.run(source, [function.step for function in functions], shown)
        for text in done["warnings"]:
            warnings.warn(text, stacklevel=3)
        error, raised = done.pop("error", None), done.pop("raised")
        result = Result(**done)
        if not debug_logging:
            told = (m for m in result.messages if m.warning or m.category != "logEvents")
            result.messages = Messages(told)
        if error is not None:
            text, component, function, time = error
            raise FmuError(text, component, function, time, result) from raised
        return result

    def _input(self, given: Input, changes: Mapping[str, Any]) -> str | Given:
        """Return the file of inputs, or their values."""
        if isinstance(given, str | os.PathLike):
            return str(Path(given).absolute())
        units = given.units if isinstance(given, Result) else {}
        return inputs(given, units, lambda: self._points(changes).tolist())


@suggests
def simulate(
    filename: str | os.PathLike[str],
    start_time: float | None = None,
    stop_time: float | None = None,
    step_size: float | None = None,
    start_values: Mapping[str, Any] | None = None,
    input: Input | None = None,
    output: Sequence[str] | None = None,
    *,
    output_step: float | None = None,
    parameters: str | os.PathLike[str] | None = None,
    experiment: str | None = None,
    tolerance: float | None = None,
    solver: str | None = None,
    interface: str | None = None,
    event_mode: bool | None = None,
    save_state: str | os.PathLike[str] | None = None,
    load_state: str | os.PathLike[str] | None = None,
    compile: bool = False,
    real_time: float | None = None,
    threads: int | None = None,
    trace: str | os.PathLike[str] | None = None,
    profile: bool = False,
    in_process: bool = False,
    progress: bool = False,
    debug_logging: bool = False,
) -> Result:
    """Run an FMU, a system file or an SSP package, as `fmpy.simulate_fmu` does.

    Parameters
    ----------
    filename
        The FMU, system file (TOML) or SSP package.
    start_time, stop_time, step_size
        Start time, stop time and communication step [s], by default from the default experiment.
    start_values
        Start values by name, in the units of the variables; enumerations by the names of items.
    input
        Inputs over time; see `Input`.
    output
        Names of variables to record, by default all outputs that are numbers.
    output_step
        Time between two rows [s], a multiple of the communication step, which it is by default.
    parameters
        Name of a parameter set that the FMU has, or a file with one (`.ssv`), whose values
        `start_values` replace.
    experiment
        Name of an experiment that the FMU has, which gives times, tolerance, parameters and inputs,
        unless other arguments do.
    tolerance
        Relative tolerance.
    solver
        How equations are integrated in model exchange: "explicit", which is the default, or
        "implicit" if they are stiff.
    interface
        "co-simulation", "model-exchange" or "scheduled-execution", by default the first of them
        that the FMU supports.
    event_mode
        Handle the events of an FMU for FMI 3.0 in event mode, by default if it has clocks.
    save_state
        File to which the state of the run is saved at the stop time, for a run that continues it.
    load_state
        File with a saved state of the same FMU or system. The run begins from it, at its time, and
        has the rows that the first run would have had. Of start values, only those of inputs and
        tunable parameters may differ.
    compile
        Compile FMUs that have C or C++ sources, but no binary for this machine.
    real_time
        Pace the steps by the clock: 1.0 is real time, 2.0 twice as fast. An `input` that is a pipe
        (FIFO) then gives its rows while the run goes.
    threads
        Number of threads in which components of a system step at the same time, where the order
        allows it; the results are the same.
    trace
        Record each call of the FMUs in this file, as JSON Lines, which `cargo fmu replay` repeats.
    profile
        Measure the time of each function of each component, for `Result.profile`.
    in_process
        Run in this process, which saves some milliseconds, but an FMU that crashes ends Python.
    progress
        Show a progress bar with the simulated time, the speed and the time that is left.
    debug_logging
        Keep the messages about changes of the state of FMUs (category "logEvents"), too.

    Raises
    ------
    FmuError
        An argument is invalid, or the FMU fails or ends its process; its `result` has the rows so
        far.

    Examples
    --------
    >>> result = simulate("target/fmu/Pendulum.fmu", stop_time=1.0, start_values={"theta0": 0.1})
    >>> theta = result["theta"]  # [rad]
    """
    if isinstance(start_time, Mapping):
        raise TypeError(f"start_time = {start_time}, expected a number; did you mean start_values?")
    return System(filename).simulate(
        start_values,
        start_time=start_time,
        stop_time=stop_time,
        step_size=step_size,
        input=input,
        output=output,
        output_step=output_step,
        parameters=parameters,
        experiment=experiment,
        tolerance=tolerance,
        solver=solver,
        interface=interface,
        event_mode=event_mode,
        save_state=save_state,
        load_state=load_state,
        compile=compile,
        real_time=real_time,
        threads=threads,
        trace=trace,
        profile=profile,
        in_process=in_process,
        progress=progress,
        debug_logging=debug_logging,
    )


def _runner(in_process: bool, keeps: bool) -> _native.Runner:
    return _native.Runner([] if in_process else COMMAND, keeps)


def is_fmu(file: str | os.PathLike[str]) -> bool:
    """Return whether a file is an FMU, by its name."""
    return os.fspath(file).lower().endswith(".fmu")
