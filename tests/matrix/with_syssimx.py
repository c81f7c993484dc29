# /// script
# dependencies = ["syssimx==0.4.3", "fmpy==0.3.32"]
# ///
"""SysSimX with its Jacobi master."""

from syssimx import Connection, System
from syssimx.components.fmu import FMUComponent
from syssimx.system.algorithms import JacobiAlgorithm

from loop import CONNECTIONS, FMUS, STEP, STEPS, write

system = System("loop")
for name, path in FMUS.items():
    system.add_component(FMUComponent(name, str(path)))
for source, output, target, input_ in CONNECTIONS:
    system.add_connection(Connection(source, output, target, input_))
system.set_algorithm(JacobiAlgorithm())
system.initialize(t0=0.0)
_, results = system.run(t0=0.0, tf=STEPS * STEP, dt=STEP)["plant"]
write(results["theta"])
