"""Noise and delay in the measured angle."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...loop import TS, Loop
from ..claims import Finding, Row
from ..data import Data, Trace
from ..figure import Curve, Figure, Panel
from ..metrics import largest, rms
from ..numbers import number
from ..parts import Part
from .learning import RINGING
from .section import section, statement

MODELS = {"PID": "Pid", "PID-RBF": "PidRbf", "IPID-RBF own": "IpidRbf"}
COLUMNS = ("PID", "PID-RBF", "IPID-RBF, own")

DEVIATIONS = (1e-6, 1e-5, 1e-4, 1e-3)
"""Standard deviations of the noise [rad]."""

DELAYS = tuple(range(9))
"""Delays [samples]."""

STEPS = 5000
LATE = 3.0
"""Start of the evaluated part [s] of STEPS samples."""


@dataclass(frozen=True)
class Measured(Loop):
    """A loop with the sensor of `examples/sensor` between plant and controller.

    Parameters
    ----------
    noise
        Standard deviation of the noise [rad].
    delay
        Delay in samples.
    """

    noise: float = 0.0
    delay: int = 0

    def models(self) -> dict[str, str]:
        """Return the FMUs; the sensor measures first."""
        return {"sensor": "Sensor", **super().models()}

    def starts(self) -> dict[str, dict[str, Any]]:
        """Return the start values."""
        starts = super().starts()
        starts["sensor"] |= {"noise": self.noise, "delay": self.delay}
        return starts

    def connections(self) -> list[tuple[str, str]]:
        """Return the connections, through the sensor."""
        direct = super().connections()
        direct.remove(("plant.theta", "controller.y"))
        return [*direct, ("plant.theta", "sensor.theta"), ("sensor.y", "controller.y")]


def measured(kind: str, noise: float = 0.0, delay: int = 0) -> Measured:
    """Return the step response of a controller, a key of MODELS, with current terms."""
    return Measured(
        MODELS[kind], previous_sample_terms=False, steps=STEPS, noise=noise, delay=delay
    )


def loops() -> list[Loop]:
    """Return all step responses of the section."""
    noisy = [measured(kind, deviation) for kind in MODELS for deviation in DEVIATIONS]
    return noisy + [measured(kind, delay=delay) for kind in MODELS for delay in DELAYS]


def late(data: Data, loop: Loop) -> Trace:
    """Return the evaluated part of a run."""
    return data.loop(loop).part(LATE, np.inf)


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    noise = {
        kind: [late(data, measured(kind, deviation)) for deviation in DEVIATIONS] for kind in MODELS
    }
    quiet = {kind: late(data, measured(kind)) for kind in MODELS}
    off = {kind: [rms(t.theta - quiet[kind].theta) for t in noise[kind]] for kind in MODELS}
    force = {kind: [rms(np.diff(t.u)) for t in noise[kind]] for kind in MODELS}
    ring = {
        kind: [largest(np.diff(late(data, measured(kind, delay=n)).u)) for n in DELAYS]
        for kind in MODELS
    }
    tolerated = {kind: sum(1 for _ in _until_ringing(values)) - 1 for kind, values in ring.items()}
    rows = []
    for i, deviation in enumerate(DEVIATIONS):
        moved = [values[i] for values in off.values()]
        name = f"noise {number(deviation, 1)} rad"
        rows.append(Row(f"RMS of Δθ, {name} [rad]", moved, min(moved[1:]) > moved[0]))
        rows.append(Row(f"RMS change of u, {name} [N]", [force[kind][i] for kind in MODELS]))
    borne = list(tolerated.values())
    return section(
        "beyond-noise",
        "Noise and delay",
        figure(off, ring),
        [
            statement(
                "Measurement noise moves the pendulum more with a network than with the PID alone",
                f"step, white noise, RMS from {LATE:g} s to {STEPS * TS:g} s of the difference of θ"
                " from the same run without noise: larger for both networks than for PID, at each"
                " noise",
                Finding(COLUMNS, rows),
            ),
            statement(
                "A measurement delay makes the networks ring at delays that the PID tolerates",
                "step; the largest delay up to which u changes by less than 1 N per sample from"
                f" {LATE:g} s on is larger for PID than for both networks",
                Finding(
                    COLUMNS,
                    [
                        Row("delay without ringing [samples]", borne, borne[0] > max(borne[1:])),
                        *(
                            Row(f"change of u, delay {n} [N]", [ring[kind][n] for kind in MODELS])
                            for n in DELAYS
                        ),
                    ],
                ),
            ),
        ],
        ("All controllers use current terms here; the noise has a new value every millisecond.",),
    )


def _until_ringing(values: list[float]):
    for value in values:
        if value >= RINGING:
            return
        yield value


def figure(off: dict[str, list[float]], ring: dict[str, list[float]]) -> Figure:
    """Return the figure of the effects of noise and delay."""
    x = np.array(DEVIATIONS)
    n = np.array(DELAYS, float)
    return Figure(
        "noise",
        "Noise and delay",
        "Left, RMS movement of the angle over the standard deviation of the measurement noise;"
        " right, change of the force per sample over the measurement delay.",
        [
            [
                Panel(
                    "noise",
                    "RMS of Δθ [rad]",
                    [Curve(f"noise/{k}", x, np.array(v), k) for k, v in off.items()],
                    x_label="noise, standard deviation [rad]",
                    log_x=True,
                    log_y=True,
                ),
                Panel(
                    "delay",
                    "change of u per sample [N]",
                    [Curve(f"delay/{k}", n, np.maximum(v, 1e-4), k) for k, v in ring.items()],
                    x_label="delay [samples]",
                    log_y=True,
                ),
            ]
        ],
    )
