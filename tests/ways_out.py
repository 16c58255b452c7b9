"""Faults of every output of a package's calls, one after the other: the self-test has to notice each.

Between the self-test and the package stand calls (the linker's --wrap) that spoil one output: its sign, zero, half of
it, or what the call before handed out; on one of the ways to call an axis. Outputs come from the public header: what a
call returns, and each field of a structure that it fills.
"""

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_bench import C_DIR
from sgms_bench.verification.mutants import structures_of
from sgms_bench.verification.outcome import definitions, run_or_raise
from sgms_mhe.emission.package import Package, write_package

WAYS: Final = ("tick", "sample", "insert", "any")
FAULTS: Final = ("sign", "zero", "half", "late")
NO_FAULT: Final = {
    r"due by tick: (sign|zero|half)": "tick() ends the interval itself",
    r"settings .*: late": "the machine file's at every call",
    r"save (format|machine)\b.*: late": "the same at every call",
    r"save spread.* by (sample|insert): late": "one at both calls: no error that stays has shown",
    r"status_text .*: (sign|half)": "no number",
}
"""Faults that leave an output as it is, with the reason."""


@dataclass(frozen=True)
class Spoilt:
    """One fault of one output.

    Attributes:
        title: output, way and fault.
        code: of the self-test; negative: it crashed or did not come back.
        changed: times that the output was another one by it.
    """

    title: str
    code: int
    changed: int

    @property
    def is_missed(self) -> bool:
        """Return True if the self-test has not noticed it, or does not ask for the output, without a reason."""
        is_none = self.changed == 0 and any(re.fullmatch(pattern, self.title) for pattern in NO_FAULT)
        return self.code == 0 and not is_none


@dataclass(frozen=True)
class _Output:
    """One output: call, and field of what it fills; ways to call the axis, by which it differs."""

    title: str
    ways: tuple[str, ...]


def spoil_outputs(package: Package, folder: Path, calls_of: str = "") -> list[Spoilt]:
    """Run the self-test with each fault of each output of a package, or of the calls whose names begin so.

    Raises:
        BuildError: it does not compile.
    """
    name, source, program = package.machine.name, folder / "ways_out.c", folder / "ways_out"
    write_package(package, folder / name)
    outputs: list[_Output] = []
    calls = "".join(_calls(package, outputs))
    source.write_text(f'enum {{ OUTPUTS = {len(outputs)} }};\n#include "spoil.h"\n\n{calls}')
    wrapped = [f"-Wl,--wrap={name}_{call}" for call in dict.fromkeys(re.findall(rf"__wrap_{name}_(\w+)", calls))]
    sources = [source, folder / name / f"{name}.c", folder / name / f"{name}_selftest.c"]
    words = ["-std=c99", "-O1", "-ffp-contract=off", *definitions(package), f"-I{folder / name}", f"-I{C_DIR}"]
    run_or_raise(["gcc", *words, *sources, *wrapped, "-o", program])
    spoilt = [(o, of) for o, of in enumerate(outputs) if of.title.startswith(calls_of)]
    chosen = [(o, w, f) for o, of in spoilt for w in of.ways for f in range(len(FAULTS))]
    asked = "".join(f"{o} {WAYS.index(w) if w != 'any' else -1} {f}\n" for o, w, f in chosen)
    answers = subprocess.run([program], input=asked, capture_output=True, text=True, check=True).stdout.splitlines()
    return [
        Spoilt(f"{outputs[o].title} by {w}: {FAULTS[f]}", *map(int, answer.split()))
        for (o, w, f), answer in zip(chosen, answers, strict=True)
    ]


def _calls(package: Package, outputs: list[_Output]) -> Iterator[str]:
    """C of the calls between self-test and package; adds their outputs."""
    name = package.machine.name
    header = re.sub(r"/\*.*?\*/", "", package.files[f"{name}.h"], flags=re.DOTALL)
    structures = structures_of(package)
    for kind, call, arguments in re.findall(rf"^(\w[\w ]*?[ *]+){name}_(\w+)\(([^()]*)\);", header, re.MULTILINE):
        if call.startswith("selftest"):
            continue
        ways = (call,) if call in WAYS else WAYS[:3] if " *self" in arguments and call != "init_with" else ("any",)
        passed = ", ".join(re.findall(r"(\w+)(?:,|$)", arguments))
        lines = [f"way = {WAYS.index(call)};"] if call in WAYS else []
        returns = kind.strip() != "void"
        lines.append(f"{f'{kind}returned = ' if returns else ''}__real_{name}_{call}({passed});")
        for of, to in re.findall(rf"(?<!const )\b{name}_(estimate_t|saved_t|settings_t) \*(\w+)", arguments):
            for field, typed in structures[f"{name}_{of}"].items():
                for element, type_name in _elements(field, typed, package):
                    outputs.append(_Output(f"{call} {element}", ways))
                    lines.append(f"{to}->{element} = {_spoil(f'{to}->{element}', type_name, len(outputs) - 1)};")
            if of == "saved_t":
                checksum = next(k for k, output in enumerate(outputs) if output.title == f"{call} checksum")
                lines.append(f"seal({to}, {checksum});")
        if returns:
            outputs.append(_Output(call, ways))
            lines.append(f"return {_spoil('returned', kind.strip(), len(outputs) - 1)};")
        if len(lines) > 1:
            body = "".join(f"    {line}\n" for line in lines)
            yield f"{kind}__real_{name}_{call}({arguments});\n{kind}__wrap_{name}_{call}({arguments});\n"
            yield f"{kind}__wrap_{name}_{call}({arguments})\n{{\n{body}}}\n\n"


def _elements(field: str, typed: str, package: Package) -> list[tuple[str, str]]:
    """Elements of a field, and their type."""
    kind, _, size = typed.partition(" ")
    if not size:
        return [(field, kind)]
    found = re.search(rf"\b{size[1:-1]} (?:= )?(\d+)", package.files[f"{package.machine.name}.h"])
    return [(f"{field}[{k}]", kind) for k in range(int(found[1] if found else size[1:-1]))]


def _spoil(value: str, kind: str, output: int) -> str:
    """C of a value of a type, spoilt."""
    if "*" in kind:
        return f"spoil_text({output}, {value})"
    whole = "int" in kind
    return f"({kind}){'(int64_t)' if whole else ''}spoil({output}, (double){value}, {int(whole)})"
