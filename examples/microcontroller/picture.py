"""Draw the loop on the microcontroller over the native one: `python picture.py [FILE]`.

It needs what `make -C examples/microcontroller run`, `make fmus` and `make module` write.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fmu_master import System

ROOT = Path(__file__).resolve().parents[2]
LOOP = ROOT / "examples" / "closed-loop" / "pid-rbf.toml"
SIGNALS = ROOT / "target" / "microcontroller" / "cortex-m7" / "signals.bin"

NAMES = (
    ["source.r", "source.d", *(f"plant.{name}" for name in ("theta", "omega", "x", "v"))]
    + [f"controller.{name}" for name in ("u", "u_p", "u_n", "e")]
    + [f"controller.rbf.{name}[{i}]" for name in "wh" for i in range(1, 5)]
)
"""The signals of a row, in the order of loop.c."""


def on_board(file: Path = SIGNALS) -> dict[str, np.ndarray]:
    """Return the signals that the board has written."""
    rows = np.fromfile(file, "<f8").reshape(-1, len(NAMES))
    return dict(zip(NAMES, rows.T, strict=True))


def draw(board: dict[str, np.ndarray]) -> Figure:
    """Draw angle, force and the network's weights."""
    native = System(LOOP).simulate({"source.signal": "sine"}, output=NAMES)
    differ = sum(native[name].tobytes() != board[name].tobytes() for name in NAMES)
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    panels = {"angle θ [rad]": ["plant.theta"], "force u [N]": ["controller.u"]}
    panels["weights of the network [N]"] = [f"controller.rbf.w[{i}]" for i in range(1, 5)]
    # The first second, then every fiftieth row, as all would make the file large.
    shown = np.r_[0:1000:5, 1000 : len(native["time"]) : 50]
    for axis, (label, names) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        for signals, style, width in ((native, "0.75", 4.0), (board, "C3", 1.0)):
            for name in names:
                axis.plot(native["time"][shown], signals[name][shown], style, linewidth=width)
        axis.set(xlabel="time [s]", ylabel=label)
    lines = figure.axes[0].lines
    labels = ["native FMUs", "C sources on a Cortex-M7"]
    figure.legend(lines, labels, loc="outside lower center", ncols=2)
    same = "the same bits" if not differ else f"{differ} DIFFER"
    figure.suptitle(f"{len(NAMES)} signals, {len(native['time'])} steps of 1 ms: {same}")
    return figure


def main() -> None:
    """Write the picture."""
    file = sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs" / "microcontroller.svg"
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "docs", "font.size": 8}
    draw(on_board()).savefig(file, metadata={"Date": None})


if __name__ == "__main__":
    main()
