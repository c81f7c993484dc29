"""Progress bars of runs and sweeps, in terminals and notebooks."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator

Show = Callable[[float, str], None]
"""Shows the part that is done, 0 to 1, and the progress in words."""


@contextlib.contextmanager
def bar(is_wanted: bool) -> Iterator[Show | None]:
    """Show a progress bar, if it is wanted, until the end of the block."""
    if not is_wanted:
        yield None
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of notebooks without widgets, where the bar is text
        from tqdm.auto import tqdm
    style = "{percentage:3.0f}%|{bar}| {desc}"
    # The native module limits how often the bar changes.
    often = {"miniters": 0, "mininterval": 0}
    with tqdm(total=1.0, bar_format=style, leave=False, dynamic_ncols=True, **often) as shown:

        def show(part: float, text: str) -> None:
            shown.set_description_str(text, refresh=False)
            shown.update(part - shown.n)

        yield show
