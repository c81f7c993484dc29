"""How sure the inferred settings are: the range of each in which Table 1 rounds as printed."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import table1
from ..loop import Loop
from .claims import number
from .runs import sweep
from .traps import COMPONENTS

VALUES, ROUNDS = 5, 3
"""Values that are tried at once between a value that holds and one that does not, and how often."""

Case = tuple[Loop, list[str], str]
"""The loop of a number of Table 1, the full names of a setting in it, and the printed number."""


def cases(setting: Mapping[str, Any]) -> Iterator[Case]:
    """Yield the numbers that a setting can change and that round as printed with the right one."""
    for entry in table1.entries():
        run, (row, _, signal, controller) = entry.run, entry.label
        disturbed = run.disturbance or not setting.get("disturbed")
        wanted = signal in setting.get("signals", [signal]) and disturbed
        if not (wanted and entry.every_digit) or "*" in row or entry.settling:
            continue
        loop = Loop("PidRbf", signal, run.disturbance) if controller == "PidRbf" else run
        fmus = COMPONENTS[setting["of"]]
        owners = [component for component, model in loop.models().items() if model in fmus]
        yield loop, [f"{owner}.{setting['variable']}" for owner in owners], entry.printed


def kept(case: Case, values: np.ndarray, fmus: Path) -> list[bool]:
    """Return for each value of a setting whether a number rounds as printed."""
    loop, names, printed = case
    tried = {"variables": names, "values": values.tolist()}
    return [table1.agrees(e, printed) for e in sweep(loop, [tried], fmus)["final_e"]]


def edge(setting: Mapping[str, Any], end: float, fmus: Path) -> float:
    """Return the last value found towards `end` with which every number rounds as printed."""
    good, bad, decisive = setting["nominal"], end, list(cases(setting))
    for _ in range(ROUNDS):
        values = np.linspace(good, bad, VALUES + 2)[1:-1]
        found = np.array([kept(case, values, fmus) for case in decisive])
        every = found.all(axis=0)
        first = VALUES if every.all() else int(np.argmin(every))
        if first < VALUES:
            decisive = [case for case, row in zip(decisive, found, strict=True) if not row[first]]
        tried = [good, *values, bad]
        good, bad = tried[first], tried[first + 1]
    return good


def interval(setting: Mapping[str, Any], fmus: Path) -> str:
    """Return the range of a setting as text."""
    low, high = (number(edge(setting, end, fmus), setting["digits"]) for end in setting["within"])
    return f"{low} to {high} {setting['unit']}"
