"""Results beyond the paper: for each section its curves and the rows of its findings.

Each `[[beyond]]` of `statements.toml` names a function here, and has its texts, panels and columns.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..loop import Loop
from .claims import Row, number
from .figure import Curve, curve, magnitudes, outputs
from .findings import SMALL
from .measures import (
    SCALES,
    change,
    growths,
    iae,
    integral,
    largest,
    overshoot,
    rms,
    settling,
    swept,
    tone,
)
from .runs import ALONE, KINDS, SIGNALS, Data, Trace, alone, both_plants, loop_of, sweep
from .stability import DELAYS, ETA, LAWS, NOMINAL, Law, limit, printed_bound, radius

RINGING = 1.0
"""A force that changes by more than this per sample, long after the step, is ringing [N]."""


@dataclass(frozen=True)
class Section:
    """What was computed for a section."""

    curves: Sequence[Sequence[Curve]]  # of each panel
    rows: Sequence[Sequence[Row]]  # of each statement
    facts: Mapping[str, Any] = field(default_factory=dict)  # numbers for its texts


def targets(data: Data) -> Section:
    """Compare IPID-RBF with its own force as target (29) with the IPID-RBF of Table 1."""
    kinds = ("IPID-RBF", "IPID-RBF own")
    traces = {signal: {kind: data(kind, signal) for kind in kinds} for signal in SIGNALS}
    step = traces["step"].values()
    quantities = {
        "|e(20 s)|, step [rad]": [abs(float(trace.e[-1])) for trace in step],
        "settling ±0.3 %, step [s]": [settling(trace) for trace in step],
    }
    for signal, both in traces.items():
        quantities[f"integral of |e|, {signal} [rad s]"] = [iae(trace) for trace in both.values()]
    rows = [Row(name, values, values[1] < values[0]) for name, values in quantities.items()]
    return Section([magnitudes(both) for both in traces.values()], [rows])


# --- delay: the limit of the learning rate --------------------------------------------------------


def delayed(law: Law, eta: float = ETA, steps: int = 20000) -> Loop:
    """Return the step response of PID-RBF with the delay of a law and a learning rate."""
    return Loop(
        "PidRbf",
        overrides=(("controller.rbf.eta", eta),),
        steps=steps,
        order="parallel" if law.samples else "sequential",
        previous_sample_terms=law.previous_sample_terms,
    )


def learning(data: Data) -> Section:
    """Compare the limit of the learning rate with the printed bound, and with the FMUs."""
    laws, bound = list(DELAYS.values()), printed_bound()
    limits = [limit(law) for law in laws]
    near = [delayed(law, share * limit(law), 12000) for share in (0.98, 1.02) for law in laws]
    *steps, cycle = data.simulated([*near, delayed(DELAYS["2 samples"])])
    changes = [change(t.part((t.t[-1] - 0.5, np.inf)).u) for t in steps]
    below, above = changes[: len(laws)], changes[len(laws) :]
    spans = [cycle.part((5.0, 10.0)), cycle.part((15.0, 20.0))]
    swings = [float(np.ptp(span.u)) for span in spans]
    steady = abs(swings[1] / swings[0] - 1) < 0.05
    rows = [
        [
            Row("largest stable η [1]", limits, limits[0] > limits[1] > limits[3]),
            Row("share of the printed bound [1]", [x / bound for x in limits], max(limits) < bound),
            Row("spectral radius at η = 0.30 [1]", [radius(law) for law in laws]),
        ],
        [
            Row("change of u at 0.98 of the limit [N]", below, max(below) < RINGING),
            Row("change of u at 1.02 of the limit [N]", above, min(above) > RINGING),
        ],
        [
            Row("swing of u, peak to peak [N]", swings, swings[1] > RINGING and steady),
            Row("frequency [Hz]", [tone(span.u, span.ts) for span in spans]),
            Row("max |e| [rad]", [largest(span.e) for span in spans]),
        ],
    ]
    rates, ends = np.geomspace(0.05, 2.5, 120), np.array([0.0, 10.0])
    radii = [
        Curve("stable", rates[[0, -1]], np.ones(2), "limit", "limit of stability"),
        Curve("bound", bound + 1e-9 * ends, 0.8 + 0.05 * ends, "r", "printed bound"),
    ]
    for name, style in (("0 samples", "one"), ("1 sample", "half"), ("2 samples", "double")):
        values = np.array([radius(DELAYS[name], eta) for eta in rates])
        radii.append(Curve(f"radius/{name}", rates, values, style, f"delay of {name}"))
    error = Curve(f"{cycle.key}/e", cycle.t, cycle.e, "u", "e")
    return Section([radii, [curve(cycle, "u", "u")], [error]], rows, {"bound": bound})


# --- windup -------------------------------------------------------------------------------------

SUMMING = ("PID", "PID-RBF")
"""The controllers whose integral does not leak."""

LIMITS = (25.0, 35.0, 50.0, 70.0, 100.0, 140.0, 200.0)
"""Force limits [N]; Table 1 has 100 N."""

DISTURBED = (("step", 0.0), ("step", 1.0), ("square", 0.0), ("square", 1.0))
"""Signals and disturbances [rad] of Table 1 in which the force reaches its limit."""

HELD = {False: "winding", True: "held"}
"""Styles without and with anti-windup."""


def limited(kind: str, force: float, anti_windup: bool) -> Loop:
    """Return the step response of a controller with a limit of the force [N]."""
    overrides = (("controller.u_max", force), ("controller.anti_windup", anti_windup))
    return Loop(ALONE[kind], overrides=overrides, steps=4000)


def disturbed(kind: str, signal: str, amplitude: float, anti_windup: bool) -> Loop:
    """Return a loop of Table 1."""
    overrides = (("controller.anti_windup", anti_windup),)
    return Loop(ALONE[kind], signal, amplitude, overrides=overrides, steps=8000)


def windup(data: Data) -> Section:
    """Return the effects of anti-windup, above all at low limits."""
    data.simulated([limited(k, force, on) for k in ALONE for force in LIMITS for on in HELD])
    data.simulated([disturbed(k, *case, on) for k in SUMMING for case in DISTURBED for on in HELD])
    steps = {
        (kind, on): [data.loop(limited(kind, force, on)) for force in LIMITS]
        for kind in ALONE
        for on in HELD
    }
    above = {(k, on): [overshoot(t) for t in steps[k, on]] for k in SUMMING for on in HELD}
    rows = []
    for i, force in enumerate(LIMITS):
        smaller = all(above[kind, True][i] < above[kind, False][i] for kind in SUMMING)
        values = [values[i] for values in above.values()]
        rows.append(Row(f"overshoot at {force:g} N [%]", values, smaller))
    rises = {key: bool((np.diff(values) < 0).all()) for key, values in above.items()}
    words = ["yes" if one else "no" for one in rises.values()]
    without = all(rises[kind, False] for kind in SUMMING)
    rows.append(Row("overshoot rises as the limit falls", words, without))
    little = []
    for signal, amplitude in DISTURBED:
        for kind in SUMMING:
            free, held = (data.loop(disturbed(kind, signal, amplitude, on)) for on in HELD)
            values = [iae(free), iae(held), integral(np.abs(free.u) == 100.0, free.ts)]
            holds = abs(values[1] / values[0] - 1) < 0.05 and values[2] < 0.2
            little.append(Row(f"{kind}, {signal}, disturbance {amplitude:g} rad", values, holds))
    apart = []
    for kind in ALONE:
        pairs = zip(steps[kind, False], steps[kind, True], strict=True)
        apart.append(max(largest(held.theta - free.theta) for free, held in pairs))
    low = {style: steps["PID", on][0] for on, style in HELD.items()}
    curves = [outputs(low), [curve(trace, "u", style) for style, trace in low.items()]]
    for kind in SUMMING:
        pairs = [(on, np.array(above[kind, on]), style) for on, style in HELD.items()]
        curves.append([Curve(f"windup/{kind}/{on}", np.array(LIMITS), y, s) for on, y, s in pairs])
    return Section(curves, [rows, little, [Row("max |Δθ| [rad]", apart, apart[-1] < 1e-6)]])


# --- other pendulums ----------------------------------------------------------------------------

LIGHT = NOMINAL["M"] * SCALES[:15:2]
"""Masses of the cart below and just above those at which PID-RBF rings [kg]."""


def robustness(data: Data) -> Section:
    """Return how the controllers bear plants that differ from the one used for tuning."""
    curves, rows, law = [], [], LAWS["PID-RBF"]
    for variable in ("M", "l"):
        runs, worse = swept(variable, data.fmus), list(growths(variable, data.fmus).values())
        fell = [int(np.sum(m["diverged"])) for m in runs.values()]
        unsettled = [int(np.sum(np.isnan(m["settling_time"]))) for m in runs.values()]
        never = f"number that never settled to ±0.3 %, of {len(SCALES)}"
        growth = "integral of |e| at worst above nominal [%]"
        rows.append(
            [
                Row(f"number that diverged, of {len(SCALES)}", fell, max(fell) == 0),
                Row(never, unsettled, max(unsettled) == 0),
                Row(growth, [100 * one for one in worse], max(worse) < 0.1),
            ]
        )
        curves += [_over(runs, variable, metric) for metric in ("iae", "settling_time")]
    ringing = []
    loops = [Loop("PidRbf", overrides=(("plant.M", float(mass)),)) for mass in LIGHT]
    traces = data.simulated(loops)
    for mass, trace in zip(LIGHT, traces, strict=True):
        stable, late = limit(law, mass), trace.part((19.0, 21.0))
        step = change(late.u)
        frequency = tone(late.u, trace.ts) if step > RINGING else "–"
        values = [stable, step, frequency, largest(late.e), settling(trace)]
        ringing.append(Row(f"M = {mass:.3f} kg", values, (stable < ETA) == (step > RINGING)))
    mass = NOMINAL["M"] * SCALES
    stable = np.array([limit(law, one) for one in mass])
    paper = Curve("eta/paper", mass, np.full(len(mass), ETA), "limit", "η of the paper")
    curves += [[paper, Curve("eta/stable", mass, stable, "PID-RBF")], [curve(traces[0], "u", "u")]]
    lightest = radius(LAWS["PID"], 0.0, LIGHT[0])
    return Section(curves, [*rows, ringing], {"radius": lightest})


def _over(runs: dict[str, dict[str, np.ndarray]], variable: str, metric: str) -> list[Curve]:
    """Return a metric over the parameter; runs without a value are omitted."""
    found = []
    for kind, metrics in runs.items():
        known = np.isfinite(metrics[metric]) & (metrics["diverged"] == 0)
        if np.sum(known) > 1:
            x = NOMINAL[variable] * SCALES[known]
            found.append(Curve(f"{variable}/{metric}/{kind}", x, metrics[metric][known], kind))
    return found


# --- noise and delay ----------------------------------------------------------------------------

DEVIATIONS = (1e-6, 1e-5, 1e-4, 1e-3)
"""Standard deviations of the noise [rad]."""

SAMPLES = range(9)
"""Delays of the measured angle [samples]."""


def sensed(kind: str, noise: float = 0.0, delay: int = 0) -> Loop:
    """Return 5 s of the step response of a controller with current terms."""
    sensor = (noise, delay)
    return Loop(ALONE[kind], previous_sample_terms=False, steps=5000, sensor=sensor)


def noise(data: Data) -> Section:
    """Return the effects of noise and delay in the measured angle, from 3 s on."""
    sensors = [*((deviation, 0) for deviation in DEVIATIONS), *((0.0, n) for n in SAMPLES)]
    data.simulated([sensed(kind, *sensor) for kind in ALONE for sensor in sensors])

    def late(kind: str, *sensor: float) -> Trace:
        return data.loop(sensed(kind, *sensor)).part((3.0, np.inf))

    off, force, ring, borne = {}, {}, {}, []
    for kind in ALONE:
        quiet, noisy = late(kind), [late(kind, deviation) for deviation in DEVIATIONS]
        off[kind] = [rms(trace.theta - quiet.theta) for trace in noisy]
        force[kind] = [rms(np.diff(trace.u)) for trace in noisy]
        ring[kind] = [change(late(kind, 0.0, delay).u) for delay in SAMPLES]
        borne.append(next(n for n, u in enumerate([*ring[kind], np.inf]) if u >= RINGING) - 1)
    rows, delays = [], [Row("delay without ringing [samples]", borne, borne[0] > max(borne[1:]))]
    for i, deviation in enumerate(DEVIATIONS):
        moved, name = [values[i] for values in off.values()], f"noise {number(deviation, 1)} rad"
        rows.append(Row(f"RMS of Δθ, {name} [rad]", moved, min(moved[1:]) > moved[0]))
        rows.append(Row(f"RMS change of u, {name} [N]", [values[i] for values in force.values()]))
    for n in SAMPLES:
        delays.append(Row(f"change of u, delay {n} [N]", [values[n] for values in ring.values()]))
    x, n = np.array(DEVIATIONS), np.array(SAMPLES, float)
    noisy = [Curve(f"noise/{kind}", x, np.array(y), kind) for kind, y in off.items()]
    late_ = [Curve(f"delay/{kind}", n, np.maximum(y, 1e-4), kind) for kind, y in ring.items()]
    return Section([noisy, late_], [rows, delays])


# --- the nonlinear pendulum ---------------------------------------------------------------------

STILL = (("source.amplitude", 0.0),)
"""Overrides for a set-point of 0."""

FALLEN = math.pi
"""|e| above which the pendulum has fallen [rad]."""


def largest_held(kind: str, variables: list[str], fmus: Path, **changes: Any) -> float:
    """Return the limit of some variables [rad] for a stabilized pendulum.

    Each of five rounds tries six values between the last success and the first failure.
    """
    loop = alone(kind, plant_model="nonlinear", **changes)
    low, high = 0.05, math.pi / 2
    for _ in range(5):
        values = np.linspace(low, high, 6)
        tried = {"variables": variables, "values": values.tolist()}
        runs = sweep(loop, [tried], fmus, limit=FALLEN)
        lost = (runs["diverged"] > 0) | ~(np.abs(runs["final_e"]) < 0.05)
        first = int(np.argmax(lost)) if lost.any() else len(values)
        if first in (0, len(values)):
            return math.nan if first == 0 else high
        low, high = values[first - 1], values[first]
    return float(low)


def areas(kind: str, model: str, fmus: Path) -> np.ndarray:
    """Return the integrals of |e| of steps of 20° and of 1 rad [rad s], shape (2,)."""
    steps = {"variables": ["source.amplitude"], "values": [SMALL, 1.0]}
    return sweep(alone(kind, plant_model=model), [steps], fmus, limit=FALLEN)["iae"]


def nonlinear(data: Data) -> Section:
    """Return the range in which the linear design stabilizes the nonlinear pendulum."""
    fmus = data.fmus
    step = [largest_held(kind, ["source.amplitude"], fmus) for kind in KINDS]
    starts = {kind: both_plants(kind, "theta0") for kind in KINDS}
    start = [largest_held(kind, names, fmus, overrides=STILL) for kind, names in starts.items()]
    ratios = [areas(kind, "nonlinear", fmus) / areas(kind, "linear", fmus) for kind in KINDS]
    held = [
        Row("largest step [°]", [math.degrees(one) for one in step], min(step) > SMALL),
        Row("largest initial angle [°]", [math.degrees(one) for one in start], min(start) > SMALL),
        Row("largest step [rad]", step, min(step) > 1),
        Row("largest initial angle [rad]", start),
    ]
    alike = []
    for name, column in zip(("20°", "1 rad"), np.array(ratios).T - 1, strict=True):
        title = f"difference of ∫|e| dt at {name} [%]"
        alike.append(Row(title, (100 * column).tolist(), bool(np.max(np.abs(column)) < 0.05)))
    above, below = [], []
    for model in ("linear", "nonlinear"):
        loops = {kind: loop_of(kind, steps=8000, plant_model=model) for kind in KINDS}
        data.simulated(loops.values())
        traces = {kind: data.loop(run, kind, f"{kind}/{model}") for kind, run in loops.items()}
        above.append([curve(trace, "theta", kind) for kind, trace in traces.items()])
        below.append(magnitudes(traces, smallest=1e-5))
    return Section([*above, *below], [held, alike])
