"""Draw what bus load and lost frames do to the controllers: `python picture.py [FILE]`.

It needs the FMUs of `make fmus`, those of this folder, and the module of `make module`.
"""

import sys
import tomllib
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fmu_master import System

ROOT = Path(__file__).resolve().parents[2]
LOOP = ROOT / "examples" / "can" / "loop.toml"
CONTROLLERS = {"PID": "CanPid", "PID-RBF": "CanPidRbf", "IPID-RBF": "CanIpidRbf"}

PERIODS = [0.01, 0.001, 0.0007, 0.00055, 0.0005]
"""Times between the frames of higher priority [s]."""

LOSSES = [0.0, 0.05, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2]
"""Probabilities that a frame is lost."""


def loop(controller: str) -> System:
    """Return the loop with a controller."""
    keys = tomllib.loads(LOOP.read_text())
    components = {component.pop("name"): component for component in keys.pop("component")}
    components["controller"]["fmu"] = f"../../target/examples/{controller}_fmi3.fmu"
    for component in components.values():
        component["fmu"] = str((LOOP.parent / component["fmu"]).resolve())
    return System(components=components, **keys)


def runs(controller: str, name: str, values: list[float], fixed: dict) -> list[tuple]:
    """Return the load of the bus and the deviation of the angle for each value."""
    found = []
    with loop(controller).loaded() as system:
        for value in values:
            start = {"source.signal": "sine", name: value} | fixed
            result = system.simulate(start, stop_time=4.0)
            # Without the transient of the beginning.
            time = result["time"]
            late = time > 1.5
            deviation = (result["source.r"] - result["plant.theta"])[late]
            load = result["bus.busy"][-1] / time[-1]
            found.append((load, np.sqrt(np.mean(deviation**2))))
    return found


def draw() -> Figure:
    """Draw the deviation of the angle over the load, and over the probability of losses."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, controller in CONTROLLERS.items():
        loads = runs(controller, "urgent.period", PERIODS, {})
        losses = runs(controller, "bus.loss", LOSSES, {"bus.seed": 1})
        left.plot([100 * load for load, _ in loads], [rms for _, rms in loads], "o-", label=name)
        right.plot([100 * loss for loss in LOSSES], [rms for _, rms in losses], "o-", label=name)
    left.set(xlabel="load of the bus [%]", ylabel="RMS of r - θ [rad]", yscale="log")
    # The deviation of a loop that has become unstable is beyond.
    right.set(xlabel="lost frames [%]", yscale="log", ylim=(1e-4, 10))
    for axis in (left, right):
        axis.grid(alpha=0.3)
    right.legend()
    return figure


def main() -> None:
    """Write the picture."""
    file = sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs" / "bus.svg"
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "docs", "font.size": 8}
    draw().savefig(file, metadata={"Date": None})


if __name__ == "__main__":
    main()
