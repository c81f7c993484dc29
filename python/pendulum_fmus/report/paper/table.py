"""Table 1, the rows with fitted weights, and the settling times, printed and computed."""

import math
from dataclasses import dataclass

from ... import table1
from ..claims import Verdict, judge
from ..data import Data

NAMES = {"Pid": "PID", "PidRbf": "PID-RBF", "IpidRbf": "IPID-RBF"}


@dataclass(frozen=True)
class Line:
    """One number of the paper.

    Parameters
    ----------
    row, disturbance, signal, controller
        Position in the table; a row with a star has fitted initial weights.
    printed
        Number as printed in the paper.
    computed
        Result of the FMUs: an error [rad], or a settling time [s].
    every_digit
        Whether it rounds to all printed digits.
    verdict
        Whether it is reproduced.
    settling
        Whether it is a settling time.
    """

    row: str
    disturbance: str
    signal: str
    controller: str
    printed: str
    computed: float
    every_digit: bool
    verdict: Verdict
    settling: bool

    @property
    def shown(self) -> str:
        """The computed number, with more digits than the printed one."""
        return f"{self.computed:.4f} s" if self.settling else f"{self.computed:.6e}"


def lines(data: Data) -> list[Line]:
    """Return all numbers in the order of the table."""
    found = []
    for entry in table1.entries():
        computed = entry.computed(data.results[entry.run])
        digits = math.isfinite(computed) and table1.agrees(computed, entry.printed)
        row, disturbance, signal, controller = entry.label
        found.append(
            Line(
                row,
                disturbance,
                signal,
                NAMES[controller],
                entry.printed,
                computed,
                digits,
                judge([entry.holds(computed), digits]),
                entry.settling,
            )
        )
    return found
