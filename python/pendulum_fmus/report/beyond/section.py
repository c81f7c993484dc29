"""A section beyond the paper, and its statements."""

from collections.abc import Sequence

from ..claims import Claim, Finding, judged
from ..figure import Figure
from ..page import Part


def statement(says: str, measured: str, finding: Finding) -> Claim:
    """Return a statement with its measurement."""
    return Claim(says, measured, lambda _: finding)


def section(
    anchor: str, heading: str, figure: Figure, claims: Sequence[Claim], notes: Sequence[str] = ()
) -> Part:
    """Return a section of the page."""
    return Part(anchor, heading, "", notes, figure, judged(claims))
