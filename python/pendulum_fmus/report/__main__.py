"""Print Table 1; write the page, its figures and the overview."""

import argparse
import sys
from collections.abc import Sequence
from multiprocessing.pool import AsyncResult, Pool
from pathlib import Path

from .. import loop, table1
from ..master import MasterError
from ..project import REPORT
from . import overview
from .beyond import noise, sections
from .claims import judged
from .data import Data
from .page import Part, part_of, render
from .paper import conclusions, figures, table
from .printed import start as start_figures
from .scenarios import paper_loops


def run(options: argparse.Namespace) -> bool:
    """Write the report; return whether all of Table 1 is reproduced."""
    with loop.workers() as pool:
        data = Data(results(pool, options.fmus))
        text, all_hold = table1.report(data.results, colour=table1.colourful())
        print(f"{text}\n\ndrawing ...", flush=True)
        parts = [part_of(entry) for entry in figures.entries(data)]
        end = Part("conclusions", "Section 5", "", (), None, judged(conclusions.claims(data)))
        drawing = [start_writing(parts, options.out / "figures", pool)]
        beyond = sections.parts(data, options.fmus)
        drawing.append(start_writing(beyond, options.out / "figures", pool))
        page = options.out / "index.html"
        page.write_text(render(parts, end, table.lines(data), beyond), encoding="utf-8")
        overview.write(data.results, options.out)
        paths = [path for jobs in drawing for job in jobs for path in job.get()]
    print(f"wrote {page}\nand {len(paths)} files to {options.out / 'figures'}")
    return all_hold


def results(pool: Pool, fmus: Path) -> dict:
    """Co-simulate all loops of the report."""
    started: dict = loop.start(pool, paper_loops() | sections.loops(), fmus)
    for job in noise.jobs():
        started[job] = pool.apply_async(noise.execute, (job, fmus))
    print(f"co-simulating {len(started)} loops with FMPy ...", flush=True)
    return {key: run.get() for key, run in started.items()}


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
