"""Noise and delay of the measured angle."""

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
"""From when on it is measured [s], of STEPS samples."""


@dataclass(frozen=True)
class Measured:
    """A step response with a controller whose measurement is noisy or late.

    Parameters
    ----------
    kind
        Key of MODELS; the controllers use current terms.
    deviation
        Of the noise [rad].
    delay
        In samples.
    """

    kind: str
    deviation: float = 0.0
    delay: int = 0
    steps: int = STEPS


def loops() -> list[Loop]:
    """Return no loops: here a measurement stands between; `jobs` returns those."""
    return []


def jobs() -> list[Measured]:
    """Return all step responses of the section."""
    noisy = [Measured(kind, deviation) for kind in MODELS for deviation in DEVIATIONS]
    return noisy + [Measured(kind, delay=delay) for kind in MODELS for delay in DELAYS]


def execute(job: Measured, fmus: Path) -> dict[str, np.ndarray]:
    """Co-simulate FMUs and the measurement."""
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
    """Return the end of a run."""
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
    bears = {kind: sum(1 for _ in _until_ringing(values)) - 1 for kind, values in ring.items()}
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
                "Noise of the measured angle moves the pendulum more under a network than under"
                " the PID",
                f"step, white noise, RMS from {LATE:g} s to {STEPS * TS:g} s of what θ differs by"
                " from the same without noise; holds if larger for both at the smallest noise,"
                " wholly if at every",
                Finding(
                    judge(more[0], all(more)),
                    Table(COLUMNS, rows),
                    f"Not at {listing(contrary, 'rad')}." if contrary else "",
                ),
            ),
            statement(
                "A late measurement makes the networks ring at delays that the PID bears",
                "step; largest delay up to which u changes by less than 1 N per sample from"
                f" {LATE:g} s on; holds if that of PID is larger than that of both",
                Finding(
                    judge(bears["PID"] > max(bears["PID-RBF"], bears["IPID-RBF own"])),
                    Table(
                        COLUMNS,
                        {
                            "delay without ringing [samples]": list(bears.values()),
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
    """Return what noise and delay do, over their size."""
    x = np.array(DEVIATIONS)
    n = np.array(DELAYS, float)
    return Figure(
        "noise",
        "Noise and delay",
        "Left, how much the angle moves over the standard deviation of the measurement noise;"
        " right, how much the force changes per sample over the delay of the measurement.",
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
