"""A figure of the paper, with all that the page says about it."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..claims import Claim
from ..figure import Figure

LOST = "(This figure’s caption is missing in the text that the quotations were taken from.)"
"""What stands for the captions of Figures 4 and 14, which the extracted text does not have."""


@dataclass(frozen=True)
class Entry:
    """A figure of the paper.

    Parameters
    ----------
    number
        As the paper numbers it.
    caption
        As the paper prints it.
    figure
        What is drawn for it.
    claims
        What the paper says of it.
    notes
        What a reader should know about how it was drawn.
    """

    number: int
    caption: str
    figure: Figure
    claims: Sequence[Claim]
    notes: Sequence[str] = ()
