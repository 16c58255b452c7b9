"""Where the files beside the Python package are: templates, hand-written C, machine files.

In a checkout (editable install) they are folders of the repository; a wheel carries copies of them inside the package.
"""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_BUNDLED = _PACKAGE / "_data"
_CHECKOUT = _PACKAGE.parents[1]


def templates_dir() -> Path:
    """Folder of the Jinja2 templates, one per emitted file."""
    return _folder("templates")


def runtime_dir() -> Path:
    """Folder of the hand-written C that no machine changes."""
    return _folder("runtime_c")


def machines_dir() -> Path:
    """Folder of the machine files that come with the product."""
    return _folder("machines")


def _folder(name: str) -> Path:
    # The bundled copy first: where it exists this is an installed wheel, and the folders two levels up are not ours.
    for root in (_BUNDLED, _CHECKOUT):
        folder = root / name
        if folder.is_dir():
            return folder
    raise FileNotFoundError(
        f"{name}/ is neither in {_BUNDLED} nor in {_CHECKOUT}: the installation of sgms-mhe is incomplete"
    )
