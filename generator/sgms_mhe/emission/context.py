"""Context of the templates: one typed object per subject, from a machine, its model and the structure analysis."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from sgms_mhe import __version__
from sgms_mhe.emission.budget import Work
from sgms_mhe.emission.c_source import CPrinter, Function, FunctionPrinter, Output, entries, scalar
from sgms_mhe.emission.clock import Clock, clock_of
from sgms_mhe.emission.compensation import FeedForward, compensation_of
from sgms_mhe.emission.couplings import Couplings, couplings_of, node_scale
from sgms_mhe.emission.element_law import RK4, ElementLaw, EmittedFlow, Stage, element_law, flow_of
from sgms_mhe.emission.groups import GroupView, group_views
from sgms_mhe.emission.selftest import Vectors
from sgms_mhe.emission.sizes import Sizes, names_read, sizes_of
from sgms_mhe.emission.structure import Structure
from sgms_mhe.emission.variant import Status, Variant, statuses_of, variant_of
from sgms_mhe.machine import Machine
from sgms_mhe.model import FreeParameter, Model
from sgms_mhe.signals.chain import bridge_fading, lowpass_coefficients, mean_samples, settle_samples
from sgms_mhe.support.errors import InputError

MOVE = 0.3
"""How far the end of an interval may move before that, over sqrt(sigma_x / lambda); over sigma_x where it switches."""
PAUSE_PART = 0.25
"""What a power cycle changes in a parameter, over what may be wrong with it before any data."""
HOLD_PART = 0.1
"""Path of an interval below which it says nothing of the parameters, over the smallest deflection scale."""


@dataclass(frozen=True)
class ReadingRule:
    """Weights of measurements by their test ratios, squared innovations over their predicted variance.

    Attributes:
        fast, slow: weights of the newest ratio in two means of them.
        most: a ratio counts no more in the means.
        free: beyond it a measurement counts less at once.
        doubted_fast, doubted_slow: means beyond which the measurements contradict the model.
    """

    fast: float = 0.1
    slow: float = 0.003
    most: float = 1000.0
    free: float = 9.0
    doubted_fast: float = 5.0
    doubted_slow: float = 2.0


@dataclass(frozen=True)
class LastingRule:
    """Factors on variances for errors of the model that stay.

    Attributes:
        block: intervals with motion of a block.
        most: a block's square counts no more than so many times its average.
        forgets: share a mean over blocks forgets with an interval.
        doubted: factor, over the known colour, beyond which the measurements contradict the model.
    """

    block: int = 50
    most: float = 100.0
    forgets: float = 0.001
    doubted: float = 2.0


@dataclass(frozen=True)
class Identity:
    """Who the package is.

    Attributes:
        name: prefix of every symbol and file. NAME: the same of constants.
        description: one line about the axis.
        machine_digest: of the machine file it was generated from.
        version: of the generator. runtime_version: of the runtime headers the templates are written for.
        real: C type of its numbers.
        header_digest: eight hexadecimal digits of all that the public header declares; zeros until it is rendered.
    """

    name: str
    description: str
    machine_digest: str
    real: str
    version: str = __version__
    runtime_version: int = 5
    header_digest: str = "00000000"

    @property
    def NAME(self) -> str:
        """Prefix of the machine's constants."""
        return self.name.upper()


@dataclass(frozen=True)
class SignalView:
    """Signals and their chain.

    Attributes:
        mass_in_model: it stands in the model's equations, and not in the signal chain alone.
        settle: samples a disturbance of the filters lasts.
        fading: of the error that bridged samples leave, per sample.
        lowpass: (b0, b1, b2, a1, a2).
        slope_weights: of each of the merged samples in the slope of the line through them.
        read: names of the signals the estimator depends on, in the order of w.
        of_rows: names of those that the output's derivatives in (x, theta) depend on; of all of its own where
            it is not affine.
        names: of all signals, in the order of w.
        raw: (name, sample term) of the signals that are sample terms themselves.
        mean_samples: that the mean acceleration is over; 0: no such signal.
        clock: of a model that is periodic in time; None of any other.
    """

    mass_in_model: bool
    settle: int
    fading: float
    lowpass: tuple[float, ...]
    slope_weights: tuple[float, ...]
    read: tuple[str, ...]
    of_rows: tuple[str, ...]
    names: tuple[str, ...]
    raw: tuple[tuple[str, int], ...]
    mean_samples: int
    clock: Clock | None


@dataclass(frozen=True)
class EmittedWeights:
    """Weights of the least squares, and limits of an accepted solution.

    Attributes:
        readings: of the means of test ratios.
        lasting: of errors of the model that stay.
        prior_sd, drift_sd: of each theta, drift per update.
        hold_path: path of an interval below which it says nothing of the parameters [m].
        implausible: first node's standard deviations beyond which a state is no solution (docs/estimation.md).
        lower, upper: bounds on theta, finite numbers.
        pause_sd: of the change of each theta over a power cycle.
        state_noise, inverse_initial_state: per state.
        along_path: which states have their noise with the path; noise_length: along which it comes up to that [m], 0
            where there is none; least_noise: share of its variance without motion.
        inverse_move: of an interval's end before it is linearised anew, over the state noise, squared; where it
            `moves_with_noise` over the state noise besides. clearly: how much farther an older interval has to have
            moved than a newer one to be linearised in its stead, squared.
    """

    prior_sd: tuple[float, ...]
    drift_sd: tuple[float, ...]
    hold_path: float
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    pause_sd: tuple[float, ...]
    state_noise: tuple[float, ...]
    along_path: tuple[int, ...]
    noise_length: float
    inverse_initial_state: tuple[float, ...]
    inverse_move: float
    moves_with_noise: bool
    implausible: float = 1e4
    least_noise: float = 1e-6
    clearly: float = 1.01**2
    readings: ReadingRule = ReadingRule()
    lasting: LastingRule = LastingRule()


@dataclass(frozen=True)
class ModelView:
    """The symbolic model as functions, and its parameters.

    Attributes:
        sample_terms: term of w. term_names: their meaning.
        parameter_terms: q, d_q, scale, d_scale of theta.
        output: y, c, d of (x, w, theta).
        of_signals: y of w: part of the output from signals alone; None where they add nothing.
        deflection: z of (x, theta).
        si: p of theta, in SI units.
        feed_forward: y of (x, w, theta).
        parameters: free ones, whose `scale` is one unit of theta.
    """

    sample_terms: Function
    term_names: tuple[str, ...]
    parameter_terms: Function
    output: Function
    of_signals: Function | None
    deflection: Function
    si: Function
    feed_forward: Function
    parameters: tuple[FreeParameter, ...]
    state_names: tuple[str, ...]


@dataclass(frozen=True)
class PackageView:
    """All that the templates of a package read, by subject.

    Attributes:
        machine: the file's numbers, as it says them.
        law: constants of the law, where a group is emitted as it.
        flow: constants of the displacement flow, where a group follows it.
        statuses: of an update, and the remedy for each.
        vectors: self-test vectors, where the package has them.
        work: of the calls at most, once the rest is known.
        tables: (name, values) looked up by position in the model.
    """

    machine: Machine
    package: Identity
    variant: Variant
    sizes: Sizes
    signals: SignalView
    weights: EmittedWeights
    couplings: Couplings
    model: ModelView
    groups: tuple[GroupView, ...]
    law: ElementLaw | None
    flow: EmittedFlow | None
    compensation: FeedForward
    statuses: tuple[Status, ...]
    tables: tuple[tuple[str, tuple[float, ...]], ...]
    vectors: Vectors | None = None
    work: Work | None = None
    rk4: tuple[Stage, ...] = RK4


def package_view(structure: Structure) -> PackageView:
    """Assemble the templates' view of a model, self-test vectors aside. Raises InputError: it has no parameter."""
    model, machine = structure.model, structure.model.machine
    if model.n_p == 0:
        raise InputError(machine.source, "estimator.parameters", [], "at least one parameter to estimate")
    printer = CPrinter(machine.code.precision)
    functions = FunctionPrinter(structure, printer)
    variant = variant_of(model)
    couplings = couplings_of(structure)
    sizes = sizes_of(structure, variant, couplings)
    groups = group_views(structure, sizes, functions)
    signals = _signals(structure)
    return PackageView(
        machine=machine,
        package=Identity(machine.name, machine.description, machine.digest[:12], printer.real),
        variant=variant,
        sizes=sizes,
        signals=signals,
        weights=_weights(model, variant),
        couplings=couplings,
        model=_model_view(structure, functions, signals.of_rows),
        groups=groups,
        law=element_law(machine) if any(g.obeys_law for g in groups) else None,
        flow=flow_of(machine) if any(g.follows_flow for g in groups) else None,
        compensation=compensation_of(machine),
        statuses=statuses_of(machine, variant),
        tables=tuple((name, values) for values, name in printer.tables.items()),
    )


def hold_path(machine: Machine) -> float:
    """Path [m] of an interval below which it says nothing of the parameters."""
    friction = machine.friction
    return HOLD_PART * min(
        nu * friction.coulomb / kappa for nu, kappa in zip(friction.fraction, friction.stiffness, strict=True)
    )


def _signals(structure: Structure) -> SignalView:
    machine = structure.model.machine
    merged = machine.sampling.merged
    read, names = _signals_read(structure), structure.model.signal_names
    places = np.arange(merged)
    return SignalView(
        mass_in_model=structure.model.reads_mass,
        settle=settle_samples(machine),
        fading=bridge_fading(settle_samples(machine)),
        lowpass=lowpass_coefficients(machine),
        slope_weights=tuple(3.0 / (merged * merged - 1.0) * (2.0 * places + 1.0 - merged)) if merged > 1 else (),
        read=read,
        of_rows=_find_row_signals(structure.model),
        names=names,
        raw=tuple((t.name, k) for k, t in enumerate(structure.sample_terms) if t.name in names),
        mean_samples=mean_samples(machine),
        clock=clock_of(structure) if "time" in read else None,
    )


def _find_row_signals(model: Model) -> tuple[str, ...]:
    """Return the names of the signals without which a measurement cannot be linearised anew."""
    if not model.output_is_affine:
        return names_read(model.output, model)
    output = _to_node_state(model, model.output)
    return names_read(ca.densify(ca.jacobian(output, ca.vertcat(model.x, model.theta))), model)


def _split_off_signals(model: Model, kept: Sequence[str]) -> ca.SX:
    """Return the part of the output from all signals but those kept, whatever the state and the parameters are."""
    output = ca.substitute(
        _to_node_state(model, model.output),
        ca.vertcat(model.x, model.theta),
        ca.vertcat(ca.SX.zeros(model.n_x), ca.SX.ones(model.n_p)),
    )
    rest = [model.w[k] if name in kept else 0.0 for k, name in enumerate(model.signal_names)]
    return output - ca.substitute(output, model.w, ca.vertcat(*rest))


def _signals_read(structure: Structure) -> tuple[str, ...]:
    """Names of the signals the estimator's functions depend on; velocity it needs itself."""
    model = structure.model
    functions = ca.vertcat(*(t.expression for t in structure.sample_terms), model.output, model.feed_forward)
    read = {"velocity", *names_read(functions, model)}
    return tuple(name for name in model.signal_names if name in read)


def _weights(model: Model, variant: Variant) -> EmittedWeights:
    machine = model.machine
    largest = 1e30 if variant.single else 1e300
    smoothing = machine.friction.smoothing
    return EmittedWeights(
        prior_sd=tuple(model.prior),
        drift_sd=tuple(model.drift) if variant.drifts else (0.0,) * model.n_p,
        hold_path=hold_path(machine),
        lower=tuple(max(p.lower, -largest) for p in model.parameters),
        upper=tuple(min(p.upper, largest) for p in model.parameters),
        pause_sd=tuple(PAUSE_PART * model.prior),
        state_noise=tuple(model.state_noise),
        along_path=tuple(int(length > 0.0) for length in model.noise_travel),
        noise_length=float(model.noise_travel.max()),
        inverse_initial_state=tuple(1.0 / model.initial_state),
        inverse_move=(smoothing.lambda_ if smoothing else 1.0) / MOVE**2,
        moves_with_noise=smoothing is not None,
    )


def _model_view(structure: Structure, functions: FunctionPrinter, of_rows: Sequence[str]) -> ModelView:
    model = structure.model
    output = _to_node_state(model, model.output)
    point = {"x": "at->x", "w": "at->w", "theta": "at->theta"}
    outputs = [
        scalar("y", output),
        Output("c", entries(ca.gradient(output, model.x))),
        Output("d", entries(ca.gradient(output, model.theta))),
    ]
    of_signals = _split_off_signals(model, of_rows)
    terms = [Output("term", [t.expression for t in structure.sample_terms], stride="stride")]
    return ModelView(
        sample_terms=functions.model_function({"w": "w"}, terms),
        term_names=tuple(t.name for t in structure.sample_terms),
        parameter_terms=_parameter_terms(structure, functions),
        output=functions.model_function(point, outputs),
        of_signals=None if of_signals.is_zero() else functions.model_function({"w": "w"}, [scalar("y", of_signals)]),
        deflection=functions.model_function(
            point, [Output("z", ca.vertsplit(_to_node_state(model, model.deflection)))]
        ),
        si=functions.model_function(
            {"theta": "theta"}, [Output("si", [_si(p, model.theta[k]) for k, p in enumerate(model.parameters)])]
        ),
        feed_forward=functions.model_function(point, [scalar("y", _to_node_state(model, model.feed_forward))]),
        parameters=model.parameters,
        state_names=tuple(state.name for state in model.states),
    )


def _parameter_terms(structure: Structure, functions: FunctionPrinter) -> Function:
    model = structure.model
    q = [e for g in structure.groups for b in g.blocks for e in b.parameter_terms]
    scale = [node_scale(model, i) for i in range(model.n_x)]
    outputs = [
        Output("p->q", q),
        Output("p->d_q", _gradients(q, model.theta), sparse=True),
        Output("p->scale", scale),
        Output("p->d_scale", _gradients(scale, model.theta), sparse=True),
    ]
    return functions.model_function({"theta": "p->theta"}, outputs)


def _gradients(expressions: Sequence[ca.SX], variables: ca.SX) -> list[ca.SX]:
    """Derivatives of every expression in every variable, expression by expression."""
    return [d for e in expressions for d in entries(ca.gradient(e, variables))]


def _to_node_state(model: Model, expression: ca.SX) -> ca.SX:
    """An expression of chi as one of the node state."""
    return ca.substitute(expression, model.chi, model.from_node)


def _si(parameter: FreeParameter, theta: ca.SX) -> ca.SX:
    """A parameter in SI units."""
    if parameter.scale == parameter.nominal:
        return parameter.nominal * theta
    return parameter.nominal + parameter.scale * (theta - 1.0)
