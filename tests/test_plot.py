"""The pages with traces of runs, in a real browser."""

import json
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from native import LOOPS, read_csv, run

SYSTEM = LOOPS / "pid.toml"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> tuple[Path, list[dict[str, np.ndarray]]]:
    """Return a page with two runs, and their rows."""
    folder = tmp_path_factory.mktemp("plot")
    page, files = folder / "page.html", [folder / "a.csv", folder / "b <&.csv"]
    run("simulate", SYSTEM, "--csv", files[1], "--stop=1", "--step=0.002")
    gain = "--set=controller.pid.kp=300"
    plot = ("--csv", files[0], "--plot", page, "--over", files[1])
    result = run("simulate", SYSTEM, "--stop=2", gain, *plot)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.endswith(f"wrote {page}\n")
    return page, [read_csv(file) for file in files]


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_the_page_draws_all_runs_and_shows_the_values_at_the_cursor(
    browser: Browser, drawn, width, scheme
):
    file, runs = drawn
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-drawn]", state="attached")
    assert (said, asked) == ([], [file.as_uri()])
    assert page.evaluate("document.documentElement.scrollWidth") <= width

    for shown, rows in zip(json.loads(page.inner_text("#runs")), runs, strict=True):
        names = [column["name"] for column in shown["columns"]]
        assert ["time", *names] == list(rows)
        np.testing.assert_array_equal(np.array(shown["time"], np.float32), np.float32(rows["time"]))
        for column in shown["columns"]:
            expected = np.broadcast_to(column["values"], len(rows["time"]))
            np.testing.assert_allclose(expected, rows[column["name"]], rtol=1e-6)
    units = {column["unit"] for column in shown["columns"]}
    assert (
        page.locator(".uplot").count()
        == len(units)
        == int(page.get_attribute("body", "data-drawn"))
    )

    plot = page.locator(".uplot", has_text="plant.theta (this run)")
    over = plot.locator(".u-over")
    over.hover()
    labels, shown = (plot.locator(f".u-{part}").all_inner_texts() for part in ("label", "value"))
    values = dict(zip(labels, shown, strict=True))
    row = np.flatnonzero(np.isclose(runs[0]["time"], float(values["time [s]"]), atol=1e-6))
    assert float(values["plant.theta (this run)"]) == pytest.approx(
        runs[0]["plant.theta"][row[0]], rel=1e-6
    )
    context.close()


def test_what_cannot_be_drawn_is_refused(tmp_path):
    for options, message in [
        (("--csv", "a.parquet"), "a.parquet cannot be drawn on p.html; expected --csv with a name"),
        (("--stop=0.1", "--over", "none.csv"), "none.csv cannot be plotted"),
    ]:
        result = run("simulate", SYSTEM, "--plot", "p.html", *options, cwd=tmp_path)
        assert result.returncode == 1
        assert message in result.stderr
        assert not list(tmp_path.iterdir())
