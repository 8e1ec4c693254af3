"""The title of a view: the robot, the task, the controller, the link and the verdict.

Runs that are compared are named by what differs between them; the title says the rest once.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from shared.config.extensions import CONTROLLERS, TASKS
from shared.config.settings import RunConfig
from viewer.track import path_part

PATH = "title"


def parts(config: RunConfig) -> tuple[str, ...]:
    """Return the robot, the task, the controller and the link of a run in words."""
    robot, outages = config.robot.label, config.link.outage
    return (
        robot[:1].upper() + robot[1:],
        TASKS.label(config.task),
        CONTROLLERS.label(config.controller),
        config.link.network + "".join(f", {outage}" for outage in outages),
    )


def title(config: RunConfig, verdict: str) -> str:
    """Return the title of one run."""
    return _line([*parts(config), verdict])


def compared_title(
    configs: Sequence[RunConfig], names: Sequence[str], verdicts: Sequence[str]
) -> str:
    """Return the title of several runs: the words that they share, then each name and verdict."""
    words = [parts(config) for config in configs]
    shared = [each[0] for each in zip(*words, strict=True) if len(set(each)) == 1]
    ends = [f"{name} {verdict}" for name, verdict in zip(names, verdicts, strict=True)]
    return _line([*shared, ", ".join(ends)])


def compared_names(configs: Sequence[RunConfig], folders: Sequence[Path]) -> list[str]:
    """Return a name for each run, of the parts in which they differ.

    The names of the folders are used if the parts do not tell the runs apart, and the paths if the
    folders' names do not.
    """
    words = [parts(config) for config in configs]
    differing = [each for each in zip(*words, strict=True) if len(set(each)) > 1]
    folder_names = [folder.resolve().name for folder in folders]
    candidates = (
        [", ".join(own) for own in zip(*differing, strict=True)],
        _reduced(folder_names),
        [str(folder) for folder in folders],
    )
    return next(
        (names for names in candidates if len(set(map(path_part, names))) == len(folders)),
        candidates[-1],
    )


def log_title(recording: rr.RecordingStream, text: str) -> None:
    """Log a title. The newest one is shown, at all times."""
    document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
    recording.log(PATH, document, static=True)


def _line(words: Sequence[str]) -> str:
    return f"### {' · '.join(words)}"


def _reduced(names: Sequence[str]) -> list[str]:
    """Return names without the words, between hyphens, that all of them begin or end with."""
    words = [name.split("-") for name in names]
    begin = _alike(words)
    rest = [each[begin:] for each in words]
    end = _alike([each[::-1] for each in rest])
    short = ["-".join(each[: len(each) - end]) for each in rest]
    return short if all(short) else list(names)


def _alike(lists: Sequence[Sequence[str]]) -> int:
    """Return the number of first items that all lists share."""
    items = zip(*lists, strict=False)
    return sum(1 for _ in itertools.takewhile(lambda each: len(set(each)) == 1, items))
