"""The sources of commands in words."""

from __future__ import annotations

from collections.abc import Mapping

from shared.telemetry.schema import Source

_CAUSES = {
    Source.FRESH: "from the answer to the same tick",
    Source.CACHED: "an older answer, applied to fresh feedback",
    Source.HELD: "joint hold, without a usable answer",
    Source.ON_BOARD: "from the robot's own computer",
    Source.CORRECTED: "an older answer, corrected by fresh residuals",
    Source.STOPPING: "the same, while the walk ends",
}
_CACHED_BY_PR = "the torques of an older answer, as they came"


def commands_in_words(commands: Mapping[str, int], controller: str) -> str:
    """Return the sources of the commands, with the meaning of each; sources without a command are
    left out.
    """
    parts = []
    for source in Source:
        count = commands.get(source.label, 0)
        if count:
            pr_cached = controller == "pr" and source is Source.CACHED
            cause = _CACHED_BY_PR if pr_cached else _CAUSES[source]
            parts.append(f"{count} {source.label.replace('_', ' ')} ({cause})")
    return ", ".join(parts) or "none"
