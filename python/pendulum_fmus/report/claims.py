"""Statements and their verdicts: quotation, criterion, measurement.

A verdict is never written down: it follows from the rows of the numbers, and a statement's from
its claims. `Verdict` defines them all.
"""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum

from .figure import Figure

OWN = "own target"
"""Heading of the column of IPID-RBF with its own force as target (29)."""

COLUMNS = ("PID", "PID-RBF", "IPID-RBF", OWN)
"""Headings of the columns of the four controllers."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

MEASURED = re.compile(r"[−\d](?:[−\d., ·⁻⁰¹²³⁴⁵⁶⁷⁸⁹]|to)*")
"""A cell that has a unit: a number, a range or a list of numbers."""


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


def with_unit(cell: str, unit: str) -> str:
    """Return a cell with its unit, as in "5 samples" and "−1.448/s"."""
    if unit in ("", "1") or not MEASURED.fullmatch(cell):
        return cell
    if (cell, unit) == ("1", "samples"):
        unit = "sample"
    return cell + unit.removeprefix("1") if unit.startswith("1/") else f"{cell} {unit}"


class Shown(float):
    """A number with a typographic minus; its format can be a number of significant digits."""

    def __format__(self, spec: str) -> str:
        text = number(float(self), int(spec)) if spec.isdecimal() else super().__format__(spec)
        return text.replace("-", "−")


class Verdict(Enum):
    """Verdict on a statement: label, sign without colour, class on the page, and definition."""

    HOLDS = ("holds", "✓", "holds", "it passes every measure of its criterion")
    PART = ("holds in part", "◐", "partly", "it passes some measures, or some of its clauses hold")
    FAILS = ("does not hold", "✗", "fails", "it passes none")
    FITTED = ("fitted", "○", "fitted", "it passes with a number that was chosen so that it does")
    UNCLAIMED = ("not a claim", "–", "unclaimed", "it assumes or defines; the measures are shown")

    def __init__(self, label: str, sign: str, css: str, meaning: str):
        self.label, self.sign, self.css, self.meaning = label, sign, css, meaning


def judge(decisive: Sequence[bool]) -> Verdict:
    """Return the verdict on a claim that is measured in several ways, at least one."""
    if not decisive:
        raise ValueError("a claim needs at least one measure")
    if all(decisive):
        return Verdict.HOLDS
    return Verdict.PART if any(decisive) else Verdict.FAILS


def together(verdicts: Collection[Verdict]) -> Verdict:
    """Return the verdict on a sentence of several clauses."""
    return next(iter(verdicts)) if len(set(verdicts)) == 1 else Verdict.PART


@dataclass(frozen=True)
class Row:
    """One measure of a claim."""

    name: str  # with its unit
    values: Sequence[float | str]  # one per column
    holds: bool | None = None  # whether the claim holds by it; None: only information

    def cells(self) -> list[str]:
        """Return the values as text."""
        return [value if isinstance(value, str) else number(value) for value in self.values]

    @property
    def css(self) -> str:
        """Class on the page."""
        return {True: "yes", False: "no", None: ""}[self.holds]

    def told(self, columns: Sequence[str]) -> str:
        """Return the name and the values with their unit, for a sentence."""
        name, _, unit = self.name.removesuffix("]").partition(" [")
        article = "the " if re.match(r"[a-z]{4}|max |lag ", name) else ""
        shown = [
            f"{column} {with_unit(cell, unit)}"
            for column, cell in zip(columns, self.cells(), strict=True)
            if cell and column != OWN
        ]
        return f"{article}{name} ({', '.join(shown)})"


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, or one of its clauses, and what was measured."""

    words: str  # of the clause; empty if the sentence is one
    criterion: str
    columns: Sequence[str]
    rows: Sequence[Row]
    remark: str = ""  # what else the reader should know
    fitted: bool = False  # whether a number was chosen so that the claim holds
    claimed: bool = True  # rather than assumed or defined
    own: "Claim | None" = None  # the same if IPID-RBF learns its own force (29)

    @property
    def verdict(self) -> Verdict:
        """The verdict that follows from the rows."""
        if not self.claimed:
            return Verdict.UNCLAIMED
        found = judge([row.holds for row in self.rows if row.holds is not None])
        return Verdict.FITTED if self.fitted and found is Verdict.HOLDS else found

    @property
    def reason(self) -> str:
        """How many measures pass, and the first of them: one that fails, if any does."""
        held = [row for row in self.rows if row.holds]
        missed = [row for row in self.rows if row.holds is False]
        count = len(held) + len(missed)
        told = (missed or held)[0].told(self.columns)
        if held and missed:
            some = f"{len(held)} of {count} measures {'pass' if held[1:] else 'passes'}"
            return f"{some}. The first that fails: {told}."
        if count == 1:
            return f"{'Fails' if missed else 'Passes'}: {told}."
        which = "Both" if count == 2 else f"All {count}"
        return f"{which} measures {'fail' if missed else 'pass'}, first {told}."


@dataclass(frozen=True)
class Statement:
    """A sentence of the paper, or one of ours."""

    says: str  # a quotation, or a paraphrase without quotation marks
    claims: Sequence[Claim]
    number: int = 0  # on the page

    @property
    def verdict(self) -> Verdict:
        """The verdict for the controllers of Table 1."""
        return together([one.verdict for one in self.claims])

    @property
    def own(self) -> Verdict:
        """The verdict if IPID-RBF learns its own force (29)."""
        return together([(one.own or one).verdict for one in self.claims])

    @property
    def reason(self) -> str:
        """Why, in a sentence for each clause."""
        told = [f"“{c.words}”: {c.reason}" if c.words else c.reason for c in self.claims]
        return " ".join(told)


@dataclass(frozen=True)
class Part:
    """A section or figure as shown on the page."""

    anchor: str
    heading: str
    caption: str  # in the paper, or a remark on what is shown
    notes: Sequence[str]  # on how it was drawn
    figure: Figure | None
    statements: Sequence[Statement]


def counts(parts: Sequence[Part]) -> dict[Verdict, int]:
    """Return how many statements got each verdict."""
    found = [one.verdict for part in parts for one in part.statements]
    return {verdict: found.count(verdict) for verdict in Verdict}
