"""docs/numbers.md and docs/verdicts.md: the same numbers as on the page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import table1
from ..loop import TS
from .data import Data
from .paper.introduction import LASTING
from .paper.objective import poles
from .paper.traps import Traps
from .parts import Part, counts
from .scenarios import GAINS, TRANSFER_FUNCTION
from .stability import DELAYS, ETA, RAMP, limit, printed_bound, radius
from .templates import environment, findings

NAMES = ("numbers.md", "verdicts.md")


def write(folder: Path, data: Data, parts: Sequence[Part], traps: Traps) -> list[Path]:
    """Write both documents to a folder."""
    markdown = environment(escaped=False)
    markdown.filters["md"] = lambda text: text.replace("|", "\\|")
    found = counts(parts)
    context = findings(traps) | facts(data)
    context |= {"parts": parts, "counts": found, "statements": sum(found.values())}
    written = []
    for name in NAMES:
        path = folder / name
        text = markdown.get_template(f"{name}.j2").render(context)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def facts(data: Data) -> dict[str, Any]:
    """Return the numbers of docs/numbers.md by name."""
    held, difference = data("PID", "step").e[-1], data.loop(TRANSFER_FUNCTION).e[-1]
    return {
        "apart": from_print(data.results),
        "fitted": table1.FITTED,
        "ramp": RAMP,
        "ki": GAINS["ki"],
        "static": RAMP / (RAMP - GAINS["ki"]),
        "lost": LASTING.values(data)["PID-RBF"],
        "pole": max(poles().real),
        "cancelled": float(np.prod(-np.expm1(poles() * TS)).real),
        "tolerance": table1.TOLERANCE,
        "transient": table1.TRANSIENT_TOLERANCE,
        "zero": table1.ZERO,
        "forms": abs(difference / held - 1),
        "bound": printed_bound(),
        "limits": [limit(delay) for delay in DELAYS],
        "eta": ETA,
        "radius": radius(DELAYS[3], ETA),
    }


def from_print(results: Mapping) -> dict[str, str]:
    """Return by how much the sine rows differ from print at most [%], by controller."""
    found = {"PidRbf": 0.0, "IpidRbf": 0.0}
    for entry in table1.entries():
        row, _, signal, controller = entry.label
        if signal == "sine" and controller in found and "*" not in row:
            apart = entry.computed(results[entry.run]) / float(entry.printed) - 1
            found[controller] = max(found[controller], abs(100 * apart))
    return {controller: f"{apart:.2g}" for controller, apart in found.items()}
