"""The search for effects that are sines: every period at once, by Fourier transforms over position or time."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.fft import next_fast_len, rfft

from sgms_mhe.diagnosis.parts import Cause
from sgms_mhe.diagnosis.proposals import Proposal, Residual, nearest_peak, propose
from sgms_mhe.model.effects import EffectDefinition, effect_definition, effect_names
from sgms_mhe.model.effects.search import Harmonic
from sgms_mhe.recordings.evidence import Nuisance
from sgms_mhe.recordings.excitation import in_step
from sgms_mhe.recordings.recording import Recording
from sgms_mhe.recordings.series import bin_sums
from sgms_mhe.signals.chain import lowpass_coefficients
from sgms_mhe.support.arrays import Array, Complex
from sgms_mhe.support.parallel import run_parallel
from sgms_mhe.support.statements import Rule, Statement

BINS_PER_PERIOD: Final = 6.0
SINGULAR: Final = 1e-5  # of its square: the least determinant that two columns are told apart by
AT_A_TIME: Final = 300_000  # samples that are transformed at a time; bounds memory
STEP: Final = 0.25  # of the resolution that the range of x gives: the grid's, at most
PITCH_BAND: Final = 0.3
"""Frequency up to which a ripple is seen in passing [rate of the rows]: means over a row have lost it above."""
CUTOFF_BAND: Final = 0.7
"""Frequency up to which a ripple passes the chain's filters [velocity cutoff]: above, they turn its phase."""
FREQUENCY_BAND: Final = 0.45
"""Frequency up to which sines in time are searched [rate of the rows]: near half the rate they are no sines any more.
"""
SHORT_PERIOD: Final = 4.0
"""Wavenumber from which a sine has a short period, with a proposal of its own [least wavenumber]: slow trends have more
energy than they deserve."""
VISIBLE_SHARE: Final = 0.2
"""Rows slow enough for a ripple, at least, for it to be searched [rows]: one that is seen hardly anywhere is told from
nothing."""


PASSED: Final = 0.95
"""Share of a sine's amplitude that has to pass the chain's filters, lest its loss be said."""


def list_smoothed(recording: Recording, causes: Iterable[Cause]) -> tuple[Statement, ...]:
    """Return the low-passes' attenuation of the named sines, on average over the used rows.

    Force and acceleration come through two of them and a sample, the model's sine through none: so an amplitude is too
    small by H^2 / z and the delay taken out, at f = |v| / pitch for one in place.
    """
    delay = recording.signals.delay
    if delay <= 0.0:  # the log brought what the chain would have made
        return ()
    sampling, speed = recording.machine.sampling, np.abs(recording.velocity[recording.used])
    b0, b1, b2, a1, a2 = lowpass_coefficients(recording.machine)
    said = []
    for cause in causes:
        kind = effect_definition(cause.name).search if cause.name in effect_names() else None
        if not isinstance(kind, Harmonic):
            continue
        period = cause.parameters[kind.period]
        frequency = np.array([period]) if kind.coordinate == "time" else speed / period
        angle = math.tau * np.minimum(frequency / sampling.rate, 0.5)
        z = np.exp(-1j * angle)  # of one sample
        lowpass = (b0 + b1 * z + b2 * z**2) / (1.0 + a1 * z + a2 * z**2)
        passed = float(np.abs(np.mean(lowpass**2 * z * np.exp(1j * angle * delay * sampling.rate))))
        if passed < PASSED:
            units, value = recording.machine.plant.units, cause.parameters[kind.size] / passed
            size: dict[str, float | str] = {"percent": 100.0 * passed, "size": units.named(kind.size)}
            said.append(Statement(Rule.SMOOTHED, cause.name, value, None, units.unit(kind.size), size))
    return tuple(said)


@dataclass(frozen=True)
class _Sine:
    """A sine along one coordinate of a record.

    Attributes:
        kind: names and factors.
        x: the coordinate on used rows.
        weights: w_j on used rows, 0 where the sine is too fast to be seen.
    """

    kind: Harmonic
    seen: Residual
    x: Array
    weights: tuple[Array, ...]

    def factors(self, kappa: Array) -> list[Complex]:
        """c_j of wavenumbers (n) in periods per unit of x."""
        return list(self.kind.factors(self.seen.motion, math.tau * kappa))

    def columns(self, kappa: float) -> Array:
        """Sine and cosine of a wavenumber (rows used, 2)."""
        turns = kappa * self.x
        angle = math.tau * (turns - np.floor(turns))  # functions of small angles take half as long
        sine, cosine = np.sin(angle), np.cos(angle)
        found = np.zeros((len(angle), 2))
        for factor, w in zip(self.factors(np.array([kappa])), self.weights, strict=True):
            c = complex(factor[0])
            if c.real != 0.0:
                scaled = c.real * w
                found[:, 0] += scaled * sine
                found[:, 1] += scaled * cosine
            if c.imag != 0.0:
                scaled = c.imag * w
                found[:, 0] += scaled * cosine
                found[:, 1] -= scaled * sine
        return found


def search_harmonic(definition: EffectDefinition, kind: Harmonic, seen: Residual) -> list[Proposal]:
    """Proposals of the best long period and of the best short one.

    Slow trends have more energy than they deserve: a short period gets a proposal of its own.
    """
    found = run_parallel([partial(_search, definition, kind, seen, fine) for fine in (False, True)])
    return [proposal for proposal in found if proposal is not None]


def _search(definition: EffectDefinition, kind: Harmonic, seen: Residual, fine: bool) -> Proposal | None:
    """The best period: of those that the record covers many times (`fine`), or of the longer ones."""
    motion, extents, used = seen.motion, seen.motion.extents, seen.recording.used
    machine = seen.recording.machine
    in_time = kind.coordinate == "time"
    x = (motion.time if in_time else motion.position)[used]
    span = float(np.ptp(x))
    if span <= 0.0:
        return None
    weights = [w[used] for w in kind.weights(motion)]
    speed = np.abs(motion.velocity[used])
    if in_time:
        bands = [(extents.lowest_frequency, FREQUENCY_BAND * extents.rate)]
    else:
        octaves = math.ceil(math.log2(machine.diagnosis.finest_pitch))
        edges = 1.0 / extents.longest_pitch * 2.0 ** np.arange(0, octaves + 1)
        bands = [(float(low), float(high)) for low, high in pairwise(edges)]
    split = SHORT_PERIOD * bands[0][0]
    bands = [(max(low, split), high) for low, high in bands if high > split] if fine else [(bands[0][0], split)]
    best: tuple[float, float, _Sine] | None = None
    tests = 0.0
    limit = min(PITCH_BAND * extents.rate, CUTOFF_BAND * machine.sampling.velocity_cutoff)
    slow = float(np.quantile(speed, VISIBLE_SHARE))
    for low, high in bands:
        if not in_time and slow * high > limit:
            high = limit / slow
        if high <= low:
            continue
        visible = np.ones(len(x)) if in_time else (speed * high <= limit).astype(np.float64)
        if not in_time and float((speed * visible).sum()) / extents.rate * low < 1.0:  # not one period is passed
            continue
        sine = _Sine(kind, seen, x, tuple(w * visible for w in weights))
        kappa, found = _energies(sine, (low, high), seen.free, seen.e)
        if in_time:
            # What comes again with the motion is a function of the motion as well: no record like that shows a clock.
            found = np.where(in_step(seen.recording, kappa), 0.0, found)
        tests += (high - low) * span
        peak = int(np.argmax(found))
        if best is None or found[peak] > best[0]:
            best = float(found[peak]), float(kappa[peak]), sine
    if best is None:
        return None
    _, kappa_best, sine = best
    kappa_best = max(bands[0][0], nearest_peak(seen, sine.columns, kappa_best, STEP / span, math.inf))

    def parameters(size: Array) -> Mapping[str, float]:
        return {
            kind.size: float(np.hypot(size[0], size[1])),
            kind.period: kappa_best if in_time else 1.0 / kappa_best,
            kind.phase: float(np.arctan2(size[1], size[0])),
        }

    return propose(definition, seen, seen.free.project(sine.columns(kappa_best)), max(1.0, tests), parameters)


def _energies(sine: _Sine, band: tuple[float, float], free: Nuisance, e: Array) -> tuple[Array, Array]:
    """Wavenumbers of a band, four over the span of x apart or closer, and the energy each one's columns explain.

    Nuisance projected out; FFTs over bins of x, six to the shortest period: binning loses 5 % of a sine, and as much
    of the projected part.
    """
    x, weights = sine.x, sine.weights
    bin_width = 1.0 / (BINS_PER_PERIOD * band[1])
    index = ((x - x.min()) / bin_width).astype(np.int64)
    count = int(index.max()) + 1
    length = int(next_fast_len(4 * count, real=True))
    grid = 1.0 / (length * bin_width)
    first, last = math.ceil(band[0] / grid), max(math.ceil(band[0] / grid) + 1, math.ceil(band[1] / grid))
    kappa: Array = np.asarray(np.arange(first, last) * grid, dtype=np.float64)
    factors = sine.factors(kappa)

    def transform(weight: Array, series: Array, at: slice) -> Complex:
        """sum over rows of weight series exp(2 pi i kappa x) of each of some series (rows, k): (k, n).

        Up to the phase of the first bin, which cancels in energies.
        """
        return np.asarray(np.conj(rfft(bin_sums(series, weight, index, count).T, length)[:, at]))

    def along(series: Array) -> Complex:
        parts = (c * transform(w, series, slice(first, last)) for c, w in zip(factors, weights, strict=True))
        return np.asarray(sum(parts))

    square = np.zeros(len(kappa))
    double = np.zeros(len(kappa), dtype=np.complex128)
    one = np.ones((len(x), 1))
    for i, (ci, wi) in enumerate(zip(factors, weights, strict=True)):
        for cj, wj in zip(factors[i:], weights[i:], strict=True):
            both = 1.0 if wi is wj else 2.0
            square += both * float(wi @ wj) * np.real(ci * np.conj(cj))
            double += both * ci * cj * transform(wi * wj, one, slice(2 * first, 2 * last, 2))[0]
    at_a_time = max(1, AT_A_TIME // length)
    basis = (free.basis[:, j : j + at_a_time] for j in range(0, free.basis.shape[1], at_a_time))
    return kappa, _explained(along(e[:, None])[0], square, double, (b for part in basis for b in along(part)))


def _explained(target: Complex, square: Array, double: Complex, basis: Iterable[Complex]) -> Array:
    """Energy (n) from transforms: of the residual, of the columns' squares and products, of the nuisance."""
    ss, cc, sc = 0.5 * (square - double.real), 0.5 * (square + double.real), 0.5 * double.imag
    s, c = target.imag.copy(), target.real.copy()
    for b in basis:
        # e has no part along the basis, so only the Gram matrix changes.
        ss -= b.imag**2
        cc -= b.real**2
        sc -= b.imag * b.real
    determinant = ss * cc - sc**2
    floor = SINGULAR * np.maximum(square, 1e-300) ** 2
    found = (cc * s**2 - 2.0 * sc * s * c + ss * c**2) / np.maximum(determinant, floor)
    good = (ss > 0.0) & (cc > 0.0) & (determinant > floor)
    return np.asarray(np.where(good, found, 0.0), dtype=np.float64)
