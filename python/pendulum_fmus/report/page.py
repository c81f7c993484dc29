"""The page, one HTML file with styles, scripts and data; docs/numbers.md and docs/verdicts.md."""

import base64
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from .. import table1
from ..loop import TS
from . import stability
from .claims import Finding, Judged, Part, Verdict, counts, judge, number
from .figure import RESOLUTION, STYLES, Curve, Figure, Panel
from .findings import PRINTED, coefficients, poles
from .measures import MEASURES
from .runs import GAINS, SHOWN, TRANSFER_FUNCTION, Data
from .statements import texts
from .traps import SAME, Traps

ASSETS = Path(__file__).parent / "assets"

DOCUMENTS = ("numbers.md", "verdicts.md")

SCRIPTS = ["data", "ticks", "curves", "readout", "panel", "page", "contents"]
"""The page's scripts, in order."""

MOST = 90
"""No table needs as much [em]."""

UNBROKEN = re.compile(r"[−\d.]+ · 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+|I?PID-RBF")
"""What must not be broken into two lines: numbers with powers of ten, names of controllers."""

SUBSCRIPT = re.compile(r"\b([a-zA-Z])_([a-z0-9])(?![a-zA-Z0-9_])")
"""A symbol of one letter with a subscript, such as u_n."""

QUANTITY = re.compile(r"(\d) (%|s|ms|Hz|N|rad|kg|m)(?![\w/])")
"""A number and its unit."""

STEP = 3
"""Tables are distinguished by the width that they need, in steps [em]."""


# --- layout -------------------------------------------------------------------------------------


def unbroken(text: str) -> Markup:
    """Return text as HTML in which UNBROKEN stays on one line."""
    return Markup(UNBROKEN.sub(r'<span class="unbroken">\g<0></span>', str(escape(text))))


def typeset(text: str) -> Markup:
    """Return text as HTML in which subscripts are set as such, and UNBROKEN stays on one line."""
    set_ = SUBSCRIPT.sub(r"<var>\1<sub>\2</sub></var>", str(unbroken(text)))
    return Markup(QUANTITY.sub("\\1\u00a0\\2", set_))


def folded(one: Judged, ours: bool) -> bool:
    """Return whether a table is folded: its statement simply holds."""
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


def in_threes(figure: Figure) -> bool:
    """Return whether there are rows of three panels, too many for the width beside text."""
    return len(figure.rows) > 1 and all(len(row) == 3 for row in figure.rows)


# --- figures ------------------------------------------------------------------------------------


def pack(column: np.ndarray) -> str:
    """Return a column as base64 of little-endian numbers."""
    return base64.b64encode(np.ascontiguousarray(column, dtype="<f8").tobytes()).decode()


def page_json(figures: Iterable[Figure]) -> dict[str, Any]:
    """Return all data for the page's script; the panels in the order of the page.

    A column has the samples of a curve that any panel needs, in full precision.
    """
    panels = [panel for figure in figures for row in figure.rows for panel in row]
    curves: dict[str, Curve] = {}
    kept: dict[str, np.ndarray] = {}
    for panel in panels:
        for index, curve in enumerate(panel.curves):
            needed = np.union1d(panel.needed(curve), panel.markers(index))
            kept[curve.key] = np.union1d(kept.get(curve.key, needed), needed).astype(int)
            curves[curve.key] = curve

    def curve_json(panel: Panel, index: int) -> dict[str, Any]:
        curve, style = panel.curves[index], STYLES[panel.curves[index].style]
        marks = np.searchsorted(kept[curve.key], panel.markers(index)).tolist()
        return {
            "column": curve.key,
            "style": curve.style,
            "name": curve.name or style.name,
            "marks": marks if style.marker else [],
        }

    def panel_json(panel: Panel) -> dict[str, Any]:
        return {
            "xLabel": panel.x_label,
            "yLabel": panel.y_label,
            "x": panel.x_range(),
            "y": panel.y_range(),
            "logX": panel.log_x,
            "logY": panel.log_y,
            "frame": panel.frame,
            "curves": [curve_json(panel, index) for index in range(len(panel.curves))],
        }

    styles = {key: vars(style).copy() for key, style in STYLES.items()}
    for style in styles.values():
        style["dash"] = [round(part * style["width"], 2) for part in style["dash"]]  # in pixels
        del style["name"]
    return {
        "columns": {
            key: {axis: pack(getattr(curve, axis)[kept[key]]) for axis in "xy"}
            for key, curve in curves.items()
        },
        "panels": [panel_json(panel) for panel in panels],
        "styles": styles,
    }


# --- texts --------------------------------------------------------------------------------------


class Shown(float):
    """A number with a typographic minus; its format can be a number of significant digits."""

    def __format__(self, spec: str) -> str:
        text = number(float(self), int(spec)) if spec.isdecimal() else super().__format__(spec)
        return text.replace("-", "−")


def settings(traps: Traps) -> dict[str, Any]:
    """Return the misprints, the settings and the mistakes by name."""
    _, cubic, other, last = map(float, PRINTED)
    # s⁴ + 0.0883 s³ - 27.8285 s³ - 2.3094 s, without the s that cancels
    misprinted = np.roots([1, cubic - other, 0, -last])
    facts = {"gravity": coefficients()[2], "pole": misprinted.real.max()}
    for key, values in traps.facts().items():
        facts[key] = {case: Shown(value) for case, value in values.items()}

    def filled(rows: Iterable[Mapping[str, str]]) -> list[dict[str, str]]:
        return [{key: text.format_map(facts) for key, text in row.items()} for row in rows]

    return {
        "corrections": filled(texts()["correction"]),
        "settings": filled(texts()["setting"]),
        "traps": traps.tables(),
        "same": SAME,
    }


def lines(data: Data) -> list[tuple]:
    """Return each number of Table 1, the computed one, if it has every digit, and the verdict."""
    found = []
    for entry in table1.entries():
        computed = entry.computed(data.results[entry.run])
        digits = table1.agrees(computed, entry.printed)
        found.append((entry, computed, digits, judge([entry.holds(computed), digits])))
    return found


def write(
    out: Path, docs: Path, parts: Sequence[Part], beyond: Sequence[Part], data: Data, traps: Traps
) -> Path:
    """Write the page to the folder `out` and DOCUMENTS to `docs`; return the path of the page."""
    environment = Environment(
        loader=FileSystemLoader(ASSETS),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=select_autoescape(["html.j2"]),
    )
    environment.filters |= {
        "capital": lambda text: text[:1].upper() + text[1:],
        "md": lambda text: text.replace("|", "\\|"),
        "unbroken": unbroken,
        "typeset": typeset,
        "needed_width": needed_width,
        "in_threes": in_threes,
    }
    figures = page_json(part.figure for part in [*parts, *beyond] if part.figure)
    encoded = json.dumps(figures, allow_nan=False, separators=(",", ":"))
    held, difference = data("PID").e[-1], data.loop(TRANSFER_FUNCTION).e[-1]
    context = settings(traps) | {
        "parts": parts,
        "beyond": beyond,
        "counts": counts(parts),
        "lines": lines(data),
        "table1": table1,
        "stability": stability,
        "ki": GAINS["ki"],
        # of the page
        "trap_columns": [*SHOWN, *(f"{name}, disturbed" for name in SHOWN)],
        "folded": folded,
        "widths": range(STEP, MOST, STEP),
        "styles": STYLES,
        "asset": lambda name: Markup((ASSETS / name).read_text(encoding="utf-8")),
        "scripts": SCRIPTS,
        "data": encoded.replace("</", "<\\/"),  # in a script element
        "resolution": RESOLUTION,
        # of docs/numbers.md
        "apart": from_print(data),
        "lost": MEASURES["lost"].of(data, "PID-RBF"),
        "pole": max(poles().real),
        "cancelled": float(np.prod(-np.expm1(poles() * TS)).real),
        "forms": abs(difference / held - 1),
    }
    for folder, name in ((out, "index.html"), *((docs, name) for name in DOCUMENTS)):
        text = environment.get_template(f"{name}.j2").render(context)
        (folder / name).write_text(text, encoding="utf-8")
    return out / "index.html"


def from_print(data: Data) -> dict[str, str]:
    """Return by how much the sine rows differ from print at most [%], by controller."""
    found = {"PidRbf": 0.0, "IpidRbf": 0.0}
    for entry in table1.entries():
        row, _, signal, controller = entry.label
        if signal == "sine" and controller in found and "*" not in row:
            apart = entry.computed(data.results[entry.run]) / float(entry.printed) - 1
            found[controller] = max(found[controller], abs(100 * apart))
    return {controller: f"{apart:.2g}" for controller, apart in found.items()}
