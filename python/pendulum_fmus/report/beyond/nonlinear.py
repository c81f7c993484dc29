"""The nonlinear pendulum: range in which the linear design stabilizes it."""

import math
from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Finding, Table, judge
from ..data import Data
from ..figure import ANGLE, Curve, Figure, Panel
from ..native import both_plants, sweep
from ..page import Part
from ..paper.compare import COLUMNS
from ..scenarios import KINDS
from .section import section, statement

FALLEN = math.pi
"""|e| above which the pendulum has fallen [rad]."""

HELD = 0.05
"""A pendulum with a smaller final error is stabilized [rad]."""

GRID = 17
ROUNDS = 3
"""Each round tries GRID values; the next refines between the last success and first failure."""

SMALL = math.radians(20)
"""Angle up to which section 2 considers the linear model valid [rad]."""

ALIKE = 0.05
"""Relative difference below which integrals of |e| count as equal."""

MODELS = {"PID": "Pid", "PID-RBF": "PidRbf", "IPID-RBF own": "IpidRbf"}


def loop(kind: str, model: str) -> Loop:
    """Return the loop with a step of 1 rad on a model of the plant."""
    return Loop(MODELS[kind], "step", 0.0, steps=8000, plant_model=model)


def loops() -> list[Loop]:
    """Return the loops shown in the figure, with steps of 1 rad."""
    return [loop(kind, model) for kind in MODELS for model in ("linear", "nonlinear")]


def largest_held(kind: str, variables: list[str], settings: dict, fmus: Path) -> float:
    """Return the limit of some variables [rad] for a stabilized pendulum, by narrowing grids."""
    settings = settings | dict.fromkeys(both_plants(kind, "model"), "nonlinear")
    low, high = 0.05, math.pi / 2
    for _ in range(ROUNDS):
        values = np.linspace(low, high, GRID)
        runs = sweep(kind, variables, values, settings, FALLEN, fmus)
        lost = (runs["diverged"] > 0) | ~(np.abs(runs["final_e"]) < HELD)
        first = int(np.argmax(lost)) if lost.any() else len(values)
        if first in (0, len(values)):
            return math.nan if first == 0 else high
        low, high = values[first - 1], values[first]
    return float(low)


def areas(kind: str, model: str, fmus: Path) -> np.ndarray:
    """Return the integrals of |e| of steps of 20° and of 1 rad [rad s], shape (2,)."""
    settings = dict.fromkeys(both_plants(kind, "model"), model)
    amplitudes = np.array([SMALL, 1.0])
    return sweep(kind, ["source.amplitude"], amplitudes, settings, FALLEN, fmus)["iae"]


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    step = [largest_held(kind, ["source.amplitude"], {}, fmus) for kind in KINDS]
    zero = {"source.amplitude": 0.0}
    start = [largest_held(kind, both_plants(kind, "theta0"), zero, fmus) for kind in KINDS]
    apart = np.array(
        [areas(kind, "nonlinear", fmus) / areas(kind, "linear", fmus) - 1 for kind in KINDS]
    )
    paper = all(angle > 1 for angle in step)
    return section(
        "beyond-nonlinear",
        "The nonlinear pendulum",
        figure(data),
        [
            statement(
                "The controllers, designed for the linear model, stabilize the nonlinear pendulum"
                " far beyond the 20° up to which section 2 linearises",
                "largest step, and largest initial angle at set-point 0, after which |e| is below"
                " 0.05 rad at 20 s and never above π; holds if all are beyond 20°, fully if all"
                " steps also exceed the paper’s 1 rad",
                Finding(
                    judge(min(*step, *start) > SMALL, paper),
                    Table(
                        COLUMNS,
                        {
                            "largest step [rad]": step,
                            "largest step [°]": [math.degrees(v) for v in step],
                            "largest initial angle [rad]": start,
                            "largest initial angle [°]": [math.degrees(v) for v in start],
                        },
                    ),
                ),
            ),
            statement(
                "At 20° the nonlinear pendulum behaves like the linear one",
                "integral of |e| after a step, nonlinear against linear; holds if it differs by"
                " less than 5 % at 20°, fully if also at 1 rad, the paper’s step",
                Finding(
                    judge(np.max(np.abs(apart[:, 0])) < ALIKE, np.max(np.abs(apart)) < ALIKE),
                    Table(
                        COLUMNS,
                        {
                            "difference of IAE at 20° [%]": (100 * apart[:, 0]).tolist(),
                            "difference of IAE at 1 rad [%]": (100 * apart[:, 1]).tolist(),
                        },
                    ),
                ),
            ),
        ],
        ("Sweeps with the native master narrowed the limits down to less than 0.001 rad.",),
    )


def figure(data: Data) -> Figure:
    """Return the figure of a step of 1 rad on both models."""
    panels = []
    for model in ("linear", "nonlinear"):
        traces = {kind: data.loop(loop(kind, model)) for kind in MODELS}
        curves = [Curve(f"{t.key}/theta", t.t, t.theta, kind) for kind, t in traces.items()]
        panels.append(Panel(f"{model} plant", ANGLE, curves, xlim=(0, 8), ylim=(0, 1.4)))
    return Figure(
        "nonlinear",
        "The nonlinear pendulum",
        "Angle over 8 s after a step of 1 rad with PID, PID-RBF and IPID-RBF with its own target,"
        " on the linear and the nonlinear plant.",
        [panels],
    )
