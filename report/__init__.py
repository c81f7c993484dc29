"""The paper's figures and claims, computed from co-simulations of the FMUs, as one web page."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# The FMPy master and the runs of Table 1 live with the tests, which use them most.
sys.path.insert(0, str(ROOT / "tests"))
