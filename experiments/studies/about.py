"""Provenance of a study: `about.json` beside its trials."""

from __future__ import annotations

import datetime
import os
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from experiments.studies.code_identity import ROOT, code_version
from experiments.studies.journal import Record
from experiments.studies.study import Study
from shared.output.versions import cpu_name, versions


def about_now(study: Study) -> dict[str, Any]:
    """The study, the date, the machine, the versions, the commit and the identity of the code."""
    status = _git("status", "--porcelain")
    return {
        "study": study.name,
        "description": study.table.get("description", ""),
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "machine": {"cpu": cpu_name(), "cores": os.cpu_count()},
        "versions": versions(),
        "commit": _git("rev-parse", "HEAD"),
        "dirty": None if status is None else bool(status),
        "code": code_version(),
        "seeds": study.seeds,
    }


def commit_in_words(about: Mapping[str, Any]) -> str:
    """Describe the commit of an `about.json` in words."""
    changed = " with uncommitted changes" if about["dirty"] else ""
    return f"{(about['commit'] or 'unknown')[:10]}{changed}"


def other_codes_in_words(about: Mapping[str, Any]) -> str:
    """The trials of other code that `--keep-code` kept, from an `about.json`; "" if none."""
    others = about.get("other_code", {}).items()
    return ", ".join(f"{count} trials of code {code}" for code, count in others)


def other_codes(records: Iterable[Record]) -> dict[str, int]:
    """The number of trials that each other version of the code played (`--keep-code`)."""
    here = code_version()
    codes = Counter(record.get("code", here) for record in records)
    del codes[here]
    return dict(codes)


def _git(*arguments: str) -> str | None:
    command = ["git", "-C", str(ROOT), *arguments]
    # In a git hook these variables name the repository of the hook.
    here = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(command, env=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
