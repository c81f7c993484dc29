# /// script
# dependencies = ["fmuloader==0.1.2rc0"]
# ///
"""The bindings fmuloader, which have no master: the loop is stepped here, in parallel."""

import re
import zipfile
from pathlib import Path

from fmuloader.fmi2 import Fmi2Slave, Fmi2Type

from loop import CASE, CONNECTIONS, FMUS, FORCE, STEP, STEPS, write


class Fmu:
    """An initialized FMU, and the value references of its variables by name."""

    def __init__(self, path: Path, start: dict[str, float]):
        xml = zipfile.ZipFile(path).read("modelDescription.xml").decode()
        (guid,) = re.findall(r'guid="([^"]*)"', xml)
        variables = re.findall(r'<ScalarVariable name="([^"]*)" valueReference="(\d+)"', xml)
        self.references = {name: int(reference) for name, reference in variables}
        self.slave = Fmi2Slave(path, model_identifier=path.stem)
        self.slave.instantiate(path.stem, Fmi2Type.CO_SIMULATION, guid=guid)
        self.slave.setup_experiment()
        for name, value in start.items():
            self.set(name, value)
        self.slave.enter_initialization_mode()
        self.slave.exit_initialization_mode()

    def get(self, name: str) -> float:
        """Return a Real."""
        return self.slave.get_real([self.references[name]])[0]

    def set(self, name: str, value: float) -> None:
        """Set a Real."""
        self.slave.set_real([self.references[name]], [value])


names = FMUS if CASE == "loop" else ["plant"]
fmus = {name: Fmu(FMUS[name], {"u": FORCE} if CASE == "plant" else {}) for name in names}
connections = CONNECTIONS if CASE == "loop" else []
theta = [fmus["plant"].get("theta")]
for k in range(STEPS):
    values = [fmus[source].get(output) for source, output, _, _ in connections]
    for (_, _, target, input_), value in zip(connections, values, strict=True):
        fmus[target].set(input_, value)
    for fmu in fmus.values():
        fmu.slave.do_step(k * STEP, STEP)
    theta.append(fmus["plant"].get("theta"))
write(theta)
