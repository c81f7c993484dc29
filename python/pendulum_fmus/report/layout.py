"""How the page is laid out: estimates of widths and heights, from which its styles choose."""

import re
from collections.abc import Iterable, Sequence

from markupsafe import Markup, escape

from .claims import Finding, Judged, Verdict
from .figure import Figure

UNBROKEN = re.compile(r"[−\d.]+ · 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+|I?PID-RBF")
"""What must not be broken into two lines: numbers with powers of ten, names of controllers."""

SUBSCRIPT = re.compile(r"\b([a-zA-Z])_([a-z0-9])(?![a-zA-Z0-9_])")
"""A symbol of one letter with a subscript, such as u_n."""

QUANTITY = re.compile(r"(\d) (%|s|ms|Hz|N|rad|kg|m)(?![\w/])")
"""A number and its unit."""

STEP = 3
"""Tables are distinguished by the width that they need, in steps [em]."""

PANEL, TEXT_LINE, TABLE_LINE, CLAIM = 270, 22, 30, 90
"""Estimated heights: a panel, a line of text, a line of a table, all else in a claim [px]."""

HIGHEST = 450
"""Height to which a panel can be stretched [px]."""

LINE = 60
"""Estimated characters in a line of text."""


def unbroken(text: str) -> Markup:
    """Return text as HTML in which UNBROKEN stays on one line."""
    return Markup(UNBROKEN.sub(r'<span class="unbroken">\g<0></span>', str(escape(text))))


def typeset(text: str) -> Markup:
    """Return text as HTML in which subscripts are set as such, and UNBROKEN stays on one line."""
    set_ = SUBSCRIPT.sub(r"<var>\1<sub>\2</sub></var>", str(unbroken(text)))
    return Markup(QUANTITY.sub("\\1\u00a0\\2", set_))


def folded(one: Judged, ours: bool) -> bool:
    """Return whether a table is folded: that of a statement of the paper which simply holds."""
    return one.finding.long and one.verdict is Verdict.HOLDS and not ours


def _longest_word(texts: Iterable[str]) -> int:
    """Return the length of the longest part that is never broken, in characters."""
    words = UNBROKEN.sub(lambda found: found[0].replace(" ", "_"), " ".join(texts)).split()
    return max(map(len, words))


def needed_width(table: Finding) -> int:
    """Return the width that a table needs if each row is one line, in em rounded up to STEP."""
    names = max(12, 2 + _longest_word([row.name for row in table.rows]))
    cells = [row.cells() for row in table.rows]
    columns = [
        max(4, _longest_word([heading, *(row[i] for row in cells)]))
        for i, heading in enumerate(table.columns)
    ]
    width = 0.58 * (names + sum(columns)) + 1.3 * (1 + len(columns))
    return STEP * -int(-width // STEP)


def beside(figure: Figure | None, judged: Sequence[Judged], ours: bool) -> int:
    """Return how many claims stand beside a figure: about as high as it, 0 if one is higher."""
    if not figure:
        return 0
    room = PANEL * _rows(figure)
    heights = [_height(one, ours) for one in judged]
    if heights[0] > HIGHEST * _rows(figure):
        return 0
    return min(range(1, len(judged) + 1), key=lambda n: abs(sum(heights[:n]) - room))


def _rows(figure: Figure) -> int:
    """Return the rows of panels on a wide page, where rows of three become columns of it."""
    return 3 if in_threes(figure) else len(figure.rows)


def in_threes(figure: Figure) -> bool:
    """Return whether there are rows of three panels, too many for the width beside text."""
    return len(figure.rows) > 1 and all(len(row) == 3 for row in figure.rows)


def _height(one: Judged, ours: bool) -> int:
    """Return the estimated height of a claim on a wide page [px]."""
    texts = [one.claim.says, one.claim.criterion, one.finding.remark]
    lines = sum(-(-len(text) // LINE) for text in texts)
    rows = 0 if one.source or folded(one, ours) else 1 + len(one.finding.rows)
    if needed_width(one.finding) > 33:
        rows *= 2  # with names on lines of their own
    return CLAIM + TEXT_LINE * lines + TABLE_LINE * rows
