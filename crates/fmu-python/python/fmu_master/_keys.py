"""The keys of systems and sweeps in Python: what is wrong with them, and how files have them."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._names import did_you_mean, unknown
from ._values import columns, named, one_or_more, plain
from .components import PythonComponent
from .result import FmuError

SIGNALS = ("reference", "output", "error", "control")
"""The signals of a sweep."""


DEFAULT_EXPERIMENT = "default experiment"
"""The step of a component that has the step size of its default experiment."""


class Kind(NamedTuple):
    """What the value of a key must be."""

    expected: str
    fits: Callable[[Any], bool]


def is_number(value: object) -> bool:
    """Return whether a value is a number, also one of NumPy."""
    if hasattr(value, "__array__"):
        return np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iuf"
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_map(value: object) -> bool:
    return isinstance(value, Mapping) and all(map(_is_text, value))


def _is_whole(value: object) -> bool:
    return is_number(value) and np.asarray(value).dtype.kind in "iu" and value >= 0  # type: ignore[operator]


def _are_texts(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, Sequence) and all(map(_is_text, value)))


def _are_maps(value: object) -> bool:
    return isinstance(value, Sequence) and all(map(_is_map, value))


def _is_file(value: object) -> bool:
    return isinstance(value, str | os.PathLike)


NUMBER = Kind("a number", is_number)
SECONDS = Kind("a number, in s", is_number)
WHOLE = Kind("a whole number of at least 0", _is_whole)
COUNT = Kind("a whole number of at least 1", lambda value: _is_whole(value) and value >= 1)
TABLE = Kind("a file, .csv or .parquet", _is_file)
FILE = Kind("a file", _is_file)
FLAG = Kind("True or False", lambda value: isinstance(value, bool | np.bool_))
TEXT = Kind("a text", _is_text)
TEXTS = Kind("names of variables", _are_texts)
STARTS = Kind("a dict from names to values", lambda value: hasattr(value, "keys"))
STEP = Kind(
    f'{SECONDS.expected}, or "{DEFAULT_EXPERIMENT}"',
    lambda value: is_number(value) or value == DEFAULT_EXPERIMENT,
)
SET = Kind("the name of a parameter set of the FMU, or a file (.ssv)", _is_file)


def _one_of(*names: str) -> Kind:
    *others, last = [f'"{name}"' for name in names]
    return Kind(f"{', '.join(others)} or {last}", lambda value: value in names)


SOLVER = _one_of("explicit", "implicit")
INPUTS = _one_of("held", "extrapolated")
ORDER = _one_of("sequential", "parallel", "implicit")
LOOPS = {
    "algebraic_loops": _one_of("refuse", "delay", "iterate"),
    "loop_tolerance": NUMBER,
    "loop_iterations": WHOLE,
}
"""The keys of iterated loops."""
ADAPTIVE = {"step_tolerance": NUMBER, "min_step": SECONDS}
"""The keys of adaptive steps."""

SYSTEM = {
    "components": Kind("a dict from names to FMUs", _is_map),
    "connections": Kind("a list of pairs (output, input)", lambda _: True),
    "start": SECONDS,
    "stop": SECONDS,
    "step": SECONDS,
    "output_step": SECONDS,
    "order": ORDER,
    "outputs": TEXTS,
    "input": Kind("a file; `simulate` takes tables of values as its `input`", _is_file),
    "tolerance": NUMBER,
    "solver": SOLVER,
    "allow_algebraic_loops": FLAG,
    **LOOPS,
    **ADAPTIVE,
    "seed": WHOLE,
    "expose": Kind("a dict of what a container exposes", lambda value: hasattr(value, "keys")),
}
"""The keys of a system."""

COMPONENT = {
    "fmu": Kind(
        "the file of an FMU or, for a function, `python_component(inputs, outputs, function)`",
        lambda value: _is_file(value) or isinstance(value, PythonComponent),
    ),
    "start": STARTS,
    "parameters": SET,
    "interface": TEXT,
    "step": STEP,
    "inputs": INPUTS,
    "event_mode": FLAG,
    "sampled": FLAG,
    "tolerance": NUMBER,
    "solver": SOLVER,
}
"""The keys of a component."""

CONNECTION = {
    "from": Kind('"component.output"', _is_text),
    "to": Kind('"component.input"', _is_text),
    "factor": NUMBER,
    "offset": NUMBER,
    "faults": Kind("a list of dicts", _are_maps),
}
"""The keys of a connection."""

SWEEP = {
    "system": Kind("a `System`, its file or its keys", lambda _: True),
    "start": SECONDS,
    "stop": SECONDS,
    "step": SECONDS,
    "order": ORDER,
    "load_state": Kind("a file with the saved state of a run", _is_file),
    "set": STARTS,
    "seed": WHOLE,
    "draws": WHOLE,
    "parameter": Kind("a list of dicts, one for each parameter", _are_maps),
    "signals": Kind("a dict from signals to names of variables", _is_map),
    "metrics": Kind("a dict", _is_map),
}
"""The keys of a sweep."""

PARAMETER = {
    "variable": TEXT,
    "variables": TEXTS,
    **dict.fromkeys(("values", "together"), Kind("a list", lambda v: np.ndim(v) > 0)),
    "from": NUMBER,
    "to": NUMBER,
    "count": WHOLE,
    "scale": Kind('"linear" or "log"', lambda value: value in ("linear", "log")),
    **dict.fromkeys(
        ("uniform", "log_uniform", "normal"), Kind("two numbers", lambda v: np.shape(v) == (2,))
    ),
}
"""The keys of a parameter of a sweep."""

METRICS = {"band": NUMBER, "limit": NUMBER}
"""The keys of the metrics of a sweep."""


def shown(value: object) -> str:
    """Return a value in a message, of which a large one is shortened."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 80
    return short.repr(value)


def check(keys: Mapping[str, Any], known: Mapping[str, Kind], where: str = "") -> None:
    """Raise what is wrong with keys at a place; None stands for a key that is missing."""
    for key, value in keys.items():
        if key not in known:
            raise FmuError(where + unknown("field", key, list(known)))
        if value is not None and not known[key].fits(value):
            raise FmuError(f"{where}{key} = {shown(value)}, expected {known[key].expected}")


def system_keys(description: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a description with the keys of a system file, and absolute paths.

    Raises
    ------
    FmuError, TypeError
        A key or value is none of a system.
    """
    normal = dict(description)
    components = normal.pop("components", {})
    if isinstance(normal.get("component"), Mapping):
        raise FmuError(unknown("field", "component", list(SYSTEM)))
    check({key: value for key, value in normal.items() if key != "component"}, SYSTEM)
    if not isinstance(components, Mapping) or not (components or normal.get("component")):
        raise TypeError(f"components = {components!r}, expected a dict from names to FMUs")
    parts = [_component(name, about) for name, about in components.items()]
    parts = parts or [dict(table) for table in normal["component"]]
    for part in parts:
        name = part.get("name")
        check({k: v for k, v in part.items() if k != "name"}, COMPONENT, f"component {name}: ")
        if part.get("fmu") is None:
            raise FmuError(
                f"component {name}: fmu is missing, expected {COMPONENT['fmu'].expected}"
            )
        if not isinstance(part["fmu"], PythonComponent):
            part["fmu"] = folder / part["fmu"]
        if part.get("parameters") is not None:
            named_set = os.fspath(part["parameters"])
            is_a_file = named_set.lower().endswith(".ssv")
            part["parameters"] = str(folder / named_set) if is_a_file else named_set
        if "start" in part:
            part["start"] = named(part["start"])
    normal["component"] = parts
    normal["connections"] = _connections(normal.get("connections"))
    normal["outputs"] = one_or_more(normal.get("outputs") or ())
    if normal.get("input") is not None:
        normal["input"] = folder / normal["input"]
    return normal


def _component(name: object, about: Any) -> dict[str, Any]:
    """Return the table of a component."""
    if not isinstance(name, str):
        raise TypeError(f"components: the name {name!r}, expected a text")
    if isinstance(about, Mapping):
        return {"name": name, **about}
    if callable(about):
        call = f'"{name}": python_component(inputs, outputs, function)'
        raise TypeError(f"components: {name} = {shown(about)} is a function, expected {call}")
    if not COMPONENT["fmu"].fits(about):
        expected = "the file of an FMU, a dict with the key `fmu`, or a `python_component`"
        raise TypeError(f"components: {name} = {shown(about)}, expected {expected}")
    return {"name": name, "fmu": about}


def _connections(given: Any) -> list[Any]:
    """Return connections as texts and tables."""
    expected = 'expected ("component.output", "component.input")'
    is_list = isinstance(given, str | Sequence) or given is None
    is_pair = isinstance(given, tuple | list) and len(given) == 2 and all(map(_is_text, given))
    if not is_list or (is_pair and not any("->" in name for name in given)):
        raise TypeError(
            f"connections = {shown(given)}, {expected.replace('(', 'a list of pairs (')}"
        )
    found: list[Any] = []
    for one in one_or_more(given or ()):
        if isinstance(one, Mapping):
            check(one, CONNECTION, "connections: ")
            if missing := [key for key in ("from", "to") if one.get(key) is None]:
                raise FmuError(f"connections: {missing[0]} is missing in {shown(one)}")
            found.append(one)
        elif isinstance(one, str):
            found.append(one)
        elif isinstance(one, tuple | list) and len(one) == 2 and all(map(_is_text, one)):
            found.append(" -> ".join(one))
        else:
            raise TypeError(f"connections: {shown(one)}, {expected} or a dict")
    return found


def sweep_keys(plan: Any) -> dict[str, Any]:
    """Return the keys of a sweep file for a dict with them, or for start values of each run.

    Raises
    ------
    FmuError, TypeError
        The start values are no lists of the same length.
    """
    try:
        table = columns(plan)
    except TypeError as error:
        expected = "a sweep file, or a dict or data frame with a list for each component.variable"
        raise TypeError(f"plan = {shown(plan)}: {error}; a plan is {expected}") from None
    if "parameter" in table:
        return table
    if not table:
        raise FmuError("plan = {}, expected a list of start values for each component.variable")
    lists = {name: _start_values(name, values) for name, values in table.items()}
    lengths = {name: len(values) for name, values in lists.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{count} values of {name}" for name, count in lengths.items())
        raise FmuError(f"sweep: together = {counts}; expected lists of the same length")
    return {"parameter": [{"variables": list(lists), "together": list(lists.values())}]}


def _start_values(name: str, given: Any) -> list[Any]:
    """Return the start values of a variable in each run."""
    values = plain(given)
    if hasattr(values, "__iter__") and not isinstance(values, str | Mapping):
        values = list(values)
    expected = "a list of finite numbers, bools or texts, one for each run"
    if not isinstance(values, list) or not values:
        meant = did_you_mean(name, SWEEP) if "." not in name else ""
        raise FmuError(f"plan: {name} = {shown(given)}, expected {expected}{meant}")
    for value in values:
        if not isinstance(value, str | bool) and not (is_number(value) and np.isfinite(value)):
            meant = did_you_mean(name, SWEEP) if isinstance(value, Mapping) else ""
            raise FmuError(f"plan: {name} has the value {shown(value)}, expected {expected}{meant}")
    return values


def check_sweep(plan: Mapping[str, Any]) -> None:
    """Raise what is wrong with the keys of a sweep.

    Raises
    ------
    FmuError
        A key is none of a sweep, or is missing, or its value is of another kind.
    """
    check(plan, SWEEP, "sweep: ")
    for parameter in plan.get("parameter", ()):
        check(parameter, PARAMETER, "sweep: parameter: ")
    given = plan.get("signals") or {}
    check(
        given, dict.fromkeys(SIGNALS, Kind("the name of a variable", _is_text)), "sweep: signals: "
    )
    if missing := [name for name in SIGNALS if name not in given]:
        example = ", ".join(f'"{name}": "component.variable"' for name in SIGNALS)
        name = "signals" if len(missing) == len(SIGNALS) else f"signals: {missing[0]}"
        raise FmuError(f"sweep: {name} is missing, expected signals={{{example}}}")
    check(plan.get("metrics") or {}, METRICS, "sweep: metrics: ")
