# /// script
# dependencies = ["sofirpy==1.0.2", "fmpy==0.3.32", "setuptools<81"]  # for its pkg_resources
# ///
"""SOFIRpy."""

from sofirpy import simulate

from loop import CONNECTIONS, FMUS, FORCE, LOOP, STEP, STEPS, write

names = FMUS if LOOP else ["plant"]
connections = {}
for source, output, target, input_ in CONNECTIONS if LOOP else []:
    origin = {"connect_to_system": source, "connect_to_external_parameter": output}
    connections.setdefault(target, []).append({"parameter_name": input_} | origin)
results = simulate(
    stop_time=STEPS * STEP,
    step_size=STEP,
    fmu_paths={name: FMUS[name] for name in names},
    connections_config=connections or None,
    start_values=None if LOOP else {"plant": {"u": FORCE}},
    parameters_to_log={"plant": ["theta"]},
)
write(results["plant.theta"])
