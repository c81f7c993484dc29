"""The page: one HTML file with its styles, its scripts, the plotting library and all data."""

import json
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from . import layout
from .browser import RESOLUTION, page_json
from .paper.curves import SHOWN
from .paper.table import Line
from .paper.traps import Traps
from .parts import Part, counts
from .style import STYLES
from .templates import ASSETS, environment, findings

SCRIPTS = ["data", "ticks", "curves", "readout", "panel", "page", "contents"]
"""The page's scripts, in order."""

MOST = 90
"""No table needs as much [em]."""


def asset(name: str) -> Markup:
    """Return a file that becomes part of the page as it is."""
    return Markup((ASSETS / name).read_text(encoding="utf-8"))


def script_safe(value: Any) -> str:
    """Return JSON that can be embedded in a script element."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")


def render(
    parts: Sequence[Part], lines: Sequence[Line], traps: Traps, beyond: Sequence[Part]
) -> str:
    """Return the page as HTML."""
    html = environment(escaped=True)
    html.filters |= {
        "capital": lambda text: text[:1].upper() + text[1:],
        "unbroken": layout.unbroken,
        "typeset": layout.typeset,
        "needed_width": layout.needed_width,
        "in_threes": layout.in_threes,
    }
    figures = [part.figure for part in [*parts, *beyond] if part.figure]
    return html.get_template("page.html.j2").render(
        parts=parts,
        lines=lines,
        trap_columns=[f"{name}{disturbed}" for disturbed in ("", ", disturbed") for name in SHOWN],
        beyond=beyond,
        counts=counts(parts),
        beside=layout.beside,
        folded=layout.folded,
        widths=range(layout.STEP, MOST, layout.STEP),
        styles=STYLES,
        asset=asset,
        scripts=SCRIPTS,
        data=script_safe(page_json(figures)),
        resolution=RESOLUTION,
        **findings(traps),
    )
