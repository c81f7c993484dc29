"""Robustness against plant parameters that differ from those used for tuning."""

from functools import cache
from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Claim, Finding, Row
from ..data import Data
from ..figure import FORCE, Curve, Figure, Panel
from ..metrics import HOLD, largest, settling, tone
from ..native import both_plants, sweep
from ..paper.compare import COLUMNS
from ..paper.curves import END, curve
from ..parts import Part
from ..scenarios import KINDS
from ..stability import ETA, LAWS, NOMINAL, matrix, rate_limit, spectral_radius
from .learning import RINGING
from .section import section, statement

FACTORS = np.geomspace(0.25, 4, 33)
"""Factors of a parameter; 1 is in the middle."""

LIGHT = FACTORS[:15:2]
"""Factors of the cart's mass below and just above those at which PID-RBF rings."""

SWEPT = {"M": ("kg", "mass of the cart"), "l": ("m", "length to the centre of mass")}
"""Unit and meaning of the parameters."""

DIVERGED = 1000.0
"""|e| above which a loop has diverged [rad]."""

SLIGHT = 0.1
"""Relative growth of the integral of |e| that counts as slight."""

Swept = dict[str, dict[str, np.ndarray]]


def loops() -> list[Loop]:
    """Return the steps of PID-RBF with light carts; a sweep has only metrics."""
    return [light(mass) for mass in NOMINAL["M"] * LIGHT]


def light(mass: float) -> Loop:
    """Return the step response of PID-RBF with a mass of the cart [kg]."""
    return Loop("PidRbf", "step", overrides=(("plant.M", float(mass)),))


@cache
def swept(variable: str, fmus: Path) -> Swept:
    """Return the metrics of all controllers over FACTORS."""
    values = NOMINAL[variable] * FACTORS
    runs = {
        kind: sweep(kind, both_plants(kind, variable), values, {}, DIVERGED, fmus) for kind in KINDS
    }
    for metrics in runs.values():
        # A loop that still swings through the band at the end has not settled
        metrics["settling_time"][metrics["settling_time"] > END - HOLD] = np.nan
    return runs


def growths(variable: str, fmus: Path) -> dict[str, float]:
    """Return by how much the integral of |e| exceeds the nominal one at worst, relative to it."""
    middle = len(FACTORS) // 2
    return {
        kind: float(np.max(m["iae"]) / m["iae"][middle] - 1)
        for kind, m in swept(variable, fmus).items()
    }


def finding(variable: str, fmus: Path) -> Finding:
    """Return which controllers stabilized the pendulum, and at what cost."""
    runs, worse = swept(variable, fmus), list(growths(variable, fmus).values())
    fell = [int(np.sum(m["diverged"])) for m in runs.values()]
    growth = [100 * one for one in worse]
    unsettled = [int(np.sum(np.isnan(m["settling_time"]))) for m in runs.values()]
    return Finding(
        COLUMNS,
        [
            Row(f"number that diverged, of {len(FACTORS)}", fell, max(fell) == 0),
            Row(
                f"number that never settled to ±0.3 %, of {len(FACTORS)}",
                unsettled,
                max(unsettled) == 0,
            ),
            Row("integral of |e| at worst above nominal [%]", growth, max(worse) < SLIGHT),
        ],
    )


def swinging(data: Data) -> Claim:
    """Return why some loops with PID-RBF never settle."""
    rows = []
    for mass in NOMINAL["M"] * LIGHT:
        trace = data.loop(light(mass))
        late = trace.part(19.0, 21.0)
        step = largest(np.diff(late.u))
        plant = NOMINAL | {"M": mass}
        limit = rate_limit(LAWS["PID-RBF"], 0, plant)
        frequency = tone(late.u, trace.ts) if step > RINGING else "–"
        values = [limit, step, frequency, largest(late.e), settling(trace)]
        rows.append(Row(f"M = {mass:.3f} kg", values, (limit < ETA) == (step > RINGING)))
    lightest = NOMINAL | {"M": NOMINAL["M"] * LIGHT[0]}
    pid = spectral_radius(matrix(LAWS["PID"], plant=lightest))
    return statement(
        "PID-RBF never settles with the lightest carts, since there its learning rate is beyond the"
        " limit: it rings on, in a limit cycle that the force limit bounds",
        f"step, linear plant, from 19 s on: u changes by more than {RINGING:g} N per sample where,"
        f" and only where, the largest stable η is below {ETA:g}",
        Finding(
            [
                "stable up to η [1]",
                "Δu per sample [N]",
                "ringing [Hz]",
                "max |e| [rad]",
                "settling [s]",
            ],
            rows,
            "A light cart answers a force with more acceleration, which raises the gain of the"
            " loop and with it that of learning. Where the limit cycle stays within 0.003 rad, the"
            " loop counts as settled though it rings. With the lightest cart even the loop of a"
            f" PID is unstable (spectral radius {pid:.4f}).",
        ),
    )


def curves(runs: Swept, variable: str, metric: str) -> list[Curve]:
    """Return a metric over the parameter; runs without a value are omitted."""
    found = []
    for kind, metrics in runs.items():
        known = np.isfinite(metrics[metric]) & (metrics["diverged"] == 0)
        if np.sum(known) > 1:
            x = NOMINAL[variable] * FACTORS[known]
            found.append(Curve(f"{variable}/{metric}/{kind}", x, metrics[metric][known], kind))
    return found


def limits(data: Data) -> list[Panel]:
    """Return panels of the limit of the learning rate, and of the ringing beyond it."""
    mass = NOMINAL["M"] * FACTORS
    stable = [rate_limit(LAWS["PID-RBF"], 0, NOMINAL | {"M": one}) for one in mass]
    paper = np.full(len(mass), ETA)
    trace = data.loop(light(mass[0]))
    return [
        Panel(
            "largest stable learning rate",
            "η [1]",
            [
                Curve("eta/paper", mass, paper, "limit", "η of the paper"),
                Curve("eta/stable", mass, np.array(stable), "PID-RBF"),
            ],
            x_label="M, mass of the cart [kg]",
            xlim=(mass[0], mass[-1]),
            ylim=(0.0, 0.4),
            log_x=True,
        ),
        Panel(f"PID-RBF, M = {mass[0]:.3f} kg", FORCE, [curve(trace, "u", "u")], xlim=(19.8, 20.0)),
    ]


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    runs = {variable: swept(variable, fmus) for variable in SWEPT}
    rows, claims = [], []
    for variable, (unit, meaning) in SWEPT.items():
        value = NOMINAL[variable]
        label = f"{variable}, {meaning} [{unit}]"
        row = [
            Panel(
                title,
                y_label,
                curves(runs[variable], variable, metric),
                x_label=label,
                xlim=(value * FACTORS[0], value * FACTORS[-1]),
                log_x=True,
            )
            for title, y_label, metric in (
                ("integral of |e|", "IAE [rad s]", "iae"),
                ("settling ±0.3 %", "time [s]", "settling_time"),
            )
        ]
        rows.append(row)
        low, high = value * FACTORS[0], value * FACTORS[-1]
        claims.append(
            statement(
                f"All controllers stabilize a pendulum whose {meaning} is between a quarter and"
                " four times the nominal one",
                f"step, linear plant, {len(FACTORS)} values of {variable} from {low:.3g} {unit} to"
                f" {high:.3g} {unit}; no loop diverges, each settles, and the integral of |e| is"
                " less than 10 % above the nominal one",
                finding(variable, fmus),
            )
        )
    rows.append(limits(data))
    claims.append(swinging(data))
    return section(
        "beyond-robustness",
        "Other pendulums",
        Figure(
            "robustness",
            "Other pendulums",
            "Integral of the absolute error and settling time of all controllers over the mass of"
            " the cart and the length of the pendulum; the largest stable learning rate over the"
            " mass, and the force of the lightest cart, which rings.",
            rows,
        ),
        claims,
        (
            "Computed by sweeps with the native master. Points are missing where the error does not"
            " stay within the band.",
        ),
    )
