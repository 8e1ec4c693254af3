"""The reason of a fall, from the last seconds of the robot's telemetry.

A fall is detected late: the CoM is then below 0.6 of its height. Two earlier moments count. The
fall *begins* when the CoM leaves its reference by `_BEGINS` for the last time, and cannot be
stopped any more beyond `_LOST`. Pushes, the age of the answer in use, slips, torques at their limit
and a joint hold before these moments are the reason. Later ones are consequences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shared.config.extensions import corrects
from shared.output.link_met import MetOutage
from shared.robots import Foot, Robot
from shared.telemetry.schema import Schema, Source

# CoM errors [m]. Under a push of 100 N Romeo stands with 5 cm at most, with 8 cm on answers of
# 120 ms, and with 9 cm through an outage of 0.39 s. Talos, which is taller, came back from 12.6 cm.
_BEGINS, _LOST = 0.05, 0.10
# The slip of a loaded foot that counts [m]: a robot that stands slips by some millimetres.
_SLIP = 0.01
# The part of its limit from which a torque counts as clamped.
_CLAMPED = 0.999
# Ticks before the beginning of a fall in which a slip or a clamped torque belongs to it.
_BEFORE = 500
# The time from the end of a push, or of an outage, to a fall that it may have caused [s].
_AFTER = 1.0
# Ticks that are looked at: a fall is over long before.
_LOOKED_AT = 10_000
_AXES = "xyz"


def torque_limits(robot: Robot, *, clamp: float) -> dict[str, float]:
    """Return the largest torque that each joint may be commanded [N m], by its name, in order."""
    limits = clamp * robot.effort_limit
    return dict(zip(list(robot.model.names)[2:], limits.tolist(), strict=True))


def fall_report(
    schema: Schema, rows: np.ndarray, *, torque_limits: Mapping[str, float]
) -> dict[str, Any]:
    """Return the circumstances of a fall that ends `rows`, which are of the task.

    Times are of the task [s]. A circumstance that does not apply is None.
    """
    rows = rows[-_LOOKED_AT:]

    def column(name: str) -> np.ndarray:
        return schema.column(rows, name)

    seconds, error = column("time_ns") * 1e-9, column("com_error_m")
    begins, lost = (_last(error <= limit) for limit in (_BEGINS, _LOST))
    window = slice(max(0, begins - _BEFORE), lost + 1)
    age_ns, source = column("projector_age_ns")[begins], Source(int(column("source")[begins]))
    return {
        "at_s": _rounded(seconds[-1]),
        "begins_s": _rounded(seconds[begins]),
        "push": _push(seconds[: lost + 1], column("push_n")[: lost + 1], before=seconds[begins]),
        "answer_age_ms": _rounded(age_ns * 1e-6) if age_ns >= 0 else None,
        "command": source.label,
        "slip": _slip(seconds[window], column("foot_slip_m")[window]),
        "torque_at_limit": _torque(seconds[window], column("tau")[window], torque_limits),
        "held_from_s": _first(seconds[window], column("source")[window] == Source.HELD),
    }


def fall_in_words(
    fall: Mapping[str, Any], *, controller: str, outages: Sequence[MetOutage] = ()
) -> str:
    """Return the reason of a fall, from its report and the outages that the run has met."""
    said = []
    if push := fall["push"]:
        force = force_in_words(np.array(push["force_n"]))
        said.append(f"pushed with {force} at {push['at_s']:.2f} s")
    outage = _outage_at(fall["begins_s"], outages)
    during = ""
    if outage is not None:
        place = "in" if outage.end_ns * 1e-9 >= fall["begins_s"] else "after"
        during = f"{place} an outage of the {outage.in_words()}"
    age_ms = fall["answer_age_ms"]
    if fall["command"] in (Source.FRESH.label, Source.CACHED.label) and age_ms is not None:
        # A controller that corrects does not depend on the age of its factorisation.
        used = "the answer in use" if controller != "pr" else "the torques in use"
        verb = "was" if controller != "pr" else "were"
        text = f"{used} {verb} {age_ms:.0f} ms old when the fall began at {fall['begins_s']:.2f} s"
        said.append(", ".join(filter(None, [text, during])))
    elif during:
        said.append(during)
    later = []
    if slip := fall["slip"]:
        far = f"{slip['mm']:.0f} mm from {slip['at_s']:.2f} s on"
        later.append((slip["at_s"], f"the {slip['foot']} foot slipped by {far}"))
    if torque := fall["torque_at_limit"]:
        text = f"{torque['joint']} at its torque limit from {torque['at_s']:.2f} s on"
        later.append((torque["at_s"], text))
    if (held_s := fall["held_from_s"]) is not None:
        later.append((held_s, f"the joints held from {held_s:.2f} s on, without a usable answer"))
    said += [text for _, text in sorted(later)]
    if not said:
        kind = "correction" if corrects(controller) else "answer"
        said.append(
            f"no push, outage, slip or clamped torque before; the {kind} itself was not enough"
        )
    return "; ".join(said)


def force_in_words(force: np.ndarray) -> str:
    """Return text for a force [N] in the world: along an axis, or by its components."""
    axis = int(np.argmax(np.abs(force)))
    if np.count_nonzero(force) > 1:
        return f"({', '.join(f'{part:.0f}' for part in force)}) N"
    return f"{abs(force[axis]):.0f} N to {'-' if force[axis] < 0 else '+'}{_AXES[axis]}"


def _push(seconds: np.ndarray, forces: np.ndarray, *, before: float) -> dict[str, Any] | None:
    """Return the last push that may have caused a fall which begins at `before` [s]."""
    pushed = np.flatnonzero(np.any(forces != 0.0, axis=1))
    if not pushed.size or seconds[pushed[-1]] < before - _AFTER:
        return None
    gaps = np.flatnonzero(np.diff(pushed) > 1)
    begin = pushed[gaps[-1] + 1] if gaps.size else pushed[0]
    return {"force_n": forces[begin].tolist(), "at_s": _rounded(seconds[begin])}


def _slip(seconds: np.ndarray, slips: np.ndarray) -> dict[str, Any] | None:
    """Return the earliest slip of a foot in a window, and how far it goes there."""
    far = np.nan_to_num(slips) > _SLIP
    if not far.any():
        return None
    foot = int(np.argmax(far[np.flatnonzero(far.any(axis=1))[0]]))
    return {
        "foot": list(Foot)[foot].value,
        "mm": _rounded(1e3 * float(np.nanmax(slips[:, foot]))),
        "at_s": _first(seconds, far[:, foot]),
    }


def _torque(
    seconds: np.ndarray, tau: np.ndarray, limits: Mapping[str, float]
) -> dict[str, Any] | None:
    """Return the joint that was at its torque limit in most ticks of a window."""
    at_limit = np.abs(tau) >= _CLAMPED * np.array(list(limits.values()))
    if not at_limit.any():
        return None
    joint = int(np.argmax(at_limit.sum(axis=0)))
    return {
        "joint": list(limits)[joint],
        "ticks": int(at_limit[:, joint].sum()),
        "at_s": _first(seconds, at_limit[:, joint]),
    }


def _outage_at(seconds: float, outages: Sequence[MetOutage]) -> MetOutage | None:
    """Return the longest outage at a time of the task, or shortly before it."""
    near = [
        each for each in outages if each.begin_ns * 1e-9 <= seconds <= each.end_ns * 1e-9 + _AFTER
    ]
    return max(near, key=lambda each: each.duration_ns, default=None)


def _last(within: np.ndarray) -> int:
    """Return the index of the last mark; 0 without one."""
    found = np.flatnonzero(within)
    return int(found[-1]) if found.size else 0


def _first(seconds: np.ndarray, marked: np.ndarray) -> float | None:
    """Return the time of the first mark; None without one."""
    return _rounded(seconds[int(np.argmax(marked))]) if marked.any() else None


def _rounded(value: float) -> float:
    return round(float(value), 2)
