"""Decisions of an analysis as log records, and the trace that keeps them.

Every rule that decides something logs the rule, its subject and its numbers, under `sgms_mhe.decision.STAGE` at level
DEBUG. So a library user follows them with `logging`, and `--trace` writes the same records to files.
"""

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final

from sgms_mhe.support.errors import InputError
from sgms_mhe.support.files import write_text
from sgms_mhe.support.json_values import finite

ROOT: Final = "sgms_mhe.decision"
_LOGGER: Final = logging.getLogger(ROOT)


def log_decision(stage: str, rule: str, **facts: Any) -> None:
    """Log one decision.

    Args:
        stage: of the analysis, as in docs/files.md: `search`, `rivals`, `verdict`, ...
        rule: that decides.
        facts: the numbers it decides on, its limits and its outcome; JSON types, numpy scalars.
    """
    logger = _LOGGER.getChild(stage)
    if logger.isEnabledFor(logging.DEBUG):
        said = ", ".join(f"{name} = {_short(value)}" for name, value in facts.items())
        logger.debug("%s: %s", rule, said, extra={"decision": {"rule": rule, **facts}})


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class _Collector(logging.Handler):
    """Decisions by stage, in the order of their first record; those of one trace, since others may run beside it."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.stages: dict[str, list[dict[str, Any]]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record's decision."""
        decision = getattr(record, "decision", None)
        if decision is not None and _tracing.get() is self:
            self.stages.setdefault(record.name.removeprefix(f"{ROOT}."), []).append(decision)


_tracing: Final[ContextVar[_Collector | None]] = ContextVar("tracing", default=None)


@contextmanager
def trace_decisions(folder: Path | None) -> Iterator[None]:
    """Write the decisions of the block, its parallel tasks included, to `NN_STAGE.json` in a folder, if it fails too.

    Args:
        folder: made where it does not exist; files of an earlier trace in it are replaced. None: nothing is written.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    if folder is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, "trace", None, f"a folder that can be made ({error.strerror})") from None
    collector, level = _Collector(), _LOGGER.level
    _LOGGER.addHandler(collector)
    _LOGGER.setLevel(logging.DEBUG)
    token = _tracing.set(collector)
    try:
        yield
    finally:
        _tracing.reset(token)
        _LOGGER.removeHandler(collector)
        _LOGGER.setLevel(level)
        for old in folder.glob("[0-9][0-9]_*.json"):
            old.unlink()
        for number, (stage, decisions) in enumerate(collector.stages.items(), start=1):
            content = {"stage": stage, "decisions": finite(decisions)}
            write_text(folder / f"{number:02}_{stage}.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
