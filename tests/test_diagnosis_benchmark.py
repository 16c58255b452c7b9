"""The benchmark of diagnoses: right scores, and a seeded part of it for real."""

import math
from dataclasses import replace

import pytest

from diagnosis_cases import name_nothing
from sgms_bench.diagnosis.axes import DrawnAxis
from sgms_bench.diagnosis.causes import Hidden
from sgms_bench.diagnosis.draws import Draw, simulate_draw
from sgms_bench.diagnosis.faults import FAULTS
from sgms_bench.diagnosis.running import diagnose_draw, run_draw
from sgms_bench.diagnosis.scoring import is_confidently_wrong, outcome, parameter_errors
from sgms_mhe.logfiles.plausibility import check_plausible
from sgms_mhe.machine import Machine
from sgms_mhe.support.errors import ImplausibleError


def drawn(kind: str, *names: str, size: float = 0.2) -> Draw:
    hidden = tuple(Hidden(name, {"force_N": 0.5} if name == "constant_offset" else {}, size=size) for name in names)
    return Draw(0, kind, DrawnAxis("linear", False, "sgms"), hidden, {}, "workout", 10.0, 1, 0.1, 0.0, 1e-9, 1)


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_seen_before_anything_is_fitted(machine: Machine, name: str) -> None:
    log, _ = simulate_draw(machine, replace(drawn("fault", name), seconds=3.0))
    with pytest.raises(ImplausibleError):
        check_plausible(log, machine)


# --- runs -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "index", "kind", "hidden", "right"),
    [
        (21, 7, "single", ("periodic_disturbance",), {"named"}),  # of an axis whose elements slip at once
        (21, 35, "single", ("quadratic_drag",), {"named", "ambiguous"}),  # of one that turns
        # A number of the machine beside a curve of any shape is a part of it, and no cause of its own.
        (211, 96, "unmodelled", ("log_of_speed",), {"named"}),
        (21, 33, "fault", ("position_of_other_sign",), {"right"}),
        (21, 39, "weak", ("eddy_current_damping",), {"right"}),
    ],
)
def test_part_of_the_benchmark(
    machine: Machine, seed: int, index: int, kind: str, hidden: tuple[str, ...], right: set[str]
) -> None:
    """A few draws for real: what is hidden is found with its numbers, what is not is not named."""
    draw, found = run_draw(machine, seed, index)
    assert (draw.kind, tuple(h.name for h in draw.hidden)) == (kind, hidden)
    assert outcome(draw, found) in right, (draw, found)
    assert not is_confidently_wrong(draw, found)
    if kind in ("single", "double", "base"):
        errors = parameter_errors(machine, draw, found)
        assert errors
        assert all(abs(e.relative) < 0.1 for e in errors), errors
        assert all(abs(e.error) < 4.0 * e.std for e in errors if math.isfinite(e.std)), errors
    if kind not in ("unmodelled", "fault"):
        # Down to the noise, under either law.
        assert found.held_out_after_N < 1.3 * found.noise_floor_N


@pytest.mark.slow
def test_two_causes_that_differ_by_less_than_matters_are_not_told_apart(machine: Machine) -> None:
    """A force 0.75 samples early, for which a lag leaves less, by t = 2.5 and more."""
    draw, found = run_draw(machine, 307, 4)
    assert [h.name for h in draw.hidden] == ["force_delay"]
    assert outcome(draw, found) in ("named", "ambiguous"), found


@pytest.mark.slow
def test_what_other_numbers_explain_is_not_adequate(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with a level that is wrong, where no cause is found: as it is it leaves 24 noise floors."""
    name_nothing(monkeypatch)
    draw, found = run_draw(machine, 105, 219)
    assert draw.truth == ("asymmetric_coulomb",)
    assert not found.names
    assert found.verdict == "unexplained", found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "index", "style", "hidden", "listed"),
    [
        # At one speed what comes again in time comes again in place.
        (77, 79, "crawl", "periodic_disturbance", {"periodic_disturbance", "force_ripple"}),
        # In one direction a level that is asymmetric is a level that is wrong; one fold holds what tells some numbers.
        (105, 219, "one_way", "asymmetric_coulomb", {"coulomb", "asymmetric_coulomb"}),
        (101, 239, "crawl", "force_constant_ripple", {"force_constant_ripple", "position_map"}),
    ],
)
def test_what_the_motion_makes_one_is_ambiguous(
    machine: Machine, seed: int, index: int, style: str, hidden: str, listed: set[str]
) -> None:
    draw, found = run_draw(machine, seed, index)
    assert (draw.style, draw.truth) == (style, (hidden,))
    assert found.verdict == "ambiguous", found
    assert listed <= {*found.names, *(name for name, _ in found.rivals)}
    assert found.has_experiment
    assert outcome(draw, found) == "right"


@pytest.mark.slow
def test_no_number_is_wrong_that_is_within_its_interval(machine: Machine) -> None:
    """Of a Stribeck effect the ratio is not known: with the file's the velocity is the file's too."""
    draw, found = run_draw(machine, 112, 50)
    assert draw.truth == ("micro_viscous",)
    assert (found.verdict, found.names) == ("explained", ("micro_viscous",)), found


@pytest.mark.slow
def test_what_is_known_to_look_alike_is_tried_where_a_derivative_tells_half(machine: Machine) -> None:
    """Beside a lag and an asymmetry the derivative of a friction that grows with the load has 0.65 of its gain."""
    draw = Draw(
        index=0,
        kind="triple",
        axis=DrawnAxis(kind="rotary", other_law=False, obeys="maxwell_slip"),
        hidden=(
            Hidden("asymmetric_viscous", {"difference_N_s_m": 0.3279551293968889}),
            Hidden("load_dependent_friction", {"ratio": 0.00785262763469043, "rise_ratio": 0.0}),
            Hidden("frictional_lag", {"time_constant_s": 0.005117992735122358}),
        ),
        machine_changes={"name": "specimen", "friction": {"stribeck_ratio": 0.4}},
        style="dies",
        seconds=13.713658464656962,
        motion_seed=805357180,
        force_noise_N=0.09561954679553064,
        encoder_noise_m=2.794347832918605e-10,
        encoder_resolution_m=1.1608982055278733e-09,
        noise_seed=470065265,
    )
    found = diagnose_draw(machine, draw)
    assert found.verdict == "ambiguous", found
    assert {"load_dependent_friction", "drive_efficiency"} <= {*found.names, *(name for name, _ in found.rivals)}
