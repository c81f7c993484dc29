"""All sections and figures of the paper, in its order."""

from ..data import Data
from . import conclusions, errors, forces, gains, introduction, network, objective, tracking
from .entry import Entry


def entries(data: Data) -> list[Entry]:
    """Return abstract, sections 2 and 3 with Figure 2, Figures 4 to 21, and the conclusions."""
    figures = tracking.entries(data) + forces.entries(data) + errors.entries(data)
    figures.sort(key=lambda entry: int(entry.anchor.removeprefix("figure-")))
    return [
        introduction.entry(data),
        objective.entry(data),
        gains.entry(data),
        *network.entries(data),
        *figures,
        conclusions.entry(data),
    ]
