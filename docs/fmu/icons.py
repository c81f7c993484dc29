"""Draw the icons of the FMUs: `icon.png` in the documentation of each model.

`python docs/fmu/icons.py` regenerates them. All have the same line width, size and frame; each has
its own shape and colour, which are recognizable even at 32 pixels.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[2]
SIZE = 256
FINE = 4
"""Oversampling factor, which smooths the edges."""
LINE = 14
FONT = findfont("DejaVu Sans:bold")

INK = "#55626f"
BLUE, GREEN, VERMILION, PURPLE, ORANGE = "#0072b2", "#009e73", "#d55e00", "#a84f86", "#d98e00"

Point = tuple[float, float]


class Canvas:
    """Lines, discs and letters in units of the icon's pixels."""

    def __init__(self):
        self.image = Image.new("RGBA", (SIZE * FINE, SIZE * FINE), (255, 255, 255, 0))
        self.draw = ImageDraw.Draw(self.image)

    def line(self, points: Sequence[Point], color: str, width: float = LINE) -> None:
        """Draw a line with round joints and caps."""
        fine = [(x * FINE, y * FINE) for x, y in points]
        self.draw.line(fine, color, round(width * FINE), "curve")
        for end in (points[0], points[-1]):
            self.disc(end, width / 2, color)

    def disc(self, center: Point, radius: float, color: str, line: str | None = None) -> None:
        """Draw a disc, with a border if `line` has a colour."""
        x, y = center
        box = [v * FINE for v in (x - radius, y - radius, x + radius, y + radius)]
        self.draw.ellipse(box, color, line, LINE * FINE if line else 0)

    def box(self, corners: tuple[float, float, float, float], fill: str, line: str) -> None:
        """Draw a box with rounded corners."""
        fine = [v * FINE for v in corners]
        self.draw.rounded_rectangle(fine, 28 * FINE, fill, line, LINE * FINE)

    def text(self, text: str, center: Point, size: float, color: str) -> None:
        """Draw text centred at a point."""
        font = ImageFont.truetype(FONT, size * FINE)
        x, y = center
        self.draw.text((x * FINE, y * FINE), text, color, font, anchor="mm")

    def save(self, file: Path) -> None:
        """Write the icon as a PNG with a palette, which keeps it small."""
        small = self.image.resize((SIZE, SIZE), Image.Resampling.BOX)
        small.quantize(16, Image.Quantize.FASTOCTREE).save(file, optimize=True)


def curve(height: Callable[[float], float], left: float, right: float) -> list[Point]:
    """Return the points of a curve from x = `left` to `right`, every four pixels."""
    steps = round((right - left) / 4)
    xs = [left + (right - left) * i / steps for i in range(steps + 1)]
    return [(x, height(x)) for x in xs]


def block(canvas: Canvas, letters: str, color: str) -> None:
    """Draw the block common to all controllers, with a name."""
    canvas.box((8, 24, 248, 232), "#ffffff", color)
    canvas.text(letters, (128, 84), 88 if len(letters) == 3 else 76, INK)


def bell(center: float, width: float, height: float) -> list[Point]:
    """Return the curve of a node of the network."""
    return curve(lambda x: 204 - height * math.exp(-(((x - center) / width) ** 2)), 36, 220)


def pid(canvas: Canvas) -> None:
    """Draw a block with a step response."""
    block(canvas, "PID", BLUE)

    def response(x: float) -> float:
        t = (x - 60) / 18
        return 200.0 if t < 0 else 150 + 50 * math.exp(-0.6 * t) * math.cos(1.5 * t)

    canvas.line(curve(response, 36, 220), BLUE, 12)


def pid_rbf(canvas: Canvas) -> None:
    """Draw a block with the bell curves of the network."""
    block(canvas, "PID", VERMILION)
    for center in (84, 128, 172):
        canvas.line(bell(center, 17, 64), VERMILION, 8)


def ipid_rbf(canvas: Canvas) -> None:
    """Draw a block with one filled bell curve: the network replaces the integral."""
    block(canvas, "IPID", GREEN)
    points = bell(128, 34, 70)
    canvas.draw.polygon([(x * FINE, y * FINE) for x, y in points], GREEN)
    canvas.line(points, GREEN, 10)


def pendulum(canvas: Canvas) -> None:
    """Draw the cart with its pendulum."""
    canvas.line([(12, 236), (244, 236)], INK, 10)
    pivot, bob = (112, 160), (176, 40)
    canvas.box((40, 152, 184, 214), "#ffffff", INK)
    for x in (76, 148):
        canvas.disc((x, 214), 20, "#ffffff", INK)
    canvas.line([pivot, bob], ORANGE, 20)
    canvas.disc(bob, 32, ORANGE)
    canvas.disc(pivot, 14, INK)


def source(canvas: Canvas) -> None:
    """Draw a generator: a disc with a square wave and a sine."""
    canvas.disc((128, 128), 120, "#ffffff", PURPLE)
    canvas.line([(64, 112), (64, 64), (128, 64), (128, 112), (192, 112), (192, 64)], INK, 13)
    canvas.line(curve(lambda x: 172 - 30 * math.sin((x - 60) / 136 * math.tau), 60, 196), PURPLE)


ICONS = {
    "fmu-plant/documentation/Pendulum": pendulum,
    "fmu-controller/documentation/Pid": pid,
    "fmu-controller/documentation/PidRbf": pid_rbf,
    "fmu-controller/documentation/IpidRbf": ipid_rbf,
    "fmu-source/documentation/Source": source,
}

if __name__ == "__main__":
    for folder, draw in ICONS.items():
        canvas = Canvas()
        draw(canvas)
        file = ROOT / folder / "icon.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        canvas.save(file)
        print(file.relative_to(ROOT), file.stat().st_size, "bytes")
