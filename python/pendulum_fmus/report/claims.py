"""The paper's statements: quotation, criterion, measurement and verdict.

A verdict is never written down: it follows from the rows of the numbers. A statement holds if it
holds by every row, holds in part if by some, and does not hold if by none.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from .numbers import number

OWN = "own target"
"""Heading of the column of IPID-RBF with its own force as target (29)."""

SHORT = 6
"""Rows of a table that may be repeated on the page."""

UNIT = re.compile(r" \[[^\]]*\]")
"""A unit in the name of a measure."""

LISTED = 3
"""Measures that are named before the rest is only counted."""


class Verdict(Enum):
    """Verdict on a statement: (label, sign, class on the page)."""

    HOLDS = ("holds", "✓", "holds")
    PART = ("holds in part", "◐", "partly")
    FAILS = ("does not hold", "✗", "fails")

    @property
    def label(self) -> str:
        """Label on the page."""
        return self.value[0]

    @property
    def sign(self) -> str:
        """A character that distinguishes it without colour."""
        return self.value[1]

    @property
    def css(self) -> str:
        """Class on the page."""
        return self.value[2]


def judge(decisive: Sequence[bool]) -> Verdict:
    """Return the verdict on a statement that is measured in several ways, at least one."""
    if not decisive:
        raise ValueError("a statement needs at least one measure")
    if all(decisive):
        return Verdict.HOLDS
    return Verdict.PART if any(decisive) else Verdict.FAILS


@dataclass(frozen=True)
class Row:
    """One measure of a statement.

    Parameters
    ----------
    name
        What is measured, with its unit.
    values
        A number or text per column.
    holds
        Whether the statement holds by this measure; None if the row is only information.
    """

    name: str
    values: Sequence[float | str]
    holds: bool | None = None

    def cells(self) -> list[str]:
        """Return the values as text."""
        return [value if isinstance(value, str) else number(value) for value in self.values]

    @property
    def css(self) -> str:
        """Class on the page."""
        return {True: "yes", False: "no", None: ""}[self.holds]


@dataclass(frozen=True)
class Finding:
    """The result of measuring a statement.

    Parameters
    ----------
    columns
        Headings of the columns.
    rows
        The measures.
    remark
        What the reader should know beyond the numbers.
    """

    columns: Sequence[str]
    rows: Sequence[Row]
    remark: str = ""

    @property
    def verdict(self) -> Verdict:
        """The verdict that follows from the rows."""
        return judge([row.holds for row in self.decisive])

    @property
    def decisive(self) -> list[Row]:
        """The rows that are more than information."""
        return [row for row in self.rows if row.holds is not None]

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
        held = [row for row in self.decisive if row.holds]
        missed = [row for row in self.decisive if not row.holds]
        if not held or not missed:
            return ""
        return f"only by {_names(held)}" if len(held) < len(missed) else f"not by {_names(missed)}"


def _names(rows: Sequence[Row]) -> str:
    """Name some rows, without their units."""
    names = [UNIT.sub("", row.name) for row in rows]
    rest = f"; and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return "; ".join(names[:LISTED]) + rest


@dataclass(frozen=True)
class Claim:
    """A statement of the paper.

    Parameters
    ----------
    says
        A quotation, or a paraphrase without quotation marks.
    criterion
        The rule by which each row of the finding is decided.
    measure
        Function that measures it, given the variant of IPID-RBF: "IPID-RBF" as in Table 1 or
        "IPID-RBF own".
    """

    says: str
    criterion: str
    measure: Callable[[str], Finding]


@dataclass(frozen=True)
class Judged:
    """A statement with its result.

    Parameters
    ----------
    claim, finding
        The statement and its measurement.
    own
        The verdict if IPID-RBF learns its own force (29).
    number
        Running number on the page.
    source
        Number of an earlier statement that has the same numbers, and more; 0 if there is none.
    """

    claim: Claim
    finding: Finding
    own: Verdict
    number: int
    source: int = 0

    @property
    def verdict(self) -> Verdict:
        """The verdict for the controllers of Table 1."""
        return self.finding.verdict


class Register:
    """Measures statements and numbers them in the order of the page."""

    def __init__(self) -> None:
        self.found: list[Judged] = []
        self.section = 0

    def judge(self, claims: Sequence[Claim]) -> list[Judged]:
        """Measure statements."""
        self.section = start = len(self.found)
        for claim in claims:
            finding, own = claim.measure("IPID-RBF"), claim.measure("IPID-RBF own").verdict
            number = len(self.found) + 1
            self.found.append(Judged(claim, finding, own, number, self._source(finding)))
        return self.found[start:]

    def _source(self, finding: Finding) -> int:
        wanted = _numbers(finding)
        # A short table is worth repeating beside another figure
        earlier_ones = self.found if finding.long else self.found[self.section :]
        for earlier in earlier_ones:
            if not earlier.source and wanted <= _numbers(earlier.finding):
                return earlier.number
        return 0


def _numbers(finding: Finding) -> set[tuple[str, ...]]:
    return {(*finding.columns, row.name, *row.cells()) for row in finding.rows}
