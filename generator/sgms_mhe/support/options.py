"""Mark of a function's parameters the command line offers as options."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    """Form of a parameter on the command line: `mass: Annotated[float | None, Option("KG", 1e-9, 1e6)] = None`.

    Everything else is the parameter's own: its name, type and default, and its entry under `Args:`.

    Attributes:
        metavar: of the value; empty: the unit at the end of the parameter's name.
        least, most: range of a number, ends included.
        name: of the option; empty: the parameter's, without its unit.
        infinite: word that stands for a number without bound.
    """

    metavar: str = ""
    least: float | None = None
    most: float | None = None
    name: str = ""
    infinite: str = ""
