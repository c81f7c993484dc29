"""The demo: print Table 1, then write it to a folder with a picture of the closed loops."""

import sys
from pathlib import Path

from . import loop, table1
from .master import MasterError
from .project import REPORT


def main() -> int:
    """Run the program; return its exit status."""
    parser = loop.parser(
        "Reproduce Table 1 of the paper from the FMUs; write table1.txt and closed-loop.png.",
        prog="python -m pendulum_fmus.demo",
    )
    parser.add_argument(
        "--out", type=Path, default=REPORT, metavar="DIR", help="the folder (default: %(default)s)"
    )
    options = parser.parse_args()
    try:
        results, all_hold = table1.run(options.fmus)
        # Imports matplotlib, which the table does not wait for
        from .report import printed

        print("\nwrote", *printed.write_overview(results, options.out), sep="\n  ")
    except (MasterError, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
