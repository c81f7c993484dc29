"""One FMU, stepped by hand."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from . import _native
from ._command import COMMAND
from ._names import suggests
from ._values import plain_starts
from .result import FmuError


class Variable(NamedTuple):
    """A variable of an FMU, with its attributes in FMI."""

    name: str
    causality: str
    variability: str
    type: str
    """The type of FMI 3.0, such as "Float64"."""
    unit: str
    start: Any
    """Its start value, a list of them for an array, or None."""
    description: str
    dimensions: tuple[int, ...]
    min: Any
    """Its smallest value, or None."""
    max: Any


class State:
    """A saved state of an instance; see `Instance.save`."""

    def __init__(self, instance: Instance, number: int, time: float):
        self._instance, self._number = instance, number
        self.time: float = time
        """The time of the state [s]."""

    def __repr__(self) -> str:
        return f"<State: t = {self.time:g} s>"

    def __del__(self) -> None:
        self._instance._forget(self._number)


class Instance(_native.Instance):
    """An instance of an FMU that is stepped by hand.

    The instance is initialized on first use. As a context manager it is freed at the end. Values
    are in the units of the variables.

    Parameters
    ----------
    filename
        The FMU.
    interface
        "co-simulation" or "model-exchange"; by default the first of them that the FMU supports. By
        model exchange, `step` integrates the equations and handles events, also one at its end.
    start_values
        Start values by name.
    start_time
        The start time [s].
    tolerance
        Relative tolerance of the integration.
    solver
        How equations are integrated in model exchange: "explicit", which is the default, or
        "implicit" if they are stiff.
    name
        Its name in errors, by default the name of the file.
    compile
        Compile the FMU if it has C or C++ sources, but no binary for this machine.
    trace
        Record each call of the FMU in this file, as JSON Lines, which `cargo fmu replay` repeats.
    in_process
        Run in this process, which adds some tenths of a microsecond to each step, but a crash ends
        Python. By default, the FMU runs in a child process: a step takes some microseconds more,
        and a crash is an `FmuError`.

    Raises
    ------
    FmuError
        Here and in all methods: the FMU cannot be used, fails or ends its process, or a name or
        value does not fit.

    Examples
    --------
    >>> with Instance("target/fmu/Pendulum.fmu", start_values={"theta0": 0.1}) as plant:
    ...     plant.set("u", 1.0)
    ...     plant.step(0.001)
    ...     theta = plant.get("theta")  # [rad]
    """

    @suggests
    def __init__(
        self,
        filename: str | os.PathLike[str],
        interface: str | None = None,
        start_values: Mapping[str, Any] | None = None,
        start_time: float = 0.0,
        *,
        tolerance: float | None = None,
        solver: str | None = None,
        name: str | None = None,
        compile: bool = False,
        trace: str | os.PathLike[str] | None = None,
        in_process: bool = False,
    ):
        setup: dict[str, Any] = {
            "name": name,
            "interface": interface,
            "start": start_time,
            "tolerance": tolerance,
            "solver": solver,
            "compile": compile,
            "trace": None if trace is None else Path(trace).absolute(),
        }
        setup |= {"file": Path(filename).absolute(), "sizes": plain_starts(start_values)}
        self.name: str = name or Path(filename).stem
        """Its name in errors."""
        self._open(setup, start_values, [] if in_process else COMMAND)

    def __repr__(self) -> str:
        from .display import instance_about

        return f"<{type(self).__name__}: {instance_about(self, self._starts() is None)}>"

    def _repr_html_(self) -> str:
        from .display import instance_html

        return instance_html(self, self._starts())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()

    @cached_property
    def variables(self) -> dict[str, Variable]:
        """The variables of the FMU by name."""
        variables = {}
        for *words, start, description, dimensions, low, high in self._variables():
            value = start if dimensions else next(iter(start), None)
            rest = [value, description, tuple(dimensions), low, high]
            variables[words[0]] = Variable._make([*words, *rest])
        return variables

    def initialize(self) -> None:
        """Initialize the FMU with the start values, unless it is initialized."""
        self._initialize()

    def get_list(self, names: Iterable[str]) -> list[Any]:
        """Return the values of variables, in their types."""
        return self._get_list(names)

    def reset(self, start_values: Mapping[str, Any] | None = None) -> None:
        """Return to the time before the initialization, without loading the FMU again.

        The next use initializes the FMU at its start time. All start values stay, those of the
        constructor and those of `set` before the initialization; `start_values` replace the ones
        with the same names. What was `set` after the initialization is gone. Saved states can still
        be restored, which takes the place of an initialization.
        """
        self._reset(start_values)

    def save(self) -> State:
        """Save the state of the FMU, which can be restored any number of times."""
        return State(self, self._save(), self.time)

    def restore(self, state: State) -> None:
        """Return to a saved state of this instance, and to its time."""
        if state._instance is not self:
            raise FmuError("the state is of another instance, expected one of this instance")
        self._restore(state._number)

    @property
    def continuous_states(self) -> np.ndarray:
        """The continuous states, by model exchange; they can be assigned."""
        return self._states()

    @continuous_states.setter
    def continuous_states(self, states: Sequence[float]) -> None:
        self._set_states([float(state) for state in states])

    def derivatives(self) -> np.ndarray:
        """Return the derivatives of the continuous states, by model exchange."""
        return self._derivatives()

    def directional_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> np.ndarray:
        """Return the directional derivative: the Jacobian of the unknowns times the seed."""
        return self._directional(unknowns, knowns, [float(s) for s in seed])
