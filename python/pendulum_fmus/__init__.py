"""Simulation of the pendulum FMUs from Python.

- `master` couples FMUs of FMI 2.0 and 3.0 for co-simulation with FMPy: connections, orders of
  stepping;
- `loop` defines the closed loops of the paper, `run` simulates one from the command line;
- `table1` and `report` reproduce Table 1 and all figures of the paper;
- `sweep` runs parameter sweeps on Dask.
"""
