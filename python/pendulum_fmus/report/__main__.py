"""Print Table 1; write the page, its figures and the overview."""

import argparse
import sys
import time
from pathlib import Path

from tqdm import tqdm

from .. import loop, table1
from ..project import extra

with extra("report"):
    import fmu_master  # noqa: F401, the loops need it

    from . import page, printed, traps
    from .runs import Data, lasting_loops, paper_loops, simulate_all
    from .statements import beyond_part, headline, paper_parts, texts


def run(options: argparse.Namespace) -> bool:
    """Write the report; return whether all of Table 1 is reproduced."""
    started, folder = time.monotonic(), options.out / "figures"
    with loop.workers() as pool:
        loops = paper_loops()
        say(f"simulating {len(loops)} loops with the native master ...")
        results = simulate_all(loops, options.fmus, pool)
        results |= simulate_all(lasting_loops(), options.fmus, pool, only=("theta", "e", "u"))
        data = Data(results, options.fmus, pool)
        text, all_hold = table1.report(data.results, colour=table1.colourful())
        say(f"{text}\n")
        say("making the mistakes of those who reproduce Table 1 ...")
        mistakes = traps.run(texts()["trap"], options.fmus, pool)
        parts = paper_parts(data)
        top = headline(data)
        figures = [top, *(part.figure for part in parts if part.figure)]
        drawing = printed.start(figures, folder, pool)
        say("sweeping parameters for the sections beyond the paper ...")
        bar = tqdm(texts()["beyond"], unit="section", leave=False, disable=None)
        ours = [beyond_part(data, section) for section in bar]
        drawing += printed.start([part.figure for part in ours], folder, pool)
        say(f"drawing {len(drawing)} figures ...")
        docs = options.docs or options.out
        file = page.write(options.out, docs, top, parts, ours, data, mistakes)
        printed.write_overview(data.results, options.out)
        bar = tqdm(drawing, unit="figure", leave=False, disable=None)
        files = sum(len(job.get()) for job in bar)
    seconds = time.monotonic() - started
    say(f"wrote {file}\nand {files} files to {folder} in {seconds:.0f} s")
    return all_hold


def say(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)


def main() -> int:
    """Run the program; return its exit status."""
    parser = loop.parser(
        "report",
        "Reproduce the paper from the FMUs: print Table 1; write index.html, every figure as SVG"
        " and PDF, table1.txt and closed-loop.png.",
        out=True,
    )
    shown = "folder of numbers.md and verdicts.md (default: the output folder)"
    parser.add_argument("--docs", type=Path, metavar="DIR", help=shown)
    return loop.finish(parser, run)


if __name__ == "__main__":
    sys.exit(main())
