"""A controller outside of FMI: reads rows of `--csv -`, and writes rows for `--input`.

It holds the pendulum upright by its angle. The first line names the inputs; each further line is
written at once, and takes effect at the next communication point.
"""

import sys

GAINS = (60.0, 8.0)
"""The force by the angle [N/rad], and by its rate [N s/rad]."""

print("time,u", flush=True)
before = None
for line in sys.stdin:
    if line.startswith("time"):
        continue  # the names of the columns
    time, theta = map(float, line.split(","))
    rate = 0.0 if before is None else (theta - before[1]) / (time - before[0])
    before = (time, theta)
    u = -GAINS[0] * theta - GAINS[1] * rate
    try:
        print(f"{time},{u}", flush=True)
    except BrokenPipeError:
        break  # the run has ended
