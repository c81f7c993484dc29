"""A figure of the paper with its texts on the page."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..claims import Claim
from ..figure import Figure

LOST = "(This figure’s caption is missing in the text that the quotations were taken from.)"
"""Placeholder for the captions of Figures 4 and 14, which the extracted text lacks."""


@dataclass(frozen=True)
class Entry:
    """A figure of the paper.

    Parameters
    ----------
    number
        Number in the paper.
    caption
        Caption in the paper.
    figure
        The reproduced figure.
    claims
        Claims of the paper about it.
    notes
        Remarks on how it was drawn.
    """

    number: int
    caption: str
    figure: Figure
    claims: Sequence[Claim]
    notes: Sequence[str] = ()
