"""Components of a system that are functions of Python."""

from __future__ import annotations

import contextlib
import copy
import dis
import inspect
import pickle
import types
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ._names import suggests
from ._values import one_or_more


@dataclass(frozen=True, repr=False)
class PythonComponent:
    """A component of a system that is a function of Python; see `python_component`."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    step: Callable[..., Any]
    sample_time: float | None
    units: Mapping[str, str]
    types: Mapping[str, str]
    reset: Callable[[], object] | None
    _before: list[dict[str, Any]] = field(default_factory=list, repr=False, compare=False)
    """The state before the first run, and before the second one."""

    def __repr__(self) -> str:
        from .display import component_line

        return component_line(self)

    def begin(self) -> None:
        """Prepare a run: reset the function, or warn of a state that the first run has left."""
        if self.reset is not None:
            self.reset()
        elif len(self._before) < 2:
            self._before.append(_state(self.step))
            first, last = self._before[0], self._before[-1]
            changed = [name for name in last if last[name] != first.get(name)]
            if changed:
                text = f"the run before has changed {', '.join(changed)} of {_owner(self.step)!r}"
                expected = "expected `reset` in `python_component`, which begins each run anew"
                warnings.warn(f"{text}, {expected}", stacklevel=4)

    def _begin_run(self, is_apart: bool) -> Callable[..., Any]:
        """Prepare a run of a sweep; return the function, with a state of its own if `is_apart`."""
        if self.reset is not None:
            self.reset()
        return _copied(self.step, {}) if is_apart else self.step

    def _can_run_apart(self) -> bool:
        """Return whether several runs at the same time can have a state of their own.

        Raises
        ------
        TypeError
            They cannot, and there is no `reset` with which each run could begin after the last one.
        """
        try:
            is_apart = _copied(self.step, {}) is not self.step
            reason = ""
        except Exception as error:  # whatever the object raises
            is_apart, reason = False, f"cannot be copied ({type(error).__name__}: {error})"
        if not is_apart and not reason and _changes_globals(self.step):
            reason = "changes global variables"
        if reason and self.reset is None:
            expected = (
                "expected `reset` in `python_component`, with which one run follows the other"
            )
            raise TypeError(f"the function {reason}, {expected}")
        # A function that is reset has a state, though nobody knows where.
        return is_apart or self.reset is None

    def signature(self) -> dict[str, Any]:
        """Return what the native module needs of it."""

        def argument(name: str) -> tuple[str, str, str]:
            return name, self.types.get(name, "Float64"), self.units.get(name, "")

        variables = {"inputs": self.inputs, "outputs": self.outputs}
        arguments = {key: [argument(name) for name in names] for key, names in variables.items()}
        return {"sample_time": self.sample_time} | arguments


def _owner(step: Callable[..., Any]) -> object:
    """Return the object of a method, or the callable object itself."""
    return getattr(step, "__self__", step) if inspect.ismethod(step) else step


def _copied(step: Any, memo: dict[int, Any]) -> Any:
    """Return a copy of an object with its state, also of a function with what it has captured."""
    if not isinstance(step, types.FunctionType):
        return step if isinstance(step, types.ModuleType) else copy.deepcopy(step, memo)
    if id(step) in memo:
        return memo[id(step)]
    if not (step.__closure__ or step.__defaults__ or step.__kwdefaults__):
        return step
    cells = step.__closure__ or ()
    own = [memo.setdefault(id(cell), types.CellType()) for cell in cells]
    function = types.FunctionType(step.__code__, step.__globals__, step.__name__, None, tuple(own))
    memo[id(step)] = function
    function.__defaults__ = copy.deepcopy(step.__defaults__, memo)
    function.__kwdefaults__ = copy.deepcopy(step.__kwdefaults__, memo)
    for cell, new in zip(cells, own, strict=True):
        with contextlib.suppress(ValueError):  # of a variable that has no value yet
            new.cell_contents = _copied(cell.cell_contents, memo)
    return function


def _changes_globals(step: Any) -> bool:
    """Return whether a function assigns to global variables."""
    code = getattr(step, "__code__", None)
    return code is not None and any(i.opname == "STORE_GLOBAL" for i in dis.get_instructions(code))


def _state(step: Callable[..., Any]) -> dict[str, Any]:
    """Return what tells the values of the attributes of an object from others, by name."""
    owner = _owner(step)
    if inspect.isroutine(owner) or inspect.isclass(owner):
        return {}
    state: dict[str, Any] = {}
    for name, value in getattr(owner, "__dict__", {}).items():
        try:
            state[name] = pickle.dumps(value)
        except Exception:  # whatever the object raises
            state[name] = id(value)
    return state


@suggests
def python_component(
    inputs: Sequence[str],
    outputs: Sequence[str],
    step: Callable[..., Any],
    sample_time: float | None = None,
    units: Mapping[str, str] | None = None,
    *,
    types: Mapping[str, str] | None = None,
    reset: Callable[[], object] | None = None,
) -> PythonComponent:
    """Make a component of a system from a function.

    Parameters
    ----------
    inputs, outputs
        Names of its variables.
    step
        Called with the time [s] and the values of the inputs, in their order; returns the value of
        the output, or a sequence with those of all outputs, which hold until the next call. What it
        raises ends the run, and is the cause of an `FmuError`.
    sample_time
        Time between two calls [s], by default the communication step. A call is at the first
        communication point that is not before its sample.
    units
        Units of variables by name.
    types
        Types of variables by name: "Float64", which is the default, "Int64", "Boolean", "String" or
        "Binary", whose values are `bytes`.
    reset
        Called before each run, for a function that keeps a state. Without it, a run begins with the
        state that the one before has left; a warning says so if the function is a method. In a
        sweep, each run has a copy of the function and of the object of a method, or of what a
        function has captured. If it cannot be copied, or is a plain function with `reset`, one run
        follows the other.

    Examples
    --------
    >>> controller = python_component(["y"], ["u"], lambda t, y: -30.0 * y)
    """
    for name, given in {"inputs": inputs, "outputs": outputs}.items():
        texts = [given] if isinstance(given, str) else given
        if not (isinstance(texts, Sequence) and all(isinstance(text, str) for text in texts)):
            raise TypeError(f"{name} = {given!r}, expected names of variables")
    for name, called in {"step": step, "reset": reset}.items():
        if not callable(called) and (called is not None or name == "step"):
            raise TypeError(f"{name} = {called!r}, expected a function")
    for name, about in {"units": units, "types": types}.items():
        is_dict = isinstance(about, Mapping) and all(isinstance(t, str) for t in about.values())
        if about is not None and not is_dict:
            raise TypeError(f"{name} = {about!r}, expected a dict from names of variables to texts")
    received, returned = tuple(one_or_more(inputs)), tuple(one_or_more(outputs))
    if unknown := {*(units or {}), *(types or {})} - {*received, *returned}:
        raise ValueError(f"{min(unknown)} has a unit or type, but is no input or output")
    return PythonComponent(received, returned, step, sample_time, units or {}, types or {}, reset)
