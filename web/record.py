"""Record the page for the README, and measure what docs/web.md tells: `make picture`."""

import io
import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
sys.path.append(str(ROOT / "bench"))

import measure  # noqa: E402

PICTURES, PER_PICTURE = 60, 50
"""The picture shows 3 s of the loops, in steps of 50 ms."""

FRAMES = """(seconds) => new Promise((resolve) => {
    let frames = 0, first;
    const count = (now) => {
        first ??= now;
        if (now - first >= 1000 * seconds) resolve([frames / (now - first) * 1000, time]);
        else { frames++; requestAnimationFrame(count); }
    };
    requestAnimationFrame(count);
})"""

CYCLE = """(name) => {
    const it = new Instance(fmus[name]);
    const [input, output] = name === "Pendulum" ? ["u", "theta"] : ["y", "u"];
    let best = Infinity, k = 0;
    for (let round = 0; round < 60; round++) {
        const start = performance.now();
        for (let i = 0; i < 20000; i++, k++) {
            it.set(input, name === "Pendulum" ? 0 : 1e-3 * (k % 2));
            it.step(k * 1e-3, 1e-3);
            it.get(output);
        }
        best = Math.min(best, (performance.now() - start) * 1e6 / 20000);
    }
    return best;
}"""


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


def native() -> list[float]:
    """Return the shortest cycles of the native FMUs in a C host [ns]."""
    with TemporaryDirectory() as folder:
        cases = [measure.in_fmi3(case) for case in list(measure.MODELS.values())[: len(MODELS)]]
        lines = measure.Host(Path(folder)).measure("cycle", 20000, 20, cases)
    return [min(line["ns"]) for line in lines]


MODELS = ["Pid", "PidRbf", "IpidRbf", "Pendulum"]


def measured(page: Page) -> str:
    """Return what is measured on this machine."""
    page.evaluate("running = true")
    page.evaluate(FRAMES, 1)
    before = page.evaluate("time")
    frames, after = page.evaluate(FRAMES, 10)
    cycles = zip(MODELS, native(), (page.evaluate(CYCLE, name) for name in MODELS), strict=True)
    version = page.context.browser.version
    machine = measure.machine()
    on = f"{machine['processor']} with {machine['cores']} cores"
    text = f"On {on}, in headless Chromium {version} without a graphics card:\n"
    text += f"{frames:.0f} frames per second with three loops at 1 ms, over 10 s, in which the\n"
    text += f"loops advanced by {after - before:.1f} s; the load of the machine was "
    text += f"{os.getloadavg()[0]:.0f}.\n\n"
    text += "| Cycle: set, step, get | native, in C | component, in Chromium |\n|---|---|---|\n"
    return text + "".join(f"| `{name}` | {a:.0f} ns | {b:.0f} ns |\n" for name, a, b in cycles)


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
        text = measured(page)
        record(page)
        browser.close()
    print(text)
    file = DOCS / "web.md"
    begin, rest = file.read_text(encoding="utf-8").split("<!-- measured -->\n")
    _, end = rest.split("<!-- / -->\n")
    partial = file.with_suffix(".partial")
    partial.write_text(f"{begin}<!-- measured -->\n\n{text}\n<!-- / -->\n{end}", encoding="utf-8")
    partial.replace(file)


if __name__ == "__main__":
    main()
