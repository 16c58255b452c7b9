"""Worked examples: notebooks are what their scripts give, and run from the first cell to the last."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import nbformat
import pytest
import scipy.io

import sgms_mhe

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "notebooks"
NAMES = ("compensation", "measured_axis", "own_axis", "own_effect")


@pytest.fixture(scope="module")
def percent() -> ModuleType:
    spec = importlib.util.spec_from_file_location("percent", ROOT / "docs" / "site" / "percent.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def played(percent: ModuleType, name: str, folder: Path, **environment: str) -> str:
    """Run a notebook in a folder of its own; return what it prints, which its page shows."""
    script, ran = FOLDER / f"{name}.py", folder / f"{name}.ipynb"
    path = os.pathsep.join(filter(None, [str(ROOT / "generator"), os.environ.get("PYTHONPATH")]))
    nbformat.write(percent.run(script, folder, {"PYTHONPATH": path} | environment), ran)
    page, figures = percent.page(script, ran)
    assert figures and all(f"]({image})" in page for image in figures)
    assert all(content.startswith(b"\x89PNG") for content in figures.values())
    book = nbformat.read(ran, as_version=4)
    outputs = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    said = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stdout")
    assert all(line in page for line in said.splitlines())
    return said


def number(pattern: str, said: str) -> float:
    """The number that stands where the pattern has its group."""
    found = re.search(pattern, said)
    assert found, f"{pattern} is not in\n{said}"
    return float(found[1])


# --- scripts and notebooks ------------------------------------------------------------------------------------------


def test_notebooks_are_found() -> None:
    assert sorted(path.name for path in FOLDER.iterdir() if not path.name.startswith("__")) == sorted(
        f"{name}{suffix}" for name in NAMES for suffix in (".py", ".ipynb")
    )


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_what_its_script_gives(name: str, percent: ModuleType) -> None:
    script = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    stored = (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    assert stored == percent.notebook(script), "make notebooks"
    book = nbformat.reads(stored, as_version=4)
    nbformat.validate(book)
    assert all(cell.outputs == [] and cell.execution_count is None for cell in book.cells if cell.cell_type == "code")
    # Every line of the script is in the notebook, in its order.
    lines = [line for line in script.splitlines() if line and not line.startswith("# %%")]
    given = [
        f"# {line}".rstrip() if cell.cell_type == "markdown" else line
        for cell in book.cells
        for line in cell.source.splitlines()
    ]
    assert [line for line in given if line] == lines


@pytest.mark.parametrize("name", NAMES)
def test_links_of_a_script_lead_to_pages(name: str) -> None:
    script = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", script)
    assert all((FOLDER / link).is_file() for link in links)


# --- run ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_own_axis_finds_the_ripple_that_it_hides(percent: ModuleType, tmp_path: Path) -> None:
    said = played(percent, "own_axis", tmp_path)
    assert "\nexplained: " in said
    cause = said.partition("\nforce_ripple: ")[2]
    assert number(r"amplitude_N = (\S+)", cause) == pytest.approx(1.5, rel=0.05)
    assert number(r"pitch_m = (\S+)", cause) == pytest.approx(0.02, rel=0.01)
    assert number(r"with the cause: (\S+) N", said) < 0.1 * number(r"as believed: (\S+) N", said)
    extended = sgms_mhe.load(tmp_path / "extended.toml")
    assert [effect.name for effect in extended.effects] == ["force_ripple"]
    assert (tmp_path / "package" / f"{extended.name}.h").is_file()


@pytest.mark.slow
def test_measured_axis_on_a_stand_in_of_the_record(percent: ModuleType, tmp_path: Path) -> None:
    """A simulated axis with a ripple of the screw's pitch, in the layout of the record: what was hidden is found."""
    ripple = ("force_ripple", {"amplitude_N": 3.0, "pitch_m": 2.5e-3, "phase_rad": 0.3})
    log = sgms_mhe.simulate("emps", "long_mixed", duration_s=24.84, hidden_effects=[ripple], seed=2).log
    record = tmp_path / "DATA_EMPS.mat"
    columns = {"t": log.time_s, "qm": log.position_m, "vir": log.force_N / 35.15065188248547}
    scipy.io.savemat(record, {name: values[:, None] for name, values in columns.items()})
    said = played(percent, "measured_axis", tmp_path)
    assert f"{len(log.time_s)} samples at 1000 Hz" in said and "\nexplained: force_ripple" in said
    assert number(r"amplitude_N = (\S+),", said) == pytest.approx(3.0, rel=0.05)
    assert number(r"pitch_m = (\S+),", said) == pytest.approx(2.5e-3, rel=0.01)
    # The first half moves by two pitches, the second by 140: what the pitch is off by grows to half a ripple there.
    assert number(r"with its causes: (\S+) N", said) < 0.6 * number(r"published model: (\S+) N", said)


@pytest.mark.slow
def test_own_effect_is_installed_and_found(percent: ModuleType, tmp_path: Path) -> None:
    source, site = tmp_path / "magnetic_preload", tmp_path / "site"
    shutil.copytree(ROOT / "examples" / "magnetic_preload", source)  # an installer builds in the folder
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--target", str(site), str(source)], check=True, stderr=subprocess.DEVNULL)
    said = played(percent, "own_effect", tmp_path, PYTHONPATH=os.pathsep.join([str(site), str(ROOT / "generator")]))
    assert "add_force" in said and "\nexplained: magnetic_preload" in said
    cause = said.partition("\nmagnetic_preload: ")[2]
    assert number(r"force_N = (\S+)", cause) == pytest.approx(1.5, rel=0.05)
    assert number(r"reach_m = (\S+)", cause) == pytest.approx(0.001, rel=0.05)
    assert "magnetic_preload" in said.splitlines()[-1]


@pytest.mark.slow
def test_compensation_beats_static_feed_forward(percent: ModuleType, tmp_path: Path) -> None:
    said = played(percent, "compensation", tmp_path)
    for row in ("circle, x", "circle, y", "circle, contour"):
        shares = said.rpartition(f"\n{row}: ")[2].partition("\n")[0]
        static, mhe, true = (number(rf"{name} (\S+)%", shares) for name in ("static", "MHE", "true friction"))
        assert true < mhe < 10.0 < 50.0 < static
