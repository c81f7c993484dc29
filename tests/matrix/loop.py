"""What the scripts simulate: the pendulum alone, or in a loop with IPID-RBF.

Arguments: `plant` or `loop`, the folder of the FMUs, the number of steps, the file for the results.
"""

import json
import sys
from collections.abc import Iterable
from pathlib import Path

STEP = 0.001
"""Communication step [s]."""

MODELS = {"source": "Source", "controller": "IpidRbf", "plant": "Pendulum"}

CONNECTIONS = [
    ("source", "r", "controller", "r"),
    ("source", "d", "controller", "d"),
    ("plant", "theta", "controller", "y"),
    ("controller", "u", "plant", "u"),
]

FORCE = 1.0
"""Force on the pendulum alone [N]."""

CASE, FOLDER, STEPS, FILE = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])

FMUS = {name: FOLDER / f"{model}.fmu" for name, model in MODELS.items()}


def write(theta: Iterable[float]) -> None:
    """Write the angle [rad] at 0, STEP, 2 STEP ... for the comparison."""
    FILE.write_text(json.dumps([float(value) for value in theta][: STEPS + 1]))
