"""Measure the FMUs as WebAssembly components: in wasmtime, Node and Chromium, and on the page."""

import shutil
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
from fmpy import read_model_description
from playwright.sync_api import Page, sync_playwright

from hosts import Costs, in_host, run
from measure import WASM
from node import in_node
from node import program as node
from pendulum_fmus.project import FMUS, ROOT

PAGE = ROOT / "target" / "page" / "index.html"

SIGNALS = {
    "Pid": ("y", "u", 1e-3),
    "PidRbf": ("y", "u", 1e-3),
    "Pendulum": ("u", "theta", 0.0),
}
"""Input, output, and how far the input moves: the plant, without a controller, would fall."""

ENGINES = ("native", "wasmtime", "Node", "Chromium")

CYCLES = """
const measure = (fmus, signals, rounds, cycles) => Object.entries(signals).map(
  ([name, [input, output, amplitude]]) => {
    const it = new Instance(fmus[name]);
    const times = [];
    for (let round = 0, k = 0; round < rounds; round++) {
      const start = performance.now();
      for (let i = 0; i < cycles; i++, k++) {
        it.set(input, amplitude * (k % 2));
        it.step(k * 1e-3, 1e-3);
        it.get(output);
      }
      times.push((performance.now() - start) * 1e6 / cycles);
    }
    return times;
  });
"""

NODE = "const answer = (fmus, given) => measure(fmus, ...given);"

FRAMES = """(seconds) => new Promise((resolve) => {
    let frames = 0, first;
    const count = (now) => {
        first ??= now;
        if (now - first >= 1000 * seconds) resolve(frames);
        else { frames++; requestAnimationFrame(count); }
    };
    requestAnimationFrame(count);
})"""


def component(name: str) -> Path:
    """Return the FMU that has a component."""
    return WASM / f"{name}_fmi3.fmu"


def by_fmu_host(folder: Path, rounds: int, cycles: int) -> Costs:
    """Measure native binaries and components in turn, by the crate fmu-host."""
    words: list[object] = []
    for name, (input_, output, amplitude) in SIGNALS.items():
        for engine, fmu in (("native", FMUS / f"{name}_fmi3.fmu"), ("wasmtime", component(name))):
            unpacked = folder / f"{name} {engine}"
            fmpy.extract(fmu, str(unpacked))
            [binary] = (file for file in unpacked.glob("binaries/*/*") if file.is_file())
            description = read_model_description(unpacked, validate=False)
            references = {v.name: v.valueReference for v in description.modelVariables}
            words += [f"{engine}/{name}", 3, binary, description.guid]
            words += [references[input_], references[output], amplitude]
    return in_host(rounds, cycles, words)


def frames(page: Page, seconds: float) -> dict[str, float]:
    """Measure frames with three loops: how many a second, and the processor's time for each [s].

    The time of the page's own thread does not depend on how busy the machine is.
    """
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def metrics() -> Mapping[str, float]:
        found = session.send("Performance.getMetrics")["metrics"]
        return {metric["name"]: metric["value"] for metric in found}

    page.evaluate(FRAMES, seconds)  # until the plots are full
    before = metrics()
    count = page.evaluate(FRAMES, seconds)
    spent = {key: value - before[key] for key, value in metrics().items()}
    return {
        "rate": count / spent["Timestamp"],
        "script": spent["ScriptDuration"] / count,
        "all": spent["TaskDuration"] / count,
    }


def in_chromium(given: list, seconds: float) -> dict[str, Any]:
    """Measure in Chromium: the times of cycles, frames of the page, and the version."""
    with sync_playwright() as playwright:
        chromium, flags = shutil.which("chromium"), ["--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport={"width": 1280, "height": 800}, bypass_csp=True)
        page.goto(PAGE.as_uri() + "#on=Pid,PidRbf,IpidRbf")
        page.wait_for_function("loops.length === 3")
        shown = frames(page, seconds)
        page.evaluate("running = false")
        cycles = f"(given) => {{ {CYCLES} return measure(fmus, ...given); }}"
        times = page.evaluate(cycles, given)
        version = browser.version
        browser.close()
    return {"times": times, "frames": shown, "version": version}


def measure(folder: Path, *, quick: bool) -> dict[str, Any]:
    """Return the costs of cycles, "ENGINE/FMU", and what describes the page and the components.

    Engines that are missing are left out, and the crate fmu-host if `quick`.
    """
    print("measuring: components", file=sys.stderr)
    rounds, cycles, seconds = (2, 100, 0.5) if quick else (30, 20_000, 5)
    given = [SIGNALS, rounds, cycles]
    costs = {} if quick else by_fmu_host(folder, rounds, cycles)
    found: dict[str, Any] = {"costs": costs, "frames": {}, "versions": {}, "sizes": {}}
    if node():
        files = {name: component(name) for name in SIGNALS}
        costs |= zip(
            [f"Node/{name}" for name in SIGNALS], in_node(files, CYCLES + NODE, given), strict=True
        )
        found["versions"]["Node"] = run([node(), "--version"]).strip().removeprefix("v")
    if shutil.which("chromium"):
        of_page = in_chromium(given, seconds)
        costs |= zip([f"Chromium/{name}" for name in SIGNALS], of_page["times"], strict=True)
        found["frames"], found["versions"]["Chromium"] = of_page["frames"], of_page["version"]
    for file in sorted(WASM.glob("*.fmu")):
        with zipfile.ZipFile(file) as archive:
            [binary] = (entry for entry in archive.infolist() if entry.filename.endswith(".wasm"))
        found["sizes"][file.stem.removesuffix("_fmi3")] = binary.file_size
    return found | {"page": PAGE.stat().st_size}
