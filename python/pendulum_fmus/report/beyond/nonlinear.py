"""The nonlinear pendulum: range in which the linear design stabilizes it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Finding, Row
from ..data import Data, trace_of
from ..figure import ANGLE, Curve, Figure, Panel
from ..native import both_plants, sweep
from ..paper.compare import COLUMNS
from ..parts import Part
from ..scenarios import KINDS, loops_of
from .section import section, statement

FALLEN = math.pi
"""|e| above which the pendulum has fallen [rad]."""

HELD = 0.05
"""A pendulum with a smaller final error is stabilized [rad]."""

GRID = 6
ROUNDS = 5
"""Each round tries GRID values; the next refines between the last success and first failure."""

SMALL = math.radians(20)
"""Angle up to which section 2 considers the linear model valid [rad]."""

ALIKE = 0.05
"""Relative difference below which integrals of |e| count as equal."""

SHOWN = 8000
"""Samples of the figure."""


def loop(kind: str, model: str) -> tuple[Loop, str, str]:
    """Return the loop with a step of 1 rad on a model of the plant, and names as `loops_of`."""
    linear, controller, plant = loops_of("step", 0.0)[kind]
    return replace(linear, steps=SHOWN, plant_model=model), controller, plant


def loops() -> list[Loop]:
    """Return the loops shown in the figure, with steps of 1 rad."""
    return [loop(kind, model)[0] for kind in KINDS for model in ("linear", "nonlinear")]


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
    return section(
        "beyond-nonlinear",
        "The nonlinear pendulum",
        figure(data),
        [
            statement(
                "The controllers, designed for the linear model, stabilize the nonlinear pendulum"
                " far beyond the 20° up to which section 2 linearizes, and beyond the paper’s step",
                "largest step, and largest initial angle at set-point 0, after which |e| is below"
                " 0.05 rad at 20 s and never above π: all are beyond 20°; all steps beyond 1 rad",
                Finding(
                    COLUMNS,
                    [
                        Row("largest step [°]", degrees(step), min(step) > SMALL),
                        Row("largest initial angle [°]", degrees(start), min(start) > SMALL),
                        Row("largest step [rad]", step, min(step) > 1),
                        Row("largest initial angle [rad]", start),
                    ],
                ),
            ),
            statement(
                "The nonlinear pendulum behaves like the linear one, at 20° and at the paper’s"
                " step",
                "the integral of |e| after a step, nonlinear against linear, differs by less than"
                " 5 % at 20°, and at 1 rad",
                Finding(
                    COLUMNS,
                    [
                        Row(
                            f"difference of ∫|e| dt at {name} [%]",
                            (100 * apart[:, k]).tolist(),
                            bool(np.max(np.abs(apart[:, k])) < ALIKE),
                        )
                        for k, name in enumerate(("20°", "1 rad"))
                    ],
                    "IPID-RBF of Table 1 keeps a larger error on the nonlinear plant, and the error"
                    " grows: the force comes from a loop that does not see it.",
                ),
            ),
        ],
        ("Sweeps with the native master narrowed the limits down to less than 0.001 rad.",),
    )


def degrees(angles: list[float]) -> list[float]:
    """Convert angles from rad."""
    return [math.degrees(angle) for angle in angles]


def figure(data: Data) -> Figure:
    """Return the figure of a step of 1 rad on both models."""
    panels, below, errors = [], [], []
    for model in ("linear", "nonlinear"):
        curves = []
        for kind in KINDS:
            run, controller, pendulum = loop(kind, model)
            trace = trace_of(f"{kind}/{model}", data.results[run], controller, pendulum)
            curves.append(Curve(f"{trace.key}/theta", trace.t, trace.theta, kind))
            errors.append(Curve(f"{trace.key}/e", trace.t, np.abs(trace.e), kind))
        panels.append(Panel(f"{model} plant", ANGLE, curves, xlim=(0, 8), ylim=(0, 1.4)))
        below.append(
            Panel(
                f"{model} plant: magnitude of the error",
                "|e| [rad]",
                [Curve(c.key, c.x, np.maximum(c.y, 1e-5), c.style) for c in errors[-len(KINDS) :]],
                xlim=(0, 8),
                ylim=(1e-5, 2),
                log_y=True,
            )
        )
    return Figure(
        "nonlinear",
        "The nonlinear pendulum",
        "Angle and magnitude of the error over 8 s after a step of 1 rad with PID, PID-RBF and"
        " IPID-RBF with both targets, on the linear and the nonlinear plant.",
        [panels, below],
    )
