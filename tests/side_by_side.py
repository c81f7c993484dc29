"""Run a closed loop with the FMUs and with the independent implementation, and compare."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

import reference
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import simulate


def both(
    fmus: Path, controller: str, signal: str = "step", disturbance: float = 0.0, **options
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the columns (steps,) of the FMU loop and of the reference."""
    timing = {"start": TS, "step": TS, "order": "sequential"} | {
        name: options.pop(name) for name in ("start", "step", "steps", "order") if name in options
    }
    expected = reference.closed_loop(controller, signal, disturbance, **options, **timing)
    with Loop(controller, signal, disturbance, **options).system(fmus) as system:
        record = [name for name in expected if name != "time"]
        computed = simulate(system, record=record, **timing)
    return computed, expected


def assert_close(
    computed: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], tolerance: float
) -> None:
    """Compare sample by sample, relative to the maximum value so far, or to 1 if that is larger.

    Relative to the maximum, since in an unstable loop deviations grow as fast as the signals.
    """
    for name, column in expected.items():
        scale = np.maximum(1.0, np.maximum.accumulate(np.abs(column)))
        deviation = np.abs(computed[name] - column) / scale
        worst = int(np.argmax(deviation))
        assert deviation[worst] <= tolerance, (
            f"{name}, sample {worst}: {computed[name][worst]!r} instead of {column[worst]!r}"
        )
