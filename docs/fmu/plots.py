"""Draw the results on the pages of the FMUs: `result.svg` in the folder of each page.

`python docs/fmu/plots.py` co-simulates the FMUs of target/fmu and redraws the plots. They are
small, use the colours of the page, and also distinguish curves by dashes.
"""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, FmpySystem, simulate
from pendulum_fmus.project import FMUS, ROOT
from pendulum_fmus.report.figure import thinned

Columns = Mapping[str, np.ndarray]

LEFT, WIDTH, HEIGHT, GAP = 58, 570, 150, 44
"""Size of a panel in pixels."""
FINE = 4
"""Grid lines per pixel, on which all points lie."""
TOLERANCE = 0.75
"""Maximum deviation of a curve, in grid lines."""

STYLES = (
    'stroke="#e58a1f" stroke-width="12"',
    'stroke="currentColor" stroke-width="6" stroke-dasharray="24 12"',
    'stroke="#2f8fd6" stroke-width="8" stroke-dasharray="8 10"',
)
"""Styles of the first, second and third curve of a panel, from back to front."""


class Panel(NamedTuple):
    """Axes with curves: names and values over time."""

    label: str
    low: float
    high: float
    ticks: Sequence[float]
    curves: Columns


def path(x: np.ndarray, y: np.ndarray) -> str:
    """Return the SVG path of a curve, in grid lines."""
    x, y = x * FINE, y * FINE
    kept = thinned(x, y, TOLERANCE)
    points = np.column_stack([x[kept], y[kept]]).round().astype(int)
    steps = np.diff(points, axis=0)
    numbers = "".join(f"{n}" if n < 0 else f" {n}" for n in steps[steps.any(axis=1)].ravel())
    return f"M{points[0][0]} {points[0][1]}l{numbers.strip()}"


def text(x: int, y: int, words: str, anchor: str = "") -> str:
    """Return text that starts at a point, or whose `anchor` is there."""
    anchored = f' text-anchor="{anchor}"' * bool(anchor)
    return f'<text x="{x}" y="{y}"{anchored}>{escape(words)}</text>'


def draw_panel(panel: Panel, time: np.ndarray, top: int) -> list[str]:
    """Return a panel whose upper edge is at `top`."""

    def row(value):
        inside = np.clip(value, panel.low, panel.high)
        return top + HEIGHT * (panel.high - inside) / (panel.high - panel.low)

    lines = []
    for tick in panel.ticks:
        y = round(float(row(tick)))
        lines.append(f'<path d="M{LEFT} {y}h{WIDTH}" stroke="#8888"/>')
        lines.append(text(LEFT - 8, y + 5, f"{tick:g}", "end"))
    lines.append(text(LEFT, top - 8, panel.label))
    x = LEFT + WIDTH * (time - time[0]) / (time[-1] - time[0])
    widths = [44 + 8 * len(name) for name in panel.curves]  # of the legend, about
    legend = LEFT + WIDTH - sum(widths)
    for (name, values), style, width in zip(panel.curves.items(), STYLES, widths, strict=False):
        sample = f"M{legend * FINE} {(top - 13) * FINE}h{28 * FINE}"
        lines.append(text(legend + 33, top - 8, name))
        d = sample + path(x, row(values))
        lines.append(f'<path transform="scale({1 / FINE})" d="{d}" {style} fill="none"/>')
        legend += width
    return lines


def draw(time: np.ndarray, ticks: Iterable[float], panels: Sequence[Panel], about: str) -> str:
    """Return the SVG of panels with a common time axis; `about` is the text alternative."""
    parts = []
    for index, panel in enumerate(panels):
        parts += draw_panel(panel, time, 24 + (HEIGHT + GAP) * index)
    bottom = 24 + (HEIGHT + GAP) * len(panels) - GAP
    for tick in ticks:
        x = round(LEFT + WIDTH * (tick - time[0]) / (time[-1] - time[0]))
        parts.append(text(x, bottom + 18, f"{tick:g}", "middle"))
    parts.append(text(LEFT + WIDTH // 2, bottom + 36, "time [s]", "middle"))
    size = f'viewBox="0 0 {LEFT + WIDTH + 12} {bottom + 42}" width="{LEFT + WIDTH + 12}"'
    head = f'xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="{escape(about)}"'
    return "\n".join([f"<svg {head}>", *parts, "</svg>\n"])


def run(system: FmpySystem, start: float, stop: float) -> Columns:
    """Co-simulate at 1 ms in sequential order."""
    with system:
        return simulate(system, start=start, step=TS, steps=round((stop - start) / TS) + 1)


Axis = tuple[float, float, Sequence[float]]
"""Lower end, upper end and ticks of an axis."""


def controlled(
    loop: Loop,
    stop: float,
    ticks: Iterable[float],
    angle: Axis,
    force: Axis,
    names: str,
    about: str,
) -> str:
    """Draw the angle with its set-point, and forces of the controller, until `stop` [s]."""
    results = run(loop.system(), TS, stop)
    angles = {"theta": results["plant.theta"], "r": results["source.r"]}
    forces = {name: results[f"controller.{name}"] for name in names.split()}
    panels = [Panel("angle [rad]", *angle, angles), Panel("force [N]", *force, forces)]
    return draw(results["time"], ticks, panels, about)


def pendulum() -> str:
    """Draw a PID raising the linear and the nonlinear pendulum."""
    loops = {}
    for model in ("linear", "nonlinear"):
        plant = Component("plant", FMUS / "Pendulum.fmu", {"theta0": 0.5, "dynamics": model})
        controller = Component("controller", FMUS / "Pid.fmu", sampled=True)
        links = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
        loops[model] = run(FmpySystem([controller, plant], links), 0.0, 5.0)
    angles, positions = (
        {f"{name}, {model}": results[f"plant.{name}"] for model, results in loops.items()}
        for name in ("theta", "x")
    )
    panels = [
        Panel("angle [rad]", -0.2, 0.5, (0, 0.5), angles),
        Panel("position [m]", -1.7, 0.1, (-1.5, -1, -0.5, 0), positions),
    ]
    about = """From 0.5 rad both pendulums come upright within 4 s, at nearly the same angles. \
The nonlinear cart goes on to -1.6 m, the linear one to -1.25 m and back."""
    return draw(loops["linear"]["time"], range(6), panels, about)


def source() -> str:
    """Draw the three set-points and the disturbance."""
    results = {}
    for form, frequency in (("square", 0.1), ("sine", 0.2), ("step", 0.2)):
        start = {"signal": form, "frequency": frequency, "disturbance.amplitude": 1.0}
        results[form] = run(
            FmpySystem([Component("source", FMUS / "Source.fmu", start)], []), 0, 20
        )
    square = results["square"]
    panels = [
        Panel("r [rad]", -1.1, 1.1, (-1, 0, 1), {f: of["source.r"] for f, of in results.items()}),
        Panel("d [rad]", -0.1, 1.1, (0, 1), {"d": square["source.d"]}),
    ]
    about = """A step of 1 rad, a sine of 0.2 Hz, a square wave of 0.1 Hz that is 0 at the start, \
and a pulse of 1 rad from 5 s to 5.5 s."""
    return draw(square["time"], range(0, 21, 5), panels, about)


# A step and a disturbance of the measured angle
PID = """The angle overshoots the step to 1.25 rad and returns within 4 s; a disturbance of \
1 rad from 5 s to 5.5 s throws it back to 0 rad. The force is at its limit at the jumps."""
# The network takes over the force from the PID
PID_RBF = """The angle overshoots the step to 1.22 rad. The network's and the PID's force ring \
against each other at 50 Hz for 0.4 s; then the network gives all of the force."""
# A sine, which the network learns within the first quarter period
IPID_RBF = "The angle lies on the sine. After 0.2 s the network gives all of the force."

TURN, SINE = (-0.1, 1.3, (0, 0.5, 1)), (-1.1, 1.1, (-1, 0, 1))
FULL, SMALL = (-110, 110, (-100, 0, 100)), (-15, 15, (-10, 0, 10))
HALVES = (0, 0.5, 1, 1.5, 2)

CONTROLLERS = {
    "Pid": (Loop("Pid", "step", 1.0), 9.0, range(10), TURN, FULL, "u", PID),
    "PidRbf": (Loop("PidRbf", "step"), 2.0, HALVES, TURN, FULL, "u_n u_p", PID_RBF),
    "IpidRbf": (Loop("IpidRbf", "sine"), 5.0, range(6), SINE, SMALL, "u_n u_p", IPID_RBF),
}

if __name__ == "__main__":
    plots = {
        "fmu-plant/documentation/Pendulum": pendulum(),
        "fmu-source/documentation/Source": source(),
    }
    for name, plot in CONTROLLERS.items():
        plots[f"fmu-controller/documentation/{name}"] = controlled(*plot)
    for folder, plot in plots.items():
        file = ROOT / folder / "result.svg"
        file.write_text(plot)
        print(file.relative_to(ROOT), file.stat().st_size, "bytes")
