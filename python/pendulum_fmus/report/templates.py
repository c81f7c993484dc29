"""The templates of the page and of the documents, and what both show."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from .paper.settings import corrections, settings
from .paper.traps import SAME, Traps

ASSETS = Path(__file__).parent / "assets"


def environment(*, escaped: bool) -> Environment:
    """Return the environment of the templates, for HTML if `escaped`."""
    return Environment(
        loader=FileSystemLoader(ASSETS),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not escaped,
        autoescape=escaped,
    )


def findings(traps: Traps) -> dict[str, Any]:
    """Return the misprints, the settings and the traps by name."""
    return {
        "corrections": corrections(),
        "settings": settings(traps.right, traps.named()),
        "traps": traps.lookups(),
        "same": SAME,
    }
