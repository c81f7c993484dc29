"""Simulation of the pendulum FMUs from Python.

- `master` couples FMUs for co-simulation with FMPy: components, connections, orders of stepping;
- `model_exchange` couples FMUs for model exchange and integrates them with CVode;
- `fmi` has the calls of FMI 2.0 and 3.0 in one form;
- `loop` defines the closed loops of the paper, `run` simulates one from the command line;
- `table1` and `report` reproduce Table 1 and all figures of the paper;
- `sweep` runs parameter sweeps on Dask.
"""
