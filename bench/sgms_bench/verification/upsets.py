"""Single bits flipped in the memory of an axis (`bench/c/upset.c`): none leaves it, few are not told and stay."""

import math
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.verification.outcome import AbsentError, CheckOutcome, definitions, require, run
from sgms_mhe.configuration import override_machine
from sgms_mhe.emission.package import Package, emit_package, write_package
from sgms_mhe.machine import Machine

FLAGS: Final = (
    *("-std=c99", "-g", "-O1", "-ffp-contract=off"),
    *("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"),
)
COUNTED: Final = r"^(\d+) flips, (\d+) back, (\d+) told, (\d+) silent, (\d+) in settings, (\d+) in factors$"
MOST_SILENT: Final = 0.0015
"""Of flips: an estimate that is another one a second later, and no status has said so. Nothing
contradicts what earlier measurements are worth (factors, variances): a flipped exponent makes another certainty of it,
that might have been."""


def check_upsets(
    machines: Sequence[Machine], flips: int, seed: int, progress: Callable[[str], None] = lambda _: None
) -> CheckOutcome:
    """Flip bits anywhere in the memory of an axis, indices included, one at a time.

    Args:
        machines: whose packages; readings that contradict the model are doubted in each, as in a machine file that
            says nothing else.
        flips: in all, as many of each package.
        seed: of places and times.
        progress: called after every package.
    """
    check = "single-event upsets: no access out of bounds, back within 1 s or told"
    counts, failures = [0] * 6, []
    try:
        require("gcc")
    except AbsentError as absent:
        return CheckOutcome(check, "", skipped=str(absent))
    for machine in machines:
        believing = override_machine(machine, {"estimator": {"noise": {"self_scaling": True}}})
        found, failure = flip_bits(emit_package(believing, selftest=False), -(-flips // len(machines)), seed)
        counts = [a + b for a, b in zip(counts, found, strict=True)]
        failures += [f"{machine.name}: {failure}"] if failure else []
        progress(f"{check}: {machine.name}, {found}, {failure or 'no failure'}")
    flips_made, back, told, silent, settings, factors = counts
    allowed = MOST_SILENT * flips_made
    if silent > allowed + 3.0 * math.sqrt(allowed):  # as many more as chance may add
        failures.append(f"{silent} of {flips_made} flips are neither told nor forgotten")
    tried = (
        f"{flips_made} flips in {len(machines)} packages: {back} back within 1 s, {told} told by the status, "
        f"{silent} neither ({settings} in settings, {factors} in factors)"
    )
    return CheckOutcome(check, tried, tuple(failures))


def flip_bits(package: Package, flips: int, seed: int) -> tuple[list[int], str]:
    """Flip bits in axes of one package.

    Returns:
        Flips; of these back, told and neither, of the last those in settings and in factors; and what went wrong, ""
        where nothing did.

    Raises:
        RuntimeError: it did not compile; the message carries why.
    """
    name, limit = package.machine.name, package.machine.compensation.limit
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_package(package, folder / name)
        own = [f"-DFORCE_LIMIT=((machine_real){limit!r})"] if limit is not None else []
        parts: list[str | Path] = [C_DIR / "upset.c", folder / name / f"{name}.c", "-o", folder / "upset"]
        made = run(["gcc", *FLAGS, *definitions(package), *own, f"-I{folder / name}", *parts])
        if made.code != 0:
            raise RuntimeError(f"gcc refused: {made.output}")
        done = run([folder / "upset", str(seed), str(flips)])
    counted = re.search(COUNTED, done.output, re.MULTILINE)
    if done.code != 0 or counted is None:
        return [0] * 6, f"exit code {done.code}: {done.output[:600]}"
    return [int(group) for group in counted.groups()], ""
