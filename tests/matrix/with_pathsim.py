# /// script
# dependencies = ["pathsim-fmi==0.1.1", "pathsim==0.27.1", "fmpy==0.3.32"]
# ///
"""PathSim with its blocks for co-simulation and model exchange."""

from pathsim import Connection, Simulation
from pathsim.blocks import Constant
from pathsim.solvers import RK4
from pathsim_fmi import CoSimulationFMU, ModelExchangeFMU

from loop import CONNECTIONS, FMUS, FORCE, LOOP, MODEL_EXCHANGE, STEP, STEPS, write


def block(name: str) -> CoSimulationFMU | ModelExchangeFMU:
    """Return the block of an FMU; that for model exchange needs continuous states."""
    if MODEL_EXCHANGE and name == "plant":
        return ModelExchangeFMU(str(FMUS[name]), name)
    return CoSimulationFMU(str(FMUS[name]), name, dt=STEP)


blocks = {name: block(name) for name in (FMUS if LOOP else ["plant"])}
connections = [
    Connection(blocks[source][output], blocks[target][input_])
    for source, output, target, input_ in CONNECTIONS
    if LOOP
]
if not LOOP:
    blocks["force"] = Constant(FORCE)
    connections = [Connection(blocks["force"], blocks["plant"]["u"])]
simulation = Simulation(list(blocks.values()), connections, dt=STEP, Solver=RK4, log=False)
theta = []
for _ in range(STEPS + 1):
    theta.append(blocks["plant"].outputs["theta"])
    simulation.timestep(STEP)
write(theta)
