# /// script
# dependencies = ["ecospy==0.7.2"]
# ///
"""Ecos, which needs the system's libtbb."""

from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

from loop import CONNECTIONS, FMUS, STEP, STEPS, write

EcosLib.set_log_level("warn")
structure = EcosSimulationStructure()
for name, path in FMUS.items():
    structure.add_model(name, path)
for source, output, target, input_ in CONNECTIONS:
    structure.make_real_connection(f"{source}::{output}", f"{target}::{input_}")
theta = []
with EcosSimulation(STEP, structure=structure) as simulation:
    simulation.init()
    for _ in range(STEPS + 1):
        theta.append(simulation.get_real("plant::theta"))
        simulation.step()
    simulation.terminate()
write(theta)
