# /// script
# dependencies = ["estim8==0.1.6", "fmpy==0.3.32"]
# ///
"""estim8, which estimates parameters of one FMU."""

from estim8.models import FmuModel

from loop import FMUS, FORCE, STEP, STEPS, write

model = FmuModel(str(FMUS["plant"]), fmi_type="CoSimulation")
results = model.simulate(0, STEPS * STEP, STEP, parameters={"u": FORCE}, observe=["theta"])
write(results["theta"].values)
