"""Co-simulation of the pendulum FMUs from Python.

- `master` couples any FMUs by FMPy: components, connections, orders of stepping;
- `loop` has the closed loops of the paper, `run` simulates one of them from the command line;
- `table1` and `report` recompute Table 1 and all figures of the paper;
- `sweep` runs parameter sweeps on Dask.
"""
