"""What a control engineer looks for: frequency responses, an LQR, the cart, small steps, weights.

Like the functions of `beyond.py`, each is named by a `[[beyond]]` of `statements.toml`.
"""

import itertools
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import solve_discrete_are

from ..loop import TS, Loop
from .beyond import STILL, Section
from .claims import Row
from .figure import Curve, curve, magnitudes, outputs
from .measures import LIMIT, MEASURES, iae, largest
from .runs import KINDS, SIGNALS, Data, Trace, alone, both_plants, loop_of, sweep
from .stability import (
    FREQUENCIES,
    LAWS,
    NOMINAL,
    bearable,
    crossings,
    gain_margin,
    held_cart,
    last_true,
    modulus_margin,
    open_loop,
    phase_margin,
)

# --- frequency responses ------------------------------------------------------------------------

BRYSON = {"x": 0.5, "theta": math.radians(10), "u": 20.0}
"""Deviations [m, rad, N] that weigh the same in the cost of the LQR (Bryson's rule)."""


def lqr() -> np.ndarray:
    """Return the gains of the discrete-time LQR, shape (1, 4)."""
    A, B = held_cart()
    effort, weights = BRYSON["u"] ** -2, [BRYSON["x"] ** -2, 0, BRYSON["theta"] ** -2, 0]
    P = solve_discrete_are(A, B, np.diag(weights), [[effort]])
    return np.linalg.solve(effort + B.T @ P @ B, B.T @ P @ A)


def responses(frequency: np.ndarray) -> dict[str, np.ndarray]:
    """Return the open loops, broken at the force, at some frequencies [rad/s]."""
    A, B = held_cart()
    z = np.exp(1j * TS * frequency)[:, None, None]
    found = {kind: open_loop(law, frequency) for kind, law in LAWS.items()}
    return found | {"LQR": (lqr() @ np.linalg.solve(z * np.eye(4) - A, B))[:, 0, 0]}


def factors() -> list[tuple[float, float]]:
    """Return the factors of the gain between which each loop is stable."""
    (A, B), gains = held_cart(), lqr()

    def stable(gain: float) -> bool:
        return bool(np.max(np.abs(np.linalg.eigvals(A - gain * B @ gains))) < 1)

    found = []
    for law in LAWS.values():
        lowest = last_true(lambda gain, law=law: bearable(law, gain=gain), 1.0, 0.0)
        found.append((lowest, gain_margin(law)))
    return [*found, (last_true(stable, 1.0, 0.0), last_true(stable, 1.0, 1000.0))]


def frequency(_: Data) -> Section:
    """Return Bode and Nyquist plots of all open loops, and their margins."""
    crossovers, phases, peaks = [], [], []
    for response in responses(FREQUENCIES).values():
        crossovers.append(float(FREQUENCIES[crossings(response)[-1]] / (2 * np.pi)))
        phases.append(phase_margin(response))
        peaks.append(1 / modulus_margin(response))
    lowest, highest = map(list, zip(*factors(), strict=True))
    margins = [
        Row("phase margin [°]", phases, phases[1] < phases[0]),
        Row("largest stable factor of the gain [1]", highest, highest[1] < highest[0]),
        Row("smallest stable factor of the gain [1]", lowest, lowest[1] > lowest[0]),
        Row("peak of the sensitivity |1/(1 + L)| [1]", peaks, peaks[1] > peaks[0]),
    ]
    compared = [
        Row("peak of the sensitivity |1/(1 + L)| [1]", peaks, peaks[-1] < min(peaks[:-1])),
        Row("largest stable factor of the gain [1]", highest, highest[-1] > max(highest[:-1])),
        Row("crossover, highest [Hz]", crossovers, crossovers[-1] < min(crossovers[:-1])),
    ]
    w, turn = np.geomspace(0.3, math.pi / TS, 1200), np.linspace(0, 2 * np.pi, 200)
    size, phase = [], []
    circle = [Curve("nyquist", np.cos(turn), np.sin(turn), "limit", "unit circle", along=True)]
    for kind, response in responses(w).items():
        angle = np.degrees(np.unwrap(np.angle(response)))
        angle -= 360 * math.ceil(angle[0] / 360)  # its branch is arbitrary
        size.append(Curve(f"bode/{kind}", w, 20 * np.log10(np.abs(response)), kind))
        phase.append(Curve(f"phase/{kind}", w, angle, kind))
        circle.append(Curve(f"nyquist/{kind}", response.real, response.imag, kind, along=True))
    return Section([size, phase, circle], [margins, compared])


# --- the cart -----------------------------------------------------------------------------------

ANGLES = {"5°": math.radians(5), "10°": math.radians(10), "1 rad": 1.0}
"""Steps [rad]."""

TRACKS = (1.0, 2.0)
"""Half the lengths of tracks [m]."""


def stepped(kind: str, height: float, data: Data) -> Trace:
    """Return the response to a step of a height [rad]."""
    loop = loop_of(kind, overrides=(("source.amplitude", height),))
    data.simulated([loop])
    return data.loop(loop, kind, f"{kind}/step of {height:g}")


def released(kind: str, angle: float, data: Data) -> Trace:
    """Return the motion from an initial angle [rad] with a set-point of 0."""
    starts = tuple((name, angle) for name in both_plants(kind, "theta0"))
    loop = alone(kind, overrides=(*STILL, *starts))
    data.simulated([loop])
    return data.loop(loop, kind, f"{kind}/released at {angle:g}")


def regulated(angle: float, like: Trace) -> Trace:
    """Return the motion from an initial angle [rad] under the LQR at the times of a trace."""
    (A, B), K = held_cart(), lqr()
    state, states, forces = np.array([0, 0, angle, 0]), [], []
    for _ in like.t:
        forces.append(float(np.clip(-K @ state, -LIMIT, LIMIT)[0]))
        state = A @ state + B[:, 0] * forces[-1]
        states.append(state)
    x, _, theta, _ = np.array(states).T
    return replace(like, key="LQR", x=x, theta=theta, e=-theta, u=np.array(forces))


def cart(data: Data) -> Section:
    """Return where the cart goes, and when it leaves a track."""
    leaving = []
    for name, angle in ANGLES.items():
        traces = [stepped(kind, angle, data) for kind in KINDS]
        for track in TRACKS:
            far = [np.flatnonzero(np.abs(trace.x) > track) for trace in traces]
            times = [TS * float(one[0] + 1) if one.size else math.nan for one in far]
            title = f"time to leave a track of ±{track:g} m, step of {name} [s]"
            leaving.append(Row(title, times, not any(map(math.isnan, times))))
    ten = ANGLES["10°"]
    steps = {kind: stepped(kind, ten, data) for kind in KINDS}
    free = {kind: released(kind, ten, data) for kind in KINDS}
    free["LQR"] = regulated(ten, free["PID"])
    rest = [abs(float(trace.x[-1])) for trace in free.values()]
    back = [
        Row("|x(20 s)| [m]", rest, rest[-1] < 1e-3 < min(rest[:-1])),
        Row("largest |x| [m]", [largest(trace.x) for trace in free.values()]),
        Row("largest |u| [N]", [largest(trace.u) for trace in free.values()]),
        Row("largest |θ| from 5 s on [rad]", [largest(t.theta[5000:]) for t in free.values()]),
    ]
    shown = [[curve(t, "x", kind) for kind, t in steps.items()]]
    shown += [[curve(t, name, kind) for kind, t in free.items()] for name in ("x", "theta")]
    return Section(shown, [leaving, back])


def small(data: Data) -> Section:
    """Return how steps of 5° and 10° differ from one of 1 rad, after scaling."""
    curves, measures = [], {"overshoot": [], "settling_2": [], "last": []}
    for angle in ANGLES.values():
        found = {}
        for kind in KINDS:
            trace = stepped(kind, angle, data)
            parts = {name: getattr(trace, name) / angle for name in ("r", "theta", "e")}
            found[kind] = replace(trace, key=f"{trace.key}, scaled", **parts)
        curves.append(outputs(found))
        for key, rows in measures.items():
            rows.append([MEASURES[key].of(trace) for trace in found.values()])
    rows = []
    for name, over, settled, last in zip(ANGLES, *measures.values(), strict=True):
        points = np.subtract(over, measures["overshoot"][-1])
        shares = np.divide(settled, measures["settling_2"][-1]) - 1
        rows += [
            Row(f"overshoot, {name} [%]", over, largest(points) < 1),
            Row(f"settling time to ±2 %, {name} [s]", settled, largest(shares) < 0.05),
            Row(f"|e(20 s)|/r, {name} [1]", last),
        ]
    return Section(curves[:2], [rows])


# --- initial weights ----------------------------------------------------------------------------

DRAWS, SPAN = 100, 1.0
"""Draws of the initial weights, and the largest of their magnitudes [N]."""

PRINTED = {"PID-RBF": 8.2377e-4, "IPID-RBF": 8.6502e-4}
"""Row 3 of Table 1 [rad]."""


def drawn(loop: Loop, data: Data) -> dict[str, np.ndarray]:
    """Return the metrics of a loop with random initial weights of its networks."""
    owners = [name for name, model in loop.models().items() if model in ("PidRbf", "IpidRbf")]
    names = [f"{owner}.rbf.w0[{j}]" for owner in owners for j in range(1, 5)]
    ranges = [{"variables": [name], "uniform": [-SPAN, SPAN]} for name in names]
    return sweep(loop, ranges, data.fmus, draws=DRAWS)


def weights(data: Data) -> Section:
    """Return the spread of the responses over random initial weights."""
    alike, digits, curves = [], [], []
    share = 100 * (np.arange(DRAWS) + 0.5) / DRAWS
    for kind, printed in PRINTED.items():
        step, sine = (drawn(alone(kind, signal=signal), data) for signal in ("step", "sine"))
        for name, values in (
            ("integral of |e| [rad s]", step["iae"]),
            ("settling time to ±0.3 % [s]", step["settling_time"]),
            ("overshoot [%]", 100 * step["overshoot"]),
        ):
            spread = [float(q) for q in np.quantile(values, (0, 0.5, 1))]
            # Overshoots are shares of the step already
            scale = 100.0 if "%]" in name else spread[1]
            alike.append(Row(f"{kind}, {name}", spread, np.ptp(values) < 1e-3 * scale))
        errors = np.sort(sine["final_e"])
        spread = [float(q) for q in np.quantile(errors, (0, 0.5, 1))]
        holds = bool(errors[0] < printed < errors[-1])
        digits.append(Row(f"{kind}, e(20 s) [rad]", [*spread, printed], holds))
        line = Curve(
            f"weights/{kind}/printed", share[[0, -1]], np.full(2, printed), "limit", "printed"
        )
        curves.append([line, Curve(f"weights/{kind}", share, errors, kind)])
    return Section(curves, [alike, digits])


# --- found gains ----------------------------------------------------------------------------------

FOUND = Path(__file__).with_name("gains.toml")
"""The gains that examples/tuning/gains.py has found."""

TUNED = {"PID-RBF": "pid-rbf", "IPID-RBF own": "ipid-rbf"}
"""The tuned controllers, and their tables in this file."""

SEARCHED = {
    "pid.kp": "kp [N/rad]",
    "pid.ki": "ki [N/(rad s)]",
    "pid.kd": "kd [N s/rad]",
    "rbf.eta": "η [1]",
}

UPRIGHT = 0.05
"""|e| below which the angle has to stay for the last 2 s with other plants [rad]."""


def tuned_loops(kind: str, gains: dict[str, float]) -> tuple[list[Loop], list[Loop]]:
    """Return the loop of each signal, and the steps with other plants."""
    given, plants = tuple(gains.items()), []
    for factors in itertools.product((0.8, 1.2), repeat=3):
        scaled = zip(("M", "m", "l"), factors, strict=True)
        plants.append(tuple((f"plant.{name}", NOMINAL[name] * factor) for name, factor in scaled))
    signals = [alone(kind, signal=signal, overrides=given) for signal in SIGNALS]
    return signals, [alone(kind, overrides=(*given, *plant)) for plant in plants]


def tuning(data: Data) -> Section:
    """Compare the gains that a search has found with those of the paper."""
    found = tomllib.loads(FOUND.read_text(encoding="utf-8"))
    areas, last, forces, late, curves = [], [], [], [], []
    for kind, name in TUNED.items():
        before, after = tuned_loops(kind, {})[0], tuned_loops(kind, found[name])
        pairs = list(zip(data.simulated(before), data.simulated(after[0]), strict=True))
        areas += [[iae(pair[i]) for pair in pairs] for i in (0, 1)]
        last += [abs(float(trace.e[-1])) for trace in pairs[0]]
        forces += [[largest(pair[i].u) for pair in pairs] for i in (0, 1)]
        ends = [trace.part((18.0, np.inf)).e for trace in data.simulated(after[1])]
        late.append([largest(end) for end in ends])
        curves += [magnitudes({kind: old, "found": new}) for old, new in pairs]
    rows = []
    for signal, area in zip(SIGNALS, zip(*areas, strict=True), strict=True):
        better = area[1] < area[0] and area[3] < area[2]
        rows.append(Row(f"integral of |e|, {signal} [rad s]", area, better))
    highest = [max(values) for values in forces]
    rows.append(Row("largest force [N]", highest, max(highest) <= LIMIT))
    rows.append(Row("|e(20 s)|, step [rad]", last))
    others = [
        Row(shown, [found[name][f"controller.{gain}"] for name in TUNED.values()])
        for gain, shown in SEARCHED.items()
    ]
    worst = [max(values) for values in late]
    others.append(Row("largest |e| from 18 s on, worst plant [rad]", worst, max(worst) < UPRIGHT))
    return Section(curves, [rows, others])
