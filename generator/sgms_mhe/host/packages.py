"""Emitted packages for this host, each derived and printed once."""

import hashlib
import json
import threading
from typing import Final

from sgms_mhe.emission.package import Package, emit_model, emit_package
from sgms_mhe.host.provenance import digest_of_sources
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model
from sgms_mhe.support import cache

SYMBOLIC: Final = threading.RLock()
"""Held where CasADi is at work: it lets other threads run, and its expressions bear no second one."""


def cached_package(machine: Machine, model: Model | None = None) -> Package:
    """The machine's package, or that of a model alone, from the cache where it was emitted before.

    Every log of an axis asks for the same few dozen models; to derive and print one takes longer than to run it.
    """
    sources = digest_of_sources(effect.name for effect in machine.effects)
    key = hashlib.sha256(f"{machine.digest} {sources}".encode()).hexdigest()
    stem = "package" if model is None else "model"
    kept = cache.read(stem, key, ".json")
    if kept is not None:
        return Package(machine, json.loads(kept))
    package = emit_package(machine, selftest=False) if model is None else emit_model(model)
    cache.keep(stem, key, ".json", json.dumps(dict(package.files)).encode())
    return package
