# /// script
# dependencies = ["fmu-manipulation-toolbox==2.0", "fmpy==0.3.32"]
# ///
"""A container FMU of the FMU Manipulation Toolbox, simulated by FMPy.

It prefers co-simulation, so this is removed from the model descriptions for model exchange.
"""

import re
import tempfile
from pathlib import Path
from zipfile import ZipFile

import fmpy
from fmu_manipulation_toolbox.assembly import AssemblyNode

from loop import CONNECTIONS, FMUS, MODEL_EXCHANGE, STEP, STEPS, write


def copy(path: Path, folder: str) -> None:
    """Copy an FMU, for model exchange without its co-simulation."""
    with ZipFile(path) as given, ZipFile(f"{folder}/{path.name}", "w") as written:
        for entry in given.infolist():
            content = given.read(entry)
            if MODEL_EXCHANGE and b"<ModelExchange" in content:
                content = re.sub(rb"<CoSimulation[^>]*/>", b"", content)
            written.writestr(entry, content)


with tempfile.TemporaryDirectory() as folder:
    for path in FMUS.values():
        copy(path, folder)
    files = {name: path.name for name, path in FMUS.items()}
    node = AssemblyNode("loop.fmu", step_size=STEP)
    for name in FMUS:
        node.add_fmu(files[name])
    for source, output, target, input_ in CONNECTIONS:
        node.add_link(files[source], output, files[target], input_)
    node.add_output(files["plant"], "theta", "theta")
    node.make_fmu(Path(folder), fmi_version=2)
    results = fmpy.simulate_fmu(
        f"{folder}/loop.fmu",
        stop_time=STEPS * STEP,
        step_size=STEP,
        output_interval=STEP,
        start_values={"container.solver": 1} if MODEL_EXCHANGE else {},  # Runge-Kutta, not Euler
    )
write(results["theta"])
