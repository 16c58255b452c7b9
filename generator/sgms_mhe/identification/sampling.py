"""The axis before anything is known of its friction: rates, filter and largest speed, as the records show them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgms_mhe.configuration import make_machine, override_machine
from sgms_mhe.identification.spectrum import BOTH_WAYS
from sgms_mhe.identification.terms import companion_terms
from sgms_mhe.machine import Machine, plant_content
from sgms_mhe.model.effects import MOVES
from sgms_mhe.recordings.encoder import encoder_noise
from sgms_mhe.recordings.recording import BLOCK_MAX, BLOCK_ROWS_MIN, add_encoder, prepare
from sgms_mhe.signals.logs import JITTER, Log, advise_time_unit
from sgms_mhe.support.errors import InputError

UPDATE_RATE: Final = 100.0
"""Estimates per second [Hz], or next to it what divides the sample rate."""
CUTOFFS: Final = (500.0, 350.0, 250.0, 180.0, 120.0, 90.0, 60.0, 40.0, 25.0, 15.0)
"""Low-passes [Hz] to choose from, the fastest first."""
HIGHEST_CUTOFF: Final = 0.16
LOWEST_CUTOFF: Final = 0.02
"""Of the sample rate: above, the differences are noise; below, what follows a reversal is smeared away."""
QUIET: Final = 0.02
"""Noise of the measured friction over its RMS that a low-pass may let through."""
BIASED: Final = 0.02
"""Of the mass: a low-pass that makes it this much smaller is not kept."""
HEADROOM: Final = 1.2
"""`max_velocity` over the fastest speed of the records."""
NOT_A_ROUND_RATE: Final = 1e-4
"""Relative distance from a rounder number within which the clock's own error is to blame."""
KEPT: Final = ("sampling", "estimator", "compensation", "code", "diagnosis", "log")
"""Tables that come from another machine file where one is given."""


def common_rate(logs: Sequence[Log]) -> float:
    """Sample rate [Hz] of all logs, as round as their clocks allow.

    Raises:
        InputError: a log of another rate than the others, or too slow to tell friction.
    """
    rate = logs[0].rate
    for log in logs[1:]:
        if abs(log.rate - rate) > JITTER * rate:
            allowed = f"{rate:.6g} Hz, the rate of {logs[0].source or 'the first log'}; logs of one call share a rate"
            raise InputError(log.source or "log", "time_s", f"{log.rate:.6g} Hz", allowed)
    rate = float(np.median([log.rate for log in logs]))
    if rate < BLOCK_ROWS_MIN / BLOCK_MAX:
        allowed = f"at least {BLOCK_ROWS_MIN / BLOCK_MAX:g} Hz; {advise_time_unit(rate)}"
        raise InputError(name_all([log.source for log in logs]), "time_s", f"{rate:.6g} Hz", allowed)
    for digits in range(1, 6):
        round_number = float(f"{rate:.{digits}g}")
        if abs(round_number - rate) <= NOT_A_ROUND_RATE * rate:
            return round_number
    return rate


def unknown_axis(logs: Sequence[Log], name: str, mass: float, like: Machine | None) -> Machine:
    """Return a machine with the records' rates and placeholder friction of elements without size.

    Args:
        logs: the records, at least one.
        name: of the machine.
        mass: moved mass [kg], or inertia [kg m^2].
        like: whose sampling, estimator, code and `[log]` are taken over; None: none.

    Raises:
        InputError: logs of different rates, or a rate that is not that of `like`.
    """
    rate = common_rate(logs)
    fastest = max(_fastest(log, rate) for log in logs)
    content: dict[str, Any] = {"name": name, "plant": plant_content(logs[0].kind, mass), "friction": _placeholder(logs)}
    if like is not None:
        if abs(like.sampling.rate - rate) > JITTER * like.sampling.rate:
            allowed = f"sampling.rate of {like.name}, {like.sampling.rate:g} Hz"
            raise InputError(name_all([log.source for log in logs]), "time_s", f"{rate:.6g} Hz", allowed)
        content |= {key: like.content[key] for key in KEPT if key in like.content}
        # What is estimated and within what bounds follows from what is found.
        estimator = dict(content.get("estimator", {}))
        dropped = ("parameters", "prior", "bounds", "disturbance")
        content["estimator"] = {k: v for k, v in estimator.items() if k not in dropped}
        sampling = dict(content.get("sampling", {}))
        sampling.pop("integrator", None)
        content["sampling"] = sampling
        return make_machine(content, Path(f"{name}.toml"))
    samples = max(1, round(rate / UPDATE_RATE))
    sampling = {
        "rate": rate,
        "update_rate": rate / samples,
        "velocity_cutoff": HIGHEST_CUTOFF * rate,
        "max_velocity": round_up(HEADROOM * fastest),
    }
    content |= {"sampling": sampling}
    machine = make_machine(content, Path(f"{name}.toml"))
    return _choose_filter(machine, logs)


def round_up(value: float) -> float:
    """The next larger number of two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1) if value > 0.0 else 1.0
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.3g}") if value > 0.0 else 1.0


def _placeholder(logs: Sequence[Log]) -> Mapping[str, Any]:
    """Friction of about the right size, for scales before any is known."""
    level = max(float(np.nanstd(log.force_N)) for log in logs) or 1.0
    travel = max(float(np.nanmax(log.position_m) - np.nanmin(log.position_m)) for log in logs) or 1.0
    return {"law": "switching", "stiffness": [100.0 * level / travel], "fraction": [1.0], "coulomb": level}


def _fastest(log: Log, rate: float) -> float:
    """Speed [m/s] that a record exceeds in one sample of a thousand, over means of 5 ms; that which counts later."""
    width = max(1, round(0.005 * rate))
    if log.velocity_m_s is None:
        speed = np.abs(np.diff(log.position_m[::width])) * rate / width
    else:
        speed = np.abs(np.convolve(log.velocity_m_s, np.full(width, 1.0 / width), "valid"))
    speed = speed[np.isfinite(speed)]
    return float(np.quantile(speed, 0.999)) if len(speed) else 0.0


def replace_filter(machine: Machine, logs: Sequence[Log]) -> tuple[Machine, tuple[str, ...]]:
    """Return the machine with a slower low-pass where its own biases the mass, and the sentence on that.

    Noise of an encoder or of time stamps in the acceleration makes the identified mass too small, by
    its share of the power at least: the filter is made slower until that is small, and the next one does not make the
    mass larger. Not where an axis goes one way: there the mass takes up friction.

    Args:
        machine: with the low-pass asked for, and the mass behind it.
        logs: whose motion shows a mass.
    """
    if not any(map(_goes_both_ways, logs)):
        return machine, ()
    asked, chosen = machine.sampling.velocity_cutoff, machine
    mass = biased = _fit_mass(machine, logs)
    if not mass > 0.0:
        return machine, ()
    for cutoff in (c for c in CUTOFFS if LOWEST_CUTOFF * machine.sampling.rate <= c < asked):
        slower = override_machine(machine, {"sampling": {"velocity_cutoff": cutoff}})
        larger = _fit_mass(slower, logs)
        if larger - mass <= BIASED * larger and all(_acceleration_noise(chosen, log) <= BIASED for log in logs):
            break
        chosen, mass = slower, larger
    cutoff = chosen.sampling.velocity_cutoff
    if mass - biased <= BIASED * mass:
        return machine, ()
    sentence = (
        f"velocity_cutoff = {cutoff:g} Hz in place of {asked:g} Hz: behind that, noise of the position makes the "
        f"{machine.plant.units.inert} {1.0 - biased / mass:.0%} too small"
    )
    return override_machine(chosen, {"plant": plant_content(machine.plant.kind, mass)}), (sentence,)


def _acceleration_noise(machine: Machine, log: Log) -> float:
    """Noise of the position in the acceleration behind a low-pass, over the acceleration, squared sums."""
    rows = add_encoder(prepare(machine, log), log)
    noise = rows.reduce(encoder_noise(rows)[:, 2])[rows.used]
    return float(noise @ noise / np.sum(rows.acceleration[rows.used] ** 2))


def _goes_both_ways(log: Log) -> bool:
    steps = np.diff(log.position_m)
    return bool(min(np.mean(steps > 0.0), np.mean(steps < 0.0)) > BOTH_WAYS * np.mean(steps != 0.0))


def _choose_filter(machine: Machine, logs: Sequence[Log]) -> Machine:
    """The machine with the fastest low-pass behind which noise is small beside friction."""
    rate = machine.sampling.rate
    allowed = [c for c in CUTOFFS if LOWEST_CUTOFF * rate <= c <= HIGHEST_CUTOFF * rate] or [0.1 * rate]
    for cutoff in allowed:
        machine = override_machine(machine, {"sampling": {"velocity_cutoff": cutoff}})
        if all(_noise_share(machine, log) <= QUIET for log in logs):
            break
    return machine


def _noise_share(machine: Machine, log: Log) -> float:
    """Scatter of the measured friction about curves through a few samples of the filter's own length, over its RMS."""
    signals = prepare(machine, log).signals
    friction = signals.friction[signals.valid]
    width = max(6, round(2.0 * machine.sampling.rate / machine.sampling.velocity_cutoff))
    count = len(friction) // width
    if count < 4:
        return 0.0
    pieces = friction[: count * width].reshape(count, width)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 3))[0]
    rest = pieces - pieces @ basis @ basis.T
    scatter = math.sqrt(float(np.median(np.mean(rest**2, axis=1))))
    size = float(np.std(friction))
    return scatter / size if size > 0.0 else 0.0


def rough_mass(machine: Machine, logs: Sequence[Log], *, is_needed: bool = True) -> float:
    """Moved mass [kg, kg m^2] by least squares of the force on acceleration, speed, direction and companions.

    Where it is not needed, one below 0 is the size of its error: a fit with a free mass begins from any.

    Raises:
        InputError: the motion asks for no mass, or one below 0.
    """
    mass, units = _fit_mass(machine, logs), machine.plant.units
    if mass < 0.0 and not is_needed:
        return -mass
    if not mass > 0.0:
        allowed = f"--{units.inert}: this motion shows none ({MOVES['jerks']} would)"
        seen = f"{mass:.3g} {units.mass}"
        raise InputError(name_all([log.source for log in logs]), f"{units.push} over acceleration", seen, allowed)
    return mass


def name_all(sources: Sequence[str]) -> str:
    """Name in sentences on several logs: the first, and how many more."""
    more = f" and {len(sources) - 1} more" if len(sources) > 1 else ""
    return f"{sources[0] or 'log'}{more}"


def _fit_mass(machine: Machine, logs: Sequence[Log]) -> float:
    """Return the mass the motion asks for [kg, kg m^2], whatever its sign."""
    columns, forces = [], []
    for log in logs:
        rows = prepare(machine, log)
        v = rows.velocity
        slow = 1e-2 * float(np.max(np.abs(v[rows.used]), initial=1e-12))
        beside = [term.columns for term in companion_terms(rows)]
        columns.append(np.column_stack((rows.acceleration, v, np.tanh(v / slow), *beside))[rows.used])
        forces.append(rows.force[rows.used])
    X, y = np.concatenate(columns), np.concatenate(forces)
    mass = float(np.linalg.lstsq(X / np.maximum(np.abs(X).max(axis=0), 1e-300), y, rcond=1e-9)[0][0])
    return mass / float(np.abs(X[:, 0]).max())
