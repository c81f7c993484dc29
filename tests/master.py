"""The FMPy master as a script: `python tests/master.py --help`."""

import sys

from pendulum_fmus.run import main

if __name__ == "__main__":
    sys.exit(main())
