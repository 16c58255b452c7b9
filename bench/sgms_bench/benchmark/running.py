"""Cost of an update on this host and error of its integration, beside the same problem by a peer's code.

Time and instructions of the emitted C are those of all the work between two updates, as `bench/c/harness.c` calls it:
the samples of one interval through the signal chain and the newest interval, feedback, prepare; in the variants that
say so also the force fed forward at every sample, which is no part of an estimate. Those of a peer are residual and
Jacobian of one window and nothing else: no signals, no solution, no arrival cost. Only instruction counts
compare between machines; time is that of this host, and says something as a ratio within one run.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from sgms_bench.benchmark.harness import build_harness, fastest_runs, instructions_of
from sgms_bench.benchmark.integration_errors import SampledMotion, emitted_errors, largest_magnitude
from sgms_bench.benchmark.peers import KINDS, Kind, PeerExport, Windows
from sgms_bench.benchmark.results import Benchmark, BenchPoint, BenchVariant, Peer, Sweep
from sgms_bench.motions import SWEEP_PERIOD, swing, there_and_back, timed_motion
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.machine import Estimator, Machine
from sgms_mhe.model import build_model
from sgms_mhe.plant.axis_config import AxisConfig
from sgms_mhe.plant.simulation import simulate_axis
from sgms_mhe.plant.trajectories import Trajectory
from sgms_mhe.reference import ReferenceIntegrator
from sgms_mhe.signals.chain import mean_samples, signal_array, signals_from_log
from sgms_mhe.signals.logs import Log, write_log
from sgms_mhe.support.toolchain import DEFAULT_FLAGS

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

PRECISIONS: Final = ("double", "single")
PLAIN_FLAGS: Final = ("-std=c99", "-O2")
"""Those of a build that nobody thought about: variants are counted with them besides."""
RUNS: Final = 5
PEER_RUNS: Final = 25
"""Timed runs; of each update the fastest counts, which leaves out what else the host does. A peer's run is short."""

CONVERGED: Final[Mapping[str, Any]] = {"scheme": "rk4", "displacement": 0.004}
"""Integrator that errors are measured against: it leaves about 1e-9 in the state, 1e-8 in its derivatives."""

WINDOWS: Final = 8
"""Windows of a record, evenly spread, whose intervals are checked and given to the peers."""
MERGED: Final = (5, 10)
"""Samples of a step in the variants that merge them."""
PEER_STEPS: Final = (0.1, 1.0)
"""Runge-Kutta steps of a peer per sample; at 1 it solves the problem as the paper states it."""
MOTIONS: Final = ("paper", "mixed")
SPEEDS: Final = (0.3, 1.0)
"""Moves there and back at these shares of max_velocity."""
INTEGRATORS: Final[tuple[Mapping[str, Any], ...]] = (
    *({"scheme": "flow", "displacement": 0.03, "slow_displacement": d} for d in (0.02, 0.01, 0.005, 0.0025)),
    *({"scheme": "rk4", "displacement": d} for d in (0.1, 0.03, 0.01, 0.005, 0.0025)),
)
"""Integrators whose work and precision are compared, over the first `FEW_UPDATES` of the motion."""
FEW_UPDATES: Final = 100

HORIZONS: Final = (10, 20, 50, 100, 200)
ELEMENTS: Final = (1, 2, 4, 6, 8, 10)
SWEEP_UPDATES: Final = 2 * SWEEP_PERIOD

_HARNESS_UPDATE: Final = "harness_update"
_PEER_UPDATE: Final = "peer_update"


def relinearisations(machine: Machine) -> list[tuple[str, Machine]]:
    """The machine with each way to choose the intervals that an update linearises anew, by name."""
    if machine.estimator.kind != "mhe":
        return [("all", machine)]
    modes = get_args(Estimator.model_fields["relinearise"].annotation)
    return [(mode, override_machine(machine, {"estimator": {"relinearise": mode}})) for mode in modes]


def mergings(machine: Machine) -> list[tuple[int, Machine]]:
    """The machine as it is, and with more and more samples to a step, by their number."""
    samples, own = machine.sampling.samples_per_update, machine.sampling.merged
    more = [k for k in MERGED if k > own and samples % k == 0]
    return [(own, machine)] + [
        (k, override_machine(machine, {"sampling": {"integrator": {"substeps": samples // k}}})) for k in more
    ]


def run_benchmark(
    machine: Machine,
    *,
    trajectory: str = "paper",
    updates: int = 500,
    quick: bool = False,
    flags: Sequence[str] = DEFAULT_FLAGS,
    progress: Progress | None = None,
) -> Benchmark:
    """Time, count and check every variant and peer on simulated logs.

    Args:
        machine: the machine.
        trajectory: name of the motion.
        updates: how many updates are timed.
        quick: on that motion alone, the machine as it is written, its linearisations, its other precision, and peers.
        flags: of the compiler, for time and instructions.
        progress: called after every step.

    Raises:
        InputError: no such motion.
        BuildError: the compiler refused.
    """
    feeding = machine
    machine = override_machine(machine, {"compensation": {"enabled": False}, "estimator": {"relinearise": "all"}})
    sampling = machine.sampling
    bench = Bench(machine, flags)

    def record(name: str, updates: int = updates) -> SampledMotion:
        return bench.record(timed_motion(machine, name, updates))

    motion = record(trajectory)
    tasks: list[tuple[str, Callable[[], Any]]] = []
    for (samples, merging), precision in product(mergings(machine)[: 1 if quick else None], PRECISIONS):
        for mode, variant in relinearisations(override_machine(merging, {"code": {"precision": precision}})):
            if quick and precision != machine.code.precision and mode != feeding.estimator.relinearise:
                continue
            name = f"{precision}, {mode}" + (f", {samples} samples a step" if samples > 1 else "")
            tasks.append(("variants", partial(bench.variant, name, variant, mode, motion)))
    if feeding.compensation.enabled and not quick:
        for precision in PRECISIONS:
            mode, variant = feeding.estimator.relinearise, override_machine(feeding, {"code": {"precision": precision}})
            tasks.append(
                ("variants", partial(bench.variant, f"{precision}, {mode}, force fed forward", variant, mode, motion))
            )
    peers = [
        (kind, round(share * sampling.samples_per_update))
        for share in PEER_STEPS
        for kind in KINDS
        if _is_smooth(machine) and (share * sampling.samples_per_update).is_integer()
    ]
    tasks += [("peers", partial(bench.peer, kind, steps, motion)) for kind, steps in peers]
    if not quick:
        others = [record(name) for name in MOTIONS if name != trajectory]
        others += [bench.record(there_and_back(sampling.rate, share * sampling.max_velocity)) for share in SPEEDS]
        for other in others:
            tasks.append(("motions", partial(bench.variant, machine.code.precision, machine, "all", other)))
            tasks += [("motions", partial(bench.peer, *peer, other)) for peer in peers if peer[0] == KINDS[0]]
        short = record(trajectory, min(updates, FEW_UPDATES))
        for precision, candidate in product(PRECISIONS, INTEGRATORS if _is_smooth(machine) else ()):
            if precision == "double" or candidate == INTEGRATORS[0]:
                changes = {"sampling": {"integrator": candidate}, "code": {"precision": precision}}
                variant = override_machine(machine, changes)
                tasks.append(("integrators", partial(bench.variant, precision, variant, "all", short)))
        for precision in PRECISIONS:
            variant = override_machine(machine, {"code": {"precision": precision}})
            if machine.estimator.kind == "mhe":
                tasks.append(("sweeps", partial(bench.sweep, "horizon", variant, set_horizon, HORIZONS)))
            tasks.append(("sweeps", partial(bench.sweep, "elements", variant, set_elements, ELEMENTS)))
    results: dict[str, list[Any]] = {}
    for done, (section, task) in enumerate(tasks, start=1):
        results.setdefault(section, []).append(task())
        if progress is not None:
            progress(done, len(tasks))
    return Benchmark(**{section: tuple(found) for section, found in results.items()})


def _is_smooth(machine: Machine) -> bool:
    """Return True if integrators have work: elements that switch take every step in closed form."""
    return not machine.friction.switches


def set_horizon(machine: Machine, intervals: int) -> Machine:
    """The machine with another horizon."""
    return override_machine(machine, {"estimator": {"horizon": intervals}})


def set_elements(machine: Machine, count: int) -> Machine:
    """The machine with so many elements of equal level, deflection scales in the middles of equal parts of its range.

    The parts are equal in the logarithm, so the mean stays, and with it the cost of an element.
    """
    friction = machine.friction
    scales = [nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)]
    spread = min(scales) * (max(scales) / min(scales)) ** ((np.arange(count) + 0.5) / count)
    changes = {
        "stiffness": [float(friction.coulomb / count / scale) for scale in spread],
        "fraction": [1.0 / count] * count,
        "micro_viscous": [0.0] * count,
    }
    return override_machine(machine, {"friction": changes})


# --- measurements ----------------------------------------------------------------------------------------------------


class Bench:
    """Measures variants of one machine and its peers; compiled with one set of flags."""

    def __init__(self, machine: Machine, flags: Sequence[str]) -> None:
        self.machine = machine
        self.flags = flags

    def record(self, trajectory: Trajectory) -> SampledMotion:
        """Simulate a motion, and integrate the intervals of some windows of it to convergence."""
        machine, sampling = self.machine, self.machine.sampling
        samples = sampling.samples_per_update
        log = simulate_axis(machine, trajectory, AxisConfig(seed=1), truth=False).log
        signals = signals_from_log(log, machine)
        converged: dict[str, Any] = {"substeps": 8 * samples}
        if _is_smooth(machine):
            converged |= CONVERGED
        model = build_model(machine)
        own = ReferenceIntegrator(model)
        fine = ReferenceIntegrator(build_model(override_machine(machine, {"sampling": {"integrator": converged}})))
        own_plan, fine_plan = own.plan(signals), fine.plan(signals)
        updates = len(own_plan.path)
        theta, x = np.ones(model.n_p), np.zeros((updates + 1, model.n_x))
        for k in range(updates):
            x[k + 1] = own.intervals(own_plan, k, x[k : k + 1], theta).x1[0]
        intervals = min(machine.estimator.horizon if machine.estimator.kind == "mhe" else 1, updates)
        firsts = sorted({int(k) for k in np.linspace(0, updates - intervals, WINDOWS)})
        w = signal_array(signals, sampling.step, mean=mean_samples(machine))
        within = [slice(k * samples + 1, (k + intervals) * samples + 1) for k in firsts]
        at_nodes = [slice(k * samples, (k + intervals) * samples + 1, samples) for k in firsts]
        nodes = np.array([x[k : k + intervals + 1] for k in firsts])
        exact = [fine.intervals(fine_plan, k, start[:-1], theta) for k, start in zip(firsts, nodes, strict=True)]
        return SampledMotion(
            name=trajectory.name,
            log=log,
            signals=signals,
            windows=Windows(
                x=nodes,
                theta=theta,
                w=np.array([w[part].reshape(intervals, samples, w.shape[1]) for part in within]),
                w_node=np.array([w[part] for part in at_nodes]),
                y=np.array([signals.friction[part] for part in at_nodes]),
            ),
            first=tuple(firsts),
            exact=tuple(exact),
        )

    def variant(self, name: str, machine: Machine, relinearise: str, recording: SampledMotion) -> BenchVariant:
        """Time, count and check one variant on a motion."""
        package = emit_package(machine, selftest=False)
        times, instructions = self._update_cost(machine, package, recording.log, self.flags)
        _, plain = self._update_cost(machine, package, recording.log, PLAIN_FLAGS)
        errors = emitted_errors(machine, package, recording)
        integrator = machine.sampling.integrator
        step = integrator.slow_displacement if integrator.scheme == "flow" else integrator.displacement
        return BenchVariant(
            name=name,
            precision=machine.code.precision,
            relinearise=relinearise,
            update_us=float(times.sum(axis=1).mean()),
            feedback_us=float(times[:, 1].mean()),
            instructions_mean=None if instructions is None else float(instructions.mean()),
            instructions_max=None if instructions is None else int(instructions.max()),
            state_error=errors[0],
            sensitivity_error=errors[1],
            integrator=f"{integrator.scheme} {step:g}",
            trajectory=recording.name,
            instructions_plain=None if plain is None else float(plain.mean()),
        )

    def peer(self, kind: Kind, steps: int, recording: SampledMotion) -> Peer:
        """Time, count and check one peer on the windows of a motion."""
        windows, exact = recording.windows, recording.exact
        export = PeerExport(self.machine, kind, windows.w.shape[1], steps, self.flags)
        with tempfile.TemporaryDirectory() as folder:
            problems, results = Path(folder) / "problems", Path(folder) / "results"
            problems.write_bytes(export.problems(windows))
            command = [str(export.program), str(problems), str(results)]
            times = fastest_runs(command, PEER_RUNS)
            found = export.evaluation(windows, results.read_bytes())
            instructions = instructions_of(command, _PEER_UPDATE)
        state, sensitivity = (
            largest_magnitude(found.x1 - np.array([window.x1 for window in exact])),
            largest_magnitude(
                found.A - np.array([window.A for window in exact]), found.B - np.array([window.B for window in exact])
            ),
        )
        return Peer(
            name=f"CasADi {kind}, rk4 x {steps}",
            update_us=float(times.mean()),
            instructions_mean=None if instructions is None else float(instructions.mean()),
            state_error=state,
            sensitivity_error=sensitivity,
            steps=steps,
            trajectory=recording.name,
        )

    def sweep(
        self, over: str, machine: Machine, sized: Callable[[Machine, int], Machine], sizes: Sequence[int]
    ) -> Sweep:
        """Cost over one size of a machine, on a motion whose period every window holds a whole number of times."""
        points = []
        for size in sizes:
            variant = sized(machine, size)
            filling = variant.estimator.horizon if variant.estimator.kind == "mhe" else SWEEP_PERIOD
            times, instructions = self._update_cost(
                variant,
                emit_package(variant, selftest=False),
                simulate_axis(variant, swing(variant, filling + SWEEP_UPDATES), _PRESCRIBED, truth=False).log,
                self.flags,
            )
            points.append(
                BenchPoint(
                    size,
                    float(times[-SWEEP_UPDATES:].sum(axis=1).mean()),
                    None if instructions is None else float(instructions[-SWEEP_UPDATES:].mean()),
                )
            )
        counted = all(point.instructions_mean is not None for point in points)
        costs = [point.instructions_mean if counted else point.update_us for point in points]
        exponent, marginal = fitted_exponents([point.size for point in points], [float(c) for c in costs if c])
        return Sweep(
            over, machine.code.precision, tuple(points), "instructions" if counted else "us", exponent, marginal
        )

    def _update_cost(
        self, machine: Machine, package: Package, log: Log, flags: Sequence[str]
    ) -> tuple[Array, Array | None]:
        """Microseconds (u, 3) and instructions (u) of every update with a full window; of all where none is full."""
        harness = build_harness(machine, package, flags)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.csv"
            write_log(path, log)
            times = fastest_runs([str(harness), "--log", str(path), "--time"], RUNS, header=1)
            instructions = instructions_of([str(harness), "--log", str(path)], _HARNESS_UPDATE)
        filling = machine.estimator.horizon if machine.estimator.kind == "mhe" else 0
        full = slice(filling if filling < len(times) else 0, None)
        return times[full], None if instructions is None else instructions[full]


_PRESCRIBED: Final = AxisConfig(control="prescribed", encoder_resolution_m=0.0, force_noise_N=0.0)


def fitted_exponents(sizes: Sequence[int], costs: Sequence[float]) -> tuple[float, float]:
    """Exponent e of cost = c size^e by least squares over the logarithms, and that without the cost's constant part.

    The second is 1 + the exponent of the slope between neighbouring sizes over their geometric mean.
    """
    size, cost = np.array(sizes, dtype=float), np.array(costs)
    slope = np.diff(cost) / np.diff(size)
    middle = np.sqrt(size[1:] * size[:-1])
    exponent = np.polyfit(np.log(size), np.log(cost), 1)[0]
    marginal = 1.0 + np.polyfit(np.log(middle), np.log(slope), 1)[0] if np.all(slope > 0.0) else np.nan
    return float(exponent), float(marginal)
