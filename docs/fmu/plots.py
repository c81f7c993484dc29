"""Draw the results on the pages of the FMUs: `result.svg` in the folder of each page.

`python docs/fmu/plots.py` co-simulates the FMUs of target/fmu and redraws the plots. They are
small, use the colours of the page, and also distinguish curves by dashes.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from html import escape

import numpy as np

from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import Component, System, simulate
from pendulum_fmus.project import FMUS, ROOT

Columns = dict[str, np.ndarray]

LEFT, WIDTH, HEIGHT, GAP = 58, 570, 150, 44
"""Size of a panel in pixels."""
FINE = 4
"""Grid lines per pixel, on which all points lie."""
TOLERANCE = 0.5
"""Maximum deviation of a curve, in grid lines."""

STYLES = (
    'stroke="#e58a1f" stroke-width="12"',
    'stroke="currentColor" stroke-width="6" stroke-dasharray="24 12"',
    'stroke="#2f8fd6" stroke-width="8" stroke-dasharray="8 10"',
)
"""Styles of the first, second and third curve of a panel, from back to front."""


@dataclass(frozen=True)
class Panel:
    """Axes with curves: names and values over time."""

    label: str
    low: float
    high: float
    ticks: Sequence[float]
    curves: Columns


def extremes(values: np.ndarray, buckets: int) -> np.ndarray:
    """Return the indices of the minimum and maximum of each bucket, and of the ends."""
    parts = np.array_split(np.arange(len(values)), min(buckets, len(values)))
    found = [(part[values[part].argmin()], part[values[part].argmax()]) for part in parts]
    return np.unique([0, *np.ravel(found), len(values) - 1])


def needed(x: np.ndarray, y: np.ndarray, first: int, last: int) -> list[int]:
    """Return the indices after `first` of points whose polygon fits the curve (Douglas-Peucker)."""
    if last - first < 2:
        return [last]
    inner = slice(first + 1, last)
    dx, dy = x[last] - x[first], y[last] - y[first]
    distance = np.abs(dx * (y[inner] - y[first]) - dy * (x[inner] - x[first])) / np.hypot(dx, dy)
    worst = int(distance.argmax())
    if distance[worst] <= TOLERANCE:
        return [last]
    middle = first + 1 + worst
    return needed(x, y, first, middle) + needed(x, y, middle, last)


def path(x: np.ndarray, y: np.ndarray) -> str:
    """Return the SVG path of a curve, in grid lines."""
    kept = extremes(y, WIDTH * FINE)
    x, y = x[kept] * FINE, y[kept] * FINE
    kept = [0, *needed(x, y, 0, len(x) - 1)]
    points = np.column_stack([x[kept], y[kept]]).round().astype(int)
    numbers = "".join(f"{n}" if n < 0 else f" {n}" for n in np.diff(points, axis=0).ravel())
    return f"M{points[0][0]} {points[0][1]}l{numbers.strip()}"


def legend_width(name: str) -> int:
    """Return the approximate width of a legend entry [px]."""
    return 44 + 8 * len(name)


def text(x: int, y: int, words: str, anchor: str = "") -> str:
    """Return text that starts at a point, or whose `anchor` is there."""
    anchored = f' text-anchor="{anchor}"' * bool(anchor)
    return f'<text x="{x}" y="{y}"{anchored}>{escape(words)}</text>'


def draw_panel(panel: Panel, time: np.ndarray, top: int) -> str:
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
    legend = LEFT + WIDTH - sum(map(legend_width, panel.curves))
    for (name, values), style in zip(panel.curves.items(), STYLES, strict=False):
        sample = f"M{legend * FINE} {(top - 13) * FINE}h{28 * FINE}"
        lines.append(text(legend + 33, top - 8, name))
        d = sample + path(x, row(values))
        lines.append(f'<path transform="scale({1 / FINE})" d="{d}" {style} fill="none"/>')
        legend += legend_width(name)
    return "\n".join(lines)


def draw(time: np.ndarray, ticks: Sequence[float], panels: Sequence[Panel], about: str) -> str:
    """Return the SVG of panels with a common time axis; `about` is the text alternative."""
    tops = [24 + (HEIGHT + GAP) * index for index in range(len(panels))]
    parts = [draw_panel(panel, time, top) for panel, top in zip(panels, tops, strict=True)]
    bottom = tops[-1] + HEIGHT
    for tick in ticks:
        x = round(LEFT + WIDTH * (tick - time[0]) / (time[-1] - time[0]))
        parts.append(text(x, bottom + 18, f"{tick:g}", "middle"))
    parts.append(text(LEFT + WIDTH // 2, bottom + 36, "time [s]", "middle"))
    size = f'viewBox="0 0 {LEFT + WIDTH + 12} {bottom + 42}" width="{LEFT + WIDTH + 12}"'
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="{escape(about)}">'
    )
    return "\n".join([head, *parts, "</svg>\n"])


def run(system: System, start: float, stop: float) -> Columns:
    """Co-simulate at 1 ms in sequential order."""
    with closing(system):
        return simulate(system, start=start, step=TS, steps=round((stop - start) / TS) + 1)


Axis = tuple[float, float, Sequence[float]]
"""Lower end, upper end and ticks of an axis."""


def controlled(
    loop: Loop,
    stop: float,
    ticks: Sequence[float],
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
        plant = Component("plant", FMUS / "Pendulum.fmu", {"theta0": 0.5, "model": model})
        controller = Component("controller", FMUS / "Pid.fmu", sampled=True)
        links = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
        loops[model] = run(System([controller, plant], links), 0.0, 5.0)

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

    def signals(form: str, frequency: float) -> Columns:
        start = {"signal": form, "frequency": frequency, "disturbance.amplitude": 1.0}
        return run(System([Component("source", FMUS / "Source.fmu", start)], []), 0.0, 20.0)

    frequencies = {"square": 0.1, "sine": 0.2, "step": 0.2}
    results = {form: signals(form, frequency) for form, frequency in frequencies.items()}
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

TURN: Axis = (-0.1, 1.3, (0, 0.5, 1))
FULL: Axis = (-110, 110, (-100, 0, 100))
SINE: Axis = (-1.1, 1.1, (-1, 0, 1))
SMALL: Axis = (-15, 15, (-10, 0, 10))
HALVES = (0, 0.5, 1, 1.5, 2)

CONTROLLERS = {
    "Pid": (Loop("Pid", "step", 1.0), 9.0, range(10), TURN, FULL, "u", PID),
    "PidRbf": (Loop("PidRbf", "step"), 2.0, HALVES, TURN, FULL, "u_n u_p", PID_RBF),
    "IpidRbf": (Loop("IpidRbf", "sine"), 5.0, range(6), SINE, SMALL, "u_n u_p", IPID_RBF),
}

PLOTS: dict[str, Callable[[], str]] = {
    "fmu-plant/documentation/Pendulum": pendulum,
    "fmu-source/documentation/Source": source,
} | {
    f"fmu-controller/documentation/{name}": partial(controlled, *plot)
    for name, plot in CONTROLLERS.items()
}

if __name__ == "__main__":
    for folder, plot in PLOTS.items():
        file = ROOT / folder / "result.svg"
        file.write_text(plot())
        print(file.relative_to(ROOT), file.stat().st_size, "bytes")
