"""What the diagnosis says about a few logs of its benchmark, as recorded in recorded/verdicts.json.

    python tests/test_recorded_verdicts.py --update    record what it says now, and print what has changed

A draw stands there as it was drawn, so that its log stays the same whatever becomes of the drawing. Verdict and names
have to be the recorded ones; numbers may be apart by what another processor's numerical libraries make of them.
"""

import json
import math
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from sgms_bench.diagnosis.draws import Draw, machine_of, make_draw, simulate_draw
from sgms_mhe.configuration import load_machine
from sgms_mhe.diagnosis import Diagnosis, diagnose
from statement_cases import check_outputs

RECORDED = Path(__file__).parent / "recorded" / "verdicts.json"
UPDATE = "python tests/test_recorded_verdicts.py --update"
MACHINE = "etel_xy"
SEED = 21
DRAWS = (1, 8, 11, 12, 19, 20, 23, 34)
"""Nothing, a force outside the catalogue, two effects, one that the log of a turning axis cannot tell from another, an
axis at rest, an effect on an axis that switches, wrong stiffnesses, a wrong level."""
# With vector instructions switched off, an older processor's BLAS and another compiler, the differences are 0.003, 0.01
# and 0.003: the simulated encoder rounds, so that a last digit may become a whole step.
OF_STD = 0.02
"""Difference of a parameter, over its standard deviation."""
OF_A_STD = 0.03
"""Relative difference of a standard deviation, which hangs on the residual's spectrum."""
OF_A_GAIN = 0.03
"""Relative difference of what a cause explains. The fit without it ends where its rough sum of squares lets it: with
eight numbers to a vector instead of four, 0.012."""
RELATIVE = 0.01
"""Relative difference of everything else."""
OF_ITS_OWN = {"std": OF_A_STD, "gain_N": OF_A_GAIN}


def recorded() -> dict[str, Any]:
    """Draws and what was found in them, by index."""
    content: dict[str, Any] = json.loads(RECORDED.read_text(encoding="utf-8")) if RECORDED.is_file() else {}
    return content


def rounded(value: Any) -> Any:
    """Six digits of every number; NaN, which JSON does not know, as null."""
    if isinstance(value, Mapping):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def said(diagnosis: Diagnosis) -> dict[str, Any]:
    """What is recorded of a diagnosis."""
    return {
        "verdict": diagnosis.verdict,
        "causes": {
            cause.name: {
                "parameters": rounded(cause.parameters),
                "std": rounded(cause.std),
                "gain_N": rounded(cause.gain_N),
            }
            for cause in diagnosis.causes
        },
        "rivals": sorted(a.name for a in diagnosis.alternatives if a.rival),
        "law": diagnosis.law,
        "noise_floor_N": rounded(diagnosis.noise_floor_N),
        "residual_before_N": rounded(diagnosis.rms.held_out_before),
        "residual_after_N": rounded(diagnosis.rms.held_out_after),
    }


def differences(before: Any, after: Any, where: str = "", relative: float = RELATIVE) -> Iterator[str]:
    """What is not the same, each as a line; parameters are compared in terms of their standard deviations."""
    if isinstance(before, list | tuple) and isinstance(after, list | tuple):
        before, after = ({str(k): entry for k, entry in enumerate(side)} for side in (before, after))
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in [*before, *(after.keys() - before.keys())]:
            place = f"{where}.{key}" if where else key
            if key not in before or key not in after:
                yield f"{place}: {'not recorded' if key not in before else 'no longer there'}"
            elif key == "parameters" and "std" in before:
                for name, value in before[key].items():
                    std, now = before["std"][name], after[key].get(name, math.nan)
                    room = OF_STD * std if std is not None else relative * abs(value)
                    if not abs(now - value) <= room:
                        yield f"{place}.{name}: {value} +- {std}, now {now}"
            else:
                yield from differences(before[key], after[key], place, OF_ITS_OWN.get(key, relative))
    elif isinstance(before, float) and isinstance(after, float):
        if not math.isclose(before, after, rel_tol=relative):
            yield f"{where}: {before}, now {after}"
    elif before != after:
        yield f"{where}: {before}, now {after}"


@cache
def examine(index: int) -> Diagnosis:
    """Diagnose the log of a recorded draw."""
    machine, draw = load_machine(MACHINE), Draw.from_json(recorded()[str(index)]["draw"])
    return diagnose(machine_of(machine, draw), simulate_draw(machine, draw)[0])


@pytest.mark.parametrize("index", DRAWS)
def test_verdict_is_the_recorded_one(index: int) -> None:
    entry = recorded()[str(index)]
    changed = list(differences(entry["found"], said(examine(index))))
    if changed:
        pytest.fail("\n".join([f"draw {index}:", *changed, f"if this is meant: {UPDATE}"]), pytrace=False)


@pytest.mark.parametrize("index", DRAWS)
def test_no_output_of_it_contradicts_another(index: int, tmp_path: Path) -> None:
    check_outputs(examine(index), tmp_path)


@pytest.mark.parametrize("index", DRAWS)
def test_draw_is_the_recorded_one(index: int) -> None:
    """Otherwise a benchmark is no longer the one whose rates are known."""
    draw = make_draw(load_machine(MACHINE), SEED, index).to_json()
    assert not list(differences(recorded()[str(index)]["draw"], draw))


def test_every_kind_is_there() -> None:
    entries = recorded()
    assert entries.keys() == {str(index) for index in DRAWS}, UPDATE
    assert {entry["found"]["verdict"] for entry in entries.values()} == {
        "adequate", "explained", "ambiguous", "unexplained",
    }  # fmt: skip
    assert {entry["draw"]["kind"] for entry in entries.values()} == {
        "single", "base", "double", "clean", "unmodelled", "weak",
    }  # fmt: skip


def update() -> None:
    """Record what is drawn and found now, and print what has changed."""
    before, after = recorded(), {}
    for index in DRAWS:
        draw = make_draw(load_machine(MACHINE), SEED, index)
        found = diagnose(machine_of(load_machine(MACHINE), draw), simulate_draw(load_machine(MACHINE), draw)[0])
        after[str(index)] = {"draw": draw.to_json(), "found": said(found)}
        for line in differences(before.get(str(index), {}).get("found", {}), after[str(index)]["found"]):
            print(f"draw {index}: {line}")
    RECORDED.parent.mkdir(exist_ok=True)
    RECORDED.write_text(json.dumps(after, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(f"{RECORDED}: {len(after)} diagnoses")


if __name__ == "__main__":
    if sys.argv[1:] != ["--update"]:
        sys.exit(__doc__)
    update()
