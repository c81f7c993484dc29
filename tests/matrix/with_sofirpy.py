# /// script
# dependencies = ["sofirpy==1.0.2", "fmpy==0.3.32", "setuptools<81"]  # for its pkg_resources
# ///
"""SOFIRpy."""

from sofirpy import simulate

from loop import CASE, CONNECTIONS, FMUS, FORCE, STEP, STEPS, write

names = FMUS if CASE == "loop" else ["plant"]
connections = {}
for source, output, target, input_ in CONNECTIONS if CASE == "loop" else []:
    origin = {"connect_to_system": source, "connect_to_external_parameter": output}
    connections.setdefault(target, []).append({"parameter_name": input_} | origin)
results = simulate(
    stop_time=STEPS * STEP,
    step_size=STEP,
    fmu_paths={name: FMUS[name] for name in names},
    connections_config=connections or None,
    start_values={"plant": {"u": FORCE}} if CASE == "plant" else None,
    parameters_to_log={"plant": ["theta"]},
)
write(results["plant.theta"])
