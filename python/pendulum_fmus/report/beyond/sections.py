"""All sections beyond the paper, in the order of the page.

A section is a module with `loops()`, the loops that it needs, and
`part(data, fmus)`.
"""

from pathlib import Path

from ...loop import Loop
from ..data import Data
from ..parts import Part
from . import learning, noise, nonlinear, order, robustness, targets, windup

MODULES = (targets, learning, order, windup, robustness, noise, nonlinear)


def loops() -> set[Loop]:
    """Return the loops that the sections need."""
    return {loop for module in MODULES for loop in module.loops()}


def parts(data: Data, fmus: Path) -> list[Part]:
    """Return the sections."""
    return [module.part(data, fmus) for module in MODULES]
