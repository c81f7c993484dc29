"""IPID-RBF with its own force as target (29), compared with that of Table 1."""

from pathlib import Path

from ...loop import Loop
from ..claims import Finding, Row
from ..data import Data
from ..figure import Figure, Panel
from ..metrics import final, iae, settling
from ..paper.curves import END, SMALLEST, absolute_errors
from ..parts import Part
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
    quantities = {
        "|e(20 s)|, step [rad]": [final(data(kind, "step")) for kind in KINDS],
        "settling ±0.3 %, step [s]": [settling(data(kind, "step")) for kind in KINDS],
    } | {
        f"integral of |e|, {signal} [rad s]": [iae(data(kind, signal)) for kind in KINDS]
        for signal in SIGNALS
    }
    rows = [Row(name, values, values[1] < values[0]) for name, values in quantities.items()]
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
                "With its own force as target, as printed, IPID-RBF is better than with the"
                " supervisor’s force, which was used for Table 1",
                "each row is smaller with its own target",
                Finding(COLUMNS, rows),
            )
        ],
    )
