# /// script
# dependencies = ["fmu-manipulation-toolbox==2.0", "fmpy==0.3.32"]
# ///
"""A container FMU of the FMU Manipulation Toolbox, simulated by FMPy."""

import tempfile
from pathlib import Path

import fmpy
from fmu_manipulation_toolbox.assembly import AssemblyNode

from loop import CONNECTIONS, FMUS, STEP, STEPS, write

with tempfile.TemporaryDirectory() as folder:
    for path in FMUS.values():
        (Path(folder) / path.name).write_bytes(path.read_bytes())
    files = {name: path.name for name, path in FMUS.items()}
    node = AssemblyNode("loop.fmu", step_size=STEP)
    for name in FMUS:
        node.add_fmu(files[name])
    for source, output, target, input_ in CONNECTIONS:
        node.add_link(files[source], output, files[target], input_)
    node.add_output(files["plant"], "theta", "theta")
    node.make_fmu(Path(folder), fmi_version=2)
    results = fmpy.simulate_fmu(
        f"{folder}/loop.fmu", stop_time=STEPS * STEP, step_size=STEP, output_interval=STEP
    )
write(results["theta"])
