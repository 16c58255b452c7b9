"""Workbench of sgms-mhe: benchmarks, studies, verification of the emitted C; part of a checkout, not of the product."""

from pathlib import Path
from typing import Final

C_DIR: Final = Path(__file__).resolve().parents[1] / "c"
"""Folder of the C programs that only the workbench compiles."""
