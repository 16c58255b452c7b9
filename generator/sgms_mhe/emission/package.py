"""A machine's package: the emitted C, its runtime headers, reports and build files, as text by file name."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from sgms_mhe.emission.bindings import binding_files
from sgms_mhe.emission.budget import check_budget
from sgms_mhe.emission.context import PackageView, package_view
from sgms_mhe.emission.delivery import accompany, write_folder
from sgms_mhe.emission.layout import memory_of
from sgms_mhe.emission.rendering import amalgamate_files, render, stamp_digest
from sgms_mhe.emission.selftest import selftest_vectors
from sgms_mhe.emission.structure import analyse, report
from sgms_mhe.emission.work import work_of
from sgms_mhe.machine import Machine
from sgms_mhe.model import Model, build_model
from sgms_mhe.support.notebooks import Presentation, Shown
from sgms_mhe.support.paths import runtime_dir

RUNTIME_HEADERS = ("sgms_real.h", "sgms_math.h", "sgms_linalg.h", "sgms_filter.h")


@dataclass(frozen=True, repr=False)
class Package(Shown):
    """Emitted files by name: text, and archives of bindings; with the missing ones of the latter, in sentences."""

    machine: Machine
    files: Mapping[str, str]
    archives: Mapping[str, bytes] = field(default_factory=dict)
    missing: tuple[str, ...] = ()

    def _shown(self) -> Presentation:
        return f"{self.machine.name}, {len(self.files) + len(self.archives)} files", (), ()


def emit_package(
    machine: Machine,
    model: Model | None = None,
    *,
    selftest: bool = True,
    within_budget: bool = False,
    amalgamate: bool = False,
    bindings: Iterable[str] = (),
) -> Package:
    """Generate the C of a machine.

    Args:
        machine: the machine file.
        model: its symbolic model, where that is not `build_model` of the machine.
        selftest: with the self-test vectors, for which the reference solver has to run.
        within_budget: refuse a machine whose longest tick takes more operations than its budget.
        amalgamate: all C in one source and one header.
        bindings: languages and tools the package is to be called from besides, of `BINDINGS`.

    Raises:
        InputError: the machine asks for something that cannot be emitted; the message names it.
    """
    bound = binding_files(tuple(bindings), machine.name)
    structure = analyse(model or build_model(machine))
    view = package_view(structure)
    work = work_of(view)
    view = replace(view, work=work)
    if within_budget:
        check_budget(machine, work)
    if selftest:
        view = replace(view, vectors=selftest_vectors(structure.model))
    view = stamp_digest(view)
    files = render(view)
    memory = memory_of(files, machine.name, view.package.real)
    files |= _runtime(view)
    if amalgamate:
        files = amalgamate_files(files, machine.name)
    files["structure.txt"] = report(structure)
    whole, archives, missing = accompany(view, files, memory, bound)
    return Package(machine, dict(sorted(whole.items())), archives, missing)


def emit_model(model: Model) -> Package:
    """Generate the headers by which a model runs without its estimator, on a host. Raises InputError likewise."""
    view = package_view(analyse(model))
    return Package(model.machine, render(view, model_alone=True) | _runtime(view))


def _runtime(view: PackageView) -> dict[str, str]:
    """The runtime headers a package includes."""
    names = RUNTIME_HEADERS + (("sgms_flow.h",) if view.flow is not None else ())
    names += ("sgms_table.h",) if view.tables else ()
    return {name: (runtime_dir() / name).read_text(encoding="utf-8") for name in names}


def write_package(package: Package, folder: Path) -> None:
    """Write a package into `folder`, which afterwards holds it and nothing else that a package could have left.

    The folder is replaced in one move, so an interruption leaves the old one or the new one.

    Raises:
        InputError: the folder cannot be written, or holds files no package emits.
    """
    write_folder({**package.files, **package.archives}, folder)
