"""Values of Python as the native module takes them, and as texts of a system file."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return an array as lists, whose whole numbers keep all their digits; other values as is."""
    if isinstance(value, list | tuple | range):
        return [plain(part) for part in value]
    return np.asarray(value).tolist() if hasattr(value, "__array__") else value


def toml(value: Any) -> str:
    """Return a value as TOML; tables have no keys for None."""
    match plain(value):
        case bool():
            return "true" if value else "false"
        case Mapping():
            return f"{{ {', '.join(_pairs(value))} }}"
        case list() as parts:
            return f"[{', '.join(map(toml, parts))}]"
        case int() as number:
            return str(int(number))
        case float() as number:
            return repr(float(number))
        case bytes() | bytearray():
            return json.dumps(bytes(value).hex())
        case str() | os.PathLike():
            return json.dumps(os.fspath(value), ensure_ascii=False).replace("\x7f", "\\u007F")
    raise TypeError(f"{value!r} is no value of a system, expected a number, bool, str or bytes")


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


def array(values: Any) -> np.ndarray:
    """Return an array; of objects, if NumPy would change values.

    It rounds whole numbers among floats, cuts zeros from bytes, and makes texts of all by a text.
    """
    if np.ma.isMaskedArray(values):
        return values
    found = np.asarray(values)
    if hasattr(values, "dtype"):
        return found
    if found.dtype.kind == "S" or (
        found.dtype.kind == "U" and any(isinstance(value, bytes | float | int) for value in values)
    ):
        return np.asarray(values, object)
    if found.dtype.kind != "f":
        return found
    whole = [value for value in values if isinstance(value, int)]
    if whole and len(whole) == len(values):
        # NumPy takes floats for numbers of Int64 and UInt64.
        return np.array(values, np.uint64 if min(whole) >= 0 else object)
    is_exact = all(int(float(value)) == value for value in whole)
    return found if is_exact else np.array(values, object)


def floats(values: bytearray) -> np.ndarray:
    """Return numbers of the type Float64 as an array."""
    return np.frombuffer(values)


def named(values: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return start values by name."""
    if values is None:
        return {}
    names = values.keys() if hasattr(values, "keys") else [None]
    if not all(isinstance(name, str) for name in names):
        raise TypeError(f"start values {values!r}, expected a dict from names to values")
    return dict(values)


def plain_starts(values: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    """Return start values as pairs, with arrays as lists."""
    return [(n, v if isinstance(v, float) else plain(v)) for n, v in named(values).items()]
