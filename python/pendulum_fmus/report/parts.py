"""A part of the page: a section or figure, with its judged statements."""

from collections.abc import Sequence
from dataclasses import dataclass

from .claims import Judged, Register, Verdict
from .paper.entry import Entry


@dataclass(frozen=True)
class Part(Entry):
    """A section or figure as shown on the page: an entry with its judged statements.

    Parameters
    ----------
    judged
        The statements with their verdicts.
    """

    judged: Sequence[Judged] = ()


def judged(entry: Entry, register: Register) -> Part:
    """Judge the statements of an entry."""
    return Part(**vars(entry), judged=register.judge(entry.claims))


def parts_of(entries: Sequence[Entry]) -> list[Part]:
    """Judge the statements of the paper; return its sections and figures."""
    register = Register()
    return [judged(entry, register) for entry in entries]


def counts(parts: Sequence[Part]) -> dict[Verdict, int]:
    """Return how many statements got each verdict."""
    found = [one.verdict for part in parts for one in part.judged]
    return {verdict: found.count(verdict) for verdict in Verdict}
