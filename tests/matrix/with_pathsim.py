# /// script
# dependencies = ["pathsim-fmi==0.1.1", "pathsim==0.27.1", "fmpy==0.3.32"]
# ///
"""PathSim with its block for co-simulation."""

from pathsim import Connection, Simulation
from pathsim.blocks import Constant
from pathsim_fmi import CoSimulationFMU

from loop import CASE, CONNECTIONS, FMUS, FORCE, STEP, STEPS, write

names = FMUS if CASE == "loop" else ["plant"]
blocks = {name: CoSimulationFMU(str(FMUS[name]), name, dt=STEP) for name in names}
connections = [
    Connection(blocks[source][output], blocks[target][input_])
    for source, output, target, input_ in CONNECTIONS
    if CASE == "loop"
]
if CASE == "plant":
    blocks["force"] = Constant(FORCE)
    connections = [Connection(blocks["force"], blocks["plant"]["u"])]
simulation = Simulation(list(blocks.values()), connections, dt=STEP, log=False)
theta = []
for _ in range(STEPS + 1):
    theta.append(blocks["plant"].outputs["theta"])
    simulation.timestep(STEP)
write(theta)
