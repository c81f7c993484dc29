"""Noise and delay in the measured angle."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...loop import TS, Loop
from ...master import Component, System, simulate
from ..claims import Finding, Table, judge
from ..data import Data, Trace, trace_of
from ..figure import Curve, Figure, Panel
from ..metrics import largest, rms
from ..numbers import listing, number
from ..page import Part
from .learning import RINGING
from .measurement import Measurement
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
class Measured:
    """A step response with a noisy or delayed measurement.

    Parameters
    ----------
    kind
        Key of MODELS; the controllers use current terms.
    deviation
        Standard deviation of the noise [rad].
    delay
        Delay in samples.
    """

    kind: str
    deviation: float = 0.0
    delay: int = 0
    steps: int = STEPS


def loops() -> list[Loop]:
    """Return no loops: those of this section contain a measurement, and `jobs` returns them."""
    return []


def jobs() -> list[Measured]:
    """Return all step responses of the section."""
    noisy = [Measured(kind, deviation) for kind in MODELS for deviation in DEVIATIONS]
    return noisy + [Measured(kind, delay=delay) for kind in MODELS for delay in DELAYS]


def execute(job: Measured, fmus: Path) -> dict[str, np.ndarray]:
    """Co-simulate the FMUs and the measurement."""
    with ExitStack() as stack:

        def fmu(name: str, model: str, sampled: bool = False) -> Component:
            path = fmus / f"{model}.fmu"
            return stack.enter_context(Component(name, path, sampled=sampled))

        components = [
            Measurement("measurement", job.deviation, job.delay),
            fmu("controller", MODELS[job.kind], sampled=True),
            fmu("plant", "Pendulum"),
            fmu("source", "Source"),
        ]
        connections = [
            ("plant.theta", "measurement.theta"),
            ("measurement.y", "controller.y"),
            ("source.r", "controller.r"),
            ("controller.u", "plant.u"),
        ]
        system = System(components, connections)
        record = [f"controller.{name}" for name in ("u", "u_p", "e")]
        record += ["plant.theta", "source.r", "source.d"]
        return simulate(system, TS, TS, job.steps, record=record)


def late(results: dict, job: Measured) -> Trace:
    """Return the evaluated part of a run."""
    return trace_of(repr(job), results[job]).part(LATE, np.inf)


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    results = data.results
    noise = {
        kind: [late(results, Measured(kind, deviation)) for deviation in DEVIATIONS]
        for kind in MODELS
    }
    quiet = {kind: late(results, Measured(kind)) for kind in MODELS}
    off = {kind: [rms(t.theta - quiet[kind].theta) for t in noise[kind]] for kind in MODELS}
    force = {kind: [rms(np.diff(t.u)) for t in noise[kind]] for kind in MODELS}
    ring = {
        kind: [largest(np.diff(late(results, Measured(kind, delay=n)).u)) for n in DELAYS]
        for kind in MODELS
    }
    tolerated = {kind: sum(1 for _ in _until_ringing(values)) - 1 for kind, values in ring.items()}
    more = [
        min(off["PID-RBF"][i], off["IPID-RBF own"][i]) > off["PID"][i]
        for i in range(len(DEVIATIONS))
    ]
    contrary = [d for d, larger in zip(DEVIATIONS, more, strict=True) if not larger]
    rows = {}
    for i, deviation in enumerate(DEVIATIONS):
        rows[f"RMS of Δθ, noise {number(deviation, 1)} rad [rad]"] = [
            off[kind][i] for kind in MODELS
        ]
        rows[f"RMS change of u, noise {number(deviation, 1)} rad [N]"] = [
            force[kind][i] for kind in MODELS
        ]
    return section(
        "beyond-noise",
        "Noise and delay",
        figure(off, ring),
        [
            statement(
                "Measurement noise moves the pendulum more with a network than with the PID alone",
                f"step, white noise, RMS from {LATE:g} s to {STEPS * TS:g} s of the difference of θ"
                " from the same run without noise; holds if larger for both at the smallest noise,"
                " fully if at every noise level",
                Finding(
                    judge(more[0], all(more)),
                    Table(COLUMNS, rows),
                    f"Not at {listing(contrary, 'rad')}." if contrary else "",
                ),
            ),
            statement(
                "A measurement delay makes the networks ring at delays that the PID tolerates",
                "step; largest delay up to which u changes by less than 1 N per sample from"
                f" {LATE:g} s on; holds if it is larger for PID than for both networks",
                Finding(
                    judge(tolerated["PID"] > max(tolerated["PID-RBF"], tolerated["IPID-RBF own"])),
                    Table(
                        COLUMNS,
                        {
                            "delay without ringing [samples]": list(tolerated.values()),
                            **{
                                f"change of u, delay {n} [N]": [ring[kind][n] for kind in MODELS]
                                for n in DELAYS
                            },
                        },
                    ),
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
