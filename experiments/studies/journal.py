"""Journal of finished trials: `trials.jsonl`, with a line per trial that holds its summary.

A trial has an identity, which is a hash of all its settings, and the version of the code that
played it. Lines of other settings and of other code stay in the file and are not used.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from experiments.studies.code_identity import code_version, present_identity
from shared.errors import ConfigError
from shared.file_lock import lock

# `summary` or `error`, `wall_seconds`; in the journal also `trial`, `code` and `label`.
Record = dict[str, Any]


class Identified(Protocol):
    """A trial, or anything else that is played once and then known by its identity."""

    @property
    def identity(self) -> str: ...
    @property
    def label(self) -> dict[str, Any]: ...


class Journal:
    """The lines of the file. `add` appends a line."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        try:
            self._lines: list[Record] = [json.loads(line) for line in file]
            for line in self._lines:
                _ = line["trial"], line["error"]
                line["code"] = present_identity(line["code"])
        except (ValueError, LookupError, TypeError) as error:
            raise ConfigError(
                f"out: expected a trial in every line of {file.name}, got another line ({error}); "
                "give another --out"
            ) from None

    def usable(self, *, keep_code: bool) -> dict[str, Record]:
        """Trials of this code that finished without an error, by identity.

        With `keep_code`, a trial that this code has not played may come from other code.
        """
        mine = [line for line in self._lines if line["code"] == code_version()]
        lines = [*self._lines, *mine] if keep_code else mine
        return {line["trial"]: line for line in lines if line["error"] is None}

    def failed(self) -> dict[str, Record]:
        """Trials of this code whose last line has an error, by identity."""
        last = {line["trial"]: line for line in self._lines if line["code"] == code_version()}
        return {name: line for name, line in last.items() if line["error"] is not None}

    def left_out(self, wanted: Set[str], *, keep_code: bool) -> str | None:
        """A sentence on the lines that are not used. `wanted`: identities of the study's trials."""
        of_study = [line for line in self._lines if line["trial"] in wanted]
        used = [line for line in of_study if keep_code or line["code"] == code_version()]
        if len(used) == len(self._lines):
            return None
        return (
            f"trials of {self._file.name} left out: {len(self._lines) - len(of_study)} of other "
            f"settings or seeds, {len(of_study) - len(used)} of other code (--keep-code uses the "
            "latter)"
        )

    def add(self, trial: Identified, record: Record) -> None:
        """Append the line of a trial, and flush it to the file."""
        line = {"trial": trial.identity, "code": code_version(), "label": trial.label, **record}
        self._file.write(json.dumps(line).encode() + b"\n")
        self._file.flush()


@contextlib.contextmanager
def open_journal(path: Path) -> Iterator[Journal]:
    """Open the journal for one sweep alone. A half-written last line is removed."""
    with path.open("a+b") as file:
        if not lock(file, within=0.0):
            raise ConfigError(
                f"out: another sweep writes to {path.parent}; wait for it or give another --out"
            )
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        file.seek(0)
        yield Journal(file)
