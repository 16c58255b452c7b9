"""Diagnoses made by hand: what a report and a benchmark see; and the check of what a diagnosis finds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest import approx

from sgms_mhe.diagnosis import (
    Alternative,
    BaseParameter,
    Cause,
    Diagnosis,
    ResidualStructure,
    RivalFit,
    Rms,
    Score,
    Traces,
    verdict,
)
from sgms_mhe.diagnosis.extension import extend_machine
from sgms_mhe.diagnosis.fits import fit_model
from sgms_mhe.diagnosis.rivals import Selection
from sgms_mhe.diagnosis.selection import Searched, search_causes
from sgms_mhe.machine import Machine

Array = NDArray[np.float64]

PITCH, AMPLITUDE = 0.032, 0.8


def traces(seconds: float = 12.0, rate: float = 500.0, ripple: float = AMPLITUDE, noise: float = 0.11) -> Traces:
    """Strokes at three speeds over a guide with Coulomb friction, and a ripple that the model may lack."""
    random = np.random.default_rng(5)
    t = np.arange(round(seconds * rate)) / rate
    position = 0.11 * np.sin(2 * np.pi * 0.31 * t) + 0.04 * np.sin(2 * np.pi * 0.73 * t)
    velocity = np.gradient(position, t)
    acceleration = np.gradient(velocity, t)
    base = 4.0 * np.tanh(velocity / 4e-3) + 20.0 * velocity
    missing = ripple * np.sin(2 * np.pi * position / PITCH + 0.6)
    friction = base + missing + noise * random.standard_normal(len(t))
    used = np.ones(len(t), dtype=np.bool_)
    used[: round(0.1 * rate)] = False
    used[round(0.4 * len(t)) : round(0.42 * len(t))] = False
    block = np.minimum(np.arange(len(t)) * 24 // len(t), 23)
    held_out = used & (block % 3 == 1)
    return Traces(
        time_s=t,
        position_m=position,
        velocity_m_s=velocity,
        acceleration_m_s2=acceleration,
        force_N=friction + 20.0 * acceleration,
        friction_N=friction,
        nominal_N=base,
        extended_N=base + missing,
        held_out_fit_N=base + 0.98 * missing,
        used=used,
        held_out=held_out,
        block=np.where(used, block, -1),
        rate=rate,
    )


def structure(shown: Traces, residual: Array, significant: bool) -> tuple[ResidualStructure, ...]:
    """Bins over two coordinates."""
    found = []
    for name, x in (("position", shown.position_m), ("velocity", shown.velocity_m_s), ("time", shown.time_s)):
        edges = np.linspace(x.min(), x.max(), 41)
        index = np.clip(np.searchsorted(edges, x) - 1, 0, 39)
        mean = np.bincount(index, weights=residual, minlength=40) / np.maximum(np.bincount(index, minlength=40), 1)
        strong = significant and name == "position"
        found.append(
            ResidualStructure(
                name,
                float(np.std(mean)) if strong else 0.011,
                1e-30 if strong else 0.4,
                float(edges[int(np.argmax(np.abs(mean)))]),
                0.5 * (edges[1:] + edges[:-1]),
                mean,
            )
        )
    return tuple(found)


def explained(machine: Machine, **changes: Any) -> Diagnosis:
    """A force ripple that was found."""
    shown = traces()
    values = {"amplitude_N": 0.797, "pitch_m": 0.032003, "phase_rad": 0.598}
    std = {"amplitude_N": 0.006, "pitch_m": 2.1e-5, "phase_rad": 0.011}
    before, after = shown.residual_before[shown.held_out], shown.residual_after[shown.held_out]
    rms = Rms(0.581, 0.112, float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))))
    extended, tables = extend_machine(machine, ["force_ripple"], {}, [{"name": "force_ripple", **values}])
    nan = math.nan
    scores = (
        Score("force_ripple", 1, 1e-34, 0.561, 0.562, values, "named"),
        Score("position_dependent_friction", 1, 2e-4, 0.083, 0.021, {}, "redundant"),
        Score("position_spring", 1, 3e-3, 0.041, 0.004, {}, "redundant"),
        Score("force_constant_ripple", 1, 0.02, 0.036, nan, {}, "not significant"),
        Score("periodic_disturbance", 1, 0.31, 0.012, nan, {}, "not significant"),
        Score("mass_mismatch", 1, 0.7, 0.004, nan, {}, "too small"),
        Score("dwell_dependence", 1, nan, 0.0, nan, {}, "not significant"),
        Score("position_dependent_friction", 2, 0.6, 0.005, nan, {}, "not significant"),
        Score("mass_mismatch", 2, 0.8, 0.002, nan, {}, "not significant"),
    )
    diagnosis = Diagnosis(
        machine=machine,
        source="axis.csv",
        verdict="explained",
        causes=(Cause("force_ripple", "force_ripple", values, std, {}, rms, 0.562, (0.548, 0.577), 1e-34),),
        alternatives=(
            Alternative(
                "position_dependent_friction", "fits 0.54 N worse: the ripple keeps its sign on the way back", False
            ),
            Alternative("encoder_periodic_error", "its force would grow with speed squared; it does not", False),
        ),
        rms=rms,
        noise_floor_N=0.110,
        gain_interval_N=(0.548, 0.577),
        base=(
            BaseParameter("stiffness_1", 120e3, 118.3e3, 4.1e3),
            BaseParameter("stiffness_4", 7.9e3, 7.9e3, nan),
            BaseParameter("coulomb", 4.0, 3.985, 0.011),
            BaseParameter("viscous", 20.0, 20.14, 0.09),
            BaseParameter("stribeck_ratio", 0.12, 0.118, 0.006),
        ),
        scores=scores,
        structure_before=structure(shown, shown.residual_before, True),
        structure_after=structure(shown, shown.residual_after, False),
        traces=shown,
        extended=extended,
        changes=tables,
        law="sgms",
        excited=True,
        warnings=("120 of 6000 samples are missing; they and 50 samples after each gap are left out",),
        seconds=21.4,
    )
    return replace(diagnosis, **changes)


def certain(first: Diagnosis) -> Diagnosis:
    """The same along a record that shows every number of the machine."""
    return replace(first, base=tuple(b for b in first.base if math.isfinite(b.std)))


def adequate(machine: Machine, **changes: Any) -> Diagnosis:
    """Nothing to find."""
    shown = traces(ripple=0.0)
    shown = replace(shown, extended_N=shown.nominal_N, held_out_fit_N=shown.nominal_N)
    rms = Rms(0.111, 0.111, 0.112, 0.112)
    return explained(
        machine,
        verdict="adequate",
        causes=(),
        alternatives=(),
        rms=rms,
        gain_interval_N=(math.nan, math.nan),
        scores=tuple(
            replace(s, outcome="not significant", p_value=0.5, gain_N=0.003)
            for s in explained(machine).scores
            if s.round == 1
        ),
        structure_before=structure(shown, shown.residual_before, False),
        structure_after=structure(shown, shown.residual_after, False),
        traces=shown,
        extended=None,
        changes=None,
        warnings=(),
        **changes,
    )


def ambiguous(machine: Machine) -> Diagnosis:
    """An offset that may be an asymmetric Coulomb level."""
    first = explained(machine)
    rms = first.rms
    cause = Cause(
        "constant_offset", "constant_offset", {"force_N": 0.41}, {"force_N": 0.02}, {}, rms, 0.40, (0.37, 0.43), 1e-9
    )
    shown = first.traces
    rival = shown.residual_after + 0.02 * np.sign(shown.velocity_m_s)
    held_out = float(np.sqrt(np.mean(rival[shown.held_out] ** 2)))
    return replace(
        first,
        rival_fits=(RivalFit("asymmetric_coulomb", "constant_offset", 0.113, held_out, rival),),
        verdict="ambiguous",
        causes=(cause,),
        alternatives=(
            Alternative(
                "asymmetric_coulomb",
                "the same force wherever the axis slides; its fit is 0.002 N worse, which is within noise",
                True,
                "constant_offset",
                {"ratio": 0.102},
                0.002,
            ),
        ),
    )


def unexplained(machine: Machine) -> Diagnosis:
    """A residual that no effect accounts for."""
    first = adequate(machine)
    shown = traces()
    return replace(
        first,
        verdict="unexplained",
        traces=replace(shown, extended_N=shown.nominal_N, held_out_fit_N=shown.nominal_N),
        rms=Rms(0.581, 0.581, 0.577, 0.577),
        structure_before=structure(shown, shown.residual_before, True),
        structure_after=structure(shown, shown.residual_before, True),
    )


def motionless(machine: Machine) -> Diagnosis:
    """A record of an axis at rest."""
    first = adequate(machine)
    t = first.traces
    zero = np.zeros_like(t.position_m)
    still = replace(t, position_m=zero, velocity_m_s=zero, acceleration_m_s2=zero, nominal_N=zero, held_out_fit_N=zero)
    return replace(
        first, traces=still, excited=False, scores=(), structure_before=(), structure_after=(), warnings=("no motion",)
    )


def name_nothing(patch: pytest.MonkeyPatch) -> None:
    """Let diagnoses try no effect and select no cause: what is judged is what comes after the search."""

    def nothing(searched: Searched) -> Selection:
        fit = fit_model(searched.laws.chosen, (), refitted=(), warm=searched.fit)
        return Selection(fit=fit, refitted=(), scores=(), rivals=(), rejected={}, p_values={}, free=searched.fit)

    patch.setattr(verdict, "search_causes", lambda laws, wanted: search_causes(laws, replace(wanted, excited=())))
    patch.setattr(verdict, "select_causes", nothing)


# --- what a diagnosis of a log has to say -------------------------------------------------------------------------

Causes = Mapping[str, Mapping[str, Any]]
"""Causes by name, each with numbers that it has to have: of `pytest.approx`, or `Within`."""


@dataclass(frozen=True)
class Within:
    """A number that differs from the true one by less than so many of its own deviations."""

    truth: float
    deviations: float = 2.0


def assert_found(found: Diagnosis, causes: Causes, *verdicts: str) -> None:
    """Check that these causes are named with their numbers and no other, and the verdict; without one: any."""
    assert sorted(cause.name for cause in found.causes) == sorted(causes), found.summary
    assert not verdicts or found.verdict in verdicts, found.summary
    for cause in found.causes:
        for key, number in causes[cause.name].items():
            value, std = cause.parameters[key], cause.std.get(key, 0.0)
            if isinstance(number, Within):
                number = approx(number.truth, rel=0.0, abs=number.deviations * std)
            assert value == number, (cause.name, key)
