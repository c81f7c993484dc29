"""The report: its Table 1, its numbers against independent ones, its files."""

import csv
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree, html

import reference
from pendulum_fmus import table1
from pendulum_fmus.loop import TS, Loop, execute
from pendulum_fmus.master import MasterError, simulate
from pendulum_fmus.report import native
from pendulum_fmus.report.beyond.eigenvalues import DELAYS, matrix
from pendulum_fmus.report.beyond.noise import Measured
from pendulum_fmus.report.claims import Verdict, judge
from pendulum_fmus.report.data import Trace
from pendulum_fmus.report.metrics import (
    bursts,
    iae,
    ise,
    itae,
    overshoot,
    rise_time,
    settling,
    tone,
)
from pendulum_fmus.report.native import SYSTEMS, both_plants, sweep
from pendulum_fmus.report.numbers import number
from pendulum_fmus.report.thin import thinned

ROOT = Path(__file__).resolve().parent.parent
FIGURES = [2, *range(4, 22)]
SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


# --- the page's numbers -------------------------------------------------------------------------


@pytest.fixture(scope="session")
def page(report_folder: Path) -> html.HtmlElement:
    return html.parse(str(report_folder / "index.html")).getroot()


def value(text: str) -> float:
    """Parse a number in the format of the page: "9.810 · 10⁻⁴", "−0.5", "never"."""
    mantissa, _, power = text.partition(" · 10")
    if mantissa == "never":
        return math.nan
    return float(mantissa.translate(SUPERSCRIPTS)) * 10 ** int(power.translate(SUPERSCRIPTS) or 0)


def cells(page: html.HtmlElement, part: str, quantity: str) -> dict[str, float]:
    """Return a row of numbers by column heading."""
    for row in page.xpath(f"//article[@id='{part}']//table[contains(@class, 'numbers')]//tbody/tr"):
        if row[0].text_content() == quantity:
            heads = row.getparent().getparent().xpath("thead/tr/th")
            pairs = zip(heads[1:], row[1:], strict=True)
            return {head.text_content(): value(cell.text_content()) for head, cell in pairs}
    raise KeyError(quantity)


def printed_lines(page: html.HtmlElement) -> list[list[str]]:
    rows = page.xpath("//table[@class='table1']/tbody/tr")
    return [[cell.text_content().strip() for cell in row] for row in rows]


def test_table_1_matches_the_data_file(page):
    lines = printed_lines(page)
    assert len(lines) == 18 + 4 + 2
    with table1.DATA.open() as file:
        rows = list(csv.DictReader(file))
    computed = iter(lines)
    for row in rows:
        for column in ("e_pid", "e_pid_rbf", "e_ipid_rbf"):
            line = next(computed)
            assert line[0] == row["row"]
            assert line[4].replace("−", "-") == row[f"{column}_printed"]
            expected, found = row[f"{column}_expected"], float(line[5].replace("−", "-"))
            if "|e|" in expected:
                assert abs(found) < 1e-11
            else:
                # Row 2 of PID-RBF is a decayed transient, which is sensitive to rounding
                tolerance = 1e-2 if abs(float(expected)) < 1e-9 else 2e-5
                assert found == pytest.approx(float(expected), rel=tolerance)


def test_no_number_of_table_1_is_missed(page):
    assert all("does not hold" not in line[7] for line in printed_lines(page))


STEP = {
    "PID": ("Pid", {}),
    "PID-RBF": ("PidRbf", {}),
    "IPID-RBF": ("IpidRbf", {"target": "supervisor"}),
    "own target": ("IpidRbf", {}),
}


@pytest.mark.parametrize("kind", STEP)
def test_step_response_matches_an_independent_simulation(page, kind):
    controller, options = STEP[kind]
    run = reference.closed_loop(controller, **options)
    e, theta, t = run["controller.e"], run["plant.theta"], run["time"]
    outside = np.flatnonzero(np.abs(e) > 0.003)[-1]

    def on_page(figure: str, quantity: str) -> float:
        return cells(page, figure, quantity)[kind]

    assert on_page("figure-6", "settling ±0.3 % [s]") == pytest.approx(t[outside + 1], abs=5e-4)
    beyond = max(100 * (theta.max() - 1), 0)
    assert on_page("figure-6", "overshoot [%]") == pytest.approx(beyond, rel=1e-3, abs=1e-9)
    assert on_page("figure-16", "IAE [rad s]") == pytest.approx(np.abs(e).sum() / 1000, rel=1e-3)
    assert on_page("figure-16", "ISE [rad² s]") == pytest.approx((e**2).sum() / 1000, rel=1e-3)
    timed = (t * np.abs(e)).sum() / 1000
    assert on_page("figure-16", "ITAE [rad s²]") == pytest.approx(timed, rel=1e-3)


def test_static_errors_of_the_pid_match_the_closed_form(page):
    found = cells(page, "figure-2", "e(20 s) [rad]")
    for name, ki in (("½ ki", 250), ("nominal", 500), ("2 ki", 1000)):
        assert found[name] == pytest.approx(1 / (1 - ki / 0.98), rel=1e-3)


def test_disturbed_sine_matches_an_independent_simulation(page):
    for amplitude in (1.0, 2.0):
        e = reference.closed_loop("PidRbf", "sine", amplitude)["controller.e"]
        row = cells(page, "figure-19", f"IAE, d = {amplitude:g} rad [rad s]")
        assert row["PID-RBF"] == pytest.approx(np.abs(e).sum() / 1000, rel=1e-3)


def test_the_summary_counts_every_verdict(page):
    summary = [cell.text_content() for cell in page.xpath("//table[@class='summary']//td[last()]")]
    claims = page.xpath("//section[@class='claim'][not(ancestor::section[@id='beyond'])]")
    assert len(summary) == len(claims)
    for verdict in Verdict:
        counted = sum(verdict.sign in text for text in summary)
        heading = page.xpath("//section[@id='summary']/p[1]")[0].text_content()
        assert re.search(rf"{verdict.sign} {verdict.label}\s+{counted}\b", heading)


# --- beyond the paper ---------------------------------------------------------------------------


def test_learning_rate_limits_match_the_crate_control(page):
    """crates/control/tests/learning_rate.rs gets the same result from its own matrix."""
    found = cells(page, "beyond-learning", "largest stable η [1]")
    for name, limit in (("0 samples", 0.582), ("1 sample", 0.324), ("2 samples", 0.205)):
        assert found[name] == pytest.approx(limit, abs=1e-3)
    radius = cells(page, "beyond-learning", "spectral radius at η = 0.30 [1]")
    assert radius["2 samples"] == pytest.approx(1.0435, abs=1e-3)


@pytest.mark.parametrize("delay", DELAYS)
def test_matrix_matches_the_independent_controller(delay):
    """At r = 1, without force limit, from a small deviation."""
    A, state = matrix(delay, 0.3), np.zeros(9)
    state[1] = deviation = 1e-6
    controller = reference.Controller("PidRbf", previous_sample_terms=delay.previous_sample_terms)
    controller.u_max = math.inf
    plant, u = reference.Plant(), 0.0
    plant.state[2] = deviation
    for _ in range(300):
        assert plant.theta == pytest.approx(state[1], rel=1e-6, abs=1e-6 * deviation)
        before = u
        # The angle is measured from the set-point; the nodes see r = 1
        controller.sample(1.0, 1.0 + plant.theta)
        u = controller.u
        plant.step(before if delay.parallel else u, reference.TS)
        state = A @ state


@pytest.mark.parametrize(("factor", "held"), [(0.99, True), (1.01, False)])
@pytest.mark.parametrize(("kind", "controller"), [("PID", "Pid"), ("own target", "IpidRbf")])
def test_largest_step_matches_another_master(page, fmus, kind, controller, factor, held):
    amplitude = factor * cells(page, "beyond-nonlinear", "largest step [rad]")[kind]
    overrides = (("source.amplitude", amplitude),)
    loop = Loop(controller, plant_model="nonlinear", overrides=overrides)
    with loop.system(fmus) as system:
        error = simulate(system, TS, TS, 20000, record=["controller.e"])["controller.e"]
    assert (np.max(np.abs(error)) < math.pi) == held


@pytest.mark.parametrize(("kind", "controller"), [("PID", "Pid"), ("PID-RBF", "PidRbf")])
@pytest.mark.parametrize("anti_windup", [False, True])
def test_overshoot_at_a_low_limit_matches_the_independent_controller(
    page, kind, controller, anti_windup
):
    law = reference.Controller(
        controller, previous_sample_terms=True, anti_windup=anti_windup, start=TS
    )
    law.u_max, plant, highest = 25.0, reference.Plant(), 0.0
    for _ in range(4000):
        law.sample(1.0, plant.theta)
        plant.step(law.u, TS)
        highest = max(highest, plant.theta)
    found = cells(page, "beyond-windup", "overshoot at 25 N [%]")
    head = f"{kind}, {'with' if anti_windup else 'without'}"
    assert found[head] == pytest.approx(100 * (highest - 1), rel=1e-3)


def test_sweep_gives_the_numbers_of_the_figures(page, fmus):
    areas = cells(page, "figure-6", "IAE [rad s]")
    heads = {"IPID-RBF own": "own target"}
    for kind in SYSTEMS:
        names = both_plants(kind, "M")
        metrics = sweep(kind, names, np.array([1.096]), {}, 1000.0, fmus)
        assert metrics["iae"][0] == pytest.approx(areas[heads.get(kind, kind)], rel=1e-3)


def test_both_masters_give_the_same_bits(fmus):
    overrides = (("controller.pid.kp", 250.0), ("source.disturbance.start", 0.1))
    loop = Loop(
        "IpidRbf", "sine", 1.0, "supervisor",
        w0=(0.1, -0.2, 0.3, -0.4), plant_model="nonlinear", overrides=overrides, steps=300,
    )  # fmt: skip
    computed, expected = native.simulate(loop, fmus), execute(loop, fmus)
    assert np.any(computed["source.d"])
    assert set(computed) > set(expected)
    for name, column in expected.items():
        assert computed[name].tobytes() == column.tobytes(), name


def test_a_failed_run_names_its_loop(fmus):
    loop = Loop("Pid", overrides=(("plant.M", -1.0),))
    with pytest.raises(MasterError, match=r"Loop\(controller='Pid'.*plant.M"):
        native.simulate_all([loop], fmus)


def test_a_missing_program_says_what_to_do(fmus, monkeypatch):
    monkeypatch.setattr(native, "PROGRAM", ROOT / "nowhere")
    with pytest.raises(MasterError, match="run `make fmus` first"):
        native.simulate(Loop("Pid"), fmus)


@pytest.mark.parametrize("delay", [0, 2])
def test_the_sensor_delays_the_measured_angle(delay, fmus, sensor):
    columns = native.simulate(Measured("PidRbf", steps=500, delay=delay), fmus)
    shown, angle = columns["sensor.y"], columns["plant.theta"]
    assert np.array_equal(shown[delay:], angle[: len(angle) - delay])
    assert not np.any(shown[:delay])
    plain = native.simulate(Loop("PidRbf", steps=500), fmus)
    assert np.array_equal(angle, plain["plant.theta"]) == (delay == 0)


# --- files --------------------------------------------------------------------------------------


def test_every_figure_of_the_paper_is_present(page):
    found = [part.get("id") for part in page.xpath("//section[@id='figures']/article")]
    assert found == [f"figure-{number}" for number in FIGURES]


def test_every_figure_is_described_and_captioned(page):
    plots = page.xpath("//div[@class='plot']")
    assert len(plots) >= len(FIGURES)
    for plot in plots:
        assert plot.get("role") == "img"
        assert len(plot.get("aria-label")) > 40
    for number_ in FIGURES:
        assert page.xpath(f"//article[@id='figure-{number_}']//figcaption/p")[0].text_content()


def test_every_link_has_a_target(page, report_folder):
    targets = page.xpath("//@href")
    ids = set(page.xpath("//@id"))
    assert len(page.xpath("//@id")) == len(ids)
    for target in targets:
        if target.startswith("#"):
            assert target[1:] in ids, target
        elif not target.startswith("data:"):
            assert (report_folder / target).is_file(), target


def test_svg_and_pdf_files_parse(page, report_folder):
    names = {plot.get("id").removeprefix("plot-") for plot in page.xpath("//div[@class='plot']")}
    folder = report_folder / "figures"
    assert {path.stem for path in folder.iterdir()} == names
    for name in names:
        drawing = etree.parse(str(folder / f"{name}.svg")).getroot()
        assert drawing.tag.endswith("svg")
        assert len(drawing.findall(".//{*}path")) > 20
        pdf = (folder / f"{name}.pdf").read_bytes()
        assert pdf.startswith(b"%PDF-")
        assert pdf.rstrip().endswith(b"%%EOF")
        assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 1


def test_the_overview_is_drawn(report_folder):
    assert (report_folder / "closed-loop.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_is_one_file_of_moderate_size(report_folder):
    assert (report_folder / "index.html").stat().st_size < 12e6


@pytest.mark.parametrize("command", ["table1", "report"])
def test_the_error_for_missing_fmus_says_what_to_do(command, tmp_path):
    options = ["-m", f"pendulum_fmus.{command}", "--fmus", "nowhere"]
    if command == "report":
        options += ["--out", str(tmp_path)]
    command = [sys.executable, *options]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "run `cargo fmu export`" in run.stderr
    assert "Traceback" not in run.stderr


# --- parts --------------------------------------------------------------------------------------


def trace(e: np.ndarray, theta: np.ndarray | None = None, ts: float = 0.001) -> Trace:
    """Return a trace at ts, 2 ts, ... with the error e and the set-point 1."""
    t = ts * np.arange(1, len(e) + 1)
    one = np.ones_like(e)
    theta = 1 - e if theta is None else theta
    return Trace("t", t, one, 0 * e, theta, e, one, one, None)


def test_metrics_of_a_decaying_exponential_are_its_integrals():
    t = 0.001 * np.arange(1, 30001)
    decay = trace(np.exp(-t))
    assert iae(decay) == pytest.approx(1, rel=1e-3)
    assert ise(decay) == pytest.approx(1 / 2, rel=2e-3)
    assert itae(decay) == pytest.approx(1, rel=1e-3)
    assert settling(decay) == pytest.approx(-math.log(0.003), abs=2e-3)
    assert rise_time(decay) == pytest.approx(math.log(9), abs=2e-3)
    assert overshoot(decay) == 0


def test_overshoot_of_a_second_order_system_follows_from_its_damping():
    damping, t = 0.3, 0.001 * np.arange(1, 20001)
    damped = math.sqrt(1 - damping**2)
    ringing = np.cos(damped * t) + damping / damped * np.sin(damped * t)
    theta = 1 - np.exp(-damping * t) * ringing
    expected = 100 * math.exp(-math.pi * damping / damped)
    assert overshoot(trace(1 - theta, theta)) == pytest.approx(expected, rel=1e-5)


def test_close_bursts_count_as_one():
    t = np.arange(0, 10, 0.001)
    u = 100.0 * ((np.abs(t - 2) < 0.05) | (np.abs(t - 2.2) < 0.05) | (np.abs(t - 7) < 0.05))
    assert bursts(t, u) == pytest.approx([1.951, 6.951], abs=1e-3)


def test_tone_finds_the_frequency():
    t = np.arange(0, 1, 0.001)
    assert tone(np.sin(2 * np.pi * 50 * t) + 10 * t, 0.001) == pytest.approx(50, abs=1.1)


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=300), st.floats(1e-3, 10))
def test_thinned_curves_stay_within_the_tolerance_and_keep_their_peaks(y, tolerance):
    y = np.array(y)
    x = np.arange(len(y), dtype=float)
    kept = thinned(x, y, tolerance)
    assert kept[0] == 0
    assert kept[-1] == len(y) - 1
    assert np.all(np.diff(kept) > 0)
    slack = tolerance + 1e-9
    assert np.max(np.abs(np.interp(x, kept, y[kept]) - y)) <= slack
    assert y[kept].max() >= y.max() - slack
    assert y[kept].min() <= y.min() + slack


def test_verdicts_follow_from_their_parts():
    assert judge(True) is judge(True, True) is Verdict.HOLDS
    assert judge(True, False) is Verdict.REMARK
    assert judge(False, True) is judge(False, False) is Verdict.FAILS


@pytest.mark.parametrize(
    ("x", "text"),
    [
        (0.0, "0"),
        (3.0, "3"),
        (-0.0019638, "−0.001964"),
        (9.81e-4, "9.810 · 10⁻⁴"),
        (-200601.0, "−200601"),
        (1.41e6, "1.410 · 10⁶"),
        (math.nan, "never"),
        (118, "118"),
    ],
)
def test_numbers_are_human_readable(x, text):
    assert number(x) == text
