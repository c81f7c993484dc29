"""The native part."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

class Runner:
    def __init__(self, program: Sequence[str], keeps: bool) -> None: ...
    def run(
        self,
        system: Mapping[str, Any],
        steps: Sequence[Callable[..., Any]],
        progress: Callable[[float, str], object] | None,
    ) -> dict[str, Any]: ...
    def free(self) -> None: ...

class Instance:
    def __new__(cls, *arguments: object, **options: object) -> Self: ...
    def _open(
        self, setup: Mapping[str, Any], starts: Mapping[str, Any] | None, program: Sequence[str]
    ) -> None: ...
    def _variables(self) -> list[tuple[Any, ...]]: ...
    def _equations(self) -> tuple[list[list[str]], bool]: ...
    def _initialize(self) -> None: ...
    def _starts(self) -> dict[str, Any] | None: ...
    def _get_list(self, names: Iterable[str]) -> list[Any]: ...
    def _reset(self, starts: Mapping[str, Any] | None) -> None: ...
    def _save(self) -> int: ...
    def _restore(self, state: int) -> None: ...
    def _forget(self, state: int) -> None: ...
    def _states(self) -> np.ndarray: ...
    def _set_states(self, states: Sequence[float]) -> None: ...
    def _derivatives(self) -> np.ndarray: ...
    def _directional(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> np.ndarray: ...
    @property
    def time(self) -> float:
        """The time that the FMU has reached [s]."""
    @overload
    def set(self, name: str, value: ArrayLike) -> None: ...
    @overload
    def set(self, name: Mapping[str, ArrayLike]) -> None:
        """Set a variable, or all variables of a mapping; before initialization, start values.

        A value has the type of its variable: a number (also a whole number for a float), a bool, a
        str, the name or the number of an item, or an array in the shape of the variable. In a child
        process, an input or tunable parameter within its bounds is set by the next call that needs
        the FMU, which then raises the error if the FMU refuses the value.
        """
    def step(self, step_size: float) -> None:
        """Step by a time [s]."""
    @overload
    def get(self, names: str) -> Any: ...
    @overload
    def get(self, names: Iterable[str]) -> np.ndarray:
        """Return the value of a variable, or an array of the values of several.

        A value is a float, int, bool, str or bytes, as the variable, or an array in its shape. The
        values of several variables follow each other in one dimension.
        """
    def free(self) -> None:
        """End and free the FMU."""

class Vector:
    def __init__(
        self,
        setup: Mapping[str, Any],
        program: Sequence[str],
        count: int,
        processes: int,
        actions: Sequence[str],
        observations: Sequence[tuple[str, float, float]],
        step: float,
        steps: int,
    ) -> None: ...
    def structural(self) -> list[str]: ...
    def reset(
        self, episodes: Sequence[tuple[int, Sequence[tuple[str, Any]]]], holds: bool
    ) -> None: ...
    def observe(self, observations: np.ndarray, times: np.ndarray) -> None: ...
    def step(
        self, actions: np.ndarray, observations: np.ndarray, times: np.ndarray, ends: np.ndarray
    ) -> bool: ...
    def free(self) -> None: ...

def read(file: Path) -> list[tuple[str, str, dict[int, str], str, Any]]: ...
def write(
    file: Path,
    columns: Sequence[tuple[str, str, list[Any]]],
    about: Sequence[tuple[str, Mapping[int, str], bool]],
) -> None: ...
def set_points(columns: Sequence[tuple[str, str, bool]]) -> dict[str, str]: ...
def compare(
    tables: Sequence[Sequence[tuple[str, str, list[Any]]]],
    names: Sequence[str],
    absolute: float,
    relative: float,
    held: Sequence[str],
) -> list[tuple[str, float, list[Any], str]]: ...
def times(system: Mapping[str, Any]) -> tuple[float, float, float]: ...
def points(system: Mapping[str, Any]) -> bytearray: ...
def bounds(system: Mapping[str, Any]) -> list[tuple[float | None, float | None]]: ...
def pack(
    file: Path,
    text: str | None,
    out: Path,
    fmi: str,
    targets: Sequence[str],
    binaries: Sequence[str],
) -> list[str]: ...
def main(program: Sequence[str], arguments: Sequence[str]) -> None: ...
def sweep(
    sweep: tuple[Path, str | None],
    system: tuple[Path, str | None] | None,
    functions: tuple[
        Sequence[tuple[str, Mapping[str, Any]]], Callable[[], Sequence[Callable[..., Any]]]
    ],
    out: Path,
    processes: tuple[int, Sequence[str]],
    progress: Callable[[float, str], object] | None,
) -> tuple[list[str], str | None]: ...
