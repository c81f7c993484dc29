"""Linear models of systems, from their responses to small pulses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .result import FmuError
from .system import System

Signals = Mapping[str, Callable[[float], float]]
"""Functions of the time [s] that inputs follow, by name."""


def respond(
    system: System,
    time: float | None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    start_values: Mapping[str, Any] | None,
    signals: Signals,
    deviation: float,
    tolerance: float,
) -> tuple[np.ndarray, float, float]:
    """Return the responses of the outputs to a pulse of each input, the time and the step [s].

    A pulse lasts one communication step and adds to what the input has. The responses, in the unit
    of the output per unit of the input, have the axes sample, output and input.
    """
    start, stop, step = system.times()
    times = system._points()
    index = 0 if time is None else round((time - start) / step)
    if not 0 <= index < len(times) - 2:
        raise FmuError(f"time = {time}, expected one from {start} s to before {stop} s")

    def run(names: Sequence[str], pulse: tuple[str, float, float] = ("", 0.0, 0.0)) -> np.ndarray:
        name, size, held = pulse
        # At both ends of a pulse, a free input jumps.
        order = np.sort([*range(len(times)), index, index + 1])
        table = {n: np.array([f(t) for t in times])[order] for n, f in signals.items()}
        changed = _with_pulse(system, name, size, times[index], step)
        if name and changed is None:
            table[name] = table.get(name, np.full(len(order), held))
            table[name][index + 1 : index + 3] += size
        given = {"time": times[order]} | table if table else None
        starts = {n: value for n, value in (start_values or {}).items() if n != name}  # held has it
        result = (changed or system).simulate(starts, output=names, input=given)
        return np.array([result[n] for n in names], float).T[index:]

    before = run(outputs)
    responses = []
    for name, bounds in zip(inputs, system._bounds(inputs), strict=True):
        held = float(run([name])[0, 0])
        size, other = _pulses(name, held, deviation * max(1.0, abs(held)), bounds)
        once, half = ((run(outputs, (name, s, held)) - before) / s for s in (size, other))
        # Of the largest response until each sample: later, that of an integrator may hide a limit.
        errors, sizes = (np.maximum.accumulate(np.abs(h)) for h in (once - half, half))
        apart = errors > 0.01 * sizes + tolerance * sizes[-1]
        if np.any(apart):
            output = outputs[int(np.argmax(np.any(apart, axis=0)))]
            raise FmuError(
                f"{output} does not respond to {name} in proportion to pulses of {size:g} and "
                f"{other:g}, expected a smaller deviation than {deviation:g}"
            )
        # Richardson extrapolation cancels the error of second order.
        responses.append((once * (other / size) - half) / (other / size - 1))
    return np.stack(responses, axis=2), float(times[index]), step


Bounds = tuple[float | None, float | None]
"""The smallest and the largest value that a variable may have, or None."""


def limits(name: str, value: float, low: float | None, high: float | None) -> tuple[float, float]:
    """Return the limits of deviations from a value; one beyond a bound shows that it is none."""
    low = -np.inf if low is None or value < low else low
    high = np.inf if high is None or value > high else high
    if low == high:
        raise FmuError(f"{name} can only be {value}, expected a range from `min` to `max`")
    return low, high


def _pulses(name: str, held: float, size: float, bounds: Bounds) -> tuple[float, float]:
    """Return the heights of two pulses, the second half as high, on both sides if possible."""
    low, high = limits(name, held, *bounds)
    below, above = held - low, high - held
    if min(below, above) >= size / 2 and max(below, above) >= size:
        size = size if above >= size else -size
        return size, -size / 2
    size = min(size, max(below, above)) * (1 if above > below else -1)
    return size, size / 2


def _with_pulse(system: System, name: str, size: float, time: float, step: float) -> System | None:
    """Return a system with a pulse on the connection to an input, or None if it has none."""
    links = list(system.keys().get("connections", ()))
    for index, link in enumerate(links):
        if isinstance(link, str):
            source, _, target = (part.strip() for part in link.partition("->"))
            link = {"from": source, "to": target}
        if link["to"] == name:
            fault = {"offset": size / link.get("factor", 1.0), "start": time, "stop": time + step}
            links[index] = {**link, "faults": [*link.get("faults", ()), fault]}
            return system.changed(connections=links)
    return None


def realize(
    responses: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, C and D of the smallest order whose pulse responses are these.

    The method is the eigensystem realization algorithm. Deviations from the responses are at most
    `tolerance` times the largest value of each output.

    Raises
    ------
    FmuError
        No linear model has these responses.
    """
    rows = _largest(responses, (0, 2))[:, None]
    columns = _largest(responses / rows, (0, 1))
    h = responses / rows / columns
    # Shifts of all magnitudes show fast and slow modes.
    limit = max((len(h) - 3) // 2, 1)
    shifts = np.unique([0, *np.geomspace(1, limit, 40).astype(int)])
    now, next_ = (np.block([[h[k + i + j] for j in shifts] for i in shifts]) for k in (1, 2))
    left, values, right = np.linalg.svd(now)
    best = np.inf
    for n in range(min(int(np.sum(values > 1e-14 * max(values[0], 1e-300))), 40) + 1):
        root = np.sqrt(values[:n])
        A = (left[:, :n] / root).T @ next_ @ (right[:n].T / root)
        B, C = (right[:n].T * root)[: h.shape[2]].T, (left[:, :n] * root)[: h.shape[1]]
        error = _deviation(A, B, C, h)
        best = min(best, error)
        if error <= tolerance:
            return A, B * columns, C * rows, responses[0]
    raise FmuError(
        f"the responses differ by {best:.1g} of their maximum from those of a linear model, "
        f"expected at most {tolerance:g}: linearize where the system is at rest, or change the "
        "deviation or the tolerance"
    )


def _largest(h: np.ndarray, axes: tuple[int, int]) -> np.ndarray:
    """Return the largest magnitudes, 1 where all are 0."""
    largest = np.max(np.abs(h), axis=axes)
    return np.where(largest > 0, largest, 1.0)


def _deviation(A: np.ndarray, B: np.ndarray, C: np.ndarray, h: np.ndarray) -> float:
    """Return the largest deviation of the responses of a model."""
    worst, x = 0.0, B
    with np.errstate(over="ignore", invalid="ignore"):
        for expected in h[1:]:
            worst = max(worst, float(np.max(np.abs(C @ x - expected), initial=0)))
            if not worst < np.inf:
                return np.inf
            x = A @ x
    return worst
