"""Plans and step laws to bytes and back, with the checks that need no robot.

The robot's own checks follow in `robot_node/plan_cache.py`. They compare a plan with its phase, its
feet and its description.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np

from shared.errors import MessageRefused
from shared.motion.footprint import Footprint
from shared.motion.planned import SUPPORT_MODE, Plan, PlannedPhase, PlanOrigin
from shared.motion.step_law import MAX_NO_GO, NoGo, StepLaw
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wire.channels import PLANS
from shared.wire.codec import Codec
from shared.wire.fields import array_of, integer_of
from shared.wire.messages import PlanMessage

_PLAN, _LAW = "step_plan", "step_law"
MAX_PHASES = 40
_SINGLE = np.dtype("<f4")
# Arrays of a law, with the lengths that they share.
_ARRAYS = {
    "times": "t",
    "footholds_x": "u",
    "footholds_y": "u",
    "cops_x": "p",
    "cops_y": "p",
    "cop_nominal": "2",
    "offsets": "d",
    "values_x": "d",
    "values_y": "d",
    "going_on_x": "d",
    "going_on_y": "d",
}
_LENGTHS = {"t": (1, 16), "u": (3, 65), "p": (3, 15), "2": (2, 2), "d": (3, 129)}
_ASCENDING = ("times", "footholds_x", "footholds_y", "cops_x", "cops_y", "offsets")
# Numbers of a phase: duration [s], x, y, heading and z of the footprint, CoP, DCM.
_PHASE_NUMBERS = 9
# At the beginning: x, y, heading and z of both soles, the CoM. Then the swing height.
_START_NUMBERS = 11


def law_identity(law: StepLaw) -> int:
    """Return a number from 1 to 2⁶³ − 1 that identifies a law, to a part in a million of its
    numbers.
    """
    digest = hashlib.sha256()
    for name in _ARRAYS:
        digest.update(np.round(getattr(law, name).astype(np.float64), 5).tobytes())
    digest.update(repr((round(law.omega, 5), round(law.width, 5), law.no_go)).encode())
    return int.from_bytes(digest.digest()[:8], "big") % (2**63 - 1) + 1


def as_sent(law: StepLaw) -> StepLaw:
    """Return a law as the other end will see it, in single precision."""
    arrays = {name: getattr(law, name).astype(_SINGLE).astype(np.float64) for name in _ARRAYS}
    omega, width = np.array((law.omega, law.width), _SINGLE).astype(float).tolist()
    no_go = _boxes(np.array([[*box.x, *box.y] for box in law.no_go], _SINGLE))
    return dataclasses.replace(law, omega=omega, width=width, no_go=no_go, **arrays)


class PlanCodec:
    """Encoder and decoder of `PlanMessage`, beside the codec of the other messages."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec

    def encode(self, message: PlanMessage) -> bytes:
        """Encode a message in at most `PLANS.max_bytes`; raise `ConfigError` if it is longer."""
        content = message.content
        fields = _law_fields(content) if isinstance(content, StepLaw) else _plan_fields(content)
        return self._codec.pack(
            _LAW if isinstance(content, StepLaw) else _PLAN,
            PLANS.max_bytes,
            session=message.session,
            sequence=message.sequence,
            stamp_ns=message.stamp_ns,
            **fields,
        )

    def decode(self, data: bytes) -> PlanMessage:
        """Decode and check a message. Raise `MessageRefused` if a check fails."""
        fields = self._codec.unpack(data, (_PLAN, _LAW), PLANS.max_bytes)
        session, sequence = integer_of(fields, "session"), integer_of(fields, "sequence")
        stamp_ns = integer_of(fields, "stamp_ns")
        if fields["kind"] == _LAW:
            return PlanMessage(session, sequence, stamp_ns, _law(fields))
        return PlanMessage(session, sequence, stamp_ns, _plan(fields, session, sequence))


def _law_fields(law: StepLaw) -> dict[str, Any]:
    arrays = {name: getattr(law, name).astype(_SINGLE).tobytes() for name in _ARRAYS}
    boxes = np.array([[*box.x, *box.y] for box in law.no_go], _SINGLE)
    pendulum = np.array((law.omega, law.width), _SINGLE)
    return {**arrays, "pendulum": pendulum.tobytes(), "no_go": boxes.tobytes()}


def _law(fields: dict[str, Any]) -> StepLaw:
    lengths: dict[str, int] = {}
    arrays = {}
    for name, kind in _ARRAYS.items():
        data = fields.get(name)
        n = len(data) // _SINGLE.itemsize if isinstance(data, bytes) else 0
        least, most = _LENGTHS[kind]
        if not least <= n <= most or lengths.setdefault(kind, n) != n:
            raise MessageRefused("shape", name)
        arrays[name] = array_of(fields, name, (n,), dtype=_SINGLE)
        if name in _ASCENDING and (np.diff(arrays[name]) <= 0.0).any():
            raise MessageRefused("shape", f"{name}, which does not ascend")
    omega, width = array_of(fields, "pendulum", (2,), dtype=_SINGLE).tolist()
    data = fields.get("no_go")
    n = len(data) // (4 * _SINGLE.itemsize) if isinstance(data, bytes) else -1
    if not 0 <= n <= MAX_NO_GO:
        raise MessageRefused("shape", "no_go")
    no_go = _boxes(array_of(fields, "no_go", (n, 4), dtype=_SINGLE))
    return StepLaw(omega=omega, width=width, no_go=no_go, **arrays)


def _boxes(corners: np.ndarray) -> tuple[NoGo, ...]:
    return tuple(NoGo((x_0, x_1), (y_0, y_1)) for x_0, x_1, y_0, y_1 in corners.tolist())


def _plan_fields(plan: Plan) -> dict[str, Any]:
    numbers = []
    for phase in plan.phases:
        print_ = phase.footprint
        pose = (0.0, 0.0, 0.0, 0.0) if print_ is None else _pose(print_)
        duration = (phase.end_ns - phase.begin_ns) * 1e-9
        numbers.append((duration, *pose, *phase.cop, *phase.dcm))
    start = (*_pose(plan.feet[0]), *_pose(plan.feet[1]), *plan.com, plan.swing_height)
    return {
        "number": plan.number,
        "phase": plan.origin.phase,
        "valid_until_ns": plan.valid_until_ns,
        "modes": bytes(int(phase.mode) for phase in plan.phases),
        "phases": np.array(numbers, _SINGLE).tobytes(),
        "start": np.array(start, _SINGLE).tobytes(),
    }


def _pose(print_: Footprint) -> tuple[float, float, float, float]:
    return print_.x, print_.y, print_.yaw, print_.z


def _plan(fields: dict[str, Any], session: int, sequence: int) -> Plan:
    modes = fields.get("modes")
    if not isinstance(modes, bytes) or not 0 < len(modes) <= MAX_PHASES:
        raise MessageRefused("shape", "modes")
    if any(mode not in list(ContactMode) for mode in modes):
        raise MessageRefused("mode", repr(modes))
    numbers = array_of(fields, "phases", (len(modes), _PHASE_NUMBERS), dtype=_SINGLE)
    start = array_of(fields, "start", (_START_NUMBERS,), dtype=_SINGLE).tolist()
    if (numbers[:, 0] <= 0.0).any() or (numbers[:, 0] > 60.0).any():
        raise MessageRefused("shape", "phases, of which one lasts no time or more than 60 s")
    phases, begin_ns = [], 0
    for mode, row in zip((ContactMode(each) for each in modes), numbers.tolist(), strict=True):
        duration, *pose = row[:5]
        end_ns = begin_ns + round(duration * 1e9)
        footprint = None
        if mode is not ContactMode.DOUBLE_SUPPORT:
            foot = next(each for each, during in SUPPORT_MODE.items() if during is mode)
            footprint = Footprint(foot, *pose)
        cop, dcm = (row[5], row[6]), (row[7], row[8])
        phases.append(PlannedPhase(mode, begin_ns, end_ns, footprint, cop, dcm))
        begin_ns = end_ns
    return Plan(
        number=integer_of(fields, "number"),
        origin=PlanOrigin(session, sequence, integer_of(fields, "phase")),
        valid_until_ns=integer_of(fields, "valid_until_ns"),
        feet=(Footprint(Foot.LEFT, *start[0:4]), Footprint(Foot.RIGHT, *start[4:8])),
        com=(start[8], start[9]),
        phases=tuple(phases),
        swing_height=start[10],
    )
