"""Emulated microcontrollers: programs cross-compiled and linked for one, and run by QEMU."""

import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sgms_mhe.support.errors import BuildError
from sgms_mhe.support.paths import runtime_dir
from sgms_mhe.support.toolchain import tool_output

TARGET_FLAGS: Final = ("-std=c99", "-O2", "-ffp-contract=off")
"""A multiply and an add stay two roundings: what the target computes is then what a host computes."""

_FAULT: Final = 100
_STALLED_S: Final = 120.0
"""A run that writes nothing for so long is stopped."""


@dataclass(frozen=True)
class Target:
    """A microcontroller: how to compile for it and how to emulate it.

    Attributes:
        name: as in the names of its start code and linker script.
        title: its name.
        prefix: of the compiler and its tools.
        flags: of the compiler, for the core and its FPU.
        emulator: command and arguments of the board, clock included.
        ticks: of the counter per instruction.
        packages: Debian packages that bring both.
        double: mnemonics of double-precision instructions (regular expression).
    """

    name: str
    title: str
    prefix: str
    flags: tuple[str, ...]
    emulator: tuple[str, ...]
    ticks: float
    packages: str
    double: str

    @property
    def remedy(self) -> str:
        """Name the remedy where they are absent."""
        return f"the Debian packages {self.packages} bring what the target takes"


TARGETS: Final[Mapping[str, Target]] = {
    target.name: target
    for target in (
        Target(
            name="cortex_m7",
            title="Arm Cortex-M7 (QEMU mps2-an500)",
            prefix="arm-none-eabi-",
            # The emulated FPU has both precisions, as some parts have; code for the smaller one runs on all.
            flags=("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"),
            # 512 ns per instruction, and a timer of 25 MHz.
            emulator=("qemu-system-arm", "-machine", "mps2-an500", "-icount", "shift=9"),
            ticks=12.8,
            packages="gcc-arm-none-eabi and qemu-system-arm",
            double=r"v\w+\.(?:\w+\.)*f64\b.*",
        ),
        Target(
            name="riscv32",
            title="RISC-V RV32IMAFC (QEMU virt)",
            prefix="riscv64-unknown-elf-",
            flags=("-march=rv32imafc", "-mabi=ilp32f"),
            # minstret counts nanoseconds of emulated time: here, instructions.
            emulator=("qemu-system-riscv32", "-machine", "virt", "-bios", "none", "-icount", "shift=0"),
            ticks=1.0,
            packages="gcc-riscv64-unknown-elf and qemu-system-misc",
            double=r"(?:c\.)?f(?:ld|sd|\w*(?:\.\w+)*\.d(?:\.\w+)*)(?:sp)?",
        ),
    )
}
"""Targets by name."""


def link_program(
    target: Target,
    parts: Mapping[str, Sequence[str | Path]],
    options: Sequence[str | Path],
    program: Path,
    core: Sequence[str] | None = None,
    start: Path | None = None,
) -> Path:
    """Compile the parts of a program, and link them with the start code and no library.

    Args:
        target: the target.
        parts: arguments of the compiler by name of the object, which is left beside the program.
        options: of the compiler, for the functions of memory that code without a library needs.
        program: the executable.
        core: flags for the core; None: the target's.
        start: folder of start code and linker script; None: that of the package.

    Returns:
        The program.

    Raises:
        BuildError: the compiler is not there, or it refused.
    """
    source, flags = runtime_dir() / "target", target.flags if core is None else core
    folder = source if start is None else start
    own: dict[str, Sequence[str | Path]] = {
        # Otherwise a compiler recognises the loop in memcpy and calls memcpy for it.
        "helpers.o": [*options, "-fno-tree-loop-distribute-patterns", source / "helpers.c"],
        "start.o": [*flags, folder / f"{target.name}.S"],
    }
    objects = []
    for part, arguments in {**parts, **own}.items():
        objects.append(program.parent / part)
        run_tool(target, "gcc", *arguments, "-c", "-o", objects[-1])
    script = folder / f"{target.name}.ld"
    run_tool(
        target, "gcc", *flags, "-nostdlib", "-Wl,--gc-sections", f"-Wl,-T,{script}", *objects, "-lgcc", "-o", program
    )
    return program


def emulate(target: Target, program: Path, results: Path, report: Callable[[int], None]) -> None:
    """Run a program to its end in the folder of its results; `report` gets the bytes that it has written so far."""
    command = [
        *target.emulator,
        *("-nodefaults", "-display", "none", "-serial", "none", "-monitor", "none", "-no-reboot"),
        *("-semihosting-config", "enable=on,target=native", "-kernel", str(program)),
    ]
    messages = results.with_name("emulator.txt")
    with messages.open("w") as stream:
        try:
            process = subprocess.Popen(
                command, cwd=results.parent, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT
            )
        except OSError as error:
            raise BuildError(f"{command[0]}: {error.strerror}; {target.remedy}") from None
        try:
            code = _wait(process, results, report)
        finally:
            process.kill()  # of no consequence where it has ended
            process.wait()
    if code is None:
        raise BuildError(f"{command[0]}: stopped, nothing came out of it for {_STALLED_S:g} s")
    if code != 0:
        meaning = {
            2: "it found no samples",
            3: "its results could not be written",
            4: "a stack was too small",
            5: f"a call takes more than {2**32 / target.ticks:.2g} instructions, which its counter cannot hold",
        }
        text = f"exception {code - _FAULT}" if code >= _FAULT else meaning.get(code, "the emulator failed")
        raise BuildError(f"{command[0]}: exit code {code}, {text}\n{messages.read_text(errors='replace')}")


def _wait(process: subprocess.Popen[bytes], results: Path, report: Callable[[int], None]) -> int | None:
    """Exit code of a process; None where its results stopped growing."""
    written, since = 0, time.monotonic()
    while True:
        try:
            return process.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            size = results.stat().st_size if results.exists() else 0
        if size > written:
            written, since = size, time.monotonic()
            report(size)
        elif time.monotonic() - since > _STALLED_S:
            return None


def run_tool(target: Target, tool: str, *arguments: str | Path) -> str:
    """Return the stdout of one of the target's tools (`gcc`, `size`). Raises BuildError if it is absent, or refused."""
    return tool_output([f"{target.prefix}{tool}", *map(str, arguments)], target.remedy)
