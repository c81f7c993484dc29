"""A section or figure of the paper with its texts on the page."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..claims import Claim
from ..figure import Figure

LOST = "(This figure’s caption is missing in the text that the quotations were taken from.)"
"""Placeholder for the captions of Figures 4 and 14, which the extracted text lacks."""


@dataclass(frozen=True)
class Entry:
    """A section or figure of the paper.

    Parameters
    ----------
    anchor
        Target of links.
    heading
        Heading on the page.
    caption
        Caption in the paper, or a remark on what is shown.
    figure
        The reproduced or additional figure, if any.
    claims
        Statements of the paper about it.
    notes
        Remarks on how it was drawn.
    """

    anchor: str
    heading: str
    caption: str
    figure: Figure | None
    claims: Sequence[Claim]
    notes: Sequence[str] = ()


def numbered(
    number: int, caption: str, figure: Figure, claims: Sequence[Claim], notes: Sequence[str] = ()
) -> Entry:
    """Return a figure of the paper."""
    heading = f"Figure {number}. {figure.title}"
    return Entry(figure.name, heading, caption, figure, claims, notes)
