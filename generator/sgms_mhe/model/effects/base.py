"""Wrong numbers of the base model, described as effects are: a diagnosis treats both alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from sgms_mhe.model.effects.definition import Start
from sgms_mhe.model.effects.excitation import Excitation, Need


@dataclass(frozen=True)
class BaseCause:
    """A wrong number: which parameters of the base model it frees, and their names in a report.

    Attributes:
        name: as in diagnosis.json.
        summary: one line for reports.
        frees: names for `[estimator] parameters`.
        reported: name in reports, with its unit, per freed parameter; of an array, the stem of `stiffness_1_N_m`.
        excitation, confused_with, start: as of an effect.
    """

    name: str
    summary: str
    frees: tuple[str, ...]
    reported: Mapping[str, str]
    excitation: Excitation
    confused_with: Mapping[str, str]
    start: Start


BASE_CAUSES: Final[Mapping[str, BaseCause]] = MappingProxyType(
    {
        cause.name: cause
        for cause in (
            BaseCause(
                name="stiffness",
                summary="presliding stiffness differs from the machine file",
                frees=("stiffness",),
                reported={"stiffness": "stiffness_N_m"},
                excitation=Excitation(
                    "reversals, and loops that stay below break-away; an element shows only where it turns round",
                    (Need("reversals", 4.0),),
                ),
                confused_with={
                    "hose_hysteresis": "small loops at places far apart: both hystereses are there, but the hose's "
                    "alone goes on rising over travels far beyond break-away",
                    "micro_viscous": "the same presliding loop at two speeds: a spring does not know speed",
                    "backlash": "one slow reversal: a gap has no force at all, a soft element a low slope",
                },
                start=Start(note="from the machine file's values"),
            ),
            BaseCause(
                name="coulomb",
                summary="Coulomb level differs from the machine file",
                frees=("coulomb",),
                reported={"coulomb": "coulomb_N"},
                excitation=Excitation(
                    "sliding in both directions", (Need("both_directions", 0.1), Need("reversals", 1.0))
                ),
                confused_with={
                    "force_gain": "one move with high acceleration: a gain scales the inertial force too",
                    "friction_drift": "the same move at the beginning and at the end of the log",
                    "constant_offset": "move in both directions: an offset does not change sign",
                },
                start=Start(note="from the machine file's value; linear"),
            ),
            BaseCause(
                name="viscous",
                summary="viscous friction differs from the machine file",
                frees=("viscous",),
                reported={"viscous": "viscous_N_s_m"},
                excitation=Excitation(
                    "constant speeds that differ by a factor of three",
                    (Need("speed_ratio", 2.0), Need("moving_s", 0.5)),
                ),
                confused_with={
                    "eddy_current_damping": "constant speeds up to twice the corner velocity: it falls off there",
                    "quadratic_drag": "three constant speeds or more: is the force over speed a line or a parabola",
                    "force_delay": "constant speed: a delay has no effect there",
                },
                start=Start(note="from the machine file's value; linear"),
            ),
            BaseCause(
                name="stribeck",
                summary="rise of friction towards low speed differs from the machine file",
                frees=("stribeck_ratio", "stribeck_velocity"),
                reported={"stribeck_ratio": "stribeck_ratio", "stribeck_velocity": "stribeck_velocity_m_s"},
                excitation=Excitation(
                    "constant speeds from well below to well above the Stribeck velocity", (Need("speed_ratio", 10.0),)
                ),
                confused_with={
                    "dwell_dependence": "break away after rests of different length, at the same speed",
                    "frictional_lag": "pass through the Stribeck velocity with different accelerations",
                    "eddy_current_damping": "speeds below the Stribeck velocity",
                },
                start=Start(note="from the machine file's values; try half and twice the velocity"),
            ),
        )
    }
)
"""Wrong-number causes by name."""


def base_cause(name: str) -> BaseCause:
    """Return the wrong-number cause called `name`; KeyError if there is none."""
    return BASE_CAUSES[name]
