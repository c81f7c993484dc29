"""Print Table 1 and draw the closed loops, all from one set of co-simulations of the FMUs.

`python tests/report.py` writes to target/report/:

- closed-loop.png: the three controllers at a glance;
- step.png, sine.png, square.png: reference, outputs and errors, and the same with the
  disturbance of the measured angle in step-disturbance.png and so on.
"""

import sys
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path

import numpy as np
from master import MasterError
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from table1 import Run, arguments, execute_all, report, runs

REPORT = Path(__file__).resolve().parent.parent / "target" / "report"

SIGNALS = ("step", "sine", "square")

# Told apart by dashes and darkness too, for those who print in black and white.
STYLES = {
    "PID": {"color": "#e69f00", "linestyle": (0, (5, 1.5)), "linewidth": 1.4},
    "PID-RBF": {"color": "#0072b2", "linestyle": (0, (1.5, 1)), "linewidth": 1.4},
    "IPID-RBF": {"color": "#8b1a1a", "linestyle": "-", "linewidth": 1.1},
}
REFERENCE_STYLE = {"color": "0.55", "linestyle": "-", "linewidth": 2.6, "alpha": 0.6}

RC = {
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 150,
}

ZOOMS = {
    ("step", False): ((0, 5), (0.95, 1.05)),
    ("sine", False): ((0.9, 1.6), (0.95, 1.04)),
    ("square", False): ((5, 10), (-1.05, -0.95)),
    ("step", True): ((4.8, 7.8), (-0.1, 1.3)),
    ("sine", True): ((4.8, 7.8), (-1.2, 1.2)),
    ("square", True): ((4.8, 7.8), (-2.3, 1.2)),
}
"""What the insets magnify: time [s] and angle [rad], by signal and whether it is disturbed."""

Columns = Mapping[str, np.ndarray]
Results = Mapping[Run, Columns]


def loops(results: Results, signal: str, disturbed: bool) -> dict[str, tuple[np.ndarray, ...]]:
    """Return (time [s], angle [rad], error [rad]) of the three controllers, each (steps,)."""
    disturbance = float(disturbed)
    pid = results[Run("Pid", signal, disturbance)]
    pair = results[Run("IpidRbf", signal, disturbance, "supervisor")]
    return {
        "PID": (pid["time"], pid["plant.theta"], pid["controller.e"]),
        "PID-RBF": (pair["time"], pair["supervisor_plant.theta"], pair["supervisor.e"]),
        "IPID-RBF": (pair["time"], pair["plant.theta"], pair["controller.e"]),
    }


def reference(results: Results, signal: str, disturbed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (time [s], reference [rad])."""
    columns = results[Run("Pid", signal, float(disturbed))]
    return columns["time"], columns["source.r"]


def draw_outputs(axes: Axes, results: Results, signal: str, disturbed: bool) -> None:
    """Draw the reference and what the pendulums make of it."""
    axes.plot(*reference(results, signal, disturbed), label="reference r", **REFERENCE_STYLE)
    for name, (time, theta, _) in loops(results, signal, disturbed).items():
        axes.plot(time, theta, label=name, **STYLES[name])
    axes.set_ylabel("angle θ [rad]")


def draw_errors(axes: Axes, results: Results, signal: str, disturbed: bool) -> None:
    """Draw |e| on a logarithmic axis, for it spans decades."""
    for name, (time, _, error) in loops(results, signal, disturbed).items():
        axes.semilogy(time, np.maximum(np.abs(error), 1e-16), label=name, **STYLES[name])
    axes.set_ylabel("error |e| [rad]")
    axes.set_ylim(1e-6, 5)


def draw_zoom(axes: Axes, results: Results, signal: str, disturbed: bool) -> None:
    """Draw the outputs where they differ most."""
    (start, stop), (low, high) = ZOOMS[signal, disturbed]
    draw_outputs(axes, results, signal, disturbed)
    axes.set(xlim=(start, stop), ylim=(low, high), ylabel="")


def signal_figure(results: Results, signal: str, disturbed: bool) -> Figure:
    """Draw one signal: outputs, with a magnified part, above the errors."""
    figure = Figure(figsize=(8.5, 5.6), layout="constrained")
    outputs, zoom, errors = figure.subplot_mosaic("AB;CC", width_ratios=[2, 1]).values()
    draw_outputs(outputs, results, signal, disturbed)
    draw_zoom(zoom, results, signal, disturbed)
    draw_errors(errors, results, signal, disturbed)
    errors.sharex(outputs)
    outputs.set_xlim(0, 20)
    for connector in outputs.indicate_inset_zoom(zoom, edgecolor="0.2").connectors:
        connector.set_visible(False)
    zoom.set_title("framed part, magnified", fontsize=9)
    for axes in (outputs, zoom, errors):
        axes.set_xlabel("time t [s]")
    figure.legend(*outputs.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    pulse = ", measured angle disturbed by 1 rad from 5 s to 5.5 s" if disturbed else ""
    figure.suptitle(f"{signal.capitalize()}{pulse}", fontsize=10, fontweight="bold")
    return figure


def overview_figure(results: Results) -> Figure:
    """Draw the three signals side by side, outputs above errors."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    grid = figure.subplots(2, 3, sharex="col", sharey="row")
    for (above, below), signal in zip(grid.T, SIGNALS, strict=True):
        draw_outputs(above, results, signal, False)
        draw_errors(below, results, signal, False)
        above.set_title(signal, fontweight="bold")
        below.set_xlabel("time t [s]")
        below.set_xlim(0, 20)
    for axes in grid[:, 1:].flat:
        axes.set_ylabel("")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """Return the figures with the names of their files."""
    yield "closed-loop", overview_figure(results)
    for signal, disturbed in product(SIGNALS, (False, True)):
        name = f"{signal}-disturbance" if disturbed else signal
        yield name, signal_figure(results, signal, disturbed)


def draw(results: Results, folder: Path) -> list[Path]:
    """Write all figures as PNG; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with rc_context(RC):
        for name, figure in figures(results):
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1])
    return paths


def main() -> int:
    """Run the script; returns its exit status."""
    parser = arguments("Print Table 1 of the paper from the FMUs, and draw the closed loops.")
    parser.add_argument(
        "--out",
        type=Path,
        default=REPORT,
        metavar="DIR",
        help="where the PNG files go (default: target/report of this project)",
    )
    options = parser.parse_args()
    try:
        results = execute_all(runs(), options.fmus, progress=True)
        text, all_hold = report(results)
        print(text)
        paths = draw(results, options.out)
    except MasterError as error:
        print(f"report.py: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"report.py: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    print("\nFigures:", *paths, sep="\n  ")
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
