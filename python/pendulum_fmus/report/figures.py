"""The figures of the paper: three kinds, for its Figures 4 to 21, and some of their own.

A function of a kind returns the rows of panels of one row of `zooms` in `statements.toml`: the
amplitude `d` of the disturbance [rad], the magnified part `x`, `y`, and the range `ylim` of all.
The others return the curves of each of the `panels` there.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .figure import (
    ANGLE,
    END,
    ERROR,
    FORCE,
    SHOWN,
    SMALLEST,
    TIME,
    Curve,
    Panel,
    curve,
    magnitudes,
    outputs,
)
from .measures import energy_of
from .runs import FACTORS, GAINS, Data, Trace

Rows = list[list[Panel]]


def panels(rows: Sequence[Sequence[Mapping[str, Any]]], curves: Iterable[list[Curve]]) -> Rows:
    """Return panels as described, with the curves of one after another."""
    given = iter(curves)

    def panel(described: Mapping[str, Any]) -> Panel:
        lims = {lim: tuple(described[lim]) for lim in ("xlim", "ylim") if lim in described}
        logs = {f"log_{axis}": True for axis in described.get("log", "")}
        labels = described["title"], described["y"]
        return Panel(*labels, next(given), described.get("x", TIME), **lims, **logs)

    return [[panel(described) for described in row] for row in rows]


def _zoomed(curves: Sequence[Curve], title: str, label: str, row: Mapping) -> list[Panel]:
    """Return a panel with all curves, and one that magnifies a framed part."""
    x, y, ylim = tuple(row["x"]), tuple(row["y"]), tuple(row.get("ylim", ())) or None
    whole = Panel(title, label, curves, xlim=(0, END), ylim=ylim, frame=(x, y), weight=1.7)
    return [whole, Panel("the framed part", label, curves, xlim=x, ylim=y)]


def tracking(traces: Mapping[str, Trace], case: str, row: Mapping[str, Any]) -> Rows:
    """Return the reference and the angles, or the measured angles."""
    curves = outputs(traces)
    if not row.get("measured"):
        return [_zoomed(curves, case, ANGLE, row)]
    curves[1:] = [Curve(f"{t.key}/y", t.t, t.theta + t.d, kind) for kind, t in traces.items()]
    return [_zoomed(curves, "measured angle θ + d", "θ + d [rad]", row)]


def errors(traces: Mapping[str, Trace], case: str, row: Mapping[str, Any]) -> Rows:
    """Return the errors, magnified and as absolute values."""
    curves = [curve(trace, "e", kind) for kind, trace in traces.items()]
    shown = {"xlim": (0, END), "ylim": (SMALLEST, 10), "log_y": True}
    logarithmic = Panel(f"{case}: magnitude", "|e| [rad]", magnitudes(traces), **shown)
    return [_zoomed(curves, case, ERROR, row), [logarithmic]]


def forces(traces: Mapping[str, Trace], _case: str, row: Mapping[str, Any]) -> Rows:
    """Return the forces of PID-RBF and IPID-RBF side by side, with magnified parts below."""
    x, y = tuple(row["x"]), tuple(row["y"])
    disturbed = f", d = {row['d']:g} rad" if row.get("d") else ""
    shown = {"xlim": (0, END), "ylim": tuple(row["ylim"]), "frame": (x, y)}
    above, below = [], []
    for kind in SHOWN[1:]:
        curves = [curve(traces[kind], name, name) for name in ("u_p", "u_n", "u")]
        above.append(Panel(f"{kind}{disturbed}", FORCE, curves, **shown))
        below.append(Panel(f"{kind}, the framed part", FORCE, curves, xlim=x, ylim=y))
    return [above, below]


KINDS = {"tracking": tracking, "errors": errors, "forces": forces}


def zoomed(data: Data, kind: str, signal: str, zooms: Iterable[Mapping[str, Any]]) -> Rows:
    """Return the rows of panels of a figure of a kind."""
    rows = []
    for row in zooms:
        amplitude = row.get("d", 0.0)
        case = f"{signal}, disturbance {amplitude:g} rad" if amplitude else signal
        traces = {shown: data(shown, signal, amplitude) for shown in SHOWN}
        rows += KINDS[kind](traces, case, row)
    return rows


def response(data: Data) -> list[list[Curve]]:
    """Return the response to a step, twice, and force and angle of a step that is held for long."""
    angles = outputs({kind: data(kind) for kind in SHOWN})
    long = {kind: data.lasting(kind) for kind in SHOWN}
    held = [[curve(t, column, kind) for kind, t in long.items()] for column in ("u", "theta")]
    return [angles, angles, *held]


def gains(data: Data) -> list[list[Curve]]:
    """Return the step responses of the PID with other gains, one panel per gain, twice."""
    styles = dict(zip(FACTORS, ("half", "one", "double"), strict=True))
    return 2 * [
        [curve(data.gains(gain, factor), "theta", style) for factor, style in styles.items()]
        for gain in GAINS
    ]


def lyapunov(data: Data) -> list[list[Curve]]:
    """Return the magnitude of the error, and the sum of its squares."""
    traces = {kind: data(kind) for kind in SHOWN[1:]}
    sums = [Curve(f"V/{kind}", trace.t, energy_of(trace), kind) for kind, trace in traces.items()]
    return [magnitudes(traces), sums]
