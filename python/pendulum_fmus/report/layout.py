"""How the page is laid out: estimates of widths and heights, from which its styles choose."""

import re
from collections.abc import Iterable, Sequence

from markupsafe import Markup, escape

from .claims import Judged, Table
from .figure import Figure

UNBROKEN = re.compile(r"[−\d.]+ · 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+|I?PID-RBF")
"""What must not be broken into two lines: numbers with powers of ten, names of controllers."""

STEP = 3
"""Tables are distinguished by the width that they need, in steps [em]."""

PANEL, TEXT_LINE, TABLE_LINE, CLAIM = 270, 22, 30, 90
"""Estimated heights: a panel, a line of text, a line of a table, all else in a claim [px]."""

LINE = 60
"""Estimated characters in a line of text."""


def unbroken(text: str) -> Markup:
    """Return text as HTML in which UNBROKEN stays on one line."""
    return Markup(UNBROKEN.sub(r'<span class="unbroken">\g<0></span>', str(escape(text))))


def _longest_word(texts: Iterable[str]) -> int:
    """Return the length of the longest part that is never broken, in characters."""
    words = UNBROKEN.sub(lambda found: found[0].replace(" ", "_"), " ".join(texts)).split()
    return max(map(len, words))


def needed_width(table: Table) -> int:
    """Return the width that a table needs if each row is one line, in em rounded up to STEP."""
    names = max([12, _longest_word(table.rows)])
    cells = [row for _, row in table.cells()]
    columns = [
        max(4, _longest_word([heading, *(row[i] for row in cells)]))
        for i, heading in enumerate(table.columns)
    ]
    width = 0.58 * (names + sum(columns)) + 1.3 * (1 + len(columns))
    return STEP * -int(-width // STEP)


def beside(figure: Figure | None, judged: Sequence[Judged]) -> int:
    """Return how many claims stand beside a figure: about as high as it."""
    if not figure:
        return 0
    room = PANEL * _rows(figure)
    heights = [_height(one) for one in judged]
    return min(range(1, len(judged) + 1), key=lambda n: abs(sum(heights[:n]) - room))


def _rows(figure: Figure) -> int:
    """Return the rows of panels on a wide page, where rows of three become columns of it."""
    return 3 if in_threes(figure) else len(figure.rows)


def in_threes(figure: Figure) -> bool:
    """Return whether there are rows of three panels, too many for the width beside text."""
    return len(figure.rows) > 1 and all(len(row) == 3 for row in figure.rows)


def _height(one: Judged) -> int:
    """Return the estimated height of a claim on a wide page [px]."""
    texts = [one.claim.says, one.claim.criterion, one.finding.remark]
    lines = sum(-(-len(text) // LINE) for text in texts)
    rows = 0 if one.repeats else 1 + len(one.finding.table.rows)
    if not one.repeats and needed_width(one.finding.table) > 33:
        rows *= 2  # with names on lines of their own
    return CLAIM + TEXT_LINE * lines + TABLE_LINE * rows
