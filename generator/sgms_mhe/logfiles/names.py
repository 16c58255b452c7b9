"""Names of columns: which quantity a name is, and the unit in it.

A name is a quantity where it is that quantity's word and words that say it was measured (actual, ist, feedback), and
nothing else: a set point, an error, a limit has a word more. Axes of one machine have a number more.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from sgms_mhe.logfiles.dialect import UNITS
from sgms_mhe.machine import BY_COLUMN, Role, normal_unit

_WORDS: Final[Mapping[Role, str]] = {
    "time": "t|time|zeit|timestamp|zeitstempel|datetime|elapsed|elapsedtime|relativetime|relativezeit|temps|tempo|"
    "tiempo|时间|時間",
    "position": "x|q|pos|position|displacement|stroke|lage|weg|angle|winkel|drehwinkel|phi|theta|encoder|"
    "encoderposition|rotorposition|pfb|plfb|(?:g[n1-3])?xist[12]|posizione|posición|posicion|位置|角度|θ|φ",
    "force": "f|u|force|kraft|loadcell|torque|trq|moment|drehmoment|m|tau|current|strom|iq|i|ilfb|effort|couple|coppia|"
    "par|forza|fuerza|转矩|扭矩|トルク|电流|電流|τ",
    "goal": "goal|goalpos|goalposition",
    "enabled": "enabled|torqueenable|torqueenabled",
    "velocity": "v|vel|velocity|speed|dq|qd|qdot|geschwindigkeit|drehzahl|omega|w|vfb|vlfb|vitesse|velocità|velocidad|"
    "速度|ω",
}
_MEASURED: Final = (
    "actual|act|active|ist|istwert|value|wert|measured|meas|mess|feedback|fbk|fb|estimate|sensor|motor|drive|antrieb|"
    "linear|angular|torqueproducing|q?axis|achse|joint|load|encoder|g[n1-3]xist"
)
_WANTED: Final = re.compile(
    r"(?:^|[\s_.\-/:])(?:set|soll|cmd|command|ref|reference|demand|target|desired|err|error|following|fehler|schlepp|action(?![^\W\d_]))",
    re.IGNORECASE,
)
_PATTERNS: Final = {
    role: re.compile(rf"(?:(?:{_MEASURED}|current)\d*)*(?:{words})(?:(?:{_MEASURED})\d*)*")
    for role, words in _WORDS.items()
}
_AXIS: Final = re.compile(r"(?:[xyz]\d?(?:axis|achse)?)?(.*?[^\W\d])(?:j?\d{1,2}|j|[xyz])?")
"""A name with the number or letter of an axis beside it: q1, tau_J3, X position, pos_y."""
_TYPE: Final = re.compile(r"(?:(?<=[.:/])|^)(?:l?r|f|[du]?i|n)(?=[A-Z][a-z]{2})")
"""Letters for the type of a variable before its name, as programs of controllers have it: fActPos, lrPosition."""


_PARAMETER: Final = re.compile(
    r"(?:[rp]\d{2,}(?:\[\d+\])?|[SP]-\d-\d+(?:\.\d+)*|0x[0-9a-f]{4}(?:[:.]\w+)?)[\s:]+", re.I
)
"""Number of a drive's parameter before its name: r80, S-0-0051, 0x6064."""
_INDEX: Final = re.compile(r"\[\d+\]")


@lru_cache(maxsize=65_536)  # each name is asked for every role, in every form
def split_name(name: str) -> tuple[str, str]:
    """(name without its unit, that unit as it stands) of 'Position [mm]', 'F (N)', 't/ms', 'pos_mm', 'Pos., mm'.

    The unit is empty where there is none; in brackets it may be anything but an index. The name is empty where it is a
    unit of time alone.
    """
    if (bare := name.strip("[](){}<> ")) in BY_COLUMN["time_s"].units:
        return "", bare
    found = re.fullmatch(r"(.*\S)\s*[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]", name)
    if found and not found[2].isdigit():
        return found[1], found[2]
    for pattern in (
        r"(.*?[^\s/])\s*/\s*([^/\s][^/]*(?:/.+)?)",  # Speed/m/min
        r"(.*[^\s/])\s*/\s*([^/\s][^/]*(?:/.+)?)",  # Axis/Speed/mm
        r"(.*\S)\s*,\s*(\S+)",
        r"(.*\S)\s+in\s+(\S+)",
    ):
        if (found := re.fullmatch(pattern, name)) and normal_unit(found[2].replace("_", "/")) in UNITS:
            return found[1], found[2].replace("_", "/")
    for mark in re.finditer("(?!^)_", name):  # act_vel_mm_s: the longest tail that is a unit
        tail = name[mark.end() :]
        for unit in (tail.replace("_", "/"), tail.replace("_", " ")):
            if normal_unit(unit) in UNITS:
                return name[: mark.start()], unit
    return name, ""


def plain_name(name: str) -> str:
    """A name without spaces, marks and capitals."""
    return re.sub(r"[\s_.,:\-/]+", "", name).casefold()


def is_usual(header: str, role: Role, *, numbered: bool = False) -> bool:
    """Return True for a usual name of a measured quantity, whole or the end of a path; `numbered`: of one of many axes.

    Time has no axis; there `numbered` is a unit alone.
    """
    bare, unit = split_name(header)
    if role == "time" and unit and not bare:
        return numbered
    name = _TYPE.sub("", _INDEX.sub("", _PARAMETER.sub("", bare)))
    if role not in _PATTERNS or _WANTED.search(name):
        return False
    names = [plain_name(end) for end in (name, *(name[mark.end() :] for mark in re.finditer(r"[.:/]", name)))]
    if numbered:
        names = [found[1] for end in names if role != "time" and (found := _AXIS.fullmatch(end))]
    return any(_PATTERNS[role].fullmatch(end) for end in names)
