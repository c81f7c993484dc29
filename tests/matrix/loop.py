"""What the scripts simulate: the pendulum alone, or in a loop with IPID-RBF or PID.

Arguments: `co-simulation` or `model exchange`; `plant`, `loop` or `pid`; the folder of the FMUs,
the ending of their names; the number of steps; the file for the results.
"""

import json
import sys
from collections.abc import Iterable
from pathlib import Path

STEP = 0.001
"""Communication step [s]."""

CONNECTIONS = [
    ("source", "r", "controller", "r"),
    ("source", "d", "controller", "d"),
    ("plant", "theta", "controller", "y"),
    ("controller", "u", "plant", "u"),
]

FORCE = 1.0
"""Force on the pendulum alone [N]."""

KIND, CASE, FOLDER, ENDING = sys.argv[1:5]
STEPS, FILE = int(sys.argv[5]), Path(sys.argv[6])

MODEL_EXCHANGE = KIND == "model exchange"
LOOP = CASE != "plant"

CONTROLLER = "Pid" if CASE == "pid" else "IpidRbf"
MODELS = {"source": "Source", "controller": CONTROLLER, "plant": "Pendulum"}
FMUS = {name: Path(FOLDER) / f"{model}{ENDING}.fmu" for name, model in MODELS.items()}


def write(theta: Iterable[float]) -> None:
    """Write the angle [rad] at 0, STEP, 2 STEP ... for the comparison."""
    FILE.write_text(json.dumps([float(value) for value in theta][: STEPS + 1]))
