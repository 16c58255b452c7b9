"""NPZ archives, as numpy writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sgms_mhe.signals.formats.variables import Choose, Variables, array_row, damaged, vector
from sgms_mhe.support.errors import InputError


def read_npz(path: Path, choose: Choose) -> Variables:
    """Read the wanted arrays. Raises InputError for a damaged archive, OSError as open does."""
    with path.open("rb") as stream:
        try:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            variables = {name: archive[name] for name in choose(archive.files)}
        except InputError:
            raise
        except Exception as error:  # the readers of a damaged file stumble in many ways
            raise damaged(path, "a whole NPZ archive of numeric arrays", error) from None
    return Variables({name: vector(path, name, value) for name, value in variables.items()}, array_row)
