"""The closed loops of the paper: source, controller and plant, coupled at 1 ms."""

import argparse
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from .master import Component, FmpySystem, MasterError, simulate
from .project import FMUS, REPORT, SENSOR

TS = 0.001
"""Sample time of the paper's controllers [s]."""

STEPS = 20000
"""Samples per run in the paper; Table 1 gives the errors of the last one."""

FREQUENCY = {"sine": 0.2, "square": 0.1}
"""Frequencies of the paper's signals [Hz]."""

PREVIOUS_SAMPLE_TERMS = {"Pid": True, "PidRbf": True, "IpidRbf": False}
"""Whether u(k) uses the PID terms of sample k-1, as in the paper's Table 1."""

SETTLING_BAND = 0.003
"""Half the width of the band in which a step response counts as settled, relative to the step."""

RECORDED = {
    "Pid": ("e", "u", "u_p"),
    "PidRbf": ("e", "u", "u_p", "u_n"),
    "IpidRbf": ("e", "u", "u_p", "u_n"),
    "Pendulum": ("theta", "x"),
    "Source": ("r", "d"),
    "Sensor": ("y",),
}
"""The outputs that are recorded, by FMU."""


@dataclass(frozen=True)
class Loop:
    """One closed loop of the paper: `source`, `controller` and `plant`.

    With the target "supervisor", a second PID-RBF loop (`supervisor` and `supervisor_plant`)
    runs alongside, and the network of `controller` learns its u.
    """

    controller: str  # "Pid", "PidRbf" or "IpidRbf"
    signal: str = "step"  # or "sine" (0.2 Hz), "square" (0.1 Hz); amplitude 1 rad
    disturbance: float = 0.0  # added to the measured angle from 5 s to 5.5 s [rad]
    target: str = "own"  # what the network of IpidRbf learns: its own u, or the "supervisor"'s
    w0: tuple[float, ...] | None = None  # initial weights, four [N]
    supervisor_w0: tuple[float, ...] | None = None
    plant_model: str = "linear"  # or "nonlinear", "transfer_function"
    previous_sample_terms: bool | None = None  # None: as in the paper's Table 1
    overrides: tuple[tuple[str, Any], ...] = ()  # start values: (("plant.M", 2.0),)
    order: str = "sequential"  # or "parallel"
    steps: int = STEPS  # communication points, 1 ms apart, that `execute` records
    fmi3: tuple[str, ...] = ()  # components whose FMU is of FMI 3.0; ("all",)
    sensor: tuple[float, int] | None = None  # between plant and controller: noise [rad], delay

    def models(self) -> dict[str, str]:
        """Return the FMU of each component, in the order of sequential stepping."""
        if self.controller not in PREVIOUS_SAMPLE_TERMS:
            raise MasterError(f"there is no controller {self.controller!r}")
        models = {"controller": self.controller, "plant": "Pendulum", "source": "Source"}
        if self.sensor:
            models = {"sensor": "Sensor", **models}  # measures first
        if self.target != "supervisor":
            return models
        if self.controller != "IpidRbf":
            raise MasterError(f"{self.controller} has no target {self.target!r}; only IpidRbf does")
        return {"supervisor": "PidRbf", "supervisor_plant": "Pendulum", **models}

    def starts(self) -> dict[str, dict[str, Any]]:
        """Return the start values of each component."""
        models, late = self.models(), self.previous_sample_terms
        starts: dict[str, dict[str, Any]] = {name: {} for name in models}
        starts["source"] |= {"signal": self.signal, "disturbance.amplitude": self.disturbance}
        if self.signal in FREQUENCY:
            starts["source"]["frequency"] = FREQUENCY[self.signal]
        if self.controller == "IpidRbf":
            starts["controller"]["rbf.target"] = self.target
        if self.sensor:
            starts["sensor"] = dict(zip(("noise", "delay"), self.sensor, strict=True))
        for name, model in models.items():
            if model == "Pendulum":
                starts[name]["dynamics"] = self.plant_model
            elif model in PREVIOUS_SAMPLE_TERMS:
                terms = PREVIOUS_SAMPLE_TERMS[model] if late is None else late
                starts[name]["previous_sample_terms"] = terms
        for name, weights in ("controller", self.w0), ("supervisor", self.supervisor_w0):
            if weights and name not in models:
                raise MasterError(f"there is no {name} to give initial weights to")
            for j, weight in enumerate(weights or (), start=1):
                starts[name][f"rbf.w0[{j}]"] = weight
        for name, value in self.overrides:
            component, _, variable = name.partition(".")
            if component not in models:
                known = ", ".join(models)
                raise MasterError(f"{name}: there is no component {component!r}, only {known}")
            starts[component][variable] = value
        return starts

    def connections(self) -> list[tuple[str, str]]:
        """Return pairs of output and input, by full name."""
        connections = _closed("controller", "plant")
        if self.sensor:
            connections[2:3] = [("plant.theta", "sensor.theta"), ("sensor.y", "controller.y")]
        if self.target == "supervisor":
            connections += _closed("supervisor", "supervisor_plant")
            connections.append(("supervisor.u", "controller.u_supervisor"))
        return connections

    def recorded(self, only: Container[str] = ()) -> list[str]:
        """Return the full names of the outputs to record: all RECORDED, or `only` some of them."""
        pairs = [(name, out) for name, fmu in self.models().items() for out in RECORDED[fmu]]
        return [f"{name}.{output}" for name, output in pairs if not only or output in only]

    def files(self) -> dict[str, str]:
        """Return the name of the FMU file of each component."""
        models = self.models()
        if unknown := set(self.fmi3) - {"all", *models}:
            known = ", ".join(models)
            raise MasterError(f"there is no component {unknown.pop()!r}, only {known} and all")
        new = models if "all" in self.fmi3 else self.fmi3
        return {name: f"{model}{'_fmi3' * (name in new)}.fmu" for name, model in models.items()}

    def system(self, fmus: str | os.PathLike = FMUS) -> FmpySystem:
        """Instantiate the FMUs of a folder; if one fails, the earlier ones are freed."""
        files, starts = self.files(), self.starts()
        with ExitStack() as stack:
            components = []
            for name, model in self.models().items():
                sampled = model in PREVIOUS_SAMPLE_TERMS
                path = exported(Path(fmus) / files[name])
                part = Component(name, path, starts[name], sampled=sampled)
                components.append(stack.enter_context(part))
            system = FmpySystem(components, self.connections())
            stack.pop_all()
        return system


def exported(path: Path) -> Path:
    """Return the path of an FMU; if there is none, say how to export it."""
    if not path.is_file():
        command = "cargo fmu export" + " --fmi 3.0" * path.stem.endswith("_fmi3")
        command = "make fmus" if path == SENSOR else command
        remedy = f"run `{command}` first, or name the folder of the FMUs"
        raise MasterError(f"{path} does not exist; {remedy}")
    return path


def _closed(controller: str, plant: str) -> list[tuple[str, str]]:
    """Return the connections of one loop."""
    return [
        ("source.r", f"{controller}.r"),
        ("source.d", f"{controller}.d"),
        (f"{plant}.theta", f"{controller}.y"),
        (f"{controller}.u", f"{plant}.u"),
    ]


def settling_time(time: np.ndarray, error: np.ndarray, band: float = SETTLING_BAND) -> float:
    """Return the time [s] from which on |error| stays within `band`; NaN if it never does.

    `time` and `error` are of shape (steps,), `error` and `band` in the same unit.
    """
    outside = np.flatnonzero(~(np.abs(error) <= band))
    settled = 0 if outside.size == 0 else outside[-1] + 1
    return float(time[settled]) if settled < len(time) else math.nan


# --- many loops ---------------------------------------------------------------------------------

Columns = Mapping[str, np.ndarray]
"""Columns of one run by full name, each of shape (steps,)."""


def execute(loop: Loop, fmus: Path = FMUS) -> dict[str, np.ndarray]:
    """Co-simulate one loop at 1 ms, from the paper's k = 1."""
    with loop.system(fmus) as system:
        return simulate(system, TS, TS, loop.steps, order=loop.order, record=loop.recorded())


@contextmanager
def workers() -> Iterator[Pool]:
    """Return a pool of as many processes as there are cores."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    # Spawned, not forked: a fork would copy the locks of a threaded parent
    with multiprocessing.get_context("spawn").Pool(count) as pool:
        yield pool
        # Leaving the context kills the workers, which leaks semaphores unless they have finished
        pool.close()
        pool.join()


def run_all(
    pool: Pool, loops: Iterable[Loop], run: Callable[[Loop], Columns] = execute
) -> dict[Loop, Columns]:
    """Run loops in the processes of a pool, the longest first so that none idles at the end."""
    cost = {loop: (loop.steps * len(loop.models()), repr(loop)) for loop in loops}
    ordered = sorted(cost, key=cost.__getitem__, reverse=True)
    bar = tqdm(pool.imap(run, ordered), total=len(ordered), unit="loop", leave=False, disable=None)
    return dict(zip(ordered, bar, strict=True))


# --- programs -----------------------------------------------------------------------------------


def parser(
    module: str, description: str, *, out: bool = False, **settings: Any
) -> argparse.ArgumentParser:
    """Return a parser with the options shared by all programs; `out` adds the output folder."""
    parser = argparse.ArgumentParser(
        f"python -m pendulum_fmus.{module}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        **settings,
    )
    folders = {"--fmus": (FMUS, "folder of the FMUs"), "--out": (REPORT, "output folder")}
    for option, (folder, what) in folders.items():
        if out or option != "--out":
            shown = f"{what} (default: %(default)s)"
            parser.add_argument(option, type=Path, default=folder, metavar="DIR", help=shown)
    return parser


def finish(
    parser: argparse.ArgumentParser,
    run: Callable[[argparse.Namespace], bool],
    arguments: Sequence[str] | None = None,
) -> int:
    """Run a program; return its exit status: 0 if it returns true, and 1 after an error."""
    try:
        return 0 if run(parser.parse_args(arguments)) else 1
    except (MasterError, ModuleNotFoundError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        return 130
    return 1
