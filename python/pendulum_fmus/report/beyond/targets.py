"""IPID-RBF with its own force as target (29), compared with that of Table 1."""

from pathlib import Path

from ...loop import Loop
from ..claims import Finding, Table, judge
from ..data import Data
from ..figure import Figure, Panel
from ..metrics import iae, settling
from ..page import Part
from ..paper.curves import END, SMALLEST, absolute_errors
from ..scenarios import SIGNALS
from .section import section, statement

KINDS = ("IPID-RBF", "IPID-RBF own")
COLUMNS = ("supervised", "own target")


def loops() -> list[Loop]:
    """Return no loops, as those of the paper's figures are sufficient."""
    return []


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    panels = [
        Panel(
            signal,
            "|e| [rad]",
            absolute_errors({kind: data(kind, signal) for kind in KINDS}),
            xlim=(0, END),
            ylim=(SMALLEST, 10),
            log_y=True,
        )
        for signal in SIGNALS
    ]
    areas = {s: [iae(data(kind, s)) for kind in KINDS] for s in SIGNALS}
    final = [abs(float(data(kind, "step").e[-1])) for kind in KINDS]
    times = [settling(data(kind, "step")) for kind in KINDS]
    rows = {f"IAE, {signal} [rad s]": values for signal, values in areas.items()}
    smaller = all(own < supervised for supervised, own in areas.values())
    figure = Figure(
        "targets",
        "Two targets",
        "Magnitude of the error of IPID-RBF with both targets over 20 s, for step, sine and square"
        " wave.",
        [panels],
    )
    return section(
        "beyond-targets",
        "Target of IPID-RBF",
        figure,
        [
            statement(
                "With its own force as target, as printed, IPID-RBF has a smaller static error and"
                " settles faster than with the supervisor’s force, which was used for Table 1",
                "step; fully if the integral of |e| is also smaller for all three signals",
                Finding(
                    judge(final[1] < final[0] and times[1] < times[0], smaller),
                    Table(
                        COLUMNS,
                        {"|e(20 s)| [rad]": final, "settling ±0.3 % [s]": times, **rows},
                    ),
                ),
            )
        ],
    )
