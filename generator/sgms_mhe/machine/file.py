"""The machine file as a whole: its tables, each checked by itself, and the JSON Schema that editors read.

Checks and defaults beyond the file itself (the effects' parameters, the names an estimator may use,
the integrator the friction law asks for) is taken as it is written; `sgms_mhe.configuration` resolves it.
"""

import re
from typing import Annotated, Any, Final, Self

from pydantic import ConfigDict, Field, SkipValidation, model_validator

from sgms_mhe.machine.axis import Friction, Plant
from sgms_mhe.machine.code import Code, Compensation
from sgms_mhe.machine.diagnosis import DiagnosisTable
from sgms_mhe.machine.drive import Drive
from sgms_mhe.machine.estimator import Estimator
from sgms_mhe.machine.fields import MachineTable, refusal, text
from sgms_mhe.machine.log_mapping import LogMapping
from sgms_mhe.machine.sampling import Integrator, Sampling

C_KEYWORDS: Final = frozenset(
    """
    alignas alignof and asm auto bool break case catch char class compl const constexpr continue decltype
    default delete do double else enum explicit export extern false float for friend goto if inline int long
    main mutable namespace new noexcept not nullptr operator or private protected public register restrict
    return short signed sizeof static struct switch template this throw true try typedef typename union unsigned
    using virtual void volatile while xor
    """.split()
)

RESERVED_NAMES: Final = re.compile(
    r"sgms(_.*)?"  # the runtime's files and symbols
    r"|(element|block)[0-9]*|chain|course|flow|friction|good|hold|inner|parameter|sample"  # a package's own
    r"|selftest|start|take"
    r"|u?int((_least|_fast)?[0-9]+|ptr|max)|size|ptrdiff|wchar|wint|clock|time|fpos|va_list"  # types of the C library
    r"|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|std[a-z]+|string|tgmath"
    r"|threads|uchar|wctype",  # its headers
    re.IGNORECASE,
)
"""Machine names whose files or symbols would take the place of others, also where file names ignore case."""


class Effect(MachineTable):
    """One entry of [[effects]]: a name and that effect's parameters; units stand in the parameters' names."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, SkipValidation[float | tuple[float, ...]]]

    name: str = text("effect, as in the registry of effects", "a known effect")

    @property
    def written(self) -> dict[str, Any]:
        """The parameters the file gives, by key, whatever they are."""
        return dict(self.__pydantic_extra__)


class Tables(MachineTable):
    """A machine file's content: every table of it, each sound by itself."""

    name: str = text(
        "prefix of every emitted symbol and file",
        "a C identifier of at most 48 characters that starts with a letter",
        pattern=r"^[A-Za-z][A-Za-z0-9_]*$",
        max_length=48,
    )
    description: str = text(
        "one line about the axis", "one line without comment marks or backslashes", "", max_length=200
    )
    plant: Plant = Field(description="what moves; required")
    friction: Friction = Field(description="S-GMS parameters; required")
    sampling: Sampling = Field(
        Sampling(integrator=Integrator(substeps=100)), description="rates; default 10 kHz, 100 Hz"
    )
    drive: Drive = Field(Drive(), description="what a command does that is no force; default: the command is a force")
    estimator: Estimator = Field(Estimator(), description="the observer; default as in its keys")
    compensation: Compensation = Field(
        Compensation(), description="the friction fed forward; default: at once, unlimited, without a delay"
    )
    code: Code = Field(Code(), description="the emitted C; default double precision")
    effects: Annotated[tuple[Effect, ...], Field(strict=False)] = Field(
        (), description="what the axis has beyond S-GMS; none, one or many; default none"
    )
    learned: bool = Field(
        True, description="whether the effects count that a diagnosis learned; false leaves them out; default true"
    )
    diagnosis: DiagnosisTable = Field(
        DiagnosisTable(), description="what a diagnosis decides by, not part of the emitted C; default as in its keys"
    )
    log: LogMapping | None = Field(None, description="mapping of a measured file; default: columns named as in a log")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.name in C_KEYWORDS:
            raise refusal("name", self.name, "a C identifier that is not a keyword of C or C++")
        if RESERVED_NAMES.fullmatch(self.name):
            raise refusal(
                "name", self.name, "a name that neither the runtime (sgms...) nor a package nor C has for itself"
            )
        if not self.description.isprintable() or re.search(r"/\*|\*/|\\", self.description):
            raise refusal("description", self.description, "one printable line without comment marks or backslashes")
        return self


def json_schema() -> dict[str, Any]:
    """JSON Schema of a machine file, `extends` included."""
    schema = Tables.model_json_schema(by_alias=True)
    schema["title"] = "sgms-mhe machine file"
    schema["description"] = "A machine file, resolved and checked."
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "another machine file (same folder or machines/) whose keys this file overrides; "
        "tables merge, arrays are replaced; default none",
    }
    schema["properties"]["extends_digest"] = {
        "type": "string",
        "description": "digest of that file when this one was written: a warning where it has changed; default none",
    }
    # A file that extends another one may leave everything to it.
    schema["if"], schema["else"] = {"required": ["extends"]}, {"required": schema.pop("required")}
    return schema
