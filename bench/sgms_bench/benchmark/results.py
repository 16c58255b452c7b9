"""Results of the benchmark: variants, peers, the cost over the problem's size."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BenchVariant:
    """One variant of the emitted estimator on one motion.

    Attributes:
        name: of the variant.
        precision: double or single.
        relinearise: which intervals are linearised anew in an update.
        update_us: mean time of an update and its samples [us].
        feedback_us: mean time from the newest sample to the estimate [us].
        instructions_mean, instructions_max: of an update of a full window and its samples; None without valgrind.
        state_error: largest error of a node state after one interval, in units of its scale, with what a line leaves of
            the velocities of merged samples; None where the integration diverged.
        sensitivity_error: largest error of its derivatives in the node before and in the scaled parameters.
        integrator: scheme and largest displacement of a step; of the flow, below its gate's speed.
        trajectory: the motion.
        instructions_plain: instructions_mean of what -O2 alone compiles.
    """

    name: str
    precision: str
    relinearise: str
    update_us: float
    feedback_us: float
    instructions_mean: float | None
    instructions_max: int | None
    state_error: float | None
    sensitivity_error: float | None
    integrator: str
    trajectory: str
    instructions_plain: float | None


@dataclass(frozen=True)
class Peer:
    """Residual and Jacobian of the same problem by another tool's exported code, double precision.

    Attributes:
        name: tool, way and steps.
        update_us: mean time of one window [us].
        instructions_mean: of one window; None without valgrind.
        state_error, sensitivity_error: as of a variant; None where the integration diverged.
        steps: Runge-Kutta steps per interval.
        trajectory: the motion.
    """

    name: str
    update_us: float
    instructions_mean: float | None
    state_error: float | None
    sensitivity_error: float | None
    steps: int
    trajectory: str


@dataclass(frozen=True)
class BenchPoint:
    """Cost at one size: time [us] and instructions of an update of a full window."""

    size: int
    update_us: float
    instructions_mean: float | None


@dataclass(frozen=True)
class Sweep:
    """Cost over one size of the problem, everything else the same.

    Attributes:
        over: "horizon" or "elements".
        precision: double or single.
        points: cost at each size.
        unit: "instructions", or "us" without valgrind: what the exponents are of.
        exponent: e of cost = c size^e, fitted to all points; a constant part of the cost makes it small.
        marginal_exponent: the same without a constant part: 1 + exponent of the slope between neighbouring points.
    """

    over: str
    precision: str
    points: tuple[BenchPoint, ...]
    unit: str
    exponent: float
    marginal_exponent: float


@dataclass(frozen=True)
class Benchmark:
    """All that was measured.

    Attributes:
        variants: of the machine's estimator, on the chosen motion.
        peers: on the same motion; empty where velocity is linear between samples, which they do not do.
        motions: the machine's own variant and the peer on other motions.
        integrators: the machine with other integrators, on the chosen motion.
        sweeps: cost over horizon and elements.
    """

    variants: tuple[BenchVariant, ...]
    peers: tuple[Peer, ...] = ()
    motions: tuple[BenchVariant | Peer, ...] = ()
    integrators: tuple[BenchVariant, ...] = ()
    sweeps: tuple[Sweep, ...] = ()

    @property
    def peer(self) -> Peer | None:
        """The faster of the peers that take one step per sample."""
        most = max((peer.steps for peer in self.peers), default=0)
        return min((peer for peer in self.peers if peer.steps == most), key=lambda peer: peer.update_us, default=None)
