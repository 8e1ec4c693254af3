"""Plans and step laws on the wire: the same at the other end, small, and refused if damaged."""

from __future__ import annotations

import dataclasses

import msgpack
import numpy as np
import pytest

from shared.errors import MessageRefused
from shared.motion.footprint import Footprint
from shared.motion.planned import Plan, PlannedPhase, PlanOrigin
from shared.motion.stance import Stance
from shared.motion.standing import Standing
from shared.motion.step_law import NoGo, make_step_law
from shared.robots import Foot
from shared.wbc.contacts import ContactMode
from shared.wire.channels import PLANS
from shared.wire.codec import Codec
from shared.wire.messages import PlanMessage
from shared.wire.plans import MAX_PHASES, PlanCodec, as_sent, law_identity

DOUBLE, LEFT = ContactMode.DOUBLE_SUPPORT, ContactMode.LEFT_SUPPORT


@pytest.fixture(scope="module")
def codec(robot, configured):
    config = configured(
        **{"stepping.mode": "on", "wbc.balance.law": "dcm", "wbc.weights.com": 10.0}
    )
    return PlanCodec(Codec(robot, config, Standing(robot)))


@pytest.fixture(scope="module")
def law(robot):
    return dataclasses.replace(
        make_step_law(robot, Stance.of(robot)), no_go=(NoGo((0.1, 0.75), (-1.0, 1.0)),)
    )


def a_plan(n_steps=1):
    goal = Footprint(Foot.RIGHT, 0.25, -0.125, 0.5, 0.0625)
    phases = []
    for k in range(n_steps):
        begin = k * 600_000_000
        phases += [
            PlannedPhase(DOUBLE, begin, begin + 100_000_000, None, (0.0, 0.0), (0.0, 0.0625)),
            PlannedPhase(
                LEFT, begin + 100_000_000, begin + 600_000_000, goal, (0.0, 0.125), (0.25, 0.0)
            ),
        ]
    end = n_steps * 600_000_000
    phases.append(PlannedPhase(DOUBLE, end, end + 2_000_000_000, None, (0.125, 0.0), (0.125, 0.0)))
    return Plan(
        number=7,
        origin=PlanOrigin(session=3, sequence=11, phase=4),
        valid_until_ns=5_000,
        feet=(
            Footprint(Foot.LEFT, 0.0, 0.125, 0.0, -0.25),
            Footprint(Foot.RIGHT, 0.0, -0.125, 0.0, 0.5),
        ),
        com=(0.03125, 0.0),
        phases=tuple(phases),
        swing_height=0.0625,
    )


def message(content):
    return PlanMessage(session=3, sequence=11, stamp_ns=1_000, content=content)


def test_a_plan_is_the_same_at_the_other_end(codec):
    sent = message(a_plan())
    received = codec.decode(codec.encode(sent))
    assert dataclasses.replace(received, content=None) == dataclasses.replace(sent, content=None)
    plan, same = sent.content, received.content
    assert (same.number, same.origin, same.valid_until_ns) == (7, plan.origin, 5_000)
    assert (same.feet, same.com) == (plan.feet, plan.com)
    assert same.swing_height == plan.swing_height
    for ours, theirs in zip(plan.phases, same.phases, strict=True):
        # Durations are in single precision: 600 ms to 24 ns.
        assert abs(ours.end_ns - theirs.end_ns) < 100
        assert dataclasses.replace(theirs, begin_ns=ours.begin_ns, end_ns=ours.end_ns) == ours


def test_a_law_is_the_same_at_the_other_end_and_keeps_its_identity(codec, law):
    received = codec.decode(codec.encode(message(law))).content
    assert received.values_y == pytest.approx(law.values_y, rel=1e-6)
    assert received.no_go == as_sent(law).no_go
    assert law_identity(received) == law_identity(as_sent(law))
    changed = dataclasses.replace(law, values_x=law.values_x + 1e-3)
    assert law_identity(changed) != law_identity(law)


def test_the_longest_plan_and_the_law_fit_their_channel(codec, law):
    assert len(codec.encode(message(a_plan((MAX_PHASES - 1) // 2)))) <= PLANS.max_bytes
    assert len(codec.encode(message(law))) <= PLANS.max_bytes


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": 2}, "version"),
        ({"kind": "state"}, "kind"),
        ({"config": b"12345678"}, "config"),
        ({"modes": b""}, "shape"),
        ({"modes": b"\x00\x01\x07"}, "mode"),
        ({"modes": b"\x00\x01"}, "shape"),
        ({"number": "7"}, "shape"),
        ({"phases": np.full((3, 9), np.nan, np.float32).tobytes()}, "not_finite"),
        ({"phases": np.full((3, 9), -1.0, np.float32).tobytes()}, "shape"),
        ({"start": None}, "shape"),
    ],
)
def test_a_damaged_plan_is_refused_with_the_reason(codec, change, reason):
    fields = msgpack.unpackb(codec.encode(message(a_plan())))
    with pytest.raises(MessageRefused) as refused:
        codec.decode(msgpack.packb({**fields, **change}))
    assert refused.value.reason == reason


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("offsets", lambda x: x[::-1], "shape"),
        ("values_x", lambda x: x[:-1], "shape"),
        ("values_y", lambda x: x * np.nan, "not_finite"),
        ("times", lambda x: x[:0], "shape"),
        ("no_go", lambda x: np.zeros(4 * 17), "shape"),
    ],
)
def test_a_damaged_law_is_refused_with_the_reason(codec, law, name, value, reason):
    fields = msgpack.unpackb(codec.encode(message(law)))
    data = value(np.frombuffer(fields[name], np.float32)).astype(np.float32).tobytes()
    with pytest.raises(MessageRefused) as refused:
        codec.decode(msgpack.packb({**fields, name: data}))
    assert refused.value.reason == reason


def test_no_mutation_of_a_message_raises_anything_else(codec, law):
    """2000 messages with bytes changed, cut or added, from a seed."""
    rng = np.random.default_rng(5)
    originals = [codec.encode(message(a_plan())), codec.encode(message(law))]
    for k in range(2000):
        data = bytearray(originals[k % 2])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        damaged = bytes(data)[: rng.integers(1, len(data) + 1)] if k % 5 == 0 else bytes(data)
        try:
            codec.decode(damaged)
        except MessageRefused:
            continue
