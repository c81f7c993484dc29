"""Print Table 1; write the page, its figures and the overview."""

import argparse
import sys
import time
from collections.abc import Sequence
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path

from tqdm import tqdm

from .. import loop, table1
from ..master import MasterError
from ..project import REPORT
from . import documents, overview
from .beyond import sections
from .data import Data
from .native import simulate_all
from .page import render
from .paper import sections as paper
from .paper import table
from .paper.traps import run as run_traps
from .parts import Part, parts_of
from .printed import start as start_figures
from .scenarios import lasting_loops, paper_loops


def run(options: argparse.Namespace) -> bool:
    """Write the report; return whether all of Table 1 is reproduced."""
    started = time.monotonic()
    with loop.workers() as pool:
        loops = paper_loops() | sections.loops()
        say(f"simulating {len(loops)} loops with the native master ...")
        results = simulate_all(loops, options.fmus, pool)
        only = ("theta", "e", "u")
        results |= simulate_all(lasting_loops(), options.fmus, pool, only=only)
        data = Data(results, options.fmus)
        text, all_hold = table1.report(data.results, colour=table1.colourful())
        say(f"{text}\n")
        say("making the mistakes of those who reproduce Table 1 ...")
        traps = run_traps(options.fmus, pool)
        parts = parts_of(paper.entries(data))
        drawing = start_writing(parts, options.out / "figures", pool)
        say("sweeping parameters for the sections beyond the paper ...")
        bar = tqdm(sections.MODULES, unit="section", leave=False, disable=None)
        beyond = [module.part(data, options.fmus) for module in bar]
        drawing += start_writing(beyond, options.out / "figures", pool)
        say(f"drawing {len(drawing)} figures ...")
        page = options.out / "index.html"
        page.write_text(render(parts, table.lines(data), traps, beyond), encoding="utf-8")
        documents.write(options.docs or options.out, data, parts, traps)
        overview.write(data.results, options.out)
        bar = tqdm(drawing, unit="figure", leave=False, disable=None)
        files = sum(len(job.get()) for job in bar)
    seconds = time.monotonic() - started
    say(f"wrote {page}\nand {files} files to {options.out / 'figures'} in {seconds:.0f} s")
    return all_hold


def say(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)


def start_writing(parts: Sequence[Part], folder: Path, pool: Pool) -> list[AsyncResult]:
    """Write the figures of some parts as SVG and PDF."""
    return start_figures([part.figure for part in parts if part.figure], folder, pool)


def main() -> int:
    """Run the program; return its exit status."""
    parser = loop.parser(
        "Reproduce the paper from the FMUs: print Table 1; write index.html, every figure as SVG"
        " and PDF, table1.txt and closed-loop.png.",
        prog="python -m pendulum_fmus.report",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=REPORT,
        metavar="DIR",
        help="output folder (default: target/report of this project)",
    )
    parser.add_argument(
        "--docs",
        type=Path,
        metavar="DIR",
        help="folder of numbers.md and verdicts.md (default: the output folder)",
    )
    options = parser.parse_args()
    try:
        return 0 if run(options) else 1
    except MasterError as error:
        print(f"report: {error}", file=sys.stderr)
    except OSError as error:
        print(f"report: {error.filename}: {error.strerror}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
