"""Inputs of a run as the native module takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ._values import columns

Given = tuple[list[Any], list[tuple[str, str, list[Any], tuple[int, ...], bool | None]]]
"""The times [s]; and of each input its name, unit, values in a row, their shape, and whether its
first dimension is the time, None if that follows from the shape."""


def inputs(given: Any, units: Mapping[str, str], points: Callable[[], list[float]]) -> Given:
    """Return inputs, with functions evaluated at their times, or without them at `points`."""
    table = columns(given)
    time = table.pop("time", None)
    if time is not None:
        times, is_over_time = _array("time", time).ravel().tolist(), None
    else:
        # All values are constant, except for those of functions.
        times = points() if any(map(callable, table.values())) else [0.0]
        is_over_time = False
    found = []
    for name, value in table.items():
        is_function = callable(value)
        values = _array(name, [value(t) for t in times] if is_function else value)
        is_rows = True if is_function else is_over_time
        found.append((name, units.get(name, ""), values.ravel().tolist(), values.shape, is_rows))
    return times, found


def _array(name: str, values: Any) -> np.ndarray:
    """Return an array of the values of an input, which keep their digits."""
    if hasattr(values, "dtype"):
        array = np.asarray(values)
        values = array.tolist() if array.dtype == object else None
    if values is not None:
        # Else NumPy makes floats of whole numbers that are large, and numbers of bytes.
        array = np.array(_plain(values), object)
    if array.dtype == object and any(isinstance(value, list) for value in array.ravel().tolist()):
        raise ValueError(f"input {name}: lists of different lengths, expected an array")
    return array


def _plain(values: Any) -> Any:
    """Return lists whose values NumPy takes as they are."""
    if isinstance(values, list | tuple | range):
        return [_plain(value) for value in values]
    if isinstance(values, bytearray | memoryview):
        return bytes(values)
    return values.tolist() if hasattr(values, "__array__") else values
