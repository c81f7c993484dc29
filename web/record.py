"""Record the page for the README: `make picture`."""

import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"

PICTURES, PER_PICTURE = 60, 50
"""The picture shows 3 s of the loops, in steps of 50 ms."""


def record(page: Page) -> None:
    """Write docs/web.webp: a push, and how three controllers answer it."""
    page.evaluate("running = false; restart(); shove(settings.push)")
    scene, plot = (page.locator(".card").nth(i).bounding_box() for i in (0, 2))
    clip = {**scene, "height": plot["y"] + plot["height"] - scene["y"]}
    pictures = []
    for _ in range(PICTURES):
        page.evaluate(f"advance({PER_PICTURE}); draw()")
        pictures.append(Image.open(io.BytesIO(page.screenshot(clip=clip))))
    options = {"save_all": True, "append_images": pictures[1:], "loop": 0, "quality": 60}
    partial = DOCS / "web.webp.partial"
    pictures[0].save(partial, format="WebP", duration=PER_PICTURE, **options)
    partial.replace(DOCS / "web.webp")


def main() -> None:
    """Run the script."""
    flags = ["--no-sandbox", "--disable-gpu"]
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        size = {"width": 900, "height": 1000}
        page = browser.new_page(viewport=size, bypass_csp=True)
        page.goto((ROOT / "target/page/index.html").as_uri() + "#on=Pid,PidRbf,IpidRbf")
        page.wait_for_function("loops.length === 3")
        record(page)
        browser.close()


if __name__ == "__main__":
    main()
