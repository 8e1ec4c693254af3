"""The summary of a run: the parts of its processes joined, the verdict, and all of it in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shared.config.extensions import CONTROLLERS, TASKS, corrects
from shared.config.settings import WALKS, RunConfig
from shared.output.fall import fall_in_words
from shared.output.link_met import DIRECTIONS, LEAST_NS, LinkMet
from shared.output.no_start import why_not_begun
from shared.output.report import discrepancy_of, merge
from shared.output.sources import commands_in_words
from shared.output.validity import Machine, invalid_reasons
from shared.output.versions import versions
from shared.telemetry.metrics import quantiles

# A profile of one value, such as a constant delay, has no places.
_LEAST_PROFILE_SECONDS = 0.01
# A run has met the profile's worst outage if it has met an outage of at least this share of its
# length.
_AS_LONG = 0.9
# A run that is to meet an outage begins this long before it.
_BEFORE_SECONDS = 1.0
# Others' processes are worth a line of the summary from this number of cores on.
_BUSY_CORES = 0.3


def summary(
    config: RunConfig,
    *,
    robot: dict[str, Any],
    edge: dict[str, Any] | None,
    link: dict[str, Any] | None,
    discrepancy: dict[str, Any] | None,
    met: LinkMet | None = None,
    machine: Machine | None = None,
) -> dict[str, Any]:
    """Return the summary of a run. It has every key, even if a part is missing.

    `met` is the part of the link that the run has met, None without a shim. `machine` is None under
    simulated time. `valid` tells whether the run is a result about the link, `invalid_reasons` why
    it is none. `fall_reason` is None without a fall.
    """
    unknown = {"sent": None, "received": None, "lost": None, "refused": None}
    skeleton = {
        "task": config.task,
        "controller": config.controller,
        "network": config.link.network,
        "seed": config.seed,
        "edge_solve_ms": quantiles(np.empty(0)),
        "active_set_discrepancy": discrepancy or discrepancy_of(*[np.empty(0)] * 3),
        "link": {
            name: {**unknown, "bytes_per_second": None, "delay_error_ms": quantiles(np.empty(0))}
            for name in DIRECTIONS
        },
    }
    joined = merge(skeleton, robot, edge, link)
    if not joined["task_seconds"]:
        reasons = [f"the task did not begin: {why_not_begun(joined, config)}"]
    else:
        reasons = invalid_reasons(joined, config, machine)
    verdict = {"valid": not reasons, "invalid_reasons": reasons, "fall_reason": None}
    if joined["fall"] is not None:
        outages = () if met is None else met.outages
        words = fall_in_words(joined["fall"], controller=config.controller, outages=outages)
        verdict["fall_reason"] = words
    return {
        **verdict,
        **joined,
        **_met_report(joined, met),
        **({} if machine is None else {"machine": machine.report()}),
        "versions": versions(),
    }


def _met_report(joined: Mapping[str, Any], met: LinkMet | None) -> dict[str, Any]:
    """Return the part on the link that the run has met. Times are of the task [s]."""
    length, begins = joined.get("profile_seconds") or 0.0, joined.get("profile_begins_s")
    played: dict[str, float | None] = {"from_s": None, "seconds": None, "share": None}
    worst: dict[str, Any] = dict.fromkeys(("direction", "ms", "at_s", "profile_at_s", "over"))
    if met is None:
        return {"played": played, "worst_outage": worst}
    begin_s = (begins or 0.0) + met.task_begins_ns * 1e-9
    has_places = begins is not None and length > _LEAST_PROFILE_SECONDS
    if has_places:
        seconds = met.lasted_ns * 1e-9
        share = round(min(1.0, seconds / length), 4)
        played = {
            "from_s": round(begin_s % length, 3),
            "seconds": round(seconds, 3),
            "share": share,
        }
    worst["ms"] = 0.0
    if (outage := met.worst) is not None:
        at_s = outage.begin_ns * 1e-9
        place_s = round((begin_s + at_s) % length, 3) if has_places else None
        worst |= {"direction": outage.direction, "ms": round(outage.duration_ns * 1e-6, 3)}
        worst |= {"at_s": round(at_s, 3), "profile_at_s": place_s, "over": outage.over}
    return {"played": played, "worst_outage": worst}


def summary_in_words(summary: dict[str, Any]) -> str:
    """Return the summary as text for a person: the verdict and its reason first, counters last."""
    lines = []
    if not summary["valid"]:
        lines.append(f"NO RESULT about the link: {'; '.join(summary['invalid_reasons'])}")
    lines += [_verdict(summary), *_machine_in_words(summary)]
    if not summary["task_seconds"]:
        return "\n".join([lines[0], *_machine_in_words(summary), *_counters(summary)])
    if summary["measured_seconds"] < summary["task_seconds"]:
        lines.append(f"  figures cover its first {summary['measured_seconds']:.2f} s")
    if summary["fall_reason"]:
        lines.append(f"  reason: {summary['fall_reason']}")
    lines += [*_link_in_words(summary), *_accuracy(summary), *_commands(summary)]
    return "\n".join([*lines, *_counters(summary)])


def _verdict(summary: Mapping[str, Any]) -> str:
    """Return the first line of a summary, for a run that has begun."""
    ended = {True: "FELL", False: "Stands", None: "Killed"}[summary["fell"]]
    task = TASKS.label(summary["task"])
    controller = CONTROLLERS.label(summary["controller"])
    return (
        f"{ended} after {summary['task_seconds']:.2f} s of {task} with {controller} over "
        f"{summary['network']}"
    )


def _machine_in_words(summary: Mapping[str, Any]) -> list[str]:
    """Return the line on the work of others on the machine, with its effect; [] without work."""
    machine = summary.get("machine", {})
    taken = machine.get("other_cores")
    if taken is None or taken < _BUSY_CORES:
        return []
    busy = f"  other processes took {taken:.1f} of this machine's {machine['cores']} cores"
    edge, stalls = machine["edge_ms"]["p50"], machine["stalls_s"]
    effects = []
    # The edge of a controller that corrects answers seldom.
    if edge is not None and not corrects(summary["controller"]):
        effects.append(f"an answer left the edge {edge:.0f} ms after its state (median)")
    if stalls:
        effects.append(f"the longest standstill was {max(stalls.values()) * 1e3:.0f} ms")
    return [f"{busy}; {', '.join(effects)}" if effects else busy]


def _link_in_words(summary: Mapping[str, Any]) -> list[str]:
    played, worst = summary["played"], summary["worst_outage"]
    if worst["ms"] is None:
        return []
    span = ""
    if played["from_s"] is not None:
        length = summary["profile_seconds"]
        again = ", which then repeats" if played["from_s"] + played["seconds"] > length else ""
        span = (
            f"played {played['seconds']:.2f} s of the profile's {length:.4g} s, from "
            f"{played['from_s']:.2f} s on{again}; "
        )
    missed = _missed(summary)
    if not worst["ms"]:
        return [f"  {span}met no outage above {LEAST_NS * 1e-6:.0f} ms", *missed]
    place = f"at {worst['at_s']:.2f} s"
    if worst["profile_at_s"] is not None:
        place += f", {worst['profile_at_s']:.2f} s of the profile"
    end = "" if worst["over"] else ", and not over at the end"
    met = f"worst outage met {worst['ms']:.0f} ms ({worst['direction']}, {place}{end})"
    return [f"  {span}{met}", *missed]


def _missed(summary: Mapping[str, Any]) -> list[str]:
    """Return the line on the profile's worst outage if it is longer than every outage that the run
    met.
    """
    worst = summary.get("profile_worst_outage")
    if worst is None or worst["ms"] * _AS_LONG <= max(
        summary["worst_outage"]["ms"], LEAST_NS * 1e-6
    ):
        return []
    before_s = max(0.0, worst["at_s"] - _BEFORE_SECONDS)
    return [
        f"  not met: the profile's worst outage, {worst['ms']:.0f} ms ({worst['direction']}, at "
        f"{worst['at_s']:.2f} s of the profile); try --network-start {before_s:.2f}s"
    ]


def _accuracy(summary: Mapping[str, Any]) -> list[str]:
    if summary["fell"]:
        return ["  CoM error and contact violation have no meaning after a fall"]
    slip = summary["foot_slip_mm"]
    return [
        f"  CoM error {_number(summary['com_error_m'], 'cm', 100)}, contact violation "
        f"{_number(summary['contact_violation_m_s2'], 'm/s²', digits=3)}, foot slip at most "
        f"{_number(slip['max'], 'mm')} in a stance"
    ]


def _commands(summary: Mapping[str, Any]) -> list[str]:
    age = summary["projector_age_ms"]
    lines = [
        f"  commands: {commands_in_words(summary['commands'], summary['controller'])}",
        f"  age of the answer in use: p50 {_number(age['p50'], 'ms')}, p99 "
        f"{_number(age['p99'], 'ms')}, max {_number(age['max'], 'ms')}",
    ]
    discrepancy, wait = summary["active_set_discrepancy"], summary["switch_to_fresh_ms"]
    if discrepancy["mean"] is not None:
        lines.append(
            f"  active set differs from the optimum's in {_number(discrepancy['mean'], 'rows')} on "
            f"average, at most {_number(discrepancy['max'], 'rows', digits=0)}"
        )
    if summary["task"] in WALKS:
        # A controller that corrects needs no fresh projector at a contact switch.
        waited = (
            ""
            if corrects(summary["controller"])
            else f"contact switch to first fresh projector p50 {_number(wait['p50'], 'ms')}, max "
            f"{_number(wait['max'], 'ms')}, not in time {wait['never']} ×; "
        )
        lines.append(f"  {waited}{summary['on_board_qps']} QPs solved on board")
    return lines


def _counters(summary: Mapping[str, Any]) -> list[str]:
    tick, solve = summary["robot_tick_ms"], summary["edge_solve_ms"]
    lines = []
    for name, way in summary["link"].items():
        refused = sum((way["refused"] or {}).values())
        error = way["delay_error_ms"]
        lines.append(
            f"  {name}: {_known(way['sent'])} sent, {_known(way['received'])} received, "
            f"{_known(way['lost'])} lost, {refused} refused{_rate(way['bytes_per_second'])}; delay "
            f"error p50 {_number(error['p50'], 'ms')}, p99 {_number(error['p99'], 'ms')}"
        )
    answers = summary["link"]["downlink"].get("answers") or {}
    if len(answers) > 1:
        by_edge = ", ".join(
            f"{counts['taken']} of {edge} ({counts['refused']} refused)"
            for edge, counts in answers.items()
        )
        lines.append(f"  answers from {len(answers)} edges: {by_edge}")
    if faults := summary.get("sensor_faults"):
        held = ", ".join(f"{sensor} {count} ×" for sensor, count in faults.items())
        lines.append(f"  sensor faults held over: {held}")
    moved = summary.get("base_estimate") or {}
    if any(moved.values()):
        lines.append(
            f"  the base's estimate moved: {moved['jumps']} jumps, {moved['drifts']} drifts; the "
            "robot did not follow it"
        )
    if not summary["task_seconds"]:
        return lines
    return [
        *lines,
        f"  robot tick p50 {_number(tick['p50'], 'ms')}, p99 {_number(tick['p99'], 'ms')}; "
        f"edge solve p50 {_number(solve['p50'], 'ms')}, p99 {_number(solve['p99'], 'ms')}",
        f"  {summary['overruns']} overruns (ticks that ended after the next was due); "
        f"{_known(summary['realtime_factor'])} × real time",
    ]


def _known(value: float | None) -> str:
    return "-" if value is None else str(value)


def _rate(bytes_per_second: float | None) -> str:
    return "" if bytes_per_second is None else f", {bytes_per_second / 1e6:.3f} MB/s"


def _number(value: float | None, unit: str, scale: float = 1.0, *, digits: int = 2) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f} {unit}"
