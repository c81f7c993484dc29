"""Render the icons of the FMUs: `icons/MODEL.svg` to `icon.png` in the documentation of each model.

`python docs/fmu/icons.py` needs Chromium. All icons have the same line width, size and frame; each
has its own shape and colour, which are recognizable even at 32 pixels.
"""

import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

ICONS = Path(__file__).with_name("icons")
ROOT = ICONS.parents[2]

if __name__ == "__main__":
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 256, "height": 256})
        for icon in sorted(ICONS.glob("*.svg")):
            svg = icon.read_text(encoding="utf-8")
            page.set_content(f'<body style="margin: 0; background: none">{svg}')
            image = Image.open(io.BytesIO(page.screenshot(omit_background=True)))
            (file,) = ROOT.glob(f"*/documentation/{icon.stem}/icon.png")
            # A palette keeps it small.
            image.quantize(16, Image.Quantize.FASTOCTREE).save(file, optimize=True)
            print(file.relative_to(ROOT), file.stat().st_size, "bytes")
        browser.close()
