"""Names that do not exist, and the ones that are probably meant."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

ELSEWHERE = {"output_interval": "step_size", "fmi_type": "interface", "solver": "interface"}
"""Names of arguments of FMPy that differ from ours."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about a name that does not exist."""
    names = {other.lower(): other for other in known}
    other = ELSEWHERE.get(name, "")
    near = [other] if other in names else difflib.get_close_matches(name.lower(), names, 1, 0.55)
    return f"; did you mean `{names[near[0]]}`?" if near else ""


def similar_variables(name: str, known: Iterable[str]) -> str:
    """Return which variables are similar to one that does not exist, or end with it."""
    names = list(known)
    similar = [n for n in names if n.endswith(f".{name}")] or difflib.get_close_matches(name, names)
    return f"did you mean {' or '.join(similar[:3])}?" if similar else ""


def unknown(what: str, name: object, known: Sequence[str]) -> str:
    """Return the message about a name that does not exist, among those that do."""
    names = ", ".join(f"`{other}`" for other in known)
    return f"unknown {what} `{name}`, expected one of {names}{did_you_mean(str(name), known)}"


def suggests(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function whose error about an unknown argument is to suggest a similar one."""
    known = [name for name in inspect.signature(function).parameters if name != "self"]

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        __tracebackhide__ = True  # in IPython and pytest
        for name in kwargs.keys() - known:
            called = function.__qualname__.removesuffix(".__init__")
            raise TypeError(f"{called}: {unknown('argument', name, known)}")
        return function(*args, **kwargs)

    return call
