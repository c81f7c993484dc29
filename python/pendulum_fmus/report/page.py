"""The page: one HTML file with its styles, its scripts, the plotting library and all data."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from . import layout
from .browser import RESOLUTION, page_json
from .claims import Judged, Verdict, judged
from .figure import Figure
from .numbers import number
from .paper.entry import Entry
from .paper.table import Line
from .style import STYLES

ASSETS = Path(__file__).parent / "assets"

SCRIPTS = ["data", "ticks", "curves", "readout", "panel", "page", "contents"]
"""The page's scripts, in order."""

MOST = 90
"""No table needs as much [em]."""


@dataclass(frozen=True)
class Part:
    """A figure of the paper or an additional section, as shown on the page.

    Parameters
    ----------
    anchor
        Target of links.
    heading, caption, notes
        Text above and below the figure.
    figure
        The figure, if any.
    judged
        The claims with their verdicts.
    """

    anchor: str
    heading: str
    caption: str
    notes: Sequence[str]
    figure: Figure | None
    judged: Sequence[Judged]


def part_of(entry: Entry) -> Part:
    """Return a figure of the paper as part of the page."""
    return Part(
        entry.figure.name,
        f"Figure {entry.number}. {entry.figure.title}",
        entry.caption,
        entry.notes,
        entry.figure,
        judged(entry.claims),
    )


def asset(name: str) -> Markup:
    """Return a file that becomes part of the page as it is."""
    return Markup((ASSETS / name).read_text(encoding="utf-8"))


def script_safe(value: Any) -> str:
    """Return JSON that can be embedded in a script element."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")


def render(
    parts: Sequence[Part], conclusions: Part, lines: Sequence[Line], beyond: Sequence[Part]
) -> str:
    """Return the page as HTML."""
    environment = Environment(
        loader=FileSystemLoader(ASSETS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": number,
        "unbroken": layout.unbroken,
        "needed_width": layout.needed_width,
        "in_threes": layout.in_threes,
    }
    everything = [*parts, conclusions, *beyond]
    figures = [part.figure for part in everything if part.figure]
    return environment.get_template("page.html.j2").render(
        parts=parts,
        conclusions=conclusions,
        lines=lines,
        beyond=beyond,
        verdicts=list(Verdict),
        counts=_counts([*parts, conclusions]),
        beside=layout.beside,
        widths=range(layout.STEP, MOST, layout.STEP),
        styles=STYLES,
        asset=asset,
        scripts=SCRIPTS,
        data=script_safe(page_json(figures)),
        resolution=RESOLUTION,
    )


def _counts(parts: Sequence[Part]) -> dict[Verdict, int]:
    found = [one.verdict for part in parts for one in part.judged]
    return {verdict: found.count(verdict) for verdict in Verdict}
