"""The paper's claims: quotation, criterion, measurement and verdict."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from .numbers import number


class Verdict(Enum):
    """Verdict on a claim: (label, sign)."""

    HOLDS = ("holds", "✓")
    REMARK = ("holds with a remark", "◐")
    FAILS = ("does not hold", "✗")

    @property
    def label(self) -> str:
        """Label on the page."""
        return self.value[0]

    @property
    def sign(self) -> str:
        """A character that distinguishes it without colour."""
        return self.value[1]


def judge(main: bool, whole: bool = True) -> Verdict:
    """Return HOLDS if a claim is fully true, REMARK if only its main part is."""
    if not main:
        return Verdict.FAILS
    return Verdict.HOLDS if whole else Verdict.REMARK


@dataclass(frozen=True)
class Table:
    """Numbers behind a verdict.

    Parameters
    ----------
    columns
        Headings of the columns.
    rows
        One number or text per column, by quantity with its unit.
    """

    columns: Sequence[str]
    rows: Mapping[str, Sequence[float | str]]

    def cells(self) -> list[tuple[str, list[str]]]:
        """Return the rows as text."""
        return [(name, [_cell(value) for value in row]) for name, row in self.rows.items()]


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else number(value)


@dataclass(frozen=True)
class Finding:
    """The result of measuring a claim."""

    verdict: Verdict
    table: Table
    remark: str = ""


@dataclass(frozen=True)
class Claim:
    """A statement of the paper.

    Parameters
    ----------
    says
        A short quotation, or a paraphrase without quotation marks.
    criterion
        The rule by which the verdict follows from the numbers.
    measure
        Function that measures it, given the variant of IPID-RBF: "IPID-RBF" as in Table 1 or
        "IPID-RBF own".
    """

    says: str
    criterion: str
    measure: Callable[[str], Finding]


@dataclass(frozen=True)
class Judged:
    """A claim with its result.

    Parameters
    ----------
    claim, finding
        The claim and its measurement.
    own
        The verdict if IPID-RBF learns its own force (29).
    number
        Number of the claim in its part of the page.
    repeats
        Whether its numbers equal those of the previous claim.
    """

    claim: Claim
    finding: Finding
    own: Verdict
    number: int = 0
    repeats: bool = False

    @property
    def verdict(self) -> Verdict:
        """Whether the claim holds for the controllers of Table 1."""
        return self.finding.verdict


def judged(claims: Sequence[Claim]) -> list[Judged]:
    """Measure claims."""
    found: list[Judged] = []
    for i, claim in enumerate(claims, start=1):
        finding, own = claim.measure("IPID-RBF"), claim.measure("IPID-RBF own").verdict
        repeats = bool(found) and finding.table.cells() == found[-1].finding.table.cells()
        found.append(Judged(claim, finding, own, i, repeats))
    return found
