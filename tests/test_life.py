"""What a package does over its life: settings, payload, parameters held or set, a power cycle."""

import ctypes
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from c_packages import elements, machine, probed
from sgms_bench.motions import simulated_log
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.bindings import BINDINGS
from sgms_mhe.emission.package import emit_package
from sgms_mhe.machine import Machine
from sgms_mhe.model import build_model
from sgms_mhe.reference import NodeRecord, ReferenceIntegrator, Start, Weights, run_ekf, run_mhe
from sgms_mhe.signals.chain import Signals, settle_samples, signals_from_log
from sgms_mhe.signals.estimates import Estimates
from sgms_mhe.signals.logs import Log

Array = NDArray[np.float64]

BASE: dict[str, Any] = {
    "friction": elements(2),
    "sampling": {"rate": 1000.0, "update_rate": 50.0, "velocity_cutoff": 50.0, "integrator": {"scheme": "flow"}},
}
KINDS: dict[str, dict[str, Any]] = {
    "all": {"relinearise": "all"},
    "auto": {"relinearise": "auto"},
    "newest": {"relinearise": "newest"},
    "fixed": {"arrival_cost": {"update": "fixed"}},
    "ekf": {"kind": "ekf"},
}
UNBOUNDED: dict[str, Any] = {"parameters": ["stiffness", "coulomb"], "bounds": {}}
TOLERANCE = {"double": 1e-6, "single": 2e-3}
"""Of parameters over nominal; what the packages' comparison with the reference allows."""
HELD = 1e-6
FORMAT = 2


def settings_of(kind: str = "all", precision: str = "double", **changes: Any) -> Machine:
    """A small axis whose estimator is of a kind: 20 samples an update, six intervals."""
    estimator = {"horizon": 6, **(KINDS | {"unbounded": UNBOUNDED})[kind], **changes.pop("estimator", {})}
    return machine(**BASE, estimator=estimator, code={"precision": precision}, **changes)


class Package:
    """One package's functions, the public ones called as an application does."""

    def __init__(self, settings: Machine, folder: Path) -> None:
        self.machine = settings
        self.model = build_model(settings)
        name = settings.name
        self.c = probed(settings, folder)
        self.real = ctypes.c_float if settings.code.precision == "single" else ctypes.c_double
        number, memory = ctypes.c_double, ctypes.c_void_p
        self.c.probe_sample.restype, self.c.probe_sample.argtypes = number, [memory, number, number]
        n_x, n_p, real = self.model.n_x, self.model.n_p, self.real

        class Settings(ctypes.Structure):
            _fields_ = (
                ("measurement", real),
                ("state", real * n_x),
                ("parameter", real * n_p),
                *((("drift", real * n_p),) if settings.estimator.arrival_cost.update != "fixed" else ()),
                ("pause", real * n_p),
                ("lower", real * n_p),
                ("upper", real * n_p),
            )

        class Saved(ctypes.Structure):
            _fields_ = (
                ("checksum", ctypes.c_uint32),
                ("format", ctypes.c_uint32),
                ("machine", ctypes.c_uint32 * 2),
                ("theta", real * n_p),
                ("root", real * (n_p * (n_p + 1) // 2)),
                ("spread", real * n_p),
                ("ratio", real),
            )

        self.Settings, self.Saved = Settings, Saved
        self.refused = int(self.c.probe_status(11))

        class Position(ctypes.Structure):
            _fields_ = (("value", ctypes.c_double if real is ctypes.c_double else ctypes.c_int64),)

        self.Position = Position
        for function, arguments in (
            *((("set_origin", [memory, Position]),) if "force_ripple" in [e.name for e in settings.effects] else ()),
            ("settings", [ctypes.POINTER(Settings)]),
            ("init_with", [memory, ctypes.POINTER(Settings)]),
            ("set_mass", [memory, real]),
            ("hold", [memory, ctypes.c_int, ctypes.c_int]),
            ("set_parameter", [memory, ctypes.c_int, real, real]),
            ("save", [memory, ctypes.POINTER(Saved)]),
            ("load", [memory, ctypes.POINTER(Saved)]),
        ):
            called = getattr(self.c, f"{name}_{function}")
            called.argtypes = arguments
            setattr(self, function, called)

    def new(self) -> ctypes.Array[ctypes.c_char]:
        memory = ctypes.create_string_buffer(self.c.probe_size())
        self.c.probe_init_on(memory, 0)
        return memory

    def place(self, metres: float) -> Any:
        """The package's own type of a position; infinite: none."""
        if self.real is ctypes.c_double:
            return self.Position(metres)
        return self.Position(round(1e12 * metres) if np.isfinite(metres) else 2**63 - 1)

    def defaults(self) -> Any:
        settings = self.Settings()
        self.settings(ctypes.byref(settings))
        return settings

    def saved(self, memory: Any) -> Any:
        saved = self.Saved()
        assert self.save(memory, ctypes.byref(saved)) == 0
        return saved

    def run(self, memory: Any, log: Log, first: int = 0, last: int | None = None) -> Array:
        """Two tasks over samples of a log; friction, measured, z, parameters, deviations after every update."""
        rows = []
        for q, u in zip(log.position_m[first:last], log.force_N[first:last], strict=True):
            self.c.probe_sample(memory, float(q), float(u))
            if self.c.probe_due(memory):
                self.c.probe_feedback(memory)
                self.c.probe_prepare(memory)
                row = np.empty(int(self.c.probe_numbers()))
                self.c.probe_estimate(memory, ctypes.c_void_p(row.ctypes.data))
                rows.append(row)
        return np.array(rows)

    def parameters(self, rows: Array) -> Array:
        """Over nominal (n, n_p)."""
        n_p = self.model.n_p
        return np.asarray(rows[:, -2 * n_p : -n_p] / [p.nominal for p in self.model.parameters])

    def agrees(self, rows: Array, reference: Estimates) -> None:
        """Parameters, their deviations and friction are the reference's."""
        precision = self.machine.code.precision
        n_p, nominal = self.model.n_p, np.array([p.nominal for p in self.model.parameters])
        assert len(rows) == len(reference.friction_N) > 20
        np.testing.assert_allclose(self.parameters(rows), reference.parameters / nominal, atol=TOLERANCE[precision])
        np.testing.assert_allclose(rows[:, -n_p:] / nominal, reference.std / nominal, atol=TOLERANCE[precision])
        np.testing.assert_allclose(rows[:, 0], reference.friction_N, atol=10.0 * TOLERANCE[precision])


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Package]:
    @lru_cache
    def made(kind: str = "all", precision: str = "double") -> Package:
        return Package(settings_of(kind, precision), tmp_path_factory.mktemp("life"))

    return made


@lru_cache
def log_of(updates: int = 60, stiffer: float = 1.3) -> Log:
    """An axis whose elements are stiffer than the machine file says."""
    friction = BASE["friction"] | {"stiffness": [stiffer * kappa for kappa in BASE["friction"]["stiffness"]]}
    return simulated_log(machine(**(BASE | {"friction": friction}), estimator={"horizon": 6}), "mixed", updates)


def reference(
    package: Package, signals: Signals, *, weights: Weights | None = None, start: Start | None = None
) -> Estimates:
    """The independent solver on the package's machine."""
    record = NodeRecord(package.model, signals, ReferenceIntegrator(package.model), weights=weights, start=start)
    return run_ekf(record) if package.machine.estimator.kind == "ekf" else run_mhe(record)


# --- settings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "precision"), [*((kind, "double") for kind in KINDS), ("auto", "single")])
def test_replaced_settings_give_what_the_reference_gives(kind: str, precision: str, package: Any) -> None:
    noise = {"measurement": 0.25, "state": 0.03, "parameter": 0.2, "parameter_drift": 0.006}
    other = settings_of(kind, precision, estimator={"noise": noise, "bounds": {"stiffness": [0.97, 1.1]}})
    p: Package = package(kind, precision)
    settings, memory, log = p.defaults(), p.new(), log_of()
    settings.measurement, settings.parameter[:] = noise["measurement"], [noise["parameter"]] * p.model.n_p
    settings.state[:] = [noise["state"]] * p.model.n_x
    settings.lower[:], settings.upper[:] = [0.97] * p.model.n_p, [1.1] * p.model.n_p
    if kind != "fixed":
        settings.drift[:] = [noise["parameter_drift"]] * p.model.n_p
    assert p.init_with(memory, ctypes.byref(settings)) == 0
    expected = reference(p, signals_from_log(log, other), weights=Weights.of(build_model(other)))
    rows = p.run(memory, log)
    p.agrees(rows, expected)
    assert np.abs(p.parameters(rows)[:, :, None] - [0.97, 1.1]).min() < 1e-6, "a bound is met"
    assert np.abs(p.parameters(rows) - p.parameters(p.run(p.new(), log))).max() > 0.05, "the weights matter"


def test_settings_are_those_of_the_machine_file(package: Any) -> None:
    p: Package = package()
    settings, noise = p.defaults(), p.machine.estimator.noise
    assert settings.measurement == noise.measurement
    for field, value in (("parameter", 1.0), ("drift", noise.parameter_drift / noise.parameter), ("pause", 0.25)):
        assert list(getattr(settings, field)) == pytest.approx([value * noise.parameter] * p.model.n_p, rel=1e-15)
    assert list(settings.state) == list(p.model.state_noise)
    assert [(q.lower, q.upper) for q in p.model.parameters] == list(zip(settings.lower, settings.upper, strict=True))
    with_them, plain = p.new(), p.new()
    assert p.init_with(with_them, ctypes.byref(settings)) == 0
    assert with_them.raw == plain.raw


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((field, value) for field in ("measurement", "parameter") for value in (0.0, -0.1, np.nan, np.inf, 1e-320)),
        *((field, value) for field in ("drift", "pause") for value in (-1e-9, np.nan, np.inf)),
        *(("state", value) for value in (0.0, np.nan, -1.0)),
        *(("lower", value) for value in (np.nan, -np.inf, 1.01, 6.0)),
        *(("upper", value) for value in (np.nan, np.inf, 0.99, 0.1)),
    ],
)
def test_settings_that_cannot_be_are_refused(field: str, value: float, package: Any) -> None:
    p: Package = package()
    settings, memory = p.defaults(), p.new()
    p.run(memory, log_of(), last=300)
    if field == "measurement":
        settings.measurement = value
    else:
        getattr(settings, field)[1] = value
    ctypes.memset(memory, 0, len(memory))
    assert p.init_with(memory, ctypes.byref(settings)) == p.refused
    assert memory.raw == p.new().raw


# --- payload -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["all", "ekf"])
@pytest.mark.parametrize("mass", [12.0, 31.0])
def test_mass_gives_what_the_reference_gives(kind: str, mass: float, package: Any) -> None:
    p: Package = package(kind)
    memory, log = p.new(), log_of()
    assert p.set_mass(memory, mass) == 0
    rows = p.run(memory, log)
    loaded = settings_of(kind, plant={"mass": mass})
    p.agrees(rows, reference(p, signals_from_log(log, loaded)))
    assert np.abs(rows[:, 1] - p.run(p.new(), log)[:, 1]).max() > 1.0, "the friction is another"


def test_mass_that_changes_underway_is_followed(package: Any) -> None:
    """A payload is put on where the axis hardly moves; readings are left out while the filters hold both."""
    p: Package = package()
    light, log = p.machine, log_of(100)
    heavy = settings_of(plant={"mass": 31.0})
    settle = settle_samples(light)
    by_light, by_heavy = (signals_from_log(log, m) for m in (light, heavy))
    quiet = np.convolve(np.abs(by_light.acceleration), np.ones(2 * settle), mode="same")
    at = 300 + int(np.argmin(quiet[300:1200]))
    extra = np.where(np.arange(len(log.time_s)) < at, 0.0, 11.0)
    # What the axis with its payload would have logged: the same friction, more force.
    acceleration = np.gradient(np.gradient(log.position_m)) * log.rate**2
    loaded = replace(log, force_N=log.force_N + extra * acceleration)
    by_light, by_heavy = (signals_from_log(loaded, m) for m in (light, heavy))
    after = np.arange(len(log.time_s)) >= at
    mixed = (after) & (np.arange(len(log.time_s)) < at + settle)
    signals = replace(
        by_light, friction=np.where(after, by_heavy.friction, by_light.friction), valid=by_light.valid & ~mixed
    )
    memory = p.new()
    first = p.run(memory, loaded, last=at)
    assert p.set_mass(memory, 31.0) == 0
    rows = np.concatenate([first, p.run(memory, loaded, at)])
    p.agrees(rows, reference(p, signals))
    unaware = p.new()
    assert np.abs(p.run(unaware, loaded)[-20:, 1] - rows[-20:, 1]).max() > 1.0


@pytest.mark.parametrize("mass", [0.0, -20.0, np.nan, np.inf, 0.99, 401.0, 2e4])
def test_mass_out_of_range_is_refused(mass: float, package: Any) -> None:
    p: Package = package()
    memory = p.new()
    p.run(memory, log_of(), last=210)
    before = memory.raw
    assert p.set_mass(memory, mass) == p.refused
    assert memory.raw == before


def test_mass_in_the_equations_of_an_effect_is_not_changed(tmp_path: Path) -> None:
    gained = settings_of(effects=[{"name": "force_gain", "gain": 1.05}])
    p = Package(gained, tmp_path)
    memory = p.new()
    assert p.set_mass(memory, 21.0) == p.refused
    assert p.set_mass(memory, 20.0) == 0
    assert build_model(gained).reads_mass
    for name, numbers in (("constant_offset", {"force_N": 0.5}), ("mass_mismatch", {"mass_kg": 1.0})):
        assert not build_model(settings_of(effects=[{"name": name, **numbers}])).reads_mass


# --- origin ------------------------------------------------------------------------------------------------------

PLACES: list[dict[str, Any]] = [
    {"name": "force_ripple", "amplitude_N": 1.5, "pitch_m": 0.003, "phase_rad": 0.4},
    {"name": "position_spring", "stiffness_N_m": 8.0, "centre_m": 0.02},
]
ORIGIN = -0.0671
MERGING: dict[str, Any] = {"estimator": {"relinearise": "auto"}, "sampling": {"integrator": {"substeps": 5}}}


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Package]:
    """Packages whose force depends on the place."""

    @lru_cache
    def made(kind: str = "all", precision: str = "double") -> Package:
        settings = settings_of("auto" if kind == "merged" else kind, precision, effects=PLACES)
        settings = override_machine(settings, MERGING) if kind == "merged" else settings
        return Package(settings, tmp_path_factory.mktemp("places"))

    return made


@lru_cache
def log_of_places() -> Log:
    """An axis with a stiffer friction than the machine file says, counted from its home."""
    friction = BASE["friction"] | {"stiffness": [1.3 * kappa for kappa in BASE["friction"]["stiffness"]]}
    axis = machine(**(BASE | {"friction": friction}), estimator={"horizon": 6}, effects=PLACES)
    return simulated_log(axis, "mixed", 60)


def moved(log: Log, origin: float = ORIGIN) -> Log:
    """The same motion as an axis logs it whose counter reads `origin` at home."""
    return replace(log, position_m=log.position_m + origin)


@pytest.mark.parametrize(
    ("kind", "precision"),
    [*((kind, "double") for kind in (*KINDS, "merged")), ("auto", "single"), ("merged", "single"), ("ekf", "single")],
)
def test_origin_gives_what_the_reference_gives_of_the_homed_axis(kind: str, precision: str, placed: Any) -> None:
    p: Package = placed(kind, precision)
    memory, log = p.new(), log_of_places()
    assert p.set_origin(memory, p.place(ORIGIN)) == 0
    rows = p.run(memory, moved(log))
    expected = reference(p, signals_from_log(log, p.machine))
    p.agrees(rows, expected)
    unaware = p.run(p.new(), moved(log))
    assert np.abs(p.parameters(unaware) - p.parameters(rows)).max() > 0.05, "the place matters"


@pytest.mark.parametrize(
    ("kind", "precision"),
    [("all", "double"), ("auto", "double"), ("merged", "double"), ("ekf", "double"), ("auto", "single")],
)
def test_origin_is_set_underway(kind: str, precision: str, placed: Any) -> None:
    """The window starts anew at the last estimate, and all that is known of the parameters stays."""
    p: Package = placed(kind, precision)
    memory, log, at = p.new(), moved(log_of_places()), 401
    rows = p.run(memory, log, last=at)
    saved, n_p = p.saved(memory), p.model.n_p
    root = np.zeros((n_p, n_p))
    root[np.triu_indices(n_p)] = saved.root
    covariance = np.linalg.inv(root.T @ root)
    prior = Weights.of(p.model).parameter
    spread = (np.array(saved.spread) - 1.0) * np.diag(covariance)
    covariance += np.diag(np.minimum(spread, np.maximum(0.0, prior**2 - np.diag(covariance))))
    assert p.set_origin(memory, p.place(ORIGIN)) == 0
    friction, theta = p.machine.friction, np.array(saved.theta)
    level = np.array(friction.fraction) * friction.coulomb
    start = Start(x=rows[-1, 2:4] * theta * friction.stiffness / level, theta=theta, covariance=covariance)
    signals = signals_from_log(log, p.machine)
    signals = tail(replace(signals, position=signals.position - ORIGIN), at - 1)
    expected = reference(p, signals, start=start)
    p.agrees(p.run(memory, log, at), expected)


@pytest.mark.parametrize("kind", ["auto", "merged"])
def test_force_ahead_is_that_of_the_place(kind: str, placed: Any) -> None:
    p: Package = placed(kind)
    log, homed, other, late = log_of_places(), p.new(), p.new(), p.new()
    assert p.set_origin(other, p.place(ORIGIN)) == 0
    fed = []
    for k, (q, u) in enumerate(zip(log.position_m, log.force_N, strict=True)):
        if k == 700:
            assert p.set_origin(late, p.place(ORIGIN)) == 0
        fed.append(
            [p.c.probe_sample(m, float(q + o), float(u)) for m, o in ((homed, 0.0), (other, ORIGIN), (late, ORIGIN))]
        )
        for m in (homed, other, late):
            if p.c.probe_due(m):
                p.c.probe_feedback(m)
                p.c.probe_prepare(m)
    forces = np.array(fed)
    assert np.ptp(forces[:, 0]) > 5.0
    np.testing.assert_allclose(forces[:, 1], forces[:, 0], atol=1e-6)
    apart = np.abs(forces[:, 2] - forces[:, 0])
    assert apart[500:700].max() > 2.0 and apart[700:900].max() < 0.1


def test_signals_of_another_chain_count_from_the_origin(placed: Any) -> None:
    p: Package = placed()
    signals = signals_from_log(log_of_places(), p.machine)
    columns = np.column_stack(
        [signals.position, signals.velocity, signals.acceleration, signals.force, signals.friction]
    )
    found = []
    for origin in (0.0, ORIGIN):
        memory, shift = p.new(), np.array([origin, 0.0, 0.0, 0.0, 0.0])
        assert p.set_origin(memory, p.place(origin)) == 0
        p.c.probe_insert.restype = ctypes.c_double
        for row, valid in zip(columns + shift, signals.valid, strict=True):
            p.c.probe_insert(memory, np.ascontiguousarray(row).ctypes.data_as(ctypes.c_void_p), int(valid))
            if p.c.probe_due(memory):
                p.c.probe_feedback(memory)
                p.c.probe_prepare(memory)
        found.append(np.array(p.saved(memory).theta))
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    assert np.abs(found[0] - 1.0).max() > 0.05


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("origin", [np.inf, -np.inf, np.nan, 4e6, -5e6])
def test_origin_that_is_none_is_refused(origin: float, precision: str, placed: Any) -> None:
    p: Package = placed("auto", precision)
    memory = p.new()
    assert p.set_origin(memory, p.place(0.01)) == 0
    p.run(memory, moved(log_of_places(), 0.01), last=210)
    before = memory.raw
    assert p.set_origin(memory, p.place(origin)) == p.refused
    assert p.set_origin(memory, p.place(0.01)) == 0, "the same again"
    assert memory.raw == before


def test_origin_outlives_reset_and_load_and_no_power_cycle(placed: Any) -> None:
    p: Package = placed()
    memory, homed, log = p.new(), p.new(), log_of_places()
    assert p.set_origin(memory, p.place(ORIGIN)) == 0
    p.run(memory, moved(log), last=801)
    p.run(homed, log, last=801)
    saved = p.saved(homed)
    assert bytes(saved)[:4] != bytes(4) and ctypes.sizeof(saved) == ctypes.sizeof(p.saved(memory))
    for axis in (memory, homed):
        p.c.probe_reset(axis)
    np.testing.assert_allclose(p.run(memory, moved(log)), p.run(homed, log), atol=1e-6)
    for axis in (memory, homed):
        assert p.load(axis, ctypes.byref(saved)) == 0
    np.testing.assert_allclose(p.run(memory, moved(log)), p.run(homed, log), atol=1e-6)
    p.c.probe_init_on(memory, 0xA5)
    np.testing.assert_array_equal(p.run(memory, log), p.run(p.new(), log))


def test_packages_of_no_place_have_no_origin(package: Any) -> None:
    p: Package = package()
    assert not hasattr(p.c, f"{p.machine.name}_set_origin")
    assert not any(
        "origin" in text for text in emit_package(p.machine, selftest=True, bindings=BINDINGS).files.values()
    )


# --- parameters held and set -------------------------------------------------------------------------------------


def held_weights(p: Package, which: int) -> Weights:
    weights = Weights.of(p.model)
    parameter = weights.parameter.copy()
    parameter[which] = HELD
    return replace(weights, parameter=parameter)


@pytest.mark.parametrize("kind", list(KINDS))
def test_parameter_held_from_the_start(kind: str, package: Any) -> None:
    p: Package = package(kind)
    memory, log = p.new(), log_of()
    assert p.set_parameter(memory, 1, 1.2 * p.model.parameters[1].nominal, 0.0) == 0
    rows = p.run(memory, log)
    weights = held_weights(p, 1)
    start = Start(np.zeros(p.model.n_x), np.array([1.0, 1.2]), np.diag(weights.parameter**2))
    if kind != "fixed":  # a fixed arrival cost comes back to the machine file's prior mean by another way
        p.agrees(rows, reference(p, signals_from_log(log, p.machine), weights=weights, start=start))
    np.testing.assert_allclose(p.parameters(rows)[:, 1], 1.2, atol=1e-4)
    assert np.ptp(p.parameters(rows)[:, 0]) > 0.1


@pytest.mark.parametrize(("kind", "precision"), [("all", "double"), ("auto", "single"), ("ekf", "double")])
def test_warm_start_from_an_identification(kind: str, precision: str, package: Any) -> None:
    p: Package = package(kind, precision)
    memory, log = p.new(), log_of()
    values, deviations = np.array([1.25, 1.4]), np.array([0.05, 0.1])
    for k, q in enumerate(p.model.parameters):
        assert p.set_parameter(memory, k, values[k] * q.nominal, deviations[k] * q.nominal) == 0
    start = Start(np.zeros(p.model.n_x), values, np.diag(deviations**2))
    p.agrees(p.run(memory, log), reference(p, signals_from_log(log, p.machine), start=start))


def tail(signals: Signals, first: int) -> Signals:
    """From a sample on, whose own reading has been used."""
    changes = {name: getattr(signals, name)[first:] for name in vars(signals) if np.ndim(getattr(signals, name))}
    changes["valid"] = changes["valid"].copy()
    changes["valid"][0] = False
    return replace(signals, **changes)


@pytest.mark.parametrize("kind", ["all", "auto", "ekf"])
@pytest.mark.parametrize("way", ["hold", "set", "let go"])
def test_parameters_change_underway(kind: str, way: str, package: Any) -> None:
    """The window starts anew at the last estimate: what is known of the others is their marginal covariance."""
    p: Package = package(kind)
    memory, log, at = p.new(), log_of(), 401  # the first sample is no interval's
    if way == "let go":
        p.hold(memory, 0, 1)
    rows = p.run(memory, log, last=at)
    saved = p.saved(memory)
    n_p = p.model.n_p
    root = np.zeros((n_p, n_p))
    root[np.triu_indices(n_p)] = saved.root
    covariance = np.linalg.inv(root.T @ root)
    theta = np.array(saved.theta)
    covariance += np.diag((np.array(saved.spread) - 1.0) * np.diag(covariance))
    assert way == "let go" or abs(covariance[0, 1]) > 0.1 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    sd = {"hold": HELD, "set": 0.03, "let go": Weights.of(p.model).parameter[0]}[way]
    theta[0] = 1.3 if way == "set" else theta[0]
    if way == "set":
        assert (
            p.set_parameter(memory, 0, 1.3 * p.model.parameters[0].nominal, 0.03 * p.model.parameters[0].nominal) == 0
        )
    else:
        assert p.hold(memory, 0, int(way == "hold")) == 0
    friction = p.machine.friction
    stiffness = np.array(saved.theta) * friction.stiffness
    start = Start(
        x=rows[-1, 2:4] * stiffness / (np.array(friction.fraction) * friction.coulomb),
        theta=theta,
        covariance=np.diag([sd**2, covariance[1, 1]]),
    )
    weights = held_weights(p, 0) if way == "hold" else None
    signals = tail(signals_from_log(log, p.machine), at - 1)
    p.agrees(p.run(memory, log, at), reference(p, signals, weights=weights, start=start))


@pytest.mark.parametrize(
    ("parameter", "value", "deviation"),
    [
        *((parameter, 1.0, 0.1) for parameter in (-1, 2, 10**6)),
        *((0, value, 0.1) for value in (np.nan, np.inf, 0.19, 5.1, -1.0)),
        *((0, 1.0, deviation) for deviation in (np.nan, np.inf, -0.1, 1e-9)),
    ],
)
def test_parameter_that_cannot_be_is_refused(parameter: int, value: float, deviation: float, package: Any) -> None:
    p: Package = package()
    memory, nominal = p.new(), p.model.parameters[0].nominal
    p.run(memory, log_of(), last=210)
    before = memory.raw
    assert p.set_parameter(memory, parameter, value * nominal, deviation * nominal) == p.refused
    assert parameter in (0, 1) or p.hold(memory, parameter, 1) == p.refused
    assert memory.raw == before


@pytest.mark.parametrize("precision", ["double", "single"])
def test_level_that_leaves_no_model_is_refused(precision: str, package: Any) -> None:
    p: Package = package("unbounded", precision)
    memory, level = p.new(), p.model.n_p - 1
    p.run(memory, log_of(), last=210)
    before, nominal = memory.raw, p.model.parameters[level].nominal
    for deviation in (0.0, 0.1 * nominal):
        assert p.set_parameter(memory, level, 0.0, deviation) == p.refused
        assert memory.raw == before
    assert p.set_parameter(memory, level, 0.9 * nominal, 0.0) == 0


@pytest.mark.parametrize(("precision", "beyond"), [("double", 1e61), ("single", 1e13)])
def test_a_parameter_without_bounds_is_within_numbers(precision: str, beyond: float, tmp_path: Path) -> None:
    """One whose square is none was taken by set_parameter() and load(); what is computed with it is no number."""
    unbounded = {"parameters": ["coulomb"], "bounds": {}}
    p = Package(settings_of("all", precision, estimator=unbounded), tmp_path)
    memory, axis, nominal = p.new(), p.new(), p.model.parameters[0].nominal
    before = memory.raw
    for value in (beyond, -beyond):
        assert p.set_parameter(memory, 0, value * nominal, 0.0) == p.refused
        assert memory.raw == before
        saved = p.saved(memory)
        saved.theta[0] = value
        assert p.load(axis, ctypes.byref(sealed(saved))) == p.refused
        assert axis.raw == before
    assert p.set_parameter(memory, 0, 1e3 * nominal, 0.0) == 0


# --- over a power cycle ------------------------------------------------------------------------------------------


def sealed(saved: Any) -> Any:
    """With the checksum of what it holds now, by a library's CRC-32."""
    saved.checksum = zlib.crc32(bytes(saved)[4:])
    return saved


@pytest.mark.parametrize(("kind", "precision"), [*((kind, "double") for kind in KINDS), ("auto", "single")])
def test_loaded_axis_gives_what_the_reference_gives(kind: str, precision: str, package: Any) -> None:
    """From the saved mean and covariance, grown by what a pause may change."""
    p: Package = package(kind, precision)
    memory, log = p.new(), log_of()
    p.run(memory, log, last=801)
    saved, loaded, n_p = p.saved(memory), p.new(), p.model.n_p
    assert bytes(saved) == bytes(sealed(p.saved(memory))), "the checksum is a CRC-32"
    assert sum(getattr(p.Saved, name).size for name, _ in p.Saved._fields_) == ctypes.sizeof(p.Saved), "no padding"
    assert p.load(loaded, ctypes.byref(saved)) == 0
    root = np.zeros((n_p, n_p))
    root[np.triu_indices(n_p)] = saved.root
    covariance = np.linalg.inv(root.T @ root)
    prior, pause = Weights.of(p.model).parameter, np.array(p.defaults().pause)
    assert pause == pytest.approx(0.25 * prior)
    spread = (np.array(saved.spread) - 1.0) * np.diag(covariance)
    grown = np.minimum(pause**2 + spread, np.maximum(0.0, prior**2 - np.diag(covariance)))
    start = Start(np.zeros(p.model.n_x), np.array(saved.theta), covariance + np.diag(grown), saved.ratio)
    p.agrees(p.run(loaded, log), reference(p, signals_from_log(log, p.machine), start=start))


def test_loaded_axis_is_soon_as_good_as_one_that_ran_on(package: Any) -> None:
    """Within the first second after a power cycle; an axis that starts fresh is far from it."""
    p: Package = package()
    memory, log, truth = p.new(), log_of(400), 1.3
    p.run(memory, log, last=4001)
    saved, loaded = p.saved(memory), p.new()
    assert p.load(loaded, ctypes.byref(saved)) == 0
    error = {
        name: np.sqrt(np.mean((p.parameters(p.run(axis, log, 4001, 5001)) - truth) ** 2))
        for name, axis in (("on", memory), ("loaded", loaded), ("fresh", p.new()))
    }
    assert error["loaded"] < 1.3 * error["on"] + 0.01
    assert error["fresh"] > 3.0 * error["loaded"]


def test_loaded_numbers_stay_honest_where_the_pause_changed_the_axis(package: Any) -> None:
    """Parameters that moved by what a pause may change are within three of the stated deviations, and found again."""
    p: Package = package()
    memory, before, after = p.new(), log_of(400), log_of(200, 1.3 * 1.1)
    p.run(memory, before)
    saved, loaded, sure = p.saved(memory), p.new(), p.new()
    settings = p.defaults()
    settings.pause[:] = [0.0] * p.model.n_p
    p.init_with(sure, ctypes.byref(settings))
    assert p.load(loaded, ctypes.byref(saved)) == 0 and p.load(sure, ctypes.byref(saved)) == 0
    n_p, nominal = p.model.n_p, np.array([q.nominal for q in p.model.parameters])

    def off(axis: Any) -> Array:
        rows = p.run(axis, after)
        return np.asarray(np.abs(p.parameters(rows) - 1.43) / (rows[:, -n_p:] / nominal))

    honest = off(loaded)
    assert np.mean(honest < 3.0) > 0.95
    assert np.mean(off(sure)[:50] ** 2) > 1.5 * np.mean(honest[:50] ** 2)


@pytest.mark.parametrize(
    ("kind", "precision"), [("auto", "double"), ("auto", "single"), ("fixed", "double"), ("ekf", "double")]
)
def test_flipped_bit_of_settings_refuses_updates(kind: str, precision: str, package: Any) -> None:
    """Whichever bit, until it is back, and over a reset; the estimate stays, and init starts an axis as new."""
    p: Package = package(kind, precision)
    memory = p.new()
    before = p.run(memory, log_of(), last=221)[-1]

    def complete_interval() -> None:
        while not p.c.probe_due(memory):
            p.c.probe_sample(memory, 0.0, 0.0)

    def flip(bit: int) -> None:
        memory[bit // 8] = memory.raw[bit // 8] ^ 1 << bit % 8

    complete_interval()
    for bit in range(8 * ctypes.sizeof(p.Settings)):
        flip(bit)
        assert p.c.probe_feedback(memory) == p.refused, bit
        flip(bit)
    now = np.empty_like(before)
    assert p.c.probe_estimate(memory, ctypes.c_void_p(now.ctypes.data)) == p.refused
    np.testing.assert_array_equal(now, before)
    assert p.c.probe_feedback(memory) >= 0
    flip(3)
    p.c.probe_reset(memory)
    complete_interval()
    assert p.c.probe_feedback(memory) == p.refused
    p.c.probe_init_on(memory, 0)
    assert memory.raw == p.new().raw


def test_every_flipped_bit_is_refused_and_leaves_a_fresh_axis(package: Any) -> None:
    p: Package = package("auto")
    memory, axis, fresh = p.new(), p.new(), p.new().raw
    p.run(memory, log_of(), last=801)
    saved = bytes(p.saved(memory))
    for bit in range(8 * len(saved)):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        assert p.load(axis, ctypes.byref(p.Saved.from_buffer(damaged))) == p.refused
    assert p.load(axis, ctypes.byref(p.Saved.from_buffer(bytearray(saved)))) == 0
    ctypes.memset(axis, 0, len(axis))
    p.c.probe_init_on(axis, 0)
    for byte in (0x00, 0xFF, 0xA5):
        assert p.load(axis, ctypes.byref(p.Saved.from_buffer(bytearray([byte]) * len(saved)))) == p.refused
        assert axis.raw == fresh


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("another layout", {"format": FORMAT + 1}),
        ("an earlier layout", {"format": 0}),
        ("another machine", {"machine": (1, 2)}),
        ("no number", {"theta": (1.0, np.nan)}),
        ("an infinite one", {"root": (1.0, np.inf, 1.0)}),
        ("nothing known of one", {"root": (1.0, 0.0, 0.0)}),
        ("known beyond all numbers", {"root": (1e200, 0.0, 1.0)}),
        ("beyond a bound", {"theta": (1.0, 5.1)}),
        ("no ratio", {"ratio": np.nan}),
        ("no ratio that can be", {"ratio": -1.0}),
        ("no spread", {"spread": (1.0, np.nan)}),
        ("an infinite spread", {"spread": (np.inf, 1.0)}),
        ("a spread that narrows", {"spread": (0.9, 1.0)}),
    ],
)
def test_sealed_nonsense_is_refused(what: str, change: dict[str, Any], package: Any) -> None:
    p: Package = package()
    memory, axis = p.new(), p.new()
    p.run(memory, log_of(), last=801)
    saved = p.saved(memory)
    assert p.load(axis, ctypes.byref(sealed(saved))) == 0
    for name, value in change.items():
        if isinstance(value, tuple):
            getattr(saved, name)[:] = value
        else:
            setattr(saved, name, value)
    p.c.probe_init_on(axis, 0)
    assert p.load(axis, ctypes.byref(sealed(saved))) == p.refused, what
    assert axis.raw == p.new().raw


def test_what_another_machine_saved_is_refused(package: Any, tmp_path: Path) -> None:
    p: Package = package()
    other = Package(settings_of(estimator={"noise": {"measurement": 0.11}}), tmp_path)
    memory = other.new()
    other.run(memory, log_of(), last=801)
    saved = other.saved(memory)
    assert p.load(p.new(), ctypes.byref(p.Saved.from_buffer_copy(bytes(saved)))) == p.refused
    assert other.load(other.new(), ctypes.byref(saved)) == 0


def test_settings_and_mass_outlive_a_load_and_held_ones_do_not(package: Any) -> None:
    p: Package = package()
    memory, log = p.new(), log_of()
    p.run(memory, log, last=801)
    saved, axis, settings = p.saved(memory), p.new(), p.defaults()
    settings.measurement = 0.2
    assert p.init_with(axis, ctypes.byref(settings)) == 0
    assert p.set_mass(axis, 21.0) == 0 and p.hold(axis, 0, 1) == 0
    assert p.load(axis, ctypes.byref(saved)) == 0
    expected = p.new()
    assert p.init_with(expected, ctypes.byref(settings)) == 0
    assert p.set_mass(expected, 21.0) == 0 and p.load(expected, ctypes.byref(saved)) == 0
    np.testing.assert_array_equal(p.run(axis, log), p.run(expected, log))
    again = p.saved(expected)
    assert p.load(expected, ctypes.byref(again)) == 0


def test_saved_once_and_loaded_is_saved_the_same(package: Any) -> None:
    """Without a pause nothing is lost and nothing grows."""
    p: Package = package()
    memory, axis, settings = p.new(), p.new(), p.defaults()
    p.run(memory, log_of(), last=801)
    settings.pause[:] = [0.0] * p.model.n_p
    saved = p.saved(memory)
    assert p.init_with(axis, ctypes.byref(settings)) == 0 and p.load(axis, ctypes.byref(saved)) == 0
    assert bytes(p.saved(axis)) == bytes(saved)


@lru_cache
def contradicted() -> Log:
    """A log with a force that the model has not."""
    log = log_of(200)
    return replace(log, force_N=log.force_N + 2.0 * np.sin(2.0 * np.pi * log.time_s / 3.0))


def covariance_of(saved: Any, n_p: int) -> Array:
    root = np.zeros((n_p, n_p))
    root[np.triu_indices(n_p)] = saved.root
    return np.linalg.inv(root.T @ root)


@pytest.mark.parametrize(("kind", "precision"), [("all", "double"), ("auto", "single"), ("ekf", "double")])
def test_spread_is_stated_saved_loaded_and_kept_by_what_is_set(kind: str, precision: str, package: Any) -> None:
    """The factor of the model's errors on the variances stays in them whenever the window starts anew."""
    p: Package = package(kind, precision)
    memory, n_p, prior = p.new(), p.model.n_p, Weights.of(p.model).parameter
    nominal, rtol = np.array([q.nominal for q in p.model.parameters]), {"double": 1e-9, "single": 1e-3}[precision]
    rows = p.run(memory, contradicted())
    saved = p.saved(memory)
    spread, variance = np.array(saved.spread), np.diag(covariance_of(saved, n_p))
    assert np.all(spread > 1.5), spread
    np.testing.assert_allclose(rows[-1, -n_p:] / nominal, np.sqrt(variance * spread), rtol=rtol)
    widened = variance + np.minimum((spread - 1.0) * variance, np.maximum(0.0, prior**2 - variance))

    loaded, settings = p.new(), p.defaults()
    settings.pause[:] = [0.0] * p.model.n_p
    assert p.init_with(loaded, ctypes.byref(settings)) == 0 and p.load(loaded, ctypes.byref(saved)) == 0
    again = p.saved(loaded)
    np.testing.assert_allclose(np.diag(covariance_of(again, n_p)), widened, rtol=rtol)
    np.testing.assert_array_equal(np.array(again.spread), 1.0)

    assert p.hold(memory, 0, 1) == 0
    held = p.saved(memory)
    np.testing.assert_allclose(np.diag(covariance_of(held, n_p)), [HELD**2, widened[1]], rtol=rtol)
    np.testing.assert_array_equal(np.array(held.spread), 1.0)
    assert p.hold(memory, 0, 1) == 0
    np.testing.assert_allclose(np.diag(covariance_of(p.saved(memory), n_p)), [HELD**2, widened[1]], rtol=rtol)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_saved_data_of_the_smallest_prior_are_taken_back(precision: str, package: Any) -> None:
    """Deviations stay finite, and what was saved is no nonsense, where variances are hardly numbers any more."""
    p: Package = package("ekf", precision)
    memory, settings = p.new(), p.defaults()
    settings.measurement = {"double": 1e-59, "single": 1.1e-12}[precision]
    settings.parameter[:], settings.drift[:] = [settings.measurement] * p.model.n_p, [0.0] * p.model.n_p
    assert p.init_with(memory, ctypes.byref(settings)) == 0
    rows = p.run(memory, contradicted())
    assert np.all(np.isfinite(rows))
    assert np.all(np.isfinite(np.array(p.saved(memory).spread)))
    assert p.load(p.new(), ctypes.byref(p.saved(memory))) == 0
