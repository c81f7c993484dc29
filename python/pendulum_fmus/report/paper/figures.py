"""All figures of the paper, in its order."""

from ..data import Data
from . import errors, forces, gains, tracking
from .entry import Entry


def entries(data: Data) -> list[Entry]:
    """Return Figures 2 and 4 to 21."""
    found = [gains.entry(data)]
    found += tracking.entries(data) + forces.entries(data) + errors.entries(data)
    return sorted(found, key=lambda entry: entry.number)
