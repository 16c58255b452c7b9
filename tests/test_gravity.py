"""Identification of axes that carry a load: gravity, springs, friction that the load raises; and what no motion tells.

The plant is written here, a few lines that share nothing with the project's own simulator.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_cases import done
from sgms_mhe.identification import Identification, Wanted, description, final_fit, identify
from sgms_mhe.identification.final_fit import drop_idle_springs, drop_traces
from sgms_mhe.identification.fits import AxisFit, RecordView, Shape, fit_axis
from sgms_mhe.identification.identify import explore
from sgms_mhe.identification.search import Views, fit_aligned
from sgms_mhe.identification.terms import (
    LAW_AND_SAMPLING,
    Term,
    companion_terms,
    is_friction,
    is_level,
    is_within_limits,
)
from sgms_mhe.signals.logs import Log, write_log

Array = NDArray[np.float64]
RATE = 500.0
SUBSTEPS = 20


@dataclass(frozen=True)
class Arm:
    """A geared joint that is held under PD: sizes over those of an arm of 1 N m of friction.

    Attributes:
        size: of all torques, and of the inertia.
        gravity: torque at a quarter turn from hanging.
        zero: angle of the encoder where it hangs.
        spring: torque per angle about 0.3 rad.
    held: constant torque, as of a weight on a rope.
    asymmetry: what the level has more forth, and less back, over it.
        load: friction over the torque at the mesh.
        share: of inertial torque and friction that the mesh carries beside the load.
        bearing: friction over the load alone.
        rise: friction added towards low speed, over it.
        slow: speed at which a third of that is left.
        inertia, level, viscous: of the joint.
        reach: largest angle, from 0.05 rad on.
    """

    size: float = 1.0
    gravity: float = 8.0
    zero: float = 0.0
    spring: float = 0.0
    held: float = 0.0
    asymmetry: float = 0.0
    load: float = 0.0
    share: float = 0.0
    bearing: float = 0.0
    rise: float = 0.0
    slow: float = 0.2
    inertia: float = 0.4
    level: float = 1.0
    viscous: float = 0.4
    reach: float = 2.2
    step: float = 2e-4

    def log(self, seed: int = 0, seconds: float = 30.0) -> Log:
        """Return the log of strokes at six speeds under PD with noise: elements that slip after 2 and 8 mrad."""
        random, h = np.random.default_rng(seed), 1.0 / RATE / SUBSTEPS
        speeds, way, turn = (0.6, 1.2, 2.5, 0.3, 0.1, 0.9), 1.0, 0
        q = w = torque = reference = pace = 0.0
        force = [0.0, 0.0]
        position, drive = np.empty(int(seconds * RATE)), np.empty(int(seconds * RATE))
        for k in range(len(position) * SUBSTEPS):
            pace += min(max(way * speeds[turn] - pace, -10.0 * h), 10.0 * h)
            reference += pace * h
            if (reference > self.reach and way > 0.0) or (reference < 0.05 and way < 0.0):
                way, turn = -way, (turn + (way < 0.0)) % len(speeds)
            if k % SUBSTEPS == 0:
                n = k // SUBSTEPS
                carried = self.gravity * math.sin(q - self.zero) + self.spring * (q - 0.3) + self.held
                torque = 400.0 * (reference - q) + 20.0 * (pace - w) + carried
                position[n] = round(q / self.step) * self.step
                drive[n] = torque + 0.02 * random.standard_normal()
            outside = self.gravity * math.sin(q - self.zero) + self.spring * (q - 0.3) + self.held
            shape = 1.0 + self.rise * math.exp(-((w / self.slow) ** 2))
            level = self.level * shape * (1.0 + self.asymmetry * math.copysign(1.0, w))
            level += self.load * abs(outside + self.share * (torque - outside)) + self.bearing * abs(outside)
            friction = self.viscous * w
            for i, (share, stiffness) in enumerate(((0.4, 200.0), (0.6, 75.0))):
                force[i] = min(
                    max(force[i] + stiffness * self.level * (1.0 + self.rise) * w * h, -share * level), share * level
                )
                friction += force[i]
            w += h * (torque - outside - friction) / self.inertia
            q += h * w
        time = np.arange(len(position)) / RATE
        return Log(time, position, self.size * drive, RATE, kind="rotary", source="arm.csv")


def within(found: Identification, name: str, truth: float, deviations: float = 3.0) -> None:
    """Check a number: determined, and as far from the truth as its deviation says, or 1 %."""
    number = found.number(name)
    assert number.determined, number
    assert abs(number.value - truth) <= max(deviations * number.std, 0.01 * abs(truth)), (number, truth)


# --- what stands beside friction ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Told:
    """Expected statements of an identification of an arm.

    Attributes:
        arm: whose size multiplies what is a torque.
        seed: of its noise.
        numbers: true, of an arm of size 1.
        deviations: that they may be off.
        only: its effects, all of them, which nothing else may stand for; None: others may be beside.
    """

    arm: Arm
    seed: int
    numbers: Mapping[str, float]
    deviations: float = 3.0
    only: Sequence[str] | None = None


OWN = {"mass": 0.4, "coulomb": 1.0, "viscous": 0.4}
HANGING = {"mass": 0.4, "unbalance.amplitude_N": 8.0}
LOADED = {"load_dependent_friction.ratio": 0.25, "load_dependent_friction.friction_ratio": 0.5}
TOLD = {
    # Gravity, whatever the size, and whatever angle the encoder counts from.
    "servo": Told(Arm(zero=0.7, size=0.02), 2, OWN | HANGING | {"unbalance.phase_rad": -0.7}, only=["unbalance"]),
    "gearbox": Told(
        Arm(gravity=25.0, size=300.0, step=1e-5),
        3,
        OWN | {"unbalance.amplitude_N": 25.0, "unbalance.phase_rad": 0.0},
        only=["unbalance"],
    ),
    "turn": Told(
        Arm(gravity=3.0, zero=-2.5, reach=5.5),
        4,
        OWN | {"unbalance.amplitude_N": 3.0, "unbalance.phase_rad": 2.5},
        only=["unbalance"],
    ),
    # Friction that drives less than it brakes looks like gravity: where the mesh is, the records tell.
    "mesh": Told(Arm(load=0.25, share=0.5), 1, HANGING | LOADED),
    # A file has one mesh: where several leave less on unseen rows, numbers are as sure as both agree, and stay.
    "several meshes": Told(Arm(load=0.3, share=1.0, bearing=0.15), 1, HANGING, 2.0),
    "spring": Told(
        Arm(gravity=0.0, spring=2.0, reach=3.0),
        1,
        {"position_spring.stiffness_N_m": 2.0, "coulomb": 1.0},
        only=["position_spring"],
    ),
    "nothing": Told(Arm(gravity=0.0), 1, {"coulomb": 1.0}, only=[]),
    # A spring that is none is no rival of either: its limit is an offset, and the travel would show it.
    "cable": Told(Arm(gravity=0.0, held=-0.4), 1, {"constant_offset.force_N": -0.4}, only=["constant_offset"]),
    "level of each direction": Told(
        Arm(asymmetry=-0.3, size=20.0), 1, {"asymmetric_coulomb.ratio": -0.3}, only=["asymmetric_coulomb", "unbalance"]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("told", TOLD.values(), ids=TOLD)
def test_what_acts_on_an_arm_is_identified_with_inertia_and_friction(told: Told) -> None:
    found = identify([told.arm.log(told.seed)], Wanted("arm", elements=2))
    for name, truth in told.numbers.items():
        if name.endswith("friction_ratio"):  # one of five that are tried
            assert found.number(name).value == truth
        else:
            size = 1.0 if name.endswith(("ratio", "_rad")) else told.arm.size
            within(found, name, size * truth, 4.0 if name.endswith("_rad") else told.deviations)
    if told.only is not None:
        assert sorted(effect["name"] for effect in found.machine.as_dict()["effects"]) == told.only
        assert {number.name.split(".")[0] for number in found.numbers if "." in number.name} == set(told.only)
        assert not any("ambiguous" in sentence for sentence in found.limits)


@pytest.mark.slow
def test_friction_that_the_load_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dry friction is judged without effects of its level: they hold the direction of motion, as elements do."""
    seen: list[list[str]] = []

    def note(view: RecordView, terms: Sequence[Term], start: Shape, *, iterations: int) -> AxisFit:
        seen.append([term.name for term in terms])
        return fit_axis(view, terms, start, iterations=iterations)

    monkeypatch.setattr(description, "fit_axis", note)
    arm = Arm(load=0.12)
    found = identify([arm.log(1)], Wanted("arm", elements=2))
    assert "unbalance" in seen[0] and "load_dependent_friction" not in seen[0]
    within(found, "mass", arm.inertia)  # which steps of the encoder made a quarter too small
    within(found, "unbalance.amplitude_N", arm.gravity)
    within(found, "coulomb", arm.level)
    within(found, "load_dependent_friction.ratio", arm.load)
    # A load adds to a level and not to its stiffness: elements break away later, where it is large.
    within(found, "stiffness_1", 200.0)
    within(found, "stiffness_2", 75.0)
    assert found.held_out_rms_N < 1.2 * found.noise_floor_N


@pytest.mark.slow
def test_friction_that_is_gone_at_high_speed_is_friction() -> None:
    """The rise towards low speed alone says where elements break away."""
    arm = Arm(level=0.002, rise=200.0, slow=0.8, gravity=2.0, viscous=0.2)
    found = identify([arm.log(1)], Wanted("arm", elements=2))
    within(found, "mass", arm.inertia)
    within(found, "unbalance.amplitude_N", arm.gravity)
    standing = found.number("coulomb").value * (1.0 + found.number("stribeck_ratio").value)
    assert abs(standing - arm.level * (1.0 + arm.rise)) < 0.1 * arm.level * arm.rise


def test_teeth_carry_all_friction_and_no_load() -> None:
    """Without the curve that takes friction away with speed, what is missing at the teeth was gravity and inertia."""
    names = ("viscous", "friction_curve", "load_dependent_friction", "mass", "late", "unbalance", "position_spring")
    assert [name for name in names if is_friction(Term(name, np.ones((3, 1))))] == list(names[:3])


@pytest.mark.slow
@pytest.mark.parametrize(("reach", "told"), [(0.9, False), (1.75, True)])
def test_below_a_quarter_turn_gravity_is_ambiguous(reach: float, told: bool, tmp_path: Path) -> None:
    """The number is given all the same, and the move that would tell; a little more than a quarter turn does."""
    write_log(tmp_path / "arm.npz", Arm(reach=reach).log(1))
    found = json.loads(
        done("identify", tmp_path / "arm.npz", "--out", tmp_path / "arm.toml", "--elements", "2", "--json").stdout
    )
    number = next(number for number in found["numbers"] if number["name"] == "unbalance.amplitude_Nm")
    assert number["value"] == pytest.approx(8.0, rel=0.02)
    assert number["identified"] == told
    sentences = [text for text in found["limits"] if text.startswith("unbalance: ambiguous")]
    assert len(sentences) == (not told)
    assert told or ("position_spring" in sentences[0] and "travel over a turn" in sentences[0])
    assert ("ambiguous: or position_spring" in (tmp_path / "arm.toml").read_text()) == (not told)
    assert '[[effects]]\nname = "unbalance"' in (tmp_path / "arm.toml").read_text()


# --- springs that may be none -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "stays", "seed"), [(25.0, False, 6), (2.0, True, 7)])
def test_an_element_that_never_slips_is_dropped_where_it_may_be_none(noise: float, stays: bool, seed: int) -> None:
    """Beside a spring it may be any, and the level of sliding with it; in the place of one that shows it stays."""
    found = explore([screw(300.0, noise, seed)], Wanted("screw", elements=1))
    views, fit = found.views, found.final.fit
    wider = _hand_over_spring(views.fine, fit, 1.0 if stays else 0.5)
    assert wider.levels[-1] > 0.1 * wider.coulomb
    left = drop_traces(views, wider)
    assert len(left.levels) == len(fit.levels) + stays
    assert stays or left.coulomb == pytest.approx(40.0, rel=0.03)


@pytest.mark.slow
def test_where_every_element_may_be_none_one_stays() -> None:
    """Of noise alone: that no friction shows is for a refusal to say."""
    view = explore([screw(0.0, 2.0, 3)], Wanted("screw", elements=1)).views.fine
    noise = np.random.default_rng(8).normal(size=len(view.rows.friction))
    alone = replace(view, rows=replace(view.rows, friction=noise))
    shape = Shape("switching", np.array([0.93, 0.97]) * view.rows.extents.travel, None)
    fit = fit_axis(alone, (Term("constant_offset", np.ones((len(noise), 1))),), shape, iterations=0)
    assert len(drop_traces(Views(alone, alone), fit).levels) == 1


def _hand_over_spring(view: RecordView, fit: AxisFit, share: float) -> AxisFit:
    """The fit, this share of its spring taken from it and given to an element of nearly the travel: noise does not."""
    spring = next(term for term in fit.terms if term.name == "position_spring")
    kept = spring.columns @ fit.coefficient("position_spring") * (1.0 - share)
    rows = replace(view.rows, friction=view.rows.friction - kept)
    constant = Term("constant_offset", np.ones((len(kept), 1)))
    terms = (*(term for term in fit.terms if term is not spring), constant)
    distances = np.append(fit.shape.distances, 0.95 * rows.extents.travel)
    shape = Shape(fit.shape.law, distances, fit.shape.rise)
    wider = fit_axis(replace(view, rows=rows), terms, shape, iterations=0)
    if share == 1.0:
        return wider
    force = Term("position_spring", kept[:, None])
    jacobian = np.column_stack((wider.jacobian, force.columns))
    return replace(
        wider,
        terms=(*terms, force),
        coefficients=np.append(wider.coefficients, 1.0),
        jacobian=jacobian,
        prior=np.append(wider.prior, 0.0),
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spring", "noise", "ripple", "seed"), [(0.0, 25.0, 0.0, 1), (0.0, 0.5, 3.0, 9), (300.0, 0.5, 3.0, 11)]
)
def test_a_spring_is_dropped_where_it_may_be_part_of_what_is_left(
    spring: float, noise: float, ripple: float, seed: int
) -> None:
    """A ripple at a few places is a spring by chance; so is noise; one that is larger than both stays."""
    found = explore([screw(spring, noise, seed, ripple)], Wanted("screw", elements=1))
    views, fit = found.views, found.final.fit
    term = next(term for term in companion_terms(views.fine.rows) if term.name == "position_spring")
    terms = tuple(term for term in fit.terms if term.name in LAW_AND_SAMPLING)
    left = drop_idle_springs(views, fit_axis(views.fine, (*terms, term), fit.shape))
    assert [term.name for term in left.terms[len(terms) :]] == (["position_spring"] if spring else [])


@pytest.mark.slow
@pytest.mark.parametrize(("pitch", "seed"), [(0.15, 1), (0.8, 3)])
def test_a_ripple_of_a_long_pitch_is_no_spring_for_certain(pitch: float, seed: int) -> None:
    """Over a travel of 0.28 m it is a straight line in part, of -17 to 21 N/m."""
    found = identify([screw(0.0, 1.0, seed, 3.0, pitch)], Wanted("screw", mass=30.0))
    springs = [number for number in found.numbers if number.name.startswith("position_spring.")]
    assert not any(number.determined for number in springs)
    assert all(number.note == "ambiguous: or force_ripple" for number in springs)


@pytest.mark.slow
def test_a_spring_beside_a_ripple_of_a_short_pitch_is_one() -> None:
    """Over five pitches and more a ripple has no straight line."""
    found = identify([screw(60.0, 1.0, 2, 3.0, 0.05)], Wanted("screw", mass=30.0))
    spring = next(number for number in found.numbers if number.name == "position_spring.stiffness_N_m")
    assert spring.determined
    assert spring.value == pytest.approx(60.0, abs=2.5 * spring.std)


def screw(spring: float, noise: float, seed: int, ripple: float = 0.0, pitch: float = 0.2) -> Log:
    """Return short production moves of a screw: 30 kg, 40 N, 120 N s/m, a spring [N/m], noise, a ripple [N]."""
    random, rate = np.random.default_rng(seed), 1000.0
    sample = np.arange(8000)
    time, k = sample / rate, sample // 800
    places = np.concatenate(([0.0], random.uniform(0.02, 0.3, 9), [0.1]))
    share = np.clip(sample % 800 / 600.0, 0.0, 1.0)
    smooth = share**4 * (35.0 - 84.0 * share + 70.0 * share**2 - 20.0 * share**3)
    position = places[k] + (places[k + 1] - places[k]) * smooth
    velocity = np.gradient(position, 1.0 / rate)
    stop, friction = 0.0, np.empty(len(time))
    for i, step in enumerate(np.diff(position, prepend=position[0])):
        stop = min(max(stop + 1e6 * step, -40.0), 40.0)
        friction[i] = stop
    force = 30.0 * np.gradient(velocity, 1.0 / rate) + 120.0 * velocity + friction + spring * (position - 0.15)
    force += ripple * np.sin(2.0 * np.pi * position / pitch)
    return Log(time, position, force + noise * random.standard_normal(len(time)), rate, source="screw.csv")


@pytest.mark.parametrize(("ratio", "stated"), [(0.3, True), (1.948, False)])
def test_an_effect_beyond_its_limits_stands_for_something_else(ratio: float, stated: bool) -> None:
    """No machine file may state friction of 1.9 times the load: a fit with it is not taken."""
    term = Term("load_dependent_friction", np.ones((3, 1)), positive=True)
    assert is_within_limits(term, np.array([ratio])) == stated
    assert is_within_limits(Term("viscous", np.ones((3, 1))), np.array([1e9]))


@pytest.mark.slow
def test_load_has_no_rise_where_elements_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compared with a rise of the load alone, a rise of both explained nothing: a load's friction lost its own."""
    seen: list[int] = []

    def note(views: Views, terms: Sequence[Term], start: Shape, rounds: int = 2) -> AxisFit:
        if start.rise is None:
            seen.extend(term.columns.shape[1] for term in terms if is_level(term))
        return fit_aligned(views, terms, start, rounds)

    monkeypatch.setattr(final_fit, "fit_aligned", note)
    identify([Arm(load=0.12, rise=0.5).log(1)], Wanted("arm", elements=2))
    assert seen and set(seen) == {1}
