"""Statements and their verdicts: quotation, criterion, measurement.

A verdict is never written down: it follows from the rows of the numbers. A statement holds if it
holds by every row, holds in part if by some, and does not hold if by none.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from .figure import Figure

OWN = "own target"
"""Heading of the column of IPID-RBF with its own force as target (29)."""

COLUMNS = ("PID", "PID-RBF", "IPID-RBF", OWN)
"""Headings of the columns of the four controllers."""

SHORT = 6
"""Rows of a table that may be repeated on the page."""

UNIT = re.compile(r" \[[^\]]*\]")
"""A unit in the name of a measure."""

LISTED = 3
"""Measures that are named before the rest is only counted."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 4) -> str:
    """Return a number with `digits` significant digits; "never" for NaN and infinity."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not math.isfinite(value):
        return "never"
    if isinstance(value, int):
        return str(value)
    if value and not 1e-3 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa} · 10{str(int(exponent)).translate(SUPERSCRIPTS)}".replace("-", "−")
    text = f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:.0f}"
    return text.replace("-", "−")


class Verdict(Enum):
    """Verdict on a statement: label and class on the page, and a sign that needs no colour."""

    HOLDS = ("holds", "✓", "holds")
    PART = ("holds in part", "◐", "partly")
    FAILS = ("does not hold", "✗", "fails")
    FITTED = ("fitted", "○", "fitted")

    def __init__(self, label: str, sign: str, css: str):
        self.label, self.sign, self.css = label, sign, css


def judge(decisive: Sequence[bool]) -> Verdict:
    """Return the verdict on a statement that is measured in several ways, at least one."""
    if not decisive:
        raise ValueError("a statement needs at least one measure")
    if all(decisive):
        return Verdict.HOLDS
    return Verdict.PART if any(decisive) else Verdict.FAILS


@dataclass(frozen=True)
class Row:
    """One measure of a statement."""

    name: str  # with its unit
    values: Sequence[float | str]  # one per column
    holds: bool | None = None  # whether the statement holds by it; None: only information

    def cells(self) -> list[str]:
        """Return the values as text."""
        return [value if isinstance(value, str) else number(value) for value in self.values]

    @property
    def css(self) -> str:
        """Class on the page."""
        return {True: "yes", False: "no", None: ""}[self.holds]


@dataclass(frozen=True)
class Finding:
    """The result of measuring a statement: columns, rows, and what else the reader should know."""

    columns: Sequence[str]
    rows: Sequence[Row]
    remark: str = ""
    fitted: bool = False  # whether a number was chosen so that the statement holds

    @property
    def decisive(self) -> list[Row]:
        """The rows that are more than information."""
        return [row for row in self.rows if row.holds is not None]

    @property
    def verdict(self) -> Verdict:
        """The verdict that follows from the rows."""
        found = judge([row.holds for row in self.decisive])
        return Verdict.FITTED if self.fitted and found is Verdict.HOLDS else found

    @property
    def long(self) -> bool:
        """Whether the table is too long to be repeated."""
        return len(self.rows) > SHORT

    @property
    def key(self) -> str:
        """The numbers of the first row that decides: one that fails, if any does."""
        row = next((row for row in self.decisive if not row.holds), self.decisive[0])
        pairs = zip(self.columns, row.cells(), strict=True)
        numbers = ", ".join(f"{column} {cell}" for column, cell in pairs if cell and column != OWN)
        return f"{row.name}: {numbers}"

    @property
    def decided_by(self) -> str:
        """What decides that the statement holds in part only; empty otherwise."""
        held = [UNIT.sub("", row.name) for row in self.decisive if row.holds]
        missed = [UNIT.sub("", row.name) for row in self.decisive if not row.holds]
        if not held or not missed:
            return ""
        names, word = (held, "only by") if len(held) < len(missed) else (missed, "not by")
        rest = f"; and {len(names) - LISTED} more" if len(names) > LISTED else ""
        return f"{word} {'; '.join(names[:LISTED])}{rest}"


@dataclass(frozen=True)
class Judged:
    """A statement with its result."""

    says: str  # a quotation, or a paraphrase without quotation marks
    criterion: str
    finding: Finding  # for the controllers of Table 1
    own: Verdict  # if IPID-RBF learns its own force (29)
    number: int = 0  # on the page
    source: int = 0  # number of an earlier statement that has the same numbers, and more

    @property
    def verdict(self) -> Verdict:
        """The verdict for the controllers of Table 1."""
        return self.finding.verdict


def numbered(statements: Iterable[Judged], earlier: list[Judged]) -> list[Judged]:
    """Give the statements of a section their numbers on the page, and add them to `earlier`.

    Tables that an earlier statement has are left to it; but a short table is worth repeating
    beside another figure.
    """
    start = len(earlier)
    for one in statements:
        known, wanted = earlier[0 if one.finding.long else start :], _numbers(one.finding)
        sources = (k.number for k in known if not k.source and wanted <= _numbers(k.finding))
        earlier.append(replace(one, number=len(earlier) + 1, source=next(sources, 0)))
    return earlier[start:]


def _numbers(finding: Finding) -> set[tuple[str, ...]]:
    return {(*finding.columns, row.name, *row.cells()) for row in finding.rows}


@dataclass(frozen=True)
class Part:
    """A section or figure as shown on the page."""

    anchor: str
    heading: str
    caption: str  # in the paper, or a remark on what is shown
    notes: Sequence[str]  # on how it was drawn
    figure: Figure | None
    judged: Sequence[Judged]
    beside: int  # how many of them stand beside the figure


def counts(parts: Sequence[Part]) -> dict[Verdict, int]:
    """Return how many statements got each verdict."""
    found = [one.verdict for part in parts for one in part.judged]
    return {verdict: found.count(verdict) for verdict in Verdict}
