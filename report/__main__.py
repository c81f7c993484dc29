"""`python -m report`: print Table 1 and write the page, its figures and the overview."""

import argparse
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path

import table1
from master import MasterError

from . import ROOT
from .beyond import noise, sections
from .claims import judged
from .data import Data
from .overview import write as write_overview
from .page import Part, part_of, render
from .paper import conclusions, figures, table
from .printed import start as start_figures
from .scenarios import paper_loops, start


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = table1.arguments(
        "Recompute the paper from the FMUs: print Table 1, write index.html, every figure as SVG"
        " and PDF, and closed-loop.png."
    )
    parser.prog = "python -m report"
    add = parser.add_argument
    add("--only", choices=["paper"], help="leave out what goes beyond the paper")
    add(
        "--out",
        type=Path,
        default=ROOT / "target" / "report",
        metavar="DIR",
        help="where everything is written (default: target/report of this project)",
    )
    return parser


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run(options: argparse.Namespace) -> bool:
    """Make the report; returns whether all of Table 1 is reproduced."""
    with workers() as pool:
        data = Data(results(pool, options))
        text, all_hold = table.text(data)
        print(text, flush=True)
        parts = [part_of(entry) for entry in figures.entries(data)]
        end = Part("conclusions", "Section 5", "", (), None, judged(conclusions.claims(data)))
        drawing = [start_writing(parts, options.out / "figures", pool)]
        beyond = [] if options.only else sections.parts(data, options.fmus)
        drawing.append(start_writing(beyond, options.out / "figures", pool))
        page = options.out / "index.html"
        page.write_text(render(parts, end, table.lines(data), beyond), encoding="utf-8")
        write_overview(data, options.out / "closed-loop.png")
        paths = [path for jobs in drawing for job in jobs for path in job.get()]
    print(f"\n{page}, and {len(paths)} files in {options.out / 'figures'}")
    return all_hold


@contextmanager
def workers() -> Iterator[Pool]:
    """Return a pool of as many processes as there are cores."""
    # Spawned, not forked: a fork would copy the locks of a threaded parent
    with multiprocessing.get_context("spawn").Pool(cores()) as pool:
        yield pool
        # Leaving the context kills the workers; those that are done take their semaphores along
        pool.close()
        pool.join()


def results(pool: Pool, options: argparse.Namespace) -> dict:
    """Co-simulate all that is asked for."""
    started = start(pool, paper_loops(), options.fmus)
    if not options.only:
        started |= start(pool, sections.loops() - started.keys(), options.fmus)
        for job in noise.jobs():
            started[job] = pool.apply_async(noise.execute, (job, options.fmus))
    return {loop: run.get() for loop, run in started.items()}


def start_writing(parts: Sequence[Part], folder: Path, pool: Pool) -> list[AsyncResult]:
    """Have the figures of some parts written as SVG and PDF."""
    return start_figures([part.figure for part in parts if part.figure], folder, pool)


def main() -> int:
    """Run the program; returns its exit status."""
    options = parser().parse_args()
    try:
        return 0 if run(options) else 1
    except MasterError as error:
        print(f"report: {error}", file=sys.stderr)
    except OSError as error:
        print(f"report: {error.filename}: {error.strerror}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
