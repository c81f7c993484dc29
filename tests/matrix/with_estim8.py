# /// script
# dependencies = ["estim8==0.1.6", "fmpy==0.3.32"]
# ///
"""estim8, which estimates parameters of one FMU."""

from estim8.models import FmuModel

from loop import FMUS, FORCE, MODEL_EXCHANGE, STEP, STEPS, write

kind = "ModelExchange" if MODEL_EXCHANGE else "CoSimulation"
model = FmuModel(str(FMUS["plant"]), r_tol=1e-12, fmi_type=kind)
results = model.simulate(0, STEPS * STEP, STEP, parameters={"u": FORCE}, observe=["theta"])
write(results["theta"].values)
