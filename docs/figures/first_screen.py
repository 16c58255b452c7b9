"""The picture of the README: an axis, what the estimator makes of its log, what the diagnosis says of it.

    make picture

makes what it is drawn from (FOLDER: log.csv, estimates.csv, diagnosis/report.html) by the project's commands, and runs

    python docs/figures/first_screen.py FOLDER
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import FancyArrowPatch, Rectangle
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

OUT = Path(__file__).with_name("first_screen.png")
SIZE_IN, DPI = (12.0, 4.6), 120
MEASURED, ESTIMATED, BAND, TRUE = "0.6", "#0b5394", "#9fc5e8", "#b45f06"
STEEL, GROUND = "#d9e2ec", "#627d98"
ELEMENTS = 4
NOMINAL_N_m, TRUE_RATIO = 120e3, 1.2
"""First stiffness of machines/etel_xy.toml, and what `make picture` scales the simulated axis's by."""
REPORT_PX = (760, 900)
SHOWN_s = (1.0, 4.0)


def draw_axis(axes: Axes) -> None:
    """A carriage on its rail, driven, held back by springs that slide."""
    axes.add_patch(Rectangle((0.0, 0.0), 10.4, 0.35, color=GROUND))
    axes.add_patch(Rectangle((5.4, 0.75), 3.2, 2.0, facecolor=STEEL, edgecolor=GROUND, linewidth=1.5))
    axes.add_patch(Rectangle((5.7, 0.35), 0.5, 0.4, color=GROUND))
    axes.add_patch(Rectangle((7.8, 0.35), 0.5, 0.4, color=GROUND))
    axes.text(7.0, 1.75, "mass m", ha="center", va="center")
    axes.add_patch(Rectangle((0.0, 0.0), 0.3, 5.0, color=GROUND))
    for i in range(ELEMENTS):
        height = 0.95 + 0.52 * i
        axes.add_patch(
            Rectangle((0.8, height - 0.16), 0.9, 0.32, facecolor="white", edgecolor=ESTIMATED, linewidth=1.2)
        )
        axes.plot([0.3, 0.8], [height, height], color=ESTIMATED, linewidth=1.2)
        x = np.linspace(2.2, 4.6, 17)
        wave = height + 0.15 * np.array([0, 0, *([1, -1] * 6), 1, 0, 0])
        axes.plot([1.7, *x, 5.4], [height, *wave, height], color=ESTIMATED, linewidth=1.2)
    axes.text(3.1, 3.25, "friction: elements that\nstick, then slide", ha="center", va="bottom", color=ESTIMATED)
    for start, end, height, text in ((8.6, 10.2, 1.75, "force u"), (6.2, 7.8, 3.05, "position q")):
        arrow = FancyArrowPatch((start, height), (end, height), arrowstyle="-|>", mutation_scale=14, color="black")
        axes.add_patch(arrow)
        axes.text(0.5 * (start + end) + 0.1, height + 0.15, text, ha="center", va="bottom")
    axes.set(xlim=(-0.1, 10.6), ylim=(-0.1, 5.1), aspect="equal")
    axes.axis("off")


def draw_log(axes: Axes, log: pd.DataFrame) -> None:
    """Position over time, as it was logged."""
    shown = log[::20]
    axes.plot(shown["time_s"], 1e3 * shown["position_m"], color=GROUND, linewidth=1.2)
    axes.set(xlabel="time [s]", ylabel="position [mm]")


def draw_friction(axes: Axes, estimates: pd.DataFrame) -> None:
    """Friction measured and estimated over a few moves."""
    shown = estimates[estimates["time_s"].between(*SHOWN_s)]
    axes.plot(shown["time_s"], shown["friction_measured_N"], color=MEASURED, linewidth=2.4, label="measured")
    axes.plot(shown["time_s"], shown["friction_N"], color=ESTIMATED, linewidth=1.0, label="estimated")
    axes.set(ylabel="friction [N]")
    axes.legend(loc="upper right", frameon=False, fontsize=8)


def draw_stiffness(axes: Axes, estimates: pd.DataFrame) -> None:
    """First stiffness over nominal, with two standard deviations, and the simulated axis's own."""
    time_s = estimates["time_s"]
    ratio, std = (estimates[name] / NOMINAL_N_m for name in ("stiffness_1", "std_stiffness_1"))
    axes.fill_between(time_s, ratio - 2.0 * std, ratio + 2.0 * std, color=BAND, linewidth=0, label="$\\pm 2\\sigma$")
    axes.plot(time_s, ratio, color=ESTIMATED, linewidth=1.2, label="estimate")
    axes.axhline(TRUE_RATIO, color=TRUE, linestyle="--", linewidth=1.0, label="true")
    axes.set(xlabel="time [s]", ylabel="stiffness 1\nover nominal", ylim=(0.4, 1.8))
    axes.legend(loc="lower right", frameon=False, fontsize=8, ncols=3)


def screenshot(page: Path) -> np.ndarray:
    """The first screen of a page, pixels of red, green, blue.

    Raises:
        SystemExit: there is no browser.
    """
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or driver is None:
        raise SystemExit("make picture: chromium and chromedriver are needed to show the report")
    with tempfile.TemporaryDirectory() as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = browser
        width, height = REPORT_PX
        for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run"):
            options.add_argument(flag)
        options.add_argument(f"--user-data-dir={profile}")
        shown = webdriver.Chrome(options=options, service=Service(driver))
        try:
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            shown.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            shown.get(page.resolve().as_uri())
            return np.asarray(imread(BytesIO(shown.get_screenshot_as_png())))
        finally:
            shown.quit()


def main(folder: Path) -> None:
    """Draw the picture from what the commands wrote."""
    estimates = pd.read_csv(folder / "estimates.csv")
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subfigures(1, 3, width_ratios=(1.0, 1.15, 1.05))
    for part, title in ((left, "The axis and its log"), (middle, "The estimate"), (right, "The report")):
        part.suptitle(title, fontsize=12, fontweight="bold")
    above, below = left.subplots(2, 1, height_ratios=(1.2, 1.0))
    draw_axis(above)
    draw_log(below, pd.read_csv(folder / "log.csv"))
    above, below = middle.subplots(2, 1)
    draw_friction(above, estimates)
    draw_stiffness(below, estimates)
    shown = right.subplots()
    shown.imshow(screenshot(folder / "diagnosis" / "report.html"), interpolation="lanczos")
    shown.set(xticks=[], yticks=[])
    figure.savefig(OUT, metadata={"Software": None})


if __name__ == "__main__":
    with rc_context({"font.size": 9}):
        main(Path(sys.argv[1]))
