"""What a package brings beside its C: a page to read, build files, a list of files, digests, the licence."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.layout import Memory, memory_of
from sgms_mhe.emission.rendering import render_page

MANIFEST: Final = "MANIFEST.json"


@dataclass(frozen=True)
class Delivery:
    """The C of a package as its build files and its page name it.

    Attributes:
        sources: what is compiled.
        headers: what it includes; the public one is the first.
        memory: bytes of what they declare.
    """

    sources: tuple[str, ...]
    headers: tuple[str, ...]
    memory: Memory


def accompany(
    view: PackageView, files: Mapping[str, str], memory: Memory, bindings: Mapping[str, str]
) -> dict[str, str]:
    """A package's files with what comes beside its C.

    Args:
        view: of the package.
        files: its C and its reports, by name.
        memory: bytes of what the C declares.
        bindings: templates of the bindings that come along, by file name.
    """
    name = view.package.name
    public = f"{name}.h"
    headers = sorted(file for file in files if file.endswith(".h") and file != public)
    sources = sorted(file for file in files if file.endswith(".c"))
    delivery = Delivery(tuple(sources), (public, *headers), memory)
    pages = {
        "README.md": "README.md",
        "CMakeLists.txt": "CMakeLists.txt",
        f"{name}.pc.in": "machine.pc.in",
        "files.txt": "files.txt",
        "LICENSE": "LICENSE",
        **bindings,
    }
    whole = dict(files) | {file: render_page(view, template, delivery) for file, template in pages.items()}
    return whole | {MANIFEST: manifest(view, whole)}


def memory_of_package(view: PackageView, files: Mapping[str, str]) -> Memory:
    """Bytes that a package's C declares."""
    return memory_of(files, view.package.name, view.package.real)


def manifest(view: PackageView, files: Mapping[str, str]) -> str:
    """SHA-256 of every file, and what they were generated from."""
    package = view.package
    content = {
        "generator": f"sgms-mhe {package.version}",
        "machine": package.name,
        "machine_digest": package.machine_digest,
        "sources_digest": package.sources_digest,
        "sha256": {file: hashlib.sha256(text.encode()).hexdigest() for file, text in sorted(files.items())},
    }
    return json.dumps(content, indent=2) + "\n"


def manifested(text: str) -> frozenset[str]:
    """Names of the files that a manifest lists, itself included; none where it is no manifest of a package."""
    try:
        content = json.loads(text)
    except ValueError:
        return frozenset()
    is_ours = isinstance(content, dict) and str(content.get("generator", "")).startswith("sgms-mhe ")
    listed = content.get("sha256") if is_ours else None
    return frozenset({MANIFEST, *listed}) if isinstance(listed, dict) else frozenset()
