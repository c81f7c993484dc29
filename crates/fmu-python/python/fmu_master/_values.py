"""Values as texts, as a system file has them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np


def toml(value: Any) -> str:
    """Return a value as TOML; tables have no keys for None."""
    match value:
        case bool() | np.bool_():
            return "true" if value else "false"
        case Mapping():
            return f"{{ {', '.join(_pairs(value))} }}"
        case np.ndarray():
            return toml(value.tolist())
        case list() | tuple():
            return f"[{', '.join(map(toml, value))}]"
        case int() | np.integer():
            return str(int(value))
        case float() | np.floating():
            return repr(float(value))
        case str() | os.PathLike():
            return json.dumps(os.fspath(value), ensure_ascii=False).replace("\x7f", "\\u007F")
    raise TypeError(f"{value!r} is no value of a system, expected a number, bool or str")


def document(keys: Mapping[str, Any], tables: str = "") -> str:
    """Return a TOML file, in which one key may have a list of tables."""
    lines = _pairs({key: value for key, value in keys.items() if key != tables})
    for table in keys.get(tables, ()):
        lines += [f"[[{tables}]]", *_pairs(table)]
    return "\n".join([*lines, ""])


def _pairs(table: Mapping[str, Any]) -> list[str]:
    names = {key: key if re.fullmatch(r"[\w-]+", key, re.ASCII) else toml(key) for key in table}
    return [f"{names[key]} = {toml(part)}" for key, part in table.items() if part is not None]


def one_or_more(given: Any) -> list[Any]:
    """Return a list, in which a text alone is the only one."""
    return [given] if isinstance(given, str) else list(given)


def columns(table: Any) -> dict[str, Any]:
    """Return the columns of a mapping, a structured array or a data frame."""
    if getattr(getattr(table, "index", None), "name", None) == "time":
        table = table.reset_index()  # such as `Result.to_pandas` makes
    if hasattr(table, "dtype"):
        names = table.dtype.names
    else:
        names = getattr(table, "columns", table if isinstance(table, Mapping) else None)
    if names is None or not all(isinstance(name, str) for name in names):
        raise TypeError(f"{type(table).__name__}, expected a table of named columns")
    found = {name: table[name] for name in names}
    for name, column in found.items():
        if hasattr(column, "dtype") and np.asarray(column).dtype.kind in "mM":
            raise TypeError(f"{name} has dates or durations, expected numbers, a time in s")
    return found


def points(start: float, step: float, count: int) -> np.ndarray:
    """Return the communication points [s], and the one after the stop time."""
    return start + np.arange(count + 1) * step


def elements(values: Mapping[str, Any] | None) -> Iterator[tuple[str, Any]]:
    """Return start values by name; those of arrays by the names of the elements."""
    if values is None:
        return
    names = values.keys() if hasattr(values, "keys") else (None,)
    if not all(isinstance(name, str) for name in names):
        raise TypeError(f"start values {values!r}, expected a dict from names to values")
    for name, value in values.items():
        if isinstance(value, float | int | str) or np.ndim(value) == 0:
            yield name, value
            continue
        for index, element in np.ndenumerate(value):
            yield f"{name}[{','.join(str(i + 1) for i in index)}]", element


def texts(values: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return start values as texts."""
    pairs = elements(values)
    return [(n, v if isinstance(v, str) else toml(v)) for n, v in pairs]
