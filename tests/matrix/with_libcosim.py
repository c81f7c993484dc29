# /// script
# dependencies = ["libcosimpy==0.0.6"]
# ///
"""libcosim with its fixed-step algorithm."""

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

from loop import CONNECTIONS, FMUS, STEP, STEPS, write

log_output_level(CosimLogLevel.ERROR)
execution = CosimExecution.from_step_size(round(STEP * 1e9))
indices = {
    name: execution.add_local_slave(CosimLocalSlave(str(path), name)) for name, path in FMUS.items()
}


def locate(name: str, variable: str) -> tuple[int, int]:
    """Return the indices of an FMU and of its variable."""
    variables = execution.slave_variables(indices[name])
    return indices[name], next(v.reference for v in variables if v.name == variable.encode())


for source, output, target, input_ in CONNECTIONS:
    execution.connect_real_variables(*locate(source, output), *locate(target, input_))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
plant, angle = locate("plant", "theta")
theta = []
execution.step(0)
for _ in range(STEPS + 1):
    theta += observer.last_real_values(plant, [angle])
    execution.step()
write(theta)
