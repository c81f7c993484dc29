"""Finds parameters of a system, such as the gains of a controller, by simulation."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._names import suggests
from .components import PythonComponent
from .result import FmuError, Result
from .system import System

Starts = Mapping[str, Any]
"""Start values by name."""


class Tuned(NamedTuple):
    """The result of `tune`."""

    values: dict[str, float]
    """The best parameters, in the units of the variables."""
    objective: float
    """Their objective; infinite if nothing was found that `accepts`."""
    evaluations: int
    """The number of candidates that were simulated or read from the journal."""


def integral_of_absolute(result: Mapping[str, np.ndarray], name: str) -> float:
    """Return the integral of the absolute value of a column, in its unit times s.

    It is a sum of left rectangles. A column that is not finite makes the integral infinite.
    """
    values = np.abs(np.asarray(result[name], float)[:-1])
    integral = float(np.sum(values * np.diff(result["time"])))
    return integral if math.isfinite(integral) else math.inf


@suggests
def tune(
    system: System | str | os.PathLike[str],
    parameters: Mapping[str, tuple[float, float]],
    objective: Callable[[list[Result]], float],
    *,
    cases: Sequence[Starts] = ({},),
    plants: Sequence[Starts] = (),
    accepts: Callable[[Result], bool] = lambda _: True,
    guess: Mapping[str, float] | None = None,
    output: Sequence[str] | None = None,
    stop_time: float | None = None,
    generations: int = 20,
    seed: int = 0,
    journal: str | os.PathLike[str] | None = None,
    in_process: bool = False,
) -> Tuned:
    """Search for parameters with the smallest objective by differential evolution, on all cores.

    The same arguments give the same result on any number of cores.

    Parameters
    ----------
    system
        The system or its file.
    parameters
        The smallest and the largest value of each parameter, by name, in the unit of the
        variable. Ranges above 0 are searched on a logarithmic scale.
    objective
        Receives the results of all cases and returns a number; infinite for invalid results.
    cases
        The start values of each case, such as signals.
    plants
        Start values of other plants. `accepts` must be true for each of them.
    accepts
        Receives the result of a run with one of the `plants`, in the first case, and says
        whether it is good enough.
    guess
        Parameters to begin with.
    output, stop_time
        The variables that `objective` and `accepts` need, and the end of each run [s].
    generations
        How many times the candidates, ten for each parameter, are improved.
    seed
        The seed of the search.
    journal
        A file that keeps all evaluations, with which the same call resumes after an interruption.
    in_process
        Run the FMUs in this process, which is faster; an FMU that crashes ends Python.

    Raises
    ------
    ValueError
        The journal belongs to another search or is damaged, or a range or guess is invalid.
    FmuError
        There is no such variable, a value has the wrong type, or all runs fail.
    """
    from scipy.optimize import differential_evolution

    system = system if isinstance(system, System) else System(system)
    names = list(parameters)
    if not names or not cases:
        raise ValueError("expected at least one parameter and one case")
    for name, (low, high) in parameters.items():
        if not -math.inf < low < high < math.inf:
            raise ValueError(
                f"{name}: ({low}, {high}), expected two numbers, the smaller one first"
            )
        if guess is not None and not low <= guess.get(name, math.nan) <= high:
            raise ValueError(f"{name}: the guess {guess.get(name)} is not from {low} to {high}")
    are_log = [low > 0 for low, _ in parameters.values()]
    ranges = zip(parameters.values(), are_log, strict=True)
    scaled = [[math.log(value) if is_log else value for value in r] for r, is_log in ranges]
    best = math.inf

    def named(x: Iterable[float]) -> dict[str, float]:
        bounded = zip(names, x, are_log, strict=True)
        values = {name: math.exp(v) if is_log else float(v) for name, v, is_log in bounded}
        return {n: min(max(v, parameters[n][0]), parameters[n][1]) for n, v in values.items()}

    def run(values: Mapping[str, float], *others: Starts) -> Result:
        starts = {key: value for other in (*others, values) for key, value in other.items()}
        return loaded.simulate(starts, stop_time=stop_time, output=output, in_process=in_process)

    def evaluate(x: np.ndarray) -> float:
        values = named(x)
        key = json.dumps([value.hex() for value in values.values()])
        if key not in known:
            try:
                known[key] = judge(values)
            except FmuError:
                known[key] = math.nan
            note(key, known[key])
        return math.inf if math.isnan(known[key]) else known[key]

    def judge(values: Mapping[str, float]) -> float:
        value = float(objective([run(values, case) for case in cases]))
        # Other plants take time; they matter for what would be the best only.
        if value < best and not all(accepts(run(values, cases[0], p)) for p in plants):
            return math.inf
        return math.inf if math.isnan(value) else value

    def improved(intermediate_result: Any) -> None:
        nonlocal best
        best = float(intermediate_result.fun)

    middle = named(np.mean(scaled, axis=1)) if guess is None else guess
    # A name that does not exist is no failure of single candidates.
    for starts in (*cases, *({**cases[0], **plant} for plant in plants)):
        system._check({**starts, **middle}, stop=stop_time, outputs=output)
    about = [{n: list(b) for n, b in parameters.items()}, dict(guess or {}), seed, list(cases)]
    known, note = _journal(journal, [*about, list(plants), _identity(system), stop_time])
    start = None
    if guess is not None:
        logs = zip(names, are_log, strict=True)
        start = [math.log(guess[name]) if is_log else guess[name] for name, is_log in logs]
    with system.loaded() as loaded, ThreadPoolExecutor(os.cpu_count()) as pool:
        if start is not None:
            # Candidates that are worse are not tried with other plants.
            best = evaluate(np.array(start))
        try:
            found = differential_evolution(
                evaluate,
                scaled,
                x0=start,
                popsize=10,
                maxiter=generations,
                tol=0,
                rng=seed,
                callback=improved,
                polish=False,
                updating="deferred",
                workers=pool.map,
            )
        except RuntimeError as error:
            # SciPy blames `workers` for an error of the objective.
            cause = error.__cause__
            raise cause if isinstance(cause, TypeError | ValueError) else error from None
        values = named(found.x)
        if all(map(math.isnan, known.values())):
            try:
                judge(values)
            except FmuError as error:
                raise FmuError(f"all runs fail, such as that with {values}: {error}") from error
    return Tuned(values, float(found.fun), int(found.nfev))


def _identity(system: System) -> list[str]:
    """Return the text of a description, and hashes of the files."""
    is_text = system.description is not None
    texts, files = ([system._text()], []) if is_text else ([], [system.file])
    if is_text or system.file.suffix == ".toml":
        parts = [table["fmu"] for table in system.keys()["component"]]
        files += [system.file.parent / p for p in parts if not isinstance(p, PythonComponent)]
    return texts + [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]


def _journal(
    file: str | os.PathLike[str] | None, about: list[Any]
) -> tuple[dict[str, float], Callable[[str, float], None]]:
    """Return what a journal has, and a function that adds to it."""
    known: dict[str, float] = {}
    if file is None:
        return known, lambda key, value: None
    path = Path(file)
    head = f"{json.dumps(about, default=lambda value: value.tolist())}\n".encode()
    content = path.read_bytes() if path.exists() else b""
    if not head.startswith(content[: len(head)]):
        raise ValueError(f"{path} is the journal of another search, or of one of other FMUs")
    # The last line of an interrupted search may be incomplete.
    complete = content[: content.rfind(b"\n") + 1]
    for number, line in enumerate(complete.decode(errors="replace").split("\n")[1:-1], 2):
        key, _, value = line.partition("\t")
        try:
            known[key] = float.fromhex(value)
        except ValueError:
            expected = "expected parameters and an objective"
            raise ValueError(f"{path}:{number}: {line!r}, {expected}") from None
    with path.open("ab") as journal:
        journal.truncate(len(complete))
        journal.write(b"" if complete else head)

    def note(key: str, value: float) -> None:
        with path.open("ab") as journal:
            journal.write(f"{key}\t{float(value).hex()}\n".encode())

    return known, note
