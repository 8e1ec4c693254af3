"""Reports robots that come to an edge, leave it, or are refused."""

from __future__ import annotations

from collections.abc import Mapping

_SILENCE_NS = 1_000_000_000
_HINTS = {
    "config": "it runs with another task, [robot], [wbc] or [walk], or other content of the files "
    "of task or robot; use one --config at both ends",
    "plan": "it derived another motion from the same settings; use one version of the software",
    "version": "it runs another version of the software",
    "limits": "a joint, a speed or the base is where no robot can be; look at its sensors",
    "ahead": "its ticks or its clock run ahead of this machine's; look at the state's source",
    "crowded": "too many robots send under this name; give each another --name",
}
_OTHER = "see docs/wire.md; counted in the report at the end"


class ClientMonitor:
    """Reports the events since the last look, in lines for a person. Most looks report nothing.

    A robot comes with a message after a second of silence and leaves with the next such silence.
    Each reason for refusing is reported once in between.
    """

    def __init__(self) -> None:
        self._last_heard_ns: int | None = None
        self._refused: dict[str, int] = {}
        self._reported: set[str] = set()
        self._shared = self._renewed = 0

    def look(
        self,
        now_ns: int,
        *,
        heard: bool,
        refused: Mapping[str, int],
        shared: int = 0,
        renewed: int = 0,
    ) -> list[str]:
        """Return the lines to report.

        `heard`: whether messages have come since the last look; `refused`: refusals so far, by
        reason; `shared` and `renewed`: counts of `Sessions`.
        """
        if not heard:
            if self._last_heard_ns is None or now_ns - self._last_heard_ns <= _SILENCE_NS:
                return []
            self._last_heard_ns = None
            self._reported.clear()
            return ["no states for 1 s; waiting for a robot"]
        lines = ["a robot is sending states"] if self._last_heard_ns is None else []
        self._last_heard_ns = now_ns
        for reason, count in refused.items():
            if count > self._refused.get(reason, 0) and reason not in self._reported:
                self._reported.add(reason)
                lines.append(f"refuses a robot's states ({reason}): {_HINTS.get(reason, _OTHER)}")
        self._refused.update(refused)
        if shared > self._shared:
            self._shared = shared
            lines.append(
                "two robots send states under this name, and cannot be told apart; each gets its "
                "answers; start one of them with another --name"
            )
        if renewed > self._renewed:
            if self._renewed == 0:
                lines.append(
                    "after a state from far ahead only earlier ones came; the edge now answers "
                    "those"
                )
            self._renewed = renewed
        return lines
