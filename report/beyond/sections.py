"""All sections beyond the paper, in the page's order.

A section is a module with `loops()`, what it needs of the FMPy master, and `part(data, fmus)`.
"""

from pathlib import Path

from ..data import Data
from ..page import Part
from ..scenarios import Loop
from . import learning, noise, nonlinear, order, robustness, targets, windup


def loops() -> set[Loop]:
    """Return the loops that the sections need of the FMPy master."""
    modules = (targets, learning, order, windup, nonlinear)
    return {loop for module in modules for loop in module.loops()}


def parts(data: Data, fmus: Path) -> list[Part]:
    """Return the sections."""
    modules = (targets, learning, order, windup, robustness, noise, nonlinear)
    return [module.part(data, fmus) for module in modules]
