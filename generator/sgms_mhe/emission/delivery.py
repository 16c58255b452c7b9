"""Files of a package beside its C, and its folder: a page, build files, a list, digests, the licence."""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from sgms_mhe.emission.bindings import SUFFIX, Variable, fmu, variables_of
from sgms_mhe.emission.context import PackageView
from sgms_mhe.emission.layout import Memory
from sgms_mhe.emission.rendering import render_page
from sgms_mhe.support.errors import InputError

MANIFEST: Final = "MANIFEST.json"


@dataclass(frozen=True)
class Delivery:
    """The C of a package as its build files and its page name it.

    Attributes:
        sources: compiled files.
        headers: included files; the public one is the first.
        public: headers that another project includes.
        memory: bytes of their declarations.
        variables: of the axis, as block diagrams see it.
    """

    sources: tuple[str, ...]
    headers: tuple[str, ...]
    public: tuple[str, ...]
    memory: Memory
    variables: tuple[Variable, ...]


def accompany(
    view: PackageView, files: Mapping[str, str], memory: Memory, bindings: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, bytes], tuple[str, ...]]:
    """A package's files with the files beside its C.

    Args:
        view: of the package.
        files: its C and its reports, by name.
        memory: bytes declared by the C.
        bindings: templates of the bindings that come along, by file name.

    Returns:
        Text by file name, archives by file name, and the missing ones, sentence by sentence.
    """
    name = view.package.name
    public = f"{name}.h"
    headers = sorted(file for file in files if file.endswith(".h") and file != public)
    sources = sorted(file for file in files if file.endswith(".c"))
    includable = (public, *(file for file in bindings if file.endswith(".hpp")))
    delivery = Delivery(tuple(sources), (public, *headers), includable, memory, variables_of(view))
    pages = {
        **{file: file for file in ("README.md", "CMakeLists.txt", "files.txt", "LICENSE")},
        f"{name}.pc.in": "machine.pc.in",
        **{file: template for file, template in bindings.items() if SUFFIX not in file},
    }
    whole = dict(files) | {file: render_page(view, template, delivery) for file, template in pages.items()}
    archives, missing = _archives(view, whole, delivery, bindings)
    return whole | {MANIFEST: manifest(view, whole, archives)}, archives, missing


def _archives(
    view: PackageView, whole: Mapping[str, str], delivery: Delivery, bindings: Mapping[str, str]
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """FMUs among the bindings, and of which of them the binary is missing and why.

    The self-test stays outside: it is for the processor the axis runs on.
    """
    name = view.package.name
    own = tuple(file for file in delivery.sources if not file.startswith(f"{name}_selftest"))
    inside = {f"sources/{file}": whole[file] for file in (*own, *delivery.headers) if "_selftest." not in file}
    inside["documentation/licenses/license.txt"] = whole["LICENSE"]
    texts: dict[str, dict[str, str]] = {}
    for file, template in bindings.items():
        archive, found, path = file.partition(SUFFIX)
        if found:
            page = render_page(view, template, replace(delivery, sources=own))
            texts.setdefault(archive + SUFFIX.rstrip("/"), dict(inside))[path] = page
    built = {file: fmu(content, name, file) for file, content in texts.items()}
    missing = tuple(f"{file}: sources without a binary: {why}" for file, (_, why) in built.items() if why is not None)
    return {file: archive for file, (archive, _) in built.items()}, missing


def manifest(view: PackageView, files: Mapping[str, str], archives: Mapping[str, bytes]) -> str:
    """SHA-256 of every file, and their sources."""
    package = view.package
    contents = {file: text.encode() for file, text in files.items()} | dict(archives)
    content = {
        "generator": f"sgms-mhe {package.version}",
        "machine": package.name,
        "machine_digest": package.machine_digest,
        "sha256": {file: hashlib.sha256(content).hexdigest() for file, content in sorted(contents.items())},
    }
    return json.dumps(content, indent=2) + "\n"


def manifest_files(text: str) -> frozenset[str]:
    """Names of the files a manifest lists, itself included; none where it is no manifest of a package."""
    try:
        content = json.loads(text)
    except ValueError:
        return frozenset()
    is_ours = isinstance(content, dict) and str(content.get("generator", "")).startswith("sgms-mhe ")
    listed = content.get("sha256") if is_ours else None
    return frozenset({MANIFEST, *listed}) if isinstance(listed, dict) else frozenset()


EARLIER_SUFFIXES = (".c", ".h", ".txt")
"""Of the files of packages that had no manifest."""


def write_folder(files: Mapping[str, str | bytes], folder: Path) -> None:
    """Write files into `folder`, which afterwards holds them and nothing else that a package could have left.

    The folder is replaced in one move, so an interruption leaves the old one or the new one.

    Raises:
        InputError: the folder cannot be written, or holds files no package emits.
    """
    parent = folder.parent
    foreign = _foreign(folder) if folder.is_dir() else []
    if foreign:
        raise InputError(folder, "output folder", sorted(foreign)[0], "an empty folder or an earlier package")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=parent, prefix=f".{folder.name}-"))
        try:
            for name, content in files.items():
                (scratch / name).write_bytes(content if isinstance(content, bytes) else content.encode())
            scratch.chmod(0o755)
            if folder.exists():
                shutil.rmtree(folder)
            scratch.rename(folder)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise InputError(folder, "output folder", None, f"cannot be written: {error.strerror}") from None


def _foreign(folder: Path) -> list[str]:
    """Names of files in a folder outside of its package, which its manifest lists."""
    listed = folder / MANIFEST
    names = {path.name for path in folder.iterdir()}
    if listed.is_file():
        return list(names - manifest_files(listed.read_text(encoding="utf-8", errors="replace")))
    return [name for name in names if not name.endswith(EARLIER_SUFFIXES) or name == "CMakeLists.txt"]
