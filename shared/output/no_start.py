"""The reason for which a robot has not begun its task: no usable answer came."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shared.config.extensions import CONTROLLERS, corrects
from shared.config.link_settings import LoopConfig
from shared.config.settings import RunConfig

_OTHER = "docs/wire.md describes this check"
# The remedy for each check that a message may fail.
REMEDIES = {
    "config": "use one --config at both ends: task, ground, [robot], [wbc] and [walk] differ, or "
    "the content of the files of task or robot",
    "plan": "use one version of the software at both ends: the motions differ",
    "version": "use one version of the software at both ends",
    "session": "end the other robot of this name, or give this one --name",
    "oversized": 'try wire.projector_dtype = "float32"',
    "dtype": "use one version of the software at both ends",
    "layout": "use one --config and one version of the software at both ends",
}
# An overtaken message is refused as a matter of course.
_OVERTAKEN = "stale"


def why_not_begun(summary: Mapping[str, Any], config: RunConfig) -> str:
    """Return why the robot of this summary has not begun, with a remedy, in one line.

    Counts of a service that left no report are None.
    """
    up, down = summary["link"]["uplink"], summary["link"]["downlink"]
    youngest_ms = summary["youngest_answer_ms"]
    if youngest_ms is not None:
        return too_old(config.loop, youngest_ms, carries=carried_in_words(summary))
    if down["received"]:
        if refused := refused_in_words(down["refused"]):
            return f"the robot refused {refused}"
        if full := _no_room("downlink", down, config):
            return full
        needed = "factorisation" if corrects(config.controller) else "projector"
        return f"{down['received']} answers came, without a {needed} for the robot's contact mode"
    return _nothing_came(summary, config, up, down)


def too_old(loop: LoopConfig, youngest_ms: float, *, carries: str = "") -> str:
    """Return the text for answers that were all older than `loop.hold_after`."""
    expected = f"expected an answer of at most {1e3 * loop.hold_after:g} ms (loop.hold_after)"
    others = [name for name in CONTROLLERS.own if corrects(name)]
    return (
        f"every answer was too old: {expected}, the youngest was {youngest_ms:.0f} ms old"
        f"{carries}; try --controller {' or '.join(others)}, which stands on old answers, or a "
        "larger loop.hold_after"
    )


def refused_in_words(refused: Mapping[str, int]) -> str:
    """Return the refused messages by their check, with a remedy; empty if there are none."""
    counted = {name: count for name, count in refused.items() if name != _OVERTAKEN}
    if not counted:
        return ""
    checks = ", ".join(f"{count} by the check {name}" for name, count in counted.items())
    most = max(counted, key=lambda name: counted[name])
    return f"messages ({checks}); {REMEDIES.get(most, _OTHER)}"


def _nothing_came(
    summary: Mapping[str, Any], config: RunConfig, up: Mapping[str, Any], down: Mapping[str, Any]
) -> str:
    if down["sent"]:
        return _stuck("downlink", "answers", down, down["sent"], config)
    if up["received"]:
        if refused := refused_in_words(up["refused"] or {}):
            return f"the edge refused {refused}"
        failed = {name: n for name, n in summary.get("edge_solves", {}).items() if name != "solved"}
        if failed:
            counts = ", ".join(f"{n} {name}" for name, n in failed.items())
            return f"the edge found no solution ({counts}); try other settings of [wbc]"
        return f"the edge received {up['received']} states and has not answered yet"
    if up["received"] is None:
        return "no answer came; the edge's own output says what it receives and refuses"
    return _stuck("uplink", "states", up, up["sent"], config)


def _stuck(
    direction: str, what: str, way: Mapping[str, Any], sent: int | None, config: RunConfig
) -> str:
    """Return the text for a direction in which nothing arrives."""
    if sent == 0:
        return f"the run ended before any {what} were sent"
    if full := _no_room(direction, way, config):
        return full
    lost = way.get("dropped_by_profile") or 0
    if lost:
        return (
            f"the {direction} lost {lost} of {sent} {what}, and none arrived; try another "
            "--network, --network-start or less --loss"
        )
    return (
        f"none of {sent} {what} came out of the {direction} before the run ended. A run waits "
        f"{config.loop.connect_timeout:g} s (loop.connect_timeout). If nobody ended it, the link "
        "delays them by more, or carries less than they need; try another --network or "
        "--network-start"
    )


def _no_room(direction: str, way: Mapping[str, Any], config: RunConfig) -> str:
    """Return the text for a queue that is smaller than a message; empty for any other."""
    size = (way.get("bytes_per_message") or {}).get("max") or 0.0
    if not way.get("dropped_by_profile") or size <= config.link.queue_bytes:
        return ""
    return (
        f"the {direction} has no room for a message: {size:.0f} B, but link.queue_bytes is "
        f"{config.link.queue_bytes}; try a larger queue"
    )


def carried_in_words(summary: Mapping[str, Any]) -> str:
    """Return the text for a link whose capacity is too small, so that answers become old in its
    queue.
    """
    if not str(summary["network"]).startswith("capacity:"):
        return ""
    for name in ("uplink", "downlink"):
        way = summary["link"][name]
        sent, received = way["sent"], way["received"]
        if sent and received is not None and received < sent / 2:
            size = (way.get("bytes_per_message") or {}).get("p50") or 0.0
            return (
                f", because the {name} carried {received} of {sent} messages of {size:.0f} B, and "
                "the others wait in its queue"
            )
    return ""
