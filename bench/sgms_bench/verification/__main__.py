"""Table of properties that are tried: check, tried, failed.

Random calls under sanitizers, the same bits from every compiler and processor, every line and branch reached or
explained, work and stack within what is stated, nothing in the code that a proof could not deal with, a static proof
that no call leaves its memory, faults in emitted C that its self-test notices. And logs with something wrong at random
through the whole command line.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from sgms_bench.logs.mutations import check_logs
from sgms_bench.verification.bits import host_builds, same_bits, target_builds
from sgms_bench.verification.constructs import check_constructs
from sgms_bench.verification.coverage import check_coverage
from sgms_bench.verification.fuzzing import SANITIZERS, fuzz_machines
from sgms_bench.verification.limits import check_limits
from sgms_bench.verification.mcdc import check_conditions
from sgms_bench.verification.misra import check_misra
from sgms_bench.verification.mutation import check_self_test
from sgms_bench.verification.outcome import CheckOutcome
from sgms_bench.verification.proof import check_proof
from sgms_bench.verification.specimens import specimen, specimens
from sgms_bench.verification.upsets import check_upsets
from sgms_mhe.configuration import load_machine
from sgms_mhe.machine import Machine
from sgms_mhe.support.paths import machines_dir
from sgms_mhe.support.tables import CsvTable

Progress = Callable[[str], None]

SKIPPED: Final = 3
"""Exit code where a check could not run and none failed; argparse has 2."""
UPSET: Final = ("merged_auto", "signals", "switching", "ekf")
"""Specimens in whose memory bits are flipped."""
ON_TARGETS: Final = ("merged_auto", "switching", "groups")
"""Specimens whose bits the emulated processors repeat; in double precision they take their time."""


def _fuzz(chosen: argparse.Namespace, progress: Progress) -> list[CheckOutcome]:
    seeds = range(chosen.seed, chosen.seed + chosen.machines)
    calls = int(chosen.calls) // len(SANITIZERS)
    return [fuzz_machines(of, seeds, calls, chosen.keep / name, progress) for name, of in SANITIZERS.items()]


def _bits(_: argparse.Namespace, progress: Progress) -> list[CheckOutcome]:
    on_host = same_bits([*_machine_files(), *specimens()], list(host_builds()), progress)
    on_targets = same_bits([specimen(name) for name in ON_TARGETS], list(target_builds()), progress)
    return on_host + on_targets


def _upsets(chosen: argparse.Namespace, progress: Progress) -> list[CheckOutcome]:
    machines = [load_machine("etel_xy_controller"), *(specimen(name) for name in UPSET)]
    return [check_upsets(machines, chosen.flips, chosen.seed, progress)]


def _machine_files() -> list[Machine]:
    """The machine files of this package."""
    return [load_machine(path.stem) for path in sorted(machines_dir().glob("*.toml"))]


CHECKS: Final[Mapping[str, Callable[[argparse.Namespace, Progress], list[CheckOutcome]]]] = {
    "constructs": lambda _, progress: check_constructs(list(specimens()), progress),
    "misra": lambda _, progress: [check_misra(list(specimens()), progress)],
    "coverage": lambda _, progress: [check_coverage(list(specimens()), progress)],
    "mcdc": lambda _, progress: [check_conditions(list(specimens()), progress)],
    "proof": lambda _, progress: [check_proof([load_machine("etel_xy"), *specimens()], progress)],
    "limits": lambda _, progress: check_limits(list(specimens()), progress),
    "bits": _bits,
    "selftest": lambda chosen, progress: check_self_test(chosen.mutants, chosen.seed, progress),
    "upsets": _upsets,
    "fuzz": _fuzz,
    "logs": lambda chosen, progress: check_logs(range(chosen.seed, chosen.seed + chosen.logs), progress),
}
"""Groups of checks by name."""


def table(outcomes: Sequence[CheckOutcome]) -> CsvTable:
    """Check, tried, failed."""
    rows = [
        {
            "check": o.check,
            "tried": o.tried or f"nothing: {o.skipped}",
            "failed": "skipped" if o.skipped else len(o.failures),
        }
        for o in outcomes
    ]
    return CsvTable("verification", {"check": "", "tried": "", "failed": ""}, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the checks and print the table; 1 where one failed, else 3 where one was skipped."""
    parser = argparse.ArgumentParser(
        prog="python -m sgms_bench.verification", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--calls", type=float, default=3e5, help="random calls, in all (1e8: an hour or more)")
    parser.add_argument("--machines", type=int, default=6, help="random machines")
    parser.add_argument("--mutants", type=int, default=225, help="mutants of emitted C (225: ten minutes)")
    parser.add_argument("--flips", type=int, default=20_000, help="bits to flip, in all (20 000: five minutes)")
    parser.add_argument("--logs", type=int, default=10_000, help="mutated logs (10 000: an hour)")
    parser.add_argument("--seed", type=int, default=0, help="of the first of them")
    parser.add_argument("--keep", type=Path, default=Path("build/verify"), help="folder for inputs that fail")
    parser.add_argument("--only", choices=[*CHECKS], nargs="+", default=[*CHECKS], help="groups of checks")
    chosen = parser.parse_args(arguments)

    def progress(line: str) -> None:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()

    outcomes = [outcome for name in CHECKS if name in chosen.only for outcome in CHECKS[name](chosen, progress)]
    sys.stdout.write(f"{table(outcomes)}\n")
    for outcome in outcomes:
        for failure in outcome.failures:
            sys.stdout.write(f"failed: {outcome.check}: {failure}\n")
    if any(outcome.failures for outcome in outcomes):
        return 1
    return SKIPPED if any(outcome.skipped for outcome in outcomes) else 0


if __name__ == "__main__":
    raise SystemExit(main())
