# /// script
# dependencies = ["cofmupy==1.0.0"]
# ///
"""CoFMUPy with its Jacobi master."""

import json
import tempfile
from pathlib import Path

from cofmupy import Coordinator

from loop import CONNECTIONS, FMUS, FORCE, LOOP, STEP, STEPS, write

start = {} if LOOP else {"plant": {"u": FORCE}}
configuration = {
    "cosim_method": "jacobi",
    "iterative": False,
    "fmus": [
        {"id": name, "path": str(FMUS[name]), "initialization": start.get(name, {})}
        for name in (FMUS if LOOP else ["plant"])
    ],
    "connections": [
        {
            "source": {"id": source, "variable": output},
            "target": {"id": target, "variable": input_},
        }
        for source, output, target, input_ in CONNECTIONS
        if LOOP
    ],
}
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "configuration.json"
    file.write_text(json.dumps(configuration))
    coordinator = Coordinator()
    coordinator.start(str(file))
    for _ in range(STEPS):
        coordinator.do_step(STEP)
write([0.0, *coordinator.get_results()["plant", "theta"]])  # those after each step
