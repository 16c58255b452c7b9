"""Emitted packages for this host, each derived and printed once."""

from __future__ import annotations

import hashlib
import json
import threading
from typing import Final

from sgms_mhe.emission.package import Package, emit_package
from sgms_mhe.host.provenance import digest_of_sources
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.support import cache

SYMBOLIC: Final = threading.RLock()
"""Held where CasADi is at work: it lets other threads run, and its expressions bear no second one."""


def cached_package(machine: Machine, model: Model | None = None) -> Package:
    """The machine's package, from the cache of compiled libraries where it was emitted before; `model`: if known.

    Every log of an axis asks for the same few dozen models; to derive and print one takes longer than to run it.
    """
    sources = digest_of_sources(effect.name for effect in machine.effects)
    key = hashlib.sha256(f"{machine.digest} {sources}".encode()).hexdigest()
    kept = cache.read("package", key, ".json")
    if kept is not None:
        return Package(machine, json.loads(kept))
    package = emit_package(machine, model, selftest=False)
    cache.keep("package", key, ".json", json.dumps(dict(package.files)).encode())
    return package
