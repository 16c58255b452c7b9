"""The signal chain: alignment, exact displacement, missing samples, logs that bring their own signals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import butter

from sgms_mhe.configuration import load_machine, override_machine
from sgms_mhe.machine import Machine
from sgms_mhe.signals.chain import (
    UNKNOWN,
    Signals,
    chain_delay,
    lowpass_coefficients,
    settle_samples,
    signal_array,
    signals_from_log,
    signals_of_record,
)
from sgms_mhe.signals.logs import Log
from sgms_mhe.support.errors import InputError

Array = NDArray[np.float64]
MACHINE = load_machine("etel_xy")
RATE = MACHINE.sampling.rate
STEP = MACHINE.sampling.step
MASS = MACHINE.plant.moved
SETTLE = settle_samples(MACHINE)


def with_cutoff(cutoff: float) -> Machine:
    return override_machine(MACHINE, {"sampling": {"velocity_cutoff": cutoff}})


def a_log(position: NDArray[Any], force: Array | None = None, **columns: Any) -> Log:
    n = len(position)
    return Log(np.arange(n) / RATE, position, np.zeros(n) if force is None else force, RATE, **columns)


def smooth_motion(n: int) -> tuple[Array, Array, float, float]:
    """Position [m], acceleration, largest jerk, largest snap of strokes 10 mm sin^6(w t), from rest, in closed form."""
    angle, omega = 2 * np.pi * 5.0 * np.arange(n) / RATE, 2 * np.pi * 5.0
    weight, order = 0.01 / 32 * np.array([10.0, -15.0, 6.0, -1.0]), np.array([0, 2, 4, 6])
    position = np.cos(np.outer(angle, order)) @ weight
    acceleration = -np.cos(np.outer(angle, order)) @ (weight * (order * omega) ** 2)
    jerk = np.sin(np.outer(angle, order)) @ (weight * (order * omega) ** 3)
    snap = np.cos(np.outer(angle, order)) @ (weight * (order * omega) ** 4)
    return position, acceleration, float(np.abs(jerk).max()), float(np.abs(snap).max())


def noisy_log(n: int = 600, seed: int = 1) -> Log:
    random = np.random.default_rng(seed)
    position = 0.3 + 1e-4 * np.cumsum(random.normal(size=n))
    return a_log(position, random.normal(size=n) * 5)


def with_column(log: Log, column: str, values: Array) -> Log:
    changes: dict[str, Any] = {column: values}
    return replace(log, **changes)


# --- filter -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cutoff", [1.0, 50.0, 500.0, 2499.0, 4900.0])
def test_lowpass_is_the_butterworth_filter(cutoff: float) -> None:
    b0, b1, b2, a1, a2 = lowpass_coefficients(with_cutoff(cutoff))
    numerator, denominator = butter(2, cutoff, fs=RATE)
    np.testing.assert_allclose([b0, b1, b2], numerator, rtol=1e-10)
    np.testing.assert_allclose([1.0, a1, a2], denominator, rtol=0, atol=1e-12)


@pytest.mark.parametrize("cutoff", [5.0, 50.0, 500.0, 2500.0, 4000.0, 4990.0])
def test_settle_is_where_the_step_response_stays_within_one_percent(cutoff: float) -> None:
    machine = with_cutoff(cutoff)
    settle, coefficients = settle_samples(machine), lowpass_coefficients(machine)
    step = twin_lowpass(coefficients, twin_lowpass(coefficients, np.ones(3 * settle + 50)))
    assert (abs(step[settle:] - 1) <= 0.01).all()
    assert settle == 0 or abs(step[settle - 1] - 1) > 0.01


def test_settle_of_the_etel_axis_is_the_known_number() -> None:
    assert SETTLE == 28  # 2.8 ms at 500 Hz


# --- alignment --------------------------------------------------------------------------------------------------


def test_pure_mass_shows_no_friction() -> None:
    """u = m a, both exact at the samples: what is left is the second difference's own error, m h^2 |q''''| / 12."""
    position, acceleration, jerk, snap = smooth_motion(4000)
    signals = signals_from_log(a_log(position, MASS * acceleration), MACHINE)
    friction = np.abs(signals.friction[signals.valid])
    rounding = MASS * 4 * np.spacing(position.max()) * RATE**2 * 0.1
    bound = MASS * STEP**2 / 12 * snap + rounding
    assert friction.max() <= 1.02 * bound
    # The bound is sharp enough to see a hundredth of a sample of misalignment.
    assert bound < 0.01 * MASS * jerk * STEP


@pytest.mark.parametrize("late", [-1, 1])
def test_force_out_of_step_by_one_sample_shows(late: int) -> None:
    position, acceleration, jerk, _ = smooth_motion(4000)
    signals = signals_from_log(a_log(position, np.roll(MASS * acceleration, late)), MACHINE)
    assert np.abs(signals.friction[200:-200]).max() > 0.9 * MASS * jerk * STEP


def test_friction_on_a_moving_mass_comes_out_filtered_and_late() -> None:
    position, acceleration, _, _ = smooth_motion(4000)
    step = np.where(np.arange(4000) >= 2000, 3.0, 0.0)
    quiet = signals_from_log(a_log(position, MASS * acceleration), MACHINE).friction
    friction = signals_from_log(a_log(position, MASS * acceleration + step), MACHINE).friction - quiet
    assert np.abs(friction[:2001]).max() < 1e-12
    np.testing.assert_allclose(friction[2001 + SETTLE :], 3.0, atol=0.03)
    assert abs(friction[2000 + SETTLE] - 3.0) > 0.03


@pytest.mark.parametrize("cutoff", [20.0, 500.0, 4500.0])
def test_velocity_adds_up_to_the_aligned_position(cutoff: float) -> None:
    """No displacement is lost or invented between the two signals that the model sees."""
    log = noisy_log(2000)
    signals = signals_from_log(log, with_cutoff(cutoff))
    np.testing.assert_allclose(np.cumsum(signals.velocity) * STEP, signals.position - log.position_m[0], atol=1e-12)
    assert np.ptp(signals.position) > 1e-4


def test_velocity_of_a_steady_motion_is_exact_and_position_lags_by_the_stated_delay() -> None:
    log = a_log(0.5 + 0.2 * np.arange(3000) / RATE)
    signals = signals_from_log(log, MACHINE)
    np.testing.assert_allclose(signals.velocity[300:], 0.2, rtol=1e-9)
    np.testing.assert_allclose(signals.acceleration[300:], 0.0, atol=1e-6)
    b0, b1, b2, a1, a2 = lowpass_coefficients(MACHINE)
    # delay of a filter at low frequency: (sum k b_k) / (sum b_k) - (sum k a_k) / (sum a_k)
    delay = 1 + 2 * ((b1 + 2 * b2) / (b0 + b1 + b2) - (a1 + 2 * a2) / (1 + a1 + a2))
    lag = (log.position_m - signals.position)[300:] / (0.2 * STEP)
    np.testing.assert_allclose(lag, delay, rtol=1e-7)


def test_standstill_is_silent_to_the_last_bit() -> None:
    signals = signals_from_log(a_log(np.full(100, 0.123456789), np.full(100, -7.7)), MACHINE)
    assert (signals.velocity == 0).all()
    assert (signals.acceleration == 0).all()
    assert (signals.position == 0.123456789).all()
    assert (signals.force == -7.7).all()
    assert (signals.friction == -7.7).all()
    assert (signals.valid == (np.arange(100) >= SETTLE)).all()


def test_log_of_another_rate_is_refused() -> None:
    with pytest.raises(InputError, match=r"10200 Hz.*sampling\.rate of etel_xy, 10000 Hz"):
        signals_from_log(replace(noisy_log(), rate=10200.0), MACHINE)
    assert len(signals_from_log(replace(noisy_log(), rate=10050.0), MACHINE)) == 600


# --- an algebraic twin: sample by sample, as a controller runs it -----------------------------------------------


def twin_lowpass(coefficients: tuple[float, ...], signal: Array) -> Array:
    """Direct form I, the difference equation as it is written."""
    b0, b1, b2, a1, a2 = coefficients
    u1 = u2 = y1 = y2 = 0.0
    filtered = np.empty(len(signal))
    for k, u in enumerate(signal):
        y = b0 * u + b1 * u1 + b2 * u2 - a1 * y1 - a2 * y2
        u1, u2, y1, y2 = u, u1, y, y1
        filtered[k] = y
    return filtered


def twin_chain(log: Log, machine: Machine) -> Signals:
    """The chain of docs/signals.md, one sample at a time, written without a look at the vectorised one."""
    n, settle, rate = len(log), settle_samples(machine), machine.sampling.rate
    finite_q = log.position_m[np.isfinite(log.position_m)]
    finite_u = log.force_N[np.isfinite(log.force_N)]
    q_first, u_first = float(finite_q[0]), float(finite_u[0])
    q_old, d, u_old, u_now, u_in = q_first, 0.0, u_first, u_first, u_first
    q_known = u_known = False
    q_gap = u_gap = clean = 0
    rows = np.zeros((n, 3))  # delayed position, difference, delayed force
    error, missing = np.full(n, UNKNOWN), np.zeros(n, dtype=bool)
    fading, left = 0.01 ** (1.0 / settle), UNKNOWN

    def lowpass(signal: Array) -> Array:
        return twin_lowpass(lowpass_coefficients(machine), signal)

    for k in range(n):
        q, u = log.position_m[k], log.force_N[k]
        missing[k] = not (np.isfinite(q) and np.isfinite(u))
        left = 0.0 if clean >= settle else left
        restarts = False
        if np.isfinite(q):
            if not q_known or q_gap > settle:
                q_old, restarts = q, True
            d, q_known, q_gap = q - q_old, True, 0
        else:
            q_gap += 1
            if q_known and q_gap <= settle + 1:
                once = lowpass(rows[:k, 1])
                d += once[-1] - (once[-2] if k > 1 else 0.0)
            q = q_old + d if q_known else q_first
        u_old = u_in
        if np.isfinite(u):
            restarts = restarts or not u_known or u_gap > settle
            u_in = u + (u - u_now) * u_gap / 2.0 if u_known and u_gap <= settle else u
            u_now, u_known, u_gap = u, True, 0
        else:
            u_gap += 1
            u_in = u_now
        rows[k] = q_old, d, u_old
        q_old = q
        clean = 0 if missing[k] else clean + 1
        place = min(max(q_gap, u_gap), settle + 1)
        left = fading * (UNKNOWN if restarts else left) + 2.0 * (1.0 - fading) * place**2
        error[k] = left if q_known and u_known else UNKNOWN

    once = lowpass(rows[:, 1] * rate)
    late = np.r_[0.0, once[:-1]]
    acceleration = lowpass((once - late) * rate)
    force = u_first + lowpass(lowpass(rows[:, 2] - u_first))
    position = rows[0, 0] + lowpass(lowpass(rows[:, 0] - rows[0, 0]))
    friction = force - machine.plant.moved * acceleration
    valid = error <= 3.0
    noise = np.sqrt(1.0 + np.where(valid, error, 0.0) ** 2)
    return Signals(log.time_s, position, lowpass(late), acceleration, force, friction, valid, missing, noise=noise)


def assert_same(one: Signals, other: Signals) -> None:
    for name in ("position", "velocity", "acceleration", "force", "friction"):
        a, b = getattr(one, name), getattr(other, name)
        assert np.isfinite(a).all(), name
        # Relative to what goes in: a rounding of the position weighs 1 / h^2 in the acceleration.
        scale = {"force": 100.0, "velocity": RATE, "acceleration": RATE**2, "friction": MASS * RATE**2}.get(name, 1.0)
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15 * scale, err_msg=name)
    np.testing.assert_array_equal(one.missing, other.missing)
    np.testing.assert_array_equal(one.valid, other.valid)
    np.testing.assert_allclose(one.certainty, other.certainty, rtol=1e-12)


gaps = st.lists(st.tuples(st.integers(0, 259), st.integers(1, 2 * SETTLE)), max_size=6)


@given(position_gaps=gaps, force_gaps=gaps, infinite=st.booleans())
def test_chain_is_its_sample_by_sample_twin_whatever_is_missing(
    position_gaps: list[tuple[int, int]], force_gaps: list[tuple[int, int]], infinite: bool
) -> None:
    log = noisy_log(320)
    for channel, holes in ((log.position_m, position_gaps), (log.force_N, force_gaps)):
        for start, length in holes:
            channel[start : start + length] = np.inf if infinite else np.nan
    assert_same(signals_from_log(log, MACHINE), twin_chain(log, MACHINE))


@pytest.mark.parametrize("cutoff", [100.0, 500.0, 2000.0])
def test_time_of_signals_is_that_of_what_they_tell_of(cutoff: float) -> None:
    machine = with_cutoff(cutoff)
    position = smooth_motion(6000)[0]
    log = a_log(position, 100.0 * position)
    signals = signals_from_log(log, machine)
    time = signal_array(signals, STEP)[:, 4]
    assert time[0] == -chain_delay(machine)
    settled = slice(settle_samples(machine) + 1, None)
    then = np.interp(time, log.time_s, position)
    clock = np.abs(signals.position - position)[settled].max()
    assert np.abs(signals.position - then)[settled].max() < 0.02 * clock
    assert np.abs(signals.force - 100.0 * then)[settled].max() < 2.0 * clock
    # A part of them is as late, and counts its own samples; signals of a log of its own are not late.
    part = signals.part(slice(100, 200))
    assert part.delay == signals.delay and len(part) == 100
    np.testing.assert_array_equal(part.friction, signals.friction[100:200])
    zero = np.zeros(6000)
    for bring, late in (({"velocity_m_s": zero}, chain_delay(machine)), ({"friction_N": zero}, chain_delay(machine))):
        assert signals_from_log(replace(log, **bring), machine).delay == late
    bypassed = signals_from_log(replace(log, velocity_m_s=zero, friction_N=zero), machine)
    assert bypassed.delay == 0.0 and signal_array(bypassed, STEP)[0, 4] == 0.0


# --- missing samples --------------------------------------------------------------------------------------------


def test_short_gap_loses_no_displacement() -> None:
    log = a_log(0.2 * np.arange(900) / RATE)
    log.position_m[300 : 300 + SETTLE] = np.nan
    log.position_m[300 + SETTLE :] += 1e-4  # the axis went further than it was expected to
    signals = signals_from_log(log, MACHINE)
    np.testing.assert_allclose(np.cumsum(signals.velocity) * STEP, signals.position, atol=1e-15)
    np.testing.assert_allclose(signals.position[-1], log.position_m[-1], atol=5e-4)
    assert signals.velocity.max() > 0.3


def test_long_gap_restarts_the_difference() -> None:
    log = a_log(0.2 * np.arange(900) / RATE)
    log.position_m[300 : 301 + SETTLE] = np.nan
    log.position_m[301 + SETTLE :] += 0.5  # unseen travel is no velocity
    signals = signals_from_log(log, MACHINE)
    assert signals.velocity.max() < 0.25
    np.testing.assert_allclose(signals.position[-1], log.position_m[-1], atol=5e-4)


def test_position_continues_with_its_last_difference_through_a_gap() -> None:
    log = a_log(0.2 * np.arange(900) / RATE)
    whole = signals_from_log(log, MACHINE)
    log.position_m[300:320] = np.nan
    patched = signals_from_log(log, MACHINE)
    np.testing.assert_allclose(patched.position, whole.position, atol=1e-14)
    np.testing.assert_allclose(patched.velocity, whole.velocity, atol=1e-10)


def test_force_holds_through_a_gap() -> None:
    force = np.where(np.arange(400) < 200, 3.0, 5.0)
    force[150:250] = np.nan
    signals = signals_from_log(a_log(np.zeros(400), force), MACHINE)
    assert (signals.force[:251] == 3.0).all()
    np.testing.assert_allclose(signals.force[251 + SETTLE :], 5.0, atol=0.02)


@pytest.mark.parametrize("channel", ["position_m", "force_N"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_missing_sample_is_bridged_and_makes_friction_noisier_while_it_rings(channel: str, value: float) -> None:
    log = noisy_log(300)
    getattr(log, channel)[100] = value
    signals = signals_from_log(log, MACHINE)
    assert signals.noise is not None
    k = np.arange(300)
    np.testing.assert_array_equal(signals.missing, k == 100)
    np.testing.assert_array_equal(signals.valid, k >= SETTLE)
    np.testing.assert_array_equal(signals.noise > 1.0, (k >= 100) & (k <= 100 + SETTLE))
    assert (np.diff(signals.noise[100 : 101 + SETTLE]) < 0.0).all() and signals.noise[100] < 1.1


def lossy(log: Log, starts: NDArray[np.int64], length: int) -> Log:
    """The log without so many samples from each start on."""
    at = (starts[:, None] + np.arange(length)).ravel()
    log.position_m[at], log.force_N[at] = np.nan, np.nan
    return log


@pytest.mark.parametrize(("share", "used"), [(0.1, 0.99), (0.3, 0.85)])
def test_samples_lost_at_random_leave_friction_that_is_measured(share: float, used: float) -> None:
    starts = 100 + np.flatnonzero(np.random.default_rng(3).random(2800) < share)
    signals, whole = (
        signals_from_log(lossy(pure_mass(3000), starts, 1), MACHINE),
        signals_from_log(pure_mass(3000), MACHINE),
    )
    assert signals.valid[SETTLE:].mean() > used
    # Of a force up to 10 N that inertia takes whole.
    error = ((signals.friction - whole.friction) * signals.certainty)[signals.valid]
    assert np.sqrt(np.mean(error**2)) < 2e-3 * np.abs(whole.force).max()


def test_burst_spoils_friction_the_longer_the_longer_it_is() -> None:
    def count_lost(length: int) -> int:
        return int((~signals_from_log(lossy(noisy_log(300), np.array([100]), length), MACHINE).valid[SETTLE:]).sum())

    lost = [count_lost(length) for length in (1, 2, 3, 5, 10, 20, SETTLE)]
    assert lost[:2] == [0, 0] and lost == sorted(lost)
    assert lost[2] < 5 < lost[3] < 15 and lost[-1] > SETTLE
    assert count_lost(2 * SETTLE) > 3 * SETTLE - 10


def test_before_the_first_good_sample_the_axis_stands() -> None:
    log = noisy_log(300)
    log.position_m[:50], log.force_N[:70] = np.nan, np.nan
    signals = signals_from_log(log, MACHINE)
    assert (signals.velocity[:51] == 0).all()
    assert (signals.position[:51] == log.position_m[50]).all()
    assert (signals.force[:71] == log.force_N[70]).all()
    assert np.argmax(signals.valid) == 70 + SETTLE


def test_channel_without_a_single_sample_gives_finite_signals_and_no_measurement() -> None:
    log = noisy_log(100)
    log.position_m[:], log.force_N[:] = np.nan, np.nan
    signals = signals_from_log(log, MACHINE)
    assert not signals.valid.any()
    assert np.isfinite([signals.position, signals.velocity, signals.force, signals.friction]).all()


def test_the_log_is_left_as_it_was() -> None:
    log = noisy_log(100)
    log.position_m[40:60], log.force_N[10] = np.nan, np.nan
    before = {name: values.copy() for name, values in log.columns.items()}
    signals_from_log(log, MACHINE)
    for name, values in log.columns.items():
        np.testing.assert_array_equal(values, before[name])


def test_record_shorter_than_the_settling_has_no_valid_friction() -> None:
    assert not signals_from_log(noisy_log(SETTLE), MACHINE).valid.any()
    assert signals_from_log(noisy_log(SETTLE + 1), MACHINE).valid.sum() == 1


# --- columns that replace what would be computed ----------------------------------------------------------------


def test_velocity_and_friction_bypass_the_chain() -> None:
    base, n = noisy_log(50), 50
    velocity, friction = np.random.default_rng(2).normal(size=(2, n))
    signals = signals_from_log(replace(base, velocity_m_s=velocity, friction_N=friction), MACHINE)
    for name, values in (("velocity", velocity), ("friction", friction), ("force", base.force_N)):
        np.testing.assert_array_equal(getattr(signals, name), values)
    np.testing.assert_array_equal(signals.position, base.position_m)
    np.testing.assert_allclose(signals.acceleration[1:], np.diff(velocity) * RATE)
    assert signals.valid.all()
    given_acceleration = replace(base, velocity_m_s=velocity, friction_N=friction, acceleration_m_s2=velocity)
    np.testing.assert_array_equal(signals_from_log(given_acceleration, MACHINE).acceleration, velocity)


def test_bypassed_log_misses_only_the_missing_sample() -> None:
    velocity, friction = np.random.default_rng(2).normal(size=(2, 50))
    log = replace(noisy_log(50), velocity_m_s=velocity.copy(), friction_N=friction.copy())
    assert log.velocity_m_s is not None and log.friction_N is not None
    log.velocity_m_s[[0, 10, 11]], log.friction_N[20], log.force_N[30] = np.nan, np.inf, np.nan
    signals = signals_from_log(log, MACHINE)
    np.testing.assert_array_equal(np.flatnonzero(~signals.valid), [0, 10, 11, 20, 30])
    assert signals.velocity[0] == 0.0
    assert (signals.velocity[[10, 11]] == velocity[9]).all()
    assert signals.friction[20] == friction[19]
    assert signals.force[30] == log.force_N[29]


def test_single_velocity_column_takes_the_place_of_the_difference() -> None:
    log = noisy_log(400)
    raw = np.diff(log.position_m, prepend=log.position_m[0]) * RATE
    plain = signals_from_log(log, MACHINE)
    replaced = signals_from_log(replace(log, velocity_m_s=raw), MACHINE)
    for name in ("position", "velocity", "acceleration", "force", "friction", "valid"):
        np.testing.assert_allclose(getattr(replaced, name), getattr(plain, name), rtol=1e-12, err_msg=name)
    doubled = signals_from_log(replace(log, velocity_m_s=2 * raw), MACHINE)
    np.testing.assert_allclose(doubled.acceleration, 2 * plain.acceleration, rtol=1e-12)


@pytest.mark.parametrize(("column", "signal"), [("acceleration_m_s2", "acceleration"), ("friction_N", "friction")])
def test_single_column_passes_the_same_filters_and_delay(column: str, signal: str) -> None:
    log = noisy_log(400)
    values = np.random.default_rng(3).normal(size=400)
    values[0] = 0.0  # the filters start at rest on it, whichever kind
    plain = signals_from_log(log, MACHINE)
    signals = signals_from_log(with_column(log, column, values), MACHINE)
    coefficients = lowpass_coefficients(MACHINE)
    expected = twin_lowpass(coefficients, twin_lowpass(coefficients, np.r_[0.0, values[:-1]]))
    np.testing.assert_allclose(getattr(signals, signal), expected, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(signals.velocity, plain.velocity)
    np.testing.assert_array_equal(signals.valid, plain.valid)
    if column == "acceleration_m_s2":
        np.testing.assert_allclose(signals.friction, signals.force - MASS * expected, atol=1e-12)


@pytest.mark.parametrize("column", ["velocity_m_s", "acceleration_m_s2", "friction_N"])
def test_missing_sample_of_a_single_column_invalidates_friction(column: str) -> None:
    values = np.ones(300)
    values[100] = np.nan
    signals = signals_from_log(with_column(noisy_log(300), column, values), MACHINE)
    assert np.isfinite(signals.friction).all()
    np.testing.assert_array_equal(np.flatnonzero(~signals.valid[SETTLE:]) + SETTLE, np.arange(100, 101 + SETTLE))


# --- records, known to their end --------------------------------------------------------------------------------


def pure_mass(n: int) -> Log:
    """A mass without friction in smooth strokes."""
    position, acceleration, _, _ = smooth_motion(n)
    return a_log(position, MASS * acceleration)


def without(log: Log, name: str, start: int, end: int) -> Log:
    values = getattr(log, name).copy()
    values[start:end] = np.nan
    return with_column(log, name, values)


def test_record_without_a_gap_is_what_a_controller_sees() -> None:
    assert_same(signals_of_record(noisy_log(), MACHINE), signals_from_log(noisy_log(), MACHINE))
    missing = without(noisy_log(), "position_m", 0, 600)
    assert_same(signals_of_record(missing, MACHINE), signals_from_log(missing, MACHINE))


@pytest.mark.parametrize("name", ["position_m", "force_N"])
@pytest.mark.parametrize("length", [1, SETTLE, 3 * SETTLE, 300])
def test_gap_in_a_record_leaves_no_transient(name: str, length: int) -> None:
    whole = pure_mass(3000)
    log = without(whole, name, 700, 700 + length)  # in mid-stroke, at 0.3 m/s
    signals, complete = signals_of_record(log, MACHINE), signals_from_log(whole, MACHINE)
    assert signals.valid.sum() == 3000 - SETTLE - length - 2 * SETTLE
    assert not signals.valid[700 : 700 + length + 2 * SETTLE].any()
    np.testing.assert_array_equal(signals.missing, ~np.isfinite(getattr(log, name)))
    # No displacement is lost, whatever the length; what is left of friction is what a whole record leaves.
    np.testing.assert_allclose(signals.position[-500:], complete.position[-500:], rtol=1e-12)
    np.testing.assert_allclose(signals.velocity[signals.valid], complete.velocity[signals.valid], atol=1e-4)
    left = np.abs(signals.friction - complete.friction)[signals.valid].max()
    assert left < 2e-3 * MASS * np.abs(complete.acceleration).max()
    causal = signals_from_log(log, MACHINE)
    if length > 1:
        assert np.abs(causal.friction - complete.friction)[causal.valid].max() > 3.0 * left


def test_gaps_at_the_ends_of_a_record_are_left_to_the_chain() -> None:
    log = without(without(pure_mass(1000), "position_m", 0, 50), "force_N", 900, 1000)
    signals = signals_of_record(log, MACHINE)
    assert np.isfinite(signals.friction).all()
    assert np.flatnonzero(signals.valid)[[0, -1]].tolist() == [50 + 2 * SETTLE, 899]


def test_reading_between_two_gaps_is_kept() -> None:
    log = without(without(pure_mass(2000), "position_m", 700, 720), "position_m", 721, 740)
    signals, complete = signals_of_record(log, MACHINE), signals_from_log(pure_mass(2000), MACHINE)
    np.testing.assert_allclose(signals.friction[signals.valid], complete.friction[signals.valid], atol=0.05)


def test_bypassed_record_misses_only_the_missing_sample() -> None:
    n = 400
    log = a_log(np.linspace(0.0, 0.01, n), np.ones(n), velocity_m_s=np.linspace(0.0, 1.0, n), friction_N=np.ones(n))
    signals = signals_of_record(without(log, "velocity_m_s", 100, 120), MACHINE)
    np.testing.assert_array_equal(np.flatnonzero(~signals.valid), np.arange(100, 120))
    np.testing.assert_allclose(signals.velocity, log.velocity_m_s)
