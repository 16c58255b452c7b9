"""Reports as a browser shows them: wide and narrow, light and dark, nothing clipped, faint, fetched or wrong."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

import diagnosis_cases as cases
from browser import HIGH, WIDE, Browser, Mode
from sgms_mhe.configuration import load_machine
from sgms_mhe.evaluation.watching import RunSummary
from sgms_mhe.model import build_model
from sgms_mhe.report import (
    Band,
    FleetCourse,
    FleetLog,
    FleetPoint,
    NumberTrend,
    Watched,
    write_fleet_report,
    write_report,
    write_unread_page,
    write_watch_page,
)
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log

NARROW = 400
CONTRAST: Final = 4.5
"""Least contrast of text and its ground: AA of the Web Content Accessibility Guidelines."""
BADGES = {
    "certain explained": ("certain", "explained"),
    "certain adequate": ("certain", "adequate"),
    "adequate": ("limited", "adequate, with limits"),
    "explained": ("limited", "explained, with limits"),
    "ambiguous": ("undecided", "ambiguous"),
    "unexplained": ("failed", "unexplained"),
    "refused": ("failed", "no numbers"),
    "motionless": ("nothing", "not excited"),
    "rotary": ("undecided", "ambiguous"),
}
"""Class and words of each page's badge."""


@pytest.fixture(scope="module")
def browser(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    shown = Browser(require_tool("chromium"), require_tool("chromedriver"), tmp_path_factory.mktemp("profile"))
    yield shown
    shown.driver.quit()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of every verdict."""
    machine, rotary = load_machine("etel_xy"), load_machine("etel_xy_rotary")
    folder = tmp_path_factory.mktemp("reports")
    diagnoses = {name: getattr(cases, name)(machine) for name in BADGES if hasattr(cases, name)}
    diagnoses["rotary"] = cases.ambiguous(rotary)
    diagnoses |= {f"certain {name}": cases.certain(diagnoses[name]) for name in ("explained", "adequate")}
    written = {name: write_report(diagnosis, folder / name) for name, diagnosis in diagnoses.items()}
    sentence = f"axis.csv: column force_N = '-20 N per m/s^2': {'of the other sign ' * 12}[log] has scale = -1.0"
    written["refused"] = write_unread_page(folder / "r" / "report.html", sentence, negated_log(), {"file": "axis.csv"})
    assert set(written) == set(BADGES)
    return written


def negated_log() -> Log:
    shown = cases.traces()
    return Log(shown.time_s, shown.position_m, -shown.force_N, shown.rate, source="axis.csv")


ANY_PAGE = pytest.mark.parametrize("name", BADGES)
ANY_WIDTH = pytest.mark.parametrize("width", [WIDE, NARROW])
EITHER_MODE = pytest.mark.parametrize("mode", ["light", "dark"])


# --- layout ---------------------------------------------------------------------------------------------------------

BEYOND_THE_WINDOW = """
const wide = document.documentElement.clientWidth, found = [];
for (const e of document.body.querySelectorAll("*:not(text)")) {
  const r = e.getBoundingClientRect(), said = `${e.tagName} ${e.getAttribute("class")}: ${e.textContent.slice(0, 40)}`;
  if (r.width > 0 && (r.right > wide + 0.5 || r.left < -0.5)) found.push(`${r.left} to ${r.right}: ${said}`);
  const [inside, room] = [e.scrollWidth, e.clientWidth];
  if (room > 0 && inside > room + 1) found.push(`${inside} in ${room}: ${said}`);
}
return found;
"""

LABELS = """
return [...document.querySelectorAll(".stage svg")].map(svg => {
  const [x, y, width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
  const whole = svg.getBoundingClientRect();
  return { key: svg.parentElement.querySelector("canvas").dataset.plot, viewBox: [x, y, width, height],
    shown: [whole.width, whole.height],
    texts: [...svg.querySelectorAll("text")].map(t => { const r = t.getBoundingClientRect();
      return { text: t.textContent, kind: t.getAttribute("class"),
        box: [r.left - whole.left, r.top - whole.top, r.right - whole.left, r.bottom - whole.top] }; }) };
});
"""


@ANY_PAGE
@ANY_WIDTH
def test_nothing_is_wider_than_the_window(browser: Browser, pages: dict[str, Path], name: str, width: int) -> None:
    browser.show(pages[name], width)
    assert browser.ask("return document.documentElement.clientWidth") == width
    assert browser.ask(BEYOND_THE_WINDOW) == []


@ANY_PAGE
@ANY_WIDTH
def test_no_label_is_clipped_or_covered(browser: Browser, pages: dict[str, Path], name: str, width: int) -> None:
    browser.show(pages[name], width)
    plots = browser.ask(LABELS)
    assert len(plots) == len(browser.driver.find_elements(By.TAG_NAME, "canvas"))
    for plot in plots:
        left, top, wide, high = plot["viewBox"]
        assert [wide, high] == pytest.approx(plot["shown"], abs=1.0), plot["key"]
        kinds = [text["kind"] for text in plot["texts"]]
        assert kinds.count("axis") == 2 and "x tick" in kinds and "y tick" in kinds, plot["key"]
        for text in plot["texts"]:
            x0, y0, x1, y1 = text["box"]
            assert left - 0.5 <= x0 < x1 <= wide + 0.5 and top - 0.5 <= y0 < y1 <= high + 0.5, (plot["key"], text)
        for i, one in enumerate(plot["texts"]):
            assert not any(meet(one["box"], other["box"]) for other in plot["texts"][:i]), (plot["key"], one)


def meet(a: list[float], b: list[float]) -> bool:
    # Rows of text may touch: the box of a line is higher than its letters.
    return min(a[2], b[2]) - max(a[0], b[0]) > 0.5 and min(a[3], b[3]) - max(a[1], b[1]) > 3.0


# --- colours --------------------------------------------------------------------------------------------------------

TEXTS = """
const rgba = text => { const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number); return [r, g, b, a]; };
const over = ([r, g, b, a], [R, G, B]) => [r * a + R * (1 - a), g * a + G * (1 - a), b * a + B * (1 - a)];
const ground = e => {
  const layers = [];
  for (let n = e; n; n = n.parentElement) {
    const c = rgba(getComputedStyle(n).backgroundColor);
    if (c[3] > 0) layers.push(c);
    if (c[3] === 1) break;
  }
  return layers.reverse().reduce((below, layer) => over(layer, below), [255, 255, 255]);
};
const opacity = e => (e ? Number(getComputedStyle(e).opacity) * opacity(e.parentElement) : 1);
const found = new Map(), walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
for (let n = walk.nextNode(); n; n = walk.nextNode()) {
  const e = n.parentElement, style = getComputedStyle(e);
  if (!n.data.trim() || ["SCRIPT", "STYLE"].includes(e.tagName) || !e.getClientRects().length) continue;
  const ink = rgba(e.tagName === "text" ? style.fill : style.color), below = ground(e);
  const key = [e.tagName + "." + (e.getAttribute("class") || ""), ink, below].join(" ");
  const what = key + ": " + n.data.trim().slice(0, 40);
  found.set(key, { what, ink: over(ink, below), ground: below, opacity: opacity(e) });
}
return [...found.values()];
"""

# Where the page's curves are drawn in the colours of the mode: pixels of each role.
DRAWN = """
const style = getComputedStyle(document.documentElement);
const pixels = (canvas, role) => {
  const [r, g, b] = style.getPropertyValue("--" + role).trim().match(/[0-9a-f]{2}/g).map(v => parseInt(v, 16));
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {
    const off = Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b);
    if (data[i + 3] === 255 && off < 12) count++;
  }
  return count;
};
return Object.fromEntries([...document.querySelectorAll("canvas")].map(c => [c.dataset.plot,
  Object.fromEntries(["measured", "before", "after", "rival"].map(role => [role, pixels(c, role)]))]));
"""


def contrast(first: list[float], second: list[float]) -> float:
    """(L1 + 0.05) / (L2 + 0.05) of the relative luminances of two sRGB colours, 0 to 255."""

    def luminance(colour: list[float]) -> float:
        c = np.array(colour[:3]) / 255.0
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@ANY_PAGE
@EITHER_MODE
def test_text_stands_out_from_its_ground(browser: Browser, pages: dict[str, Path], name: str, mode: Mode) -> None:
    browser.show(pages[name], WIDE, mode)
    texts = browser.ask(TEXTS)
    assert len(texts) > 10
    for text in texts:
        assert text["opacity"] == 1.0, text["what"]
        assert contrast(text["ink"], text["ground"]) >= CONTRAST, text["what"]
    ground = browser.ask("return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (max(ground) < 64) == (mode == "dark")


def test_curves_take_the_colours_of_the_mode(browser: Browser, pages: dict[str, Path]) -> None:
    browser.show(pages["ambiguous"], WIDE, "light")
    light = browser.ask("return getComputedStyle(document.documentElement).getPropertyValue('--rival')")
    for mode in ("light", "dark"):  # the second one while the page is shown
        browser.prefer(mode)
        drawn = browser.ask(DRAWN)
        assert drawn["motion"]["measured"] > 100 and drawn["friction"]["after"] > 20
        assert drawn["residual"]["before"] > 100
        assert drawn["rival_1_residual"]["rival"] > 100
    assert browser.ask("return getComputedStyle(document.documentElement).getPropertyValue('--rival')") != light


# --- what stands where ----------------------------------------------------------------------------------------------


@ANY_PAGE
def test_badge_is_green_only_for_what_is_certain(browser: Browser, pages: dict[str, Path], name: str) -> None:
    browser.show(pages[name])
    badge = browser.driver.find_element(By.CLASS_NAME, "pill")
    kind, words = BADGES[name]
    assert badge.get_attribute("class") == f"pill {kind}"
    assert badge.text.split("\n")[-1].endswith(words)
    red, green, blue = browser.ask(
        "return getComputedStyle(arguments[0]).backgroundColor.match(/\\d+/g).map(Number)", badge
    )
    assert (green > 1.2 * max(red, blue)) == (kind == "certain")


@ANY_PAGE
@ANY_WIDTH
def test_limits_stand_before_all_that_was_found(
    browser: Browser, pages: dict[str, Path], name: str, width: int
) -> None:
    browser.show(pages[name], width)
    limits = browser.driver.find_elements(By.ID, "limits")
    assert bool(limits) == (BADGES[name][0] != "certain")
    if not limits:
        return
    # On the first screen, and above key figures, causes and plots.
    top = limits[0].rect["y"]
    assert top < HIGH - 200
    found = browser.driver.find_elements(By.CSS_SELECTOR, ".tile, .cause, .rival-fit, .plot, .next")
    assert found and all(element.rect["y"] >= top + limits[0].rect["height"] for element in found)


def test_every_rival_has_its_fit_and_its_views(browser: Browser, pages: dict[str, Path]) -> None:
    browser.show(pages["ambiguous"])
    (rival,) = browser.driver.find_elements(By.CSS_SELECTOR, ".rival-fit")
    keys = [canvas.get_attribute("data-plot") for canvas in rival.find_elements(By.TAG_NAME, "canvas")]
    coordinates = ("velocity", "position", "acceleration", "time", "after_reversal", "frequency")
    # What the rival gets wrong follows the direction: that view comes first.
    assert keys[:2] == ["rival_1_residual", "rival_1_velocity"]
    assert set(keys) == {f"rival_1_{key}" for key in ("residual", *coordinates)}
    drawn = browser.ask(DRAWN)
    assert all(drawn[key]["rival"] > 20 for key in keys)


def test_a_curve_is_hidden_by_its_name_and_a_view_zoomed_by_its_keys(browser: Browser, pages: dict[str, Path]) -> None:
    browser.show(pages["ambiguous"])
    canvas = browser.driver.find_element(By.CSS_SELECTOR, "canvas[data-plot=residual]")
    plot = canvas.find_element(By.XPATH, "ancestor::div[contains(@class, 'plot')]")
    before = browser.ask(DRAWN)["residual"]["before"]
    button = next(b for b in plot.find_elements(By.TAG_NAME, "button") if "machine file" in b.text)
    button.click()
    browser.settle()
    assert browser.ask(DRAWN)["residual"]["before"] < 0.05 * before
    assert button.get_attribute("aria-pressed") == "false"

    def last_tick() -> float:
        ticks = plot.find_elements(By.CSS_SELECTOR, "text[class='x tick']")
        return float(ticks[-1].text.replace("−", "-"))

    whole = last_tick()
    canvas.send_keys("+")
    browser.settle()
    assert last_tick() < whole
    reset = plot.find_element(By.CLASS_NAME, "reset")
    assert reset.is_displayed()
    reset.click()
    browser.settle()
    assert last_tick() == whole and not reset.is_displayed()


# --- alone ----------------------------------------------------------------------------------------------------------


@ANY_PAGE
def test_page_asks_for_nothing_and_complains_of_nothing(browser: Browser, pages: dict[str, Path], name: str) -> None:
    browser.requests(), browser.complaints()
    browser.show(pages[name], NARROW, "dark")
    assert browser.requests() == [pages[name].as_uri()]
    assert browser.complaints() == []


# --- the page over a fleet ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Axes with and without a past; some stand out; long names, and a row that failed."""

    def point(k: int, value: float) -> FleetPoint:
        return FleetPoint(f"log{k}", 1e6 * k, f"2026-0{k + 1}-01", value, 0.05, Band(3.8, 4.2, "own", 5))

    courses = [
        FleetCourse("an_axis_of_a_long_name" * 3, "m", "linear", "coulomb", 4.0, (point(0, 4.0),)),
        FleetCourse("x", "m", "linear", "coulomb", 4.0, (point(0, 4.1), point(1, 9.0))),
        FleetCourse("x", "m", "linear", "force_ripple.amplitude_N", float("nan"), (point(0, 4.1),)),
        FleetCourse(
            "y",
            "m",
            "linear",
            "coulomb",
            4.0,
            tuple(point(k, 4.0 + 0.02 * k) for k in range(6)),
            NumberTrend(0.1, 0.01, 150.0, 6),
        ),
    ]
    logs = [
        FleetLog("log0", "x", "2026-01-01", "m", "good", "certain", "done", "", ""),
        FleetLog(
            "absent", "z" * 60, "", "m", "", "nothing", "", f"/{'folder/' * 30}absent.csv: a file that can be read", ""
        ),
    ]
    return write_fleet_report("estimate", "table.csv", logs, courses, tmp_path_factory.mktemp("fleet"))


@ANY_WIDTH
@EITHER_MODE
def test_fleet_fits_the_window_and_can_be_read(browser: Browser, fleet: Path, width: int, mode: Mode) -> None:
    browser.show(fleet, width, mode)
    browser.requests(), browser.complaints()
    browser.show(fleet, width, mode)
    assert browser.requests() == [fleet.as_uri()]
    assert browser.complaints() == []
    assert browser.ask(BEYOND_THE_WINDOW) == []
    for text in browser.ask(TEXTS):
        if not text["what"].startswith("text"):  # of a drawing: coloured by `fill`
            assert contrast(text["ink"], text["ground"]) >= CONTRAST, text["what"]


OUTSIDE_OF_ITS_DRAWING = """
return [...document.querySelectorAll("svg.course")].flatMap(svg => {
  const whole = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("text, circle, rect, line")].map(t => [t, t.getBoundingClientRect()])
    .filter(([, r]) => r.left < whole.left - 1 || r.right > whole.right + 1 || r.top < whole.top - 1 ||
      r.bottom > whole.bottom + 1).map(([t]) => t.outerHTML);
});
"""


@ANY_WIDTH
def test_nothing_is_drawn_outside_of_a_drawing(browser: Browser, fleet: Path, width: int) -> None:
    browser.show(fleet, width)
    assert len(browser.driver.find_elements(By.CSS_SELECTOR, "svg.course")) == 3
    assert browser.ask(OUTSIDE_OF_ITS_DRAWING) == []
    headings = [e.text for e in browser.driver.find_elements(By.TAG_NAME, "h2")]
    assert headings[:2] == ["What failed", "What stands out"]
    said = browser.driver.find_element(By.TAG_NAME, "main").text
    assert "Moves steadily: " in said and "0.100 +- 0.020 N" in said and "Left its band: " in said


# --- the page over a run --------------------------------------------------------------------------------------------


def course(updates: int) -> RunSummary:
    """A run with a stretch in doubt, samples missing and an update that was refused, where it is long enough."""
    machine = load_machine("etel_xy")
    model, k = build_model(machine), np.arange(updates)
    status = np.select([k % 500 == 400, (k % 500 > 300) & (k % 500 < 380), k % 500 == 250, k < 20], [-2, 64, 2, 1], 0)
    wave, n_p = np.sin(k / 30.0), len(model.parameters)
    nominal = np.array([p.nominal for p in model.parameters])
    run = RunSummary(machine, model)
    run.add(
        Estimates(
            time_s=0.01 * (k + 1),
            friction_measured_N=4.0 * wave + 0.1,
            friction_N=4.0 * wave,
            z_m=np.zeros((updates, model.n_z)),
            parameters=nominal * (1.0 + 0.1 * wave[:, None]),
            std=nominal * (0.02 + 0.4 * np.exp(-k / 50.0))[:, None],
            status=status.astype(np.int64),
            innovation_N=0.1 * wave,
            test_ratio=np.where(status == 64, 40.0, 0.5 + wave**2),
            noise_scale=np.ones(updates),
            parameter_names=tuple(p.column for p in model.parameters),
        )
    )
    assert len(run.names) == n_p
    return run


RUNS = {
    "one update": (1, "", ()),
    "live": (300, "", ()),
    "long, live": (9000, "", ("axis.csv, 0 to 20 s: column force_N: of the other sign " * 4,)),
    "ended": (9000, "no new line for 10 s", ()),
}
"""Updates, why it ended, remarks."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    written = {name: folder / f"{name}.html" for name in RUNS}
    for name, (updates, ended, remarks) in RUNS.items():
        write_watch_page(written[name], Watched(course(updates), f"a/{'long/' * 20}path.csv", ended, remarks))
    return written


@pytest.mark.parametrize("name", RUNS)
@ANY_WIDTH
@EITHER_MODE
def test_a_run_fits_the_window_and_can_be_read(
    browser: Browser, runs: dict[str, Path], name: str, width: int, mode: Mode
) -> None:
    browser.requests(), browser.complaints()
    browser.show(runs[name], width, mode)
    assert set(browser.requests()) == {runs[name].as_uri()}
    assert browser.complaints() == []
    assert browser.ask(BEYOND_THE_WINDOW) == []
    for text in browser.ask(TEXTS):
        assert contrast(text["ink"], text["ground"]) >= CONTRAST, text["what"]
    for plot in browser.ask(LABELS):
        for i, one in enumerate(plot["texts"]):
            assert not any(meet(one["box"], other["box"]) for other in plot["texts"][:i]), (plot["key"], one)
    if name != "one update":
        drawn = browser.ask(DRAWN)
        assert (
            drawn["parameter_0"]["after"] > 200 and min(drawn["friction"][role] for role in ("before", "after")) > 50
        ), drawn


def test_a_live_page_reads_itself_anew_and_the_last_one_stays(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "live.html"
    write_watch_page(path, Watched(course(300), "log.csv", ""))
    browser.show(path)
    assert browser.driver.find_element(By.CLASS_NAME, "pill").text.endswith("live: good")
    write_watch_page(path, Watched(course(301), "log.csv", "end of the log"))

    def last(driver: webdriver.Chrome) -> bool:
        return "ended" in str(driver.execute_script("return document.querySelector('.pill').textContent"))

    WebDriverWait(browser.driver, 120.0).until(last)
    assert "301 updates" in browser.driver.find_element(By.TAG_NAME, "main").text
