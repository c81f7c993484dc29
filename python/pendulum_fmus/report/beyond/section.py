"""A section beyond the paper, and its statements."""

from collections.abc import Sequence

from ..claims import Claim, Finding, Register
from ..figure import Figure
from ..paper.entry import Entry
from ..parts import Part, judged


def statement(says: str, measured: str, finding: Finding) -> Claim:
    """Return a statement with its measurement."""
    return Claim(says, measured, lambda _: finding)


def section(
    anchor: str, heading: str, figure: Figure, claims: Sequence[Claim], notes: Sequence[str] = ()
) -> Part:
    """Return a section of the page."""
    return judged(Entry(anchor, heading, "", figure, claims, notes), Register())
