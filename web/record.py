"""Record the page for the README and for its link preview: `make picture`."""

import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
INDEX = (ROOT / "target/page/index.html").as_uri()

PICTURES, PER_PICTURE = 60, 50
"""The picture shows 3 s of the loops, in steps of 50 ms."""


WIDTH, HEIGHT = 600, 315
"""The size of a link preview, which is drawn at twice the resolution."""


def record(page: Page) -> None:
    """Write docs/web.webp: a push, and how three controllers answer it."""
    page.evaluate("running = false; restart(); shove(settings.push)")
    scene, plot = (page.locator(card).bounding_box() for card in (".stage", ".card:has(#angle)"))
    clip = {**scene, "height": plot["y"] + plot["height"] - scene["y"]}
    pictures = []
    for _ in range(PICTURES):
        page.evaluate(f"advance({PER_PICTURE}); draw()")
        pictures.append(Image.open(io.BytesIO(page.screenshot(clip=clip))))
    options = {"save_all": True, "append_images": pictures[1:], "loop": 0, "quality": 60}
    partial = DOCS / "web.webp.partial"
    pictures[0].save(partial, format="WebP", duration=PER_PICTURE, **options)
    partial.replace(DOCS / "web.webp")


def picture(page: Page) -> None:
    """Write web/preview.png: the carts at the end of a push, in the shape of link previews."""
    page.evaluate("running = false; begin(); pass(0.3); draw()")
    page.evaluate("document.querySelector('.lead').style.visibility = 'hidden'")
    stage = page.locator(".stage").bounding_box()
    top = stage["y"] - (HEIGHT - stage["height"]) / 2
    clip = {"x": 0, "y": top, "width": WIDTH, "height": HEIGHT}
    partial = ROOT / "web" / "preview.png.partial"
    Image.open(io.BytesIO(page.screenshot(clip=clip))).quantize().save(partial, format="PNG")
    partial.replace(ROOT / "web" / "preview.png")


def main() -> None:
    """Run the script."""
    flags = ["--no-sandbox", "--disable-gpu"]
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        size = {"width": 900, "height": 1000}
        page = browser.new_page(viewport=size, bypass_csp=True)
        page.goto(f"{INDEX}#on=Pid,PidRbf,IpidRbf")
        page.wait_for_function("loops.length === 3")
        record(page)
        size = {"width": WIDTH, "height": 2 * HEIGHT}
        page = browser.new_page(viewport=size, device_scale_factor=2, bypass_csp=True)
        page.goto(INDEX)
        page.wait_for_function("loops.length === 2")
        picture(page)
        browser.close()


if __name__ == "__main__":
    main()
