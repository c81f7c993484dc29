"""Robustness against plant parameters that differ from those used for tuning."""

from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Finding, Table, judge
from ..data import Data
from ..figure import Curve, Figure, Panel
from ..metrics import HOLD
from ..native import both_plants, sweep
from ..page import Part
from ..paper.compare import COLUMNS
from ..paper.curves import END
from ..scenarios import KINDS
from .section import section, statement

FACTORS = np.geomspace(0.25, 4, 33)
"""Factors of a parameter; 1 is in the middle."""

NOMINAL = {"M": (1.096, "kg", "mass of the cart"), "l": (0.25, "m", "length to the centre of mass")}

DIVERGED = 1000.0
"""|e| above which a loop has diverged [rad]."""

SLIGHT = 0.1
"""Relative growth of the integral of |e| that counts as slight."""

Swept = dict[str, dict[str, np.ndarray]]


def loops() -> list[Loop]:
    """Return no loops: all results are from sweeps."""
    return []


def swept(variable: str, fmus: Path) -> Swept:
    """Return the metrics of all controllers over FACTORS."""
    values = NOMINAL[variable][0] * FACTORS
    runs = {
        kind: sweep(kind, both_plants(kind, variable), values, {}, DIVERGED, fmus) for kind in KINDS
    }
    for metrics in runs.values():
        # A loop that still swings through the band at the end has not settled
        metrics["settling_time"][metrics["settling_time"] > END - HOLD] = np.nan
    return runs


def finding(runs: Swept) -> Finding:
    """Return which controllers stabilized the pendulum, and at what cost."""
    middle = len(FACTORS) // 2
    fell = [int(np.sum(m["diverged"])) for m in runs.values()]
    worse = [float(np.max(m["iae"]) / m["iae"][middle] - 1) for m in runs.values()]
    unsettled = [int(np.sum(np.isnan(m["settling_time"]))) for m in runs.values()]
    return Finding(
        judge(max(fell) == 0, max(worse) < SLIGHT),
        Table(
            COLUMNS,
            {
                f"diverged, of {len(FACTORS)}": fell,
                f"never within ±0.3 %, of {len(FACTORS)}": unsettled,
                "IAE at worst above nominal [%]": [100 * w for w in worse],
            },
        ),
    )


def curves(runs: Swept, variable: str, metric: str) -> list[Curve]:
    """Return a metric over the parameter; runs without a value are omitted."""
    found = []
    for kind, metrics in runs.items():
        known = np.isfinite(metrics[metric]) & (metrics["diverged"] == 0)
        if np.sum(known) > 1:
            x = NOMINAL[variable][0] * FACTORS[known]
            found.append(Curve(f"{variable}/{metric}/{kind}", x, metrics[metric][known], kind))
    return found


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    runs = {variable: swept(variable, fmus) for variable in NOMINAL}
    rows, claims = [], []
    for variable, (value, unit, meaning) in NOMINAL.items():
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
                f" {high:.3g} {unit}; holds if no loop diverges, fully if the integral of |e|"
                " grows by less than 10 %",
                finding(runs[variable]),
            )
        )
    return section(
        "beyond-robustness",
        "Other pendulums",
        Figure(
            "robustness",
            "Other pendulums",
            "Integral of the absolute error and settling time of all controllers over the mass of"
            " the cart and the length of the pendulum.",
            rows,
        ),
        claims,
        (
            "Computed by sweeps with the native master. Points are missing where the error does not"
            " stay within the band.",
        ),
    )
