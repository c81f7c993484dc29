"""`python -m report`: print Table 1 and write the page, its figures and the overview."""

import argparse
import multiprocessing
import os
import sys
from pathlib import Path

from master import FMUS, MasterError

from . import ROOT
from .claims import judged
from .data import Data
from .overview import write as write_overview
from .page import Part, part_of, render
from .paper import conclusions, figures, table
from .printed import write_all
from .scenarios import execute_all, paper_loops


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m report",
        description="Recompute the paper from the FMUs: prints Table 1, writes index.html, every"
        " figure as SVG and PDF, and closed-loop.png.",
    )
    add = parser.add_argument
    add("--only", choices=["paper"], help="leave out what goes beyond the paper")
    add(
        "--fmus",
        type=Path,
        default=FMUS,
        metavar="DIR",
        help="where the FMUs are (default: target/fmu of this project)",
    )
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
    data = Data(execute_all(paper_loops(), options.fmus, cores()))
    text, all_hold = table.text(data)
    print(text)
    parts = [part_of(entry) for entry in figures.entries(data)]
    end = Part("conclusions", "Section 5", "", (), None, judged(conclusions.claims(data)))
    beyond: list[Part] = []
    options.out.mkdir(parents=True, exist_ok=True)
    page = options.out / "index.html"
    page.write_text(render(parts, end, table.lines(data), beyond), encoding="utf-8")
    drawn = [part.figure for part in [*parts, *beyond] if part.figure]
    with multiprocessing.get_context("spawn").Pool(cores()) as pool:
        paths = write_all(drawn, options.out / "figures", pool)
        pool.close()
        pool.join()
    write_overview(data, options.out / "closed-loop.png")
    print(f"\n{page}, and {len(paths)} files in {options.out / 'figures'}")
    return all_hold


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
