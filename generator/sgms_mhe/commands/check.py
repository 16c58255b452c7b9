"""`sgms-mhe check`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from sgms_mhe.commands.common import json_text, progress_bar, show, table_text
from sgms_mhe.commands.options import make_command

if TYPE_CHECKING:
    from sgms_mhe.emission.package import Package
    from sgms_mhe.machine import Machine

LONGEST_LIST: Final = 8
"""Numbers of a list that are all shown."""


@make_command("check machines/etel_xy.toml")
def command(machine: Machine, *, json: bool = False) -> None:
    """Check MACHINE and print it resolved.

    Resolved are `extends`, defaults, and derived values. A machine that passes can be generated.
    """
    from sgms_mhe.emission.package import emit_package

    with progress_bar(f"check {machine.name}"):
        package = emit_package(machine, within_budget=True)  # what cannot be emitted is refused here
    content = {"source": str(machine.source), "digest": machine.digest, "machine": machine.as_dict(by_alias=True)}
    show(json_text(content) if json else _text(machine, package))


def _text(machine: Machine, package: Package) -> str:
    from sgms_mhe.emission.compensation import force_limit
    from sgms_mhe.model import build_model
    from sgms_mhe.signals.chain import settle_samples

    friction, sampling, estimator = machine.friction, machine.sampling, machine.estimator
    units = machine.plant.units
    integrator, noise, smoothing = sampling.integrator, estimator.noise, friction.smoothing
    law, horizon = "elements switch", ""
    if smoothing is not None:
        law = f"smoothing zeta {smoothing.zeta:g}, lambda {smoothing.lambda_:g}, gamma {smoothing.gamma:g}"
    if estimator.kind == "mhe":
        horizon = f", horizon {estimator.horizon} intervals, relinearise {estimator.relinearise}"
    columns = zip(friction.stiffness, friction.fraction, friction.micro_viscous, strict=True)
    elements = [
        (f"{i}", f"{kappa:g}", f"{nu:g}", f"{sigma:g}", f"{1e6 * nu * friction.coulomb / kappa:.4g}")
        for i, (kappa, nu, sigma) in enumerate(columns, start=1)
    ]
    parameters = [
        (
            units.named(p.column),
            f"{p.nominal:g}",
            f"{estimator.prior_of(p.name, p.scale) * abs(p.scale):g}",
            f"{_si(p, p.lower):g}",
            f"{_si(p, p.upper):g}",
        )
        for p in build_model(machine).parameters
    ]
    interval = f"{sampling.samples_per_update} samples ({1e3 / sampling.update_rate:g} ms)"
    lines = [
        f"{machine.name}: {machine.description}" if machine.description else machine.name,
        f"  file        {machine.source}",
        f"  digest      {machine.digest[:12]}",
        f"  plant       {units.inert} {machine.plant.moved:g} {units.mass}",
        f"  friction    coulomb {friction.coulomb:g} {units.force}, viscous {friction.viscous:g} {units.damping}, "
        f"stribeck ratio {friction.stribeck_ratio:g} at {friction.stribeck_velocity:g} {units.velocity}, {law}",
        _indent(
            table_text(
                ("element", units.stiffness, "fraction", units.damping, f"deflection u{units.position}"), elements
            )
        ),
        f"  sampling    {sampling.rate:g} Hz, low-pass {sampling.velocity_cutoff:g} Hz "
        f"(settles in {settle_samples(machine)} samples), up to {sampling.max_velocity:g} {units.velocity}, "
        f"friction read at {sampling.readings_per_update * sampling.update_rate:g} Hz",
        f"  integrator  {integrator.scheme}, {integrator.substeps} steps per interval of {interval}, "
        f"at most {integrator.displacement:g} deflection scales per substep",
        f"  estimator   {estimator.kind}{horizon}, arrival cost {estimator.arrival_cost.update}",
        f"  noise       measurement {noise.measurement:g} {units.force}, state {noise.state:g} (as {noise.state_as}), "
        f"first state {noise.initial_state:g}, parameter {noise.parameter:g}, "
        f"drift {noise.parameter_drift:g} per update, {'scaled by innovations' if noise.self_scaling else 'as stated'}",
        _indent(table_text(("parameter", "nominal", "prior, 1 sigma", "lower", "upper"), parameters)),
    ]
    fed = machine.compensation
    largest = force_limit(machine)
    limit = "none" if largest is None else f"{largest:g} {units.force}"
    lines.append(
        f"  fed forward {'on' if fed.enabled else 'off'} after init, {1e6 * fed.delay:g} us ahead, "
        f"ramp {fed.ramp:g} s, limit {limit}, hold below {fed.hold:g} {units.velocity}"
    )
    for effect in machine.effects:
        numbers = ", ".join(f"{units.named(key)} {_said(value)}" for key, value in effect.parameters.items())
        lines.append(f"  effect      {effect.label}: {numbers}")
    changed = ", ".join(f"{key} {value:g}" for key, value in machine.diagnosis.changed.items())
    lines.append(f"  diagnosis   {changed or 'defaults'}")
    if machine.log is not None:
        sources = ", ".join(f"{name} from {column.description}" for name, column in machine.log.columns.items())
        lines.append(f"  log         {sources}")
    size = sum(len(text.encode()) for text in package.files.values())
    lines.append(f"  package     {len(package.files)} files, {size} bytes, {machine.code.precision} precision")
    return "\n".join(lines)


def _said(value: float | tuple[float, ...]) -> str:
    """A number, or a list of them; a long list as its number of entries and their range."""
    numbers = value if isinstance(value, tuple) else (value,)
    if len(numbers) > LONGEST_LIST:
        return f"({len(numbers)} from {min(numbers):g} to {max(numbers):g})"
    text = " ".join(f"{number:g}" for number in numbers)
    return f"({text})" if isinstance(value, tuple) else text


def _si(parameter: Any, theta: float) -> float:
    return float(parameter.nominal + parameter.scale * (theta - 1.0))


def _indent(text: str) -> str:
    return "\n".join(f"    {line}" for line in text.splitlines())
