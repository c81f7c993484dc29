"""Sequential against parallel masters."""

from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Finding, Row
from ..data import Data
from ..figure import FORCE, Figure, Panel
from ..metrics import iae, largest, settling, variation
from ..paper.curves import curve
from ..parts import Part
from ..stability import DELAYS, ETA
from .learning import RINGING, loop
from .section import section, statement

NAMES = {
    DELAYS[0]: "sequential, current terms",
    DELAYS[1]: "sequential, previous terms",
    DELAYS[2]: "parallel, current terms",
    DELAYS[3]: "parallel, previous terms",
}

SAME = 1e-9
"""Angles that differ by less are equal up to rounding [rad]."""


def loops() -> list[Loop]:
    """Return the step responses of PID-RBF in both orders, with both kinds of terms."""
    return [loop(delay, ETA, 20000) for delay in DELAYS]


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    traces = {delay: data.loop(loop(delay, ETA, 20000)) for delay in DELAYS}
    late = [largest(np.diff(trace.part(19.0, 21.0).u)) for trace in traces.values()]
    rows = [
        Row("change of u per sample from 19 s on [N]", late, max(late[:3]) < RINGING < late[3]),
        Row("total variation of u [N]", [variation(trace.u) for trace in traces.values()]),
        Row("integral of |e| [rad s]", [iae(trace) for trace in traces.values()]),
        Row("settling ±0.3 % [s]", [settling(trace) for trace in traces.values()]),
    ]
    apart = largest(traces[DELAYS[1]].theta - traces[DELAYS[2]].theta)
    panels = [
        Panel(
            NAMES[delay], FORCE, [curve(trace, "u_n", "u_n"), curve(trace, "u", "u")], xlim=(0, 1)
        )
        for delay, trace in traces.items()
    ]
    return section(
        "beyond-order",
        "The master’s order",
        Figure(
            "order",
            "Order of stepping",
            "Force and the network’s part of it over the first second of a step with PID-RBF, in"
            " sequential and parallel order, with current terms and those of the previous sample.",
            [panels[:2], panels[2:]],
        ),
        [
            statement(
                "A parallel master with current terms gives the same loop as a sequential master"
                " with those of the previous sample, as in Table 1",
                "the angles differ by less than 1e-9 rad over 20 s",
                Finding(["both"], [Row("max |Δθ| [rad]", [apart], apart < SAME)]),
            ),
            statement(
                "PID-RBF rings only in parallel order with the terms of the previous sample",
                "step; from 19 s on u changes by more than 1 N per sample only in that case",
                Finding(["seq., now", "seq., prev.", "par., now", "par., prev."], rows),
            ),
        ],
        ("“Prev.” means the terms of the previous sample (parameter previous_sample_terms).",),
    )
