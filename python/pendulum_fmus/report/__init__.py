"""The paper's figures and claims, computed from co-simulations of the FMUs, as one web page."""
