"""The loops of the report, run by the native master, and the columns of one controller in them.

The native master computes the same bits as that on FMPy, but faster.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np

from .. import table1
from ..loop import TS, Columns, Loop, exported, run_all
from ..master import MasterError
from ..project import FMUS, SENSOR

SIGNALS = ("step", "sine", "square")

AMPLITUDES = {"step": (0.0, 1.0), "sine": (0.0, 1.0, 2.0), "square": (0.0, 1.0, 2.0)}
"""Disturbances [rad]: none, the one of Table 1, and the one of the text on Figures 12 and 14."""

KINDS = ("PID", "PID-RBF", "IPID-RBF", "IPID-RBF own")
"""The controllers: IPID-RBF learns the supervisor's force as in Table 1 or its own as in (29)."""

SHOWN = KINDS[:3]
"""The controllers compared in the paper's figures."""

END = 20.0
"""End time of all figures [s]."""

GAINS = {"kp": 300.0, "ki": 500.0, "kd": 100.0}
"""The paper's gains [N/rad, N/(rad s), N s/rad]."""

FACTORS = (0.5, 1.0, 2.0)
"""Factors of each gain in Figure 2; the paper gives its own only in the picture."""

LASTING = 110_000
"""Samples after which the force that holds 1 rad has passed its limit."""

TRANSFER_FUNCTION = Loop("Pid", plant_model="transfer_function")
"""The step response of the PID on (41)."""

WEIGHTS = tuple(Loop("PidRbf", w0=(0.0, 0.0, weight, 0.0), steps=10) for weight in (0.0, 1.0))
"""Two loops whose initial weights differ."""

ALONE = {"PID": "Pid", "PID-RBF": "PidRbf", "IPID-RBF own": "IpidRbf"}
"""The FMUs of the controllers that need no supervisor."""


def loop_of(kind: str, signal: str = "step", amplitude: float = 0.0, **changes: Any) -> Loop:
    """Return the loop of Table 1 with a controller and a disturbance of `amplitude` [rad].

    PID-RBF is the supervisor in the loop of IPID-RBF.
    """
    if kind in ("PID", "IPID-RBF own"):
        return Loop(ALONE[kind], signal, amplitude, **changes)
    return Loop("IpidRbf", signal, amplitude, "supervisor", **changes)


def gain_loop(gain: str, factor: float) -> Loop:
    """Return the step response of the PID with one gain multiplied."""
    changed = ((f"controller.pid.{gain}", GAINS[gain] * factor),) if factor != 1 else ()
    return Loop("Pid", overrides=changed)


def lasting_loops() -> set[Loop]:
    """Return steps that are held for LASTING samples."""
    return {loop_of(kind, steps=LASTING) for kind in KINDS}


def paper_loops() -> set[Loop]:
    """Return all loops that the paper's figures and Table 1 need, but for the lasting ones."""
    shown = {loop_of(k, s, a) for k in KINDS for s in SIGNALS for a in AMPLITUDES[s]}
    gains = {gain_loop(gain, factor) for gain in GAINS for factor in FACTORS}
    return shown | gains | {TRANSFER_FUNCTION, *WEIGHTS} | table1.runs()


# --- results ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trace:
    """The results of one controller in one loop; all columns have shape (steps,)."""

    key: str  # unique, for the columns of the page
    signal: str
    amplitude: float  # of the disturbance [rad]
    t: np.ndarray  # time [s]
    r: np.ndarray | None  # reference [rad]
    d: np.ndarray | None  # disturbance [rad]
    theta: np.ndarray  # angle of the pendulum [rad]
    e: np.ndarray  # r - (theta + d) [rad]
    u: np.ndarray  # force [N]
    u_p: np.ndarray | None = None  # the PID's part of the force [N]
    u_n: np.ndarray | None = None  # the network's part [N]
    x: np.ndarray | None = None  # position of the cart [m]

    @property
    def height(self) -> float:
        """Height of the jumps of the reference, or the amplitude of a sine [rad]."""
        return 2.0 if self.signal == "square" else 1.0

    @property
    def ts(self) -> float:
        """Time between two samples [s]."""
        return float(self.t[1] - self.t[0])

    def part(self, *spans: tuple[float, float]) -> "Trace":
        """Return the samples with start <= t < stop [s] of some spans, t in whole microseconds."""
        t = np.round(self.t, 6)
        inside = np.logical_or.reduce([(t >= start) & (t < stop) for start, stop in spans])
        columns = {n: c[inside] for n, c in vars(self).items() if isinstance(c, np.ndarray)}
        return replace(self, key=f"{self.key}, {np.count_nonzero(inside)} samples", **columns)


class Data:
    """Results by loop, and their traces."""

    def __init__(
        self, results: Mapping[Loop, Columns], fmus: Path = FMUS, pool: Pool | None = None
    ):
        self.results, self.fmus, self.pool = dict(results), fmus, pool

    def __call__(self, kind: str, signal: str = "step", amplitude: float = 0.0) -> Trace:
        """Return the trace of a controller for a signal and a disturbance of `amplitude` [rad]."""
        key = f"{kind}/{signal}/{amplitude:g}"
        return self.loop(loop_of(kind, signal, amplitude), kind, key)

    def simulated(self, loops: Iterable[Loop]) -> list[Trace]:
        """Return the traces of some loops, which are simulated if they have not been."""
        loops = list(loops)
        missing = set(loops) - self.results.keys()
        self.results |= simulate_all(missing, self.fmus, self.pool)
        return [self.loop(loop) for loop in loops]

    def gains(self, gain: str, factor: float) -> Trace:
        """Return the step response of the PID with one gain multiplied by `factor`."""
        return self.loop(gain_loop(gain, factor), "PID", f"{gain}*{factor:g}")

    def lasting(self, kind: str) -> Trace:
        """Return t, theta, e and u of a step that is held for LASTING samples."""
        return self.loop(loop_of(kind, steps=LASTING), kind, f"{kind}/lasting")

    def loop(self, loop: Loop, kind: str = "", key: str = "") -> Trace:
        """Return the trace of a controller in any loop; `key` is the loop's text by default."""
        columns, beside = self.results[loop], kind == "PID-RBF" and loop.target == "supervisor"
        owners = dict.fromkeys(("theta", "x"), "supervisor_plant" if beside else "plant")
        owners |= dict.fromkeys(("e", "u", "u_p", "u_n"), "supervisor" if beside else "controller")
        owners |= {"r": "source", "d": "source"}
        found = {name: columns.get(f"{owner}.{name}") for name, owner in owners.items()}
        key = key or repr(loop)
        return Trace(key, loop.signal, loop.disturbance, columns["time"], **found)


# --- the native master --------------------------------------------------------------------------


def simulate_all(loops: Iterable[Loop], fmus: Path, pool: Pool, **options: Any) -> dict:
    """Simulate many loops with a pool; return the columns of each as `simulate` does."""
    return run_all(pool, loops, partial(simulate, fmus=fmus, **options))


def simulate(
    loop: Loop, fmus: Path, *, only: Sequence[str] = (), last: int = 0, may_diverge: bool = False
) -> dict[str, np.ndarray]:
    """Simulate a loop at 1 ms, from the paper's k = 1.

    Returns "time" and the outputs RECORDED, or `only` some of them, by full name. The columns have
    shape (steps,), or (last,) if only the last samples are asked for. A loop that diverges is an
    error, or has no columns if it `may_diverge`.
    """
    import fmu_master  # here, because the demo draws a figure of the report without it

    try:
        # The FMUs are the project's own, so a run needs no process of its own
        result = _system(loop, fmus).simulate(output=loop.recorded(only), in_process=True)
    except fmu_master.FmuError as error:
        if may_diverge and "the simulation diverges" in str(error):
            return {}
        raise MasterError(f"{loop!r}: {error}") from error
    return {name: column[-last:] for name, column in result.items()}


def alone(kind: str, **changes: Any) -> Loop:
    """Return the step response of a controller; PID-RBF is not a supervisor here."""
    return Loop(ALONE[kind], **changes) if kind in ALONE else loop_of(kind, **changes)


def both_plants(kind: str, variable: str) -> list[str]:
    """Return the full names of a plant parameter in all plants of a loop."""
    models = alone(kind).models().items()
    return [f"{name}.{variable}" for name, model in models if model == "Pendulum"]


def sweep(
    loop: Loop,
    parameters: Sequence[Mapping[str, Any]],
    fmus: Path,
    *,
    limit: float = 1000.0,
    draws: int = 1,
) -> dict[str, np.ndarray]:
    """Run a loop with parameters as in the file of a sweep, each with its `variables`.

    A run has diverged if |e| is above the limit [rad]. Returns the metrics by name, each of shape
    (runs,); NaN where a run has no value.
    """
    import fmu_master

    signals = {"reference": "source.r", "output": "plant.theta"}
    signals |= {"error": "controller.e", "control": "controller.u"}
    plan = {"parameter": list(parameters), "seed": 1, "draws": draws, "metrics": {"limit": limit}}
    try:
        runs = fmu_master.sweep(plan, _system(loop, fmus), signals=signals)
    except fmu_master.FmuError as error:
        raise MasterError(f"the sweep of {loop}: {error}") from error
    return {name: column.astype(float) for name, column in runs.items() if name != "failure"}


def _system(loop: Loop, fmus: Path) -> Any:
    import fmu_master

    starts = loop.starts()
    return fmu_master.System(
        components={
            name: {"fmu": _fmu(model, fmus), "start": starts[name]}
            for name, model in loop.models().items()
        },
        connections=list(loop.connections()),
        start=TS,
        stop=TS * loop.steps,
        step=TS,
        order=loop.order,
    )


def _fmu(model: str, fmus: Path) -> Path:
    """Return the absolute path of an FMU, which exists."""
    return exported(SENSOR if model == "Sensor" else fmus / f"{model}.fmu").resolve()
