"""Where a package comes from: a digest of all that its bytes depend on beside the machine."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

from sgms_mhe.support.paths import templates_dir


@lru_cache(maxsize=1)
def digest_of_sources() -> str:
    """Digest of templates and generator, for the provenance line: the same sources give the same package."""
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[1]
    sources = sorted(templates_dir().rglob("*.jinja"))
    for room in ("emission", "integration", "model"):
        sources += sorted((package / room).rglob("*.py"))
    for path in sources:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]
