"""The page, one HTML file with styles, scripts and data; docs/numbers.md and docs/verdicts.md."""

import base64
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from .. import table1
from ..loop import TS
from . import stability
from .certainty import interval
from .claims import Part, Shown, Verdict, counts, judge
from .figure import RESOLUTION, STYLES, Curve, Figure, Panel
from .findings import PRINTED, coefficients, poles
from .measures import MEASURES
from .runs import GAINS, SHOWN, TRANSFER_FUNCTION, Data
from .statements import summary, texts
from .traps import SAME, Traps

ASSETS = Path(__file__).parent / "assets"

DOCUMENTS = ("numbers.md", "verdicts.md")

SCRIPTS = ["data", "ticks", "curves", "readout", "panel", "page", "contents"]
"""The page's scripts, in order."""

NEEDED = range(20, 77, 8)
"""Widths below which tables are stacked, each for tables of a column more [em]."""

UNBROKEN = re.compile(r"[−\d.]+ · 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+|I?PID-RBF")
"""What must not be broken into two lines: numbers with powers of ten, names of controllers."""

SUBSCRIPT = re.compile(r"\b([a-zA-Zū])_([a-z0-9])(?![a-zA-Z0-9_])")
"""A symbol of one letter with a subscript, such as u_n."""

QUANTITY = re.compile(r"(\d) (%|s|ms|Hz|N|rad|kg|m)(?![\w/])")
"""A number and its unit."""


# --- layout -------------------------------------------------------------------------------------


def unbroken(text: str) -> Markup:
    """Return text as HTML in which UNBROKEN stays on one line."""
    return Markup(UNBROKEN.sub(r'<span class="unbroken">\g<0></span>', str(escape(text))))


def typeset(text: str) -> Markup:
    """Return text as HTML in which subscripts are set as such, and UNBROKEN stays on one line."""
    set_ = SUBSCRIPT.sub(r"<var>\1<sub>\2</sub></var>", str(unbroken(text)))
    return Markup(QUANTITY.sub("\\1\u00a0\\2", set_))


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


def settings(traps: Traps, fmus: Path) -> dict[str, Any]:
    """Return the misprints, the settings and the mistakes by name."""
    _, cubic, other, last = map(float, PRINTED)
    # s⁴ + 0.0883 s³ - 27.8285 s³ - 2.3094 s, without the s that cancels
    misprinted = np.roots([1, cubic - other, 0, -last])
    facts = {"gravity": coefficients()[2], "pole": misprinted.real.max()}
    for key, values in traps.facts().items():
        facts[key] = {case: Shown(value) for case, value in values.items()}

    def filled(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, str]]:
        found = []
        for row in rows:
            varied = [interval(one, fmus) for one in row.get("varied", ())]
            texts_ = {key: text for key, text in row.items() if isinstance(text, str)}
            known = facts | {"range": varied}
            found.append({key: text.format_map(known) for key, text in texts_.items()})
        return found

    return {
        "corrections": filled(texts()["correction"]),
        "settings": filled(texts()["setting"]),
        "traps": traps.tables(),
        "same": SAME,
    }


@dataclass(frozen=True)
class Line:
    """A number of Table 1, or of the text beside it."""

    entry: table1.Entry
    computed: float
    digits: bool  # whether it rounds to every printed digit
    verdict: Verdict

    @property
    def apart(self) -> float:
        """The difference from the printed number, relative to it."""
        return self.computed / float(self.entry.printed) - 1

    @property
    def shown(self) -> str:
        """The computed number with a digit more than the printed one, or with five."""
        text = f"{self.computed:.3f} s" if self.entry.settling else f"{self.computed:.4e}"
        plain = not self.entry.settling and "e" not in self.entry.printed
        return (f"{self.computed:.6f}" if plain else text).replace("-", "−")


def lines(data: Data) -> list[Line]:
    """Return each number of Table 1."""
    found = []
    for entry in table1.entries():
        computed = entry.computed(data.results[entry.run])
        digits = table1.agrees(computed, entry.printed)
        verdict = judge([entry.holds(computed), digits])
        if entry.fitted and verdict is Verdict.HOLDS:
            verdict = Verdict.FITTED
        found.append(Line(entry, computed, digits, verdict))
    return found


def write(
    out: Path,
    docs: Path,
    top: Figure,
    parts: Sequence[Part],
    beyond: Sequence[Part],
    data: Data,
    traps: Traps,
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
        "percent": lambda share: f"{Shown(100 * share):2} %",
        "md": lambda text: text.replace("|", "\\|"),
        "unbroken": unbroken,
        "typeset": typeset,
    }
    shown = [part.figure for part in [*beyond, *parts] if part.figure]
    figures, table = page_json([top, *shown]), lines(data)
    encoded = json.dumps(figures, allow_nan=False, separators=(",", ":"))
    held, difference = data("PID").e[-1], data.loop(TRANSFER_FUNCTION).e[-1]
    context = settings(traps, data.fmus) | {
        "parts": parts,
        "beyond": beyond,
        "counts": counts(parts),
        "lines": table,
        "judged": texts()["judged"],
        "summary": summary(data, parts, table),
        "headline": top,
        "table1": table1,
        "stability": stability,
        "ki": GAINS["ki"],
        # of the page
        "trap_columns": [*SHOWN, *(f"{name}, disturbed" for name in SHOWN)],
        "widths": NEEDED,
        "styles": STYLES,
        "asset": lambda name: Markup((ASSETS / name).read_text(encoding="utf-8")),
        "scripts": SCRIPTS,
        "data": encoded.replace("</", "<\\/"),  # in a script element
        "resolution": RESOLUTION,
        # of docs/numbers.md
        "apart": from_print(data),
        "lost": {kind: MEASURES["lost"].of(data, kind) for kind in SHOWN},
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
