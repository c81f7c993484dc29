"""The demo: print Table 1, then write it to a folder with a picture of the closed loops."""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module

from . import loop, table1
from .project import extra

NEXT = """
Next:
  make help      the other jobs: make report compares every figure and statement with the paper
  target/venv/bin/python -m pendulum_fmus.run --set controller.pid.kp=250 --csv target/loop.csv
                 another gain; --help lists signals, disturbances and plants
  docs/start.md
                 what an FMU is, and how to make one from a model of your own"""


def run(options: argparse.Namespace) -> bool:
    """Print and write; return whether every number holds."""
    with ThreadPoolExecutor() as background:
        # It imports Matplotlib while other processes simulate
        printed = background.submit(import_module, ".report.printed", __package__)
        results, all_hold = table1.run(options.fmus)
    with extra("plot"):
        paths = printed.result().write_overview(results, options.out)
    print("\nwrote", *paths, sep="\n  ")
    print(NEXT)
    return all_hold


def main() -> int:
    """Run the program; return its exit status."""
    about = "Reproduce Table 1 of the paper from the FMUs; write table1.txt and closed-loop.png."
    return loop.finish(loop.parser("demo", about, out=True), run)


if __name__ == "__main__":
    sys.exit(main())
