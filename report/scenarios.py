"""The loops that the figures show, and their co-simulation by the FMPy master."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path

import numpy as np
import table1
from master import FMUS, TS, closed_loop, simulate

Columns = Mapping[str, np.ndarray]
"""Columns of one run by full name, each of shape (steps,)."""

SIGNALS = ("step", "sine", "square")

AMPLITUDES = {"step": (0.0, 1.0), "sine": (0.0, 1.0, 2.0), "square": (0.0, 1.0, 2.0)}
"""Disturbances [rad]: none; that of Table 1; that of the text on Figures 12 and 14."""

KINDS = ("PID", "PID-RBF", "IPID-RBF", "IPID-RBF own")
"""The controllers: IPID-RBF learns the supervisor's force as in Table 1, its `own` as in (29)."""

GAINS = {"kp": 300.0, "ki": 500.0, "kd": 100.0}
"""The paper's gains [N/rad, N/(rad s), N s/rad]."""

FACTORS = (0.5, 1.0, 2.0)
"""What Figure 2 multiplies each gain by; the paper's own choice stands in its picture only."""


@dataclass(frozen=True)
class Loop(table1.Run):
    """A run of Table 1's kind, which may be shorter and have other start values.

    Parameters
    ----------
    overrides
        Pairs of a variable's full name and its start value.
    steps
        How many communication points of 1 ms are recorded.
    order
        Of stepping: "sequential" or "parallel".
    previous_sample_terms
        Whether the controllers use the PID terms of the sample before; None as in Table 1.
    plant_model
        "linear" or "nonlinear".
    """

    overrides: tuple[tuple[str, float], ...] = ()
    steps: int = table1.STEPS
    order: str = "sequential"
    previous_sample_terms: bool | None = None
    plant_model: str = "linear"


def loop_of(run: table1.Run) -> Loop:
    """Return a run of Table 1 as a loop."""
    return Loop(run.controller, run.signal, run.disturbance, run.target, run.w0, run.supervisor_w0)


def loops_of(signal: str, amplitude: float) -> dict[str, tuple[Loop, str, str]]:
    """Return by kind the loop, and the names of the controller and the plant in it.

    IPID-RBF learns the supervisor's force as in Table 1, "IPID-RBF own" its own as in (29).
    """
    supervised = Loop("IpidRbf", signal, amplitude, "supervisor")
    return {
        "PID": (Loop("Pid", signal, amplitude), "controller", "plant"),
        "PID-RBF": (supervised, "supervisor", "supervisor_plant"),
        "IPID-RBF": (supervised, "controller", "plant"),
        "IPID-RBF own": (Loop("IpidRbf", signal, amplitude), "controller", "plant"),
    }


def gain_loop(gain: str, factor: float) -> Loop:
    """Return the step response of the PID with one gain multiplied."""
    if factor == 1:
        return Loop("Pid", "step", 0.0)
    return Loop("Pid", "step", 0.0, overrides=((f"controller.pid.{gain}", GAINS[gain] * factor),))


def paper_loops() -> set[Loop]:
    """Return all loops that the paper's figures and Table 1 need."""
    shown = {
        loop
        for signal in SIGNALS
        for amplitude in AMPLITUDES[signal]
        for loop, _, _ in loops_of(signal, amplitude).values()
    }
    gains = {gain_loop(gain, factor) for gain in GAINS for factor in FACTORS}
    return shown | gains | {loop_of(run) for run in table1.runs()}


# --- runs ---------------------------------------------------------------------------------------


RECORDED = {"u", "u_p", "u_n", "e", "theta", "r", "d"}
"""The outputs that are recorded, of whatever component."""


def execute(loop: Loop, fmus: Path = FMUS) -> dict[str, np.ndarray]:
    """Co-simulate one loop at 1 ms, from the paper's k = 1."""
    with closed_loop(
        loop.controller,
        loop.signal,
        loop.disturbance,
        target=loop.target,
        plant_model=loop.plant_model,
        w0=loop.w0,
        supervisor_w0=loop.supervisor_w0,
        previous_sample_terms=loop.previous_sample_terms,
        overrides=dict(loop.overrides),
        fmus=fmus,
    ) as system:
        record = [name for name in system.outputs() if name.split(".")[-1] in RECORDED]
        return simulate(system, TS, TS, loop.steps, order=loop.order, record=record)


def cost(loop: Loop) -> tuple[int, str]:
    """Return a key that sorts cheap loops first: steps times FMUs."""
    return loop.steps * (5 if loop.target == "supervisor" else 3), repr(loop)


def start(pool: Pool, loops: Iterable[Loop], fmus: Path) -> dict[Loop, AsyncResult]:
    """Have the loops co-simulated, the longest first so that no core idles at the end."""
    ordered = sorted(set(loops), key=cost, reverse=True)
    return {loop: pool.apply_async(execute, (loop, fmus)) for loop in ordered}
