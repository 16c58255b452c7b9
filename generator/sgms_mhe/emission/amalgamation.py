"""A package's C as one source and one header."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

_UNUSED: Final = """\
/* No package uses all of the runtime; in a header clang does not mind. */
#if defined(__clang__)
#pragma clang diagnostic ignored "-Wunused-function"
#endif
"""
_INCLUDE: Final = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)


def amalgamated(files: Mapping[str, str], name: str) -> dict[str, str]:
    """The same C in NAME.c and NAME.h: every other header stands where it is first included.

    Args:
        files: C of a package by file name; it includes nothing else by name in quotes.
        name: of the machine.
    """
    public = f"{name}.h"
    placed = {public}

    def place(include: re.Match[str]) -> str:
        file = include[1]
        if file in placed:
            return ""
        placed.add(file)
        return _INCLUDE.sub(place, files[file])

    sources = sorted(file for file in files if file.endswith(".c"))
    parts = [_INCLUDE.sub(place, files[file]) for file in sources]
    return {public: files[public], f"{name}.c": f'#include "{public}"\n\n{_UNUSED}\n' + "\n".join(parts)}
