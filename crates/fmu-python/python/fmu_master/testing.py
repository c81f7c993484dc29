"""Assertions about results of runs, for tests of systems, whose messages say what is wrong."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ._names import suggests

_MOST_ROWS = 50
"""The longest delay that a message recognizes, in rows."""


@suggests
def assert_carries(
    result: Mapping[str, np.ndarray],
    source: str,
    target: str,
    *,
    gain: float = 1.0,
    rows: int = 0,
    tolerance: float = 1e-9,
) -> None:
    """Check that a signal arrives: the target is the source times a gain, some rows later.

    Parameters
    ----------
    result
        Columns by name, with "time" [s].
    source, target
        The names of the signal that is sent and of the one that arrives, such as an output and the
        input that it feeds.
    gain
        The expected gain, in the unit of the target per unit of the source.
    rows
        The expected delay in rows.
    tolerance
        Tolerance of values, relative to the largest magnitude of the target.

    Raises
    ------
    AssertionError
        The message has the gain and the delay with which the signal arrives, or the first
        wrong value.
    """
    path = f"{source} -> {target}"
    time, sent, arrived = (np.asarray(result[name], float) for name in ("time", source, target))
    if not 0 <= rows < len(time):
        raise AssertionError(f"{path}: the result has {len(time)} rows, expected more than {rows}")
    wrong = _deviations(sent, arrived, gain, rows) > tolerance
    if not np.any(wrong):
        return
    limit = max(tolerance, 1e-9)
    for late in range(min(_MOST_ROWS, len(time) - 1)):
        earlier = sent[: len(sent) - late]
        power = float(earlier @ earlier)
        found = float(earlier @ arrived[late:]) / power if power else 0.0
        if np.all(_deviations(sent, arrived, found, late) <= limit):
            faults = []
            if abs(found - gain) > limit * abs(gain) or late == rows:
                fault = "the sign is swapped" if found * gain < 0 else "the gain is wrong"
                faults.append(f"{fault}: {found:.12g}, expected {gain:.12g}")
            if late != rows:
                faults.append(
                    f"the value arrives {time[late] - time[0]:.6g} s late (rows: {late}), "
                    f"expected {time[rows] - time[0]:.6g} s"
                )
            raise AssertionError(f"{path}: {' and '.join(faults)}")
    first = int(np.argmax(wrong)) + rows
    raise AssertionError(
        f"{path}: {arrived[first]:.9g} arrives at t = {time[first]:.9g} s, "
        f"expected {gain * sent[first - rows]:.9g}"
    )


def _deviations(sent: np.ndarray, arrived: np.ndarray, gain: float, rows: int) -> np.ndarray:
    """Return how far values are from those expected, relative to the largest that has arrived."""
    largest = float(np.max(np.abs(arrived), initial=0.0)) or 1.0
    apart = np.abs(arrived[rows:] - gain * sent[: len(sent) - rows]) / largest
    return np.where(np.isnan(apart), np.inf, apart)


@suggests
def assert_within(
    result: Mapping[str, np.ndarray],
    name: str,
    low: float,
    high: float,
    *,
    start: float = -np.inf,
    stop: float = np.inf,
) -> None:
    """Check that a column stays within two limits, in its unit, between two times [s].

    Raises
    ------
    AssertionError
        The message has the first value beyond the limits, the one farthest beyond, and their
        times; or there is no value between the times.
    """
    time, values = result["time"], np.asarray(result[name], float)
    chosen = (time >= start) & (time <= stop)
    time, values = time[chosen], values[chosen]
    if not len(time):
        raise AssertionError(f"{name} has no value from {start:.6g} s to {stop:.6g} s")
    beyond = np.maximum(low - values, values - high)
    beyond = np.where(np.isnan(values), np.inf, beyond)
    if np.all(beyond <= 0):
        return
    first, worst = int(np.argmax(beyond > 0)), int(np.argmax(beyond))
    raise AssertionError(
        f"{name} is {values[first]:.6g} at t = {time[first]:.6g} s and {values[worst]:.6g} at "
        f"t = {time[worst]:.6g} s, expected from {low:.6g} to {high:.6g}"
    )
