"""A part of the page: a section or figure, with its judged statements."""

from collections.abc import Sequence
from dataclasses import dataclass

from .claims import Judged, Register, Verdict
from .figure import Figure
from .paper.entry import Entry


@dataclass(frozen=True)
class Part:
    """A section or figure of the paper, or an additional section, as shown on the page.

    Parameters
    ----------
    anchor
        Target of links.
    heading, caption, notes
        Text above and below the figure.
    figure
        The figure, if any.
    judged
        The statements with their verdicts.
    """

    anchor: str
    heading: str
    caption: str
    notes: Sequence[str]
    figure: Figure | None
    judged: Sequence[Judged]


def parts_of(entries: Sequence[Entry]) -> list[Part]:
    """Judge the statements of the paper; return its sections and figures."""
    register = Register()
    return [
        Part(
            entry.anchor,
            entry.heading,
            entry.caption,
            entry.notes,
            entry.figure,
            register.judge(entry.claims),
        )
        for entry in entries
    ]


def counts(parts: Sequence[Part]) -> dict[Verdict, int]:
    """Return how many statements got each verdict."""
    found = [one.verdict for part in parts for one in part.judged]
    return {verdict: found.count(verdict) for verdict in Verdict}
