"""The loops shown in the paper's figures."""

from dataclasses import replace

from .. import table1
from ..loop import Loop

SIGNALS = ("step", "sine", "square")

AMPLITUDES = {"step": (0.0, 1.0), "sine": (0.0, 1.0, 2.0), "square": (0.0, 1.0, 2.0)}
"""Disturbances [rad]: none, that of Table 1, and that of the text on Figures 12 and 14."""

KINDS = ("PID", "PID-RBF", "IPID-RBF", "IPID-RBF own")
"""The controllers: IPID-RBF learns the supervisor's force as in Table 1 or its own as in (29)."""

GAINS = {"kp": 300.0, "ki": 500.0, "kd": 100.0}
"""The paper's gains [N/rad, N/(rad s), N s/rad]."""

FACTORS = (0.5, 1.0, 2.0)
"""Factors of each gain in Figure 2; the paper gives its own only in the picture."""


def loops_of(signal: str, amplitude: float) -> dict[str, tuple[Loop, str, str]]:
    """Return, by kind, the loop and the names of its controller and plant.

    IPID-RBF learns the supervisor's force as in Table 1, "IPID-RBF own" learns its own as in (29).
    """
    supervised = Loop("IpidRbf", signal, amplitude, "supervisor")
    return {
        "PID": (Loop("Pid", signal, amplitude), "controller", "plant"),
        "PID-RBF": (supervised, "supervisor", "supervisor_plant"),
        "IPID-RBF": (supervised, "controller", "plant"),
        "IPID-RBF own": (Loop("IpidRbf", signal, amplitude), "controller", "plant"),
    }


LASTING = 110_000
"""Samples after which the force that holds 1 rad has passed its limit."""

TRANSFER_FUNCTION = Loop("Pid", "step", plant_model="transfer_function")
"""The step response of the PID on (41)."""

WEIGHTS = tuple(
    Loop("PidRbf", "step", w0=(0.0, 0.0, weight, 0.0), steps=10) for weight in (0.0, 1.0)
)
"""Two loops whose initial weights differ."""


def lasting_loop(kind: str) -> tuple[Loop, str, str]:
    """Return a step held for LASTING samples, and the names of its controller and plant."""
    loop, controller, plant = loops_of("step", 0.0)[kind]
    return replace(loop, steps=LASTING), controller, plant


def lasting_loops() -> set[Loop]:
    """Return all long steps."""
    return {lasting_loop(kind)[0] for kind in KINDS}


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
    return shown | gains | {TRANSFER_FUNCTION, *WEIGHTS} | table1.runs()
