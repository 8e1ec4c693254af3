"""Hostile messages: honest ones, changed so that they are malformed, or well formed and wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np

from benchmarks.faults.cases import Parameters
from benchmarks.faults.lockstep import flip_bits
from shared.wbc.answer import Factorisation, Projector
from shared.wire.codec import Codec
from shared.wire.messages import FactorisationMessage, ProjectorMessage, RobotState

_HOUR_NS = 3_600_000_000_000
HUGE = 2**63 - 1

# From an honest message to a hostile one, or to many.
Change = Callable[[bytes, Codec, Parameters, np.random.Generator], bytes | list[bytes]]
# The parameter `by` of a change.
Drawn = Callable[[np.random.Generator], Parameters]


def choose(*choices: Any) -> Drawn:
    """Drawn the parameter `by` from a few values."""
    return lambda rng: {"by": choices[int(rng.integers(len(choices)))]}


def _in_state(change: Callable[[RobotState, Any, np.random.Generator], dict[str, Any]]) -> Change:
    """Change fields of a state."""

    def changed(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
        state = codec.decode_state(data)
        if not given["first"]:
            # After the honest one: else it would be stale.
            state.sequence += 1
        return codec.encode_state(dataclasses.replace(state, **change(state, given["by"], rng)))

    return changed


def _joint(state: RobotState, by: float, rng: np.random.Generator) -> dict[str, Any]:
    q = state.q.copy()
    q[7 + int(rng.integers(len(q) - 7))] += by
    return {"q": q}


def _speed(state: RobotState, by: float, rng: np.random.Generator) -> dict[str, Any]:
    v = state.v.copy()
    v[int(rng.integers(len(v)))] += by
    return {"v": v}


def _quaternion(state: RobotState, by: float, rng: np.random.Generator) -> dict[str, Any]:
    del rng
    q = state.q.copy()
    q[3:7] *= by
    return {"q": q}


def _in_answer(
    change: Callable[[ProjectorMessage | FactorisationMessage, Any, np.random.Generator], Any],
) -> Change:
    """Change an answer, of either kind."""

    def changed(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
        kind = msgpack.unpackb(data)["kind"]
        with np.errstate(all="ignore"):
            if kind == "projector":
                projector = change(codec.decode_projector(data), given["by"], rng)
                return codec.encode_projector(projector)
            return codec.encode_factorisations(
                change(codec.decode_factorisations(data), given["by"], rng)
            )

    return changed


def _field(name: str, value: Callable[[int, Any], int]) -> Change:
    def changed(
        message: ProjectorMessage | FactorisationMessage, by: Any, rng: np.random.Generator
    ) -> Any:
        del rng
        fields: dict[str, Any] = {name: value(getattr(message, name), by)}
        return dataclasses.replace(message, **fields)

    return _in_answer(changed)


def _matrices(change: Callable[[np.ndarray, Any, np.random.Generator], np.ndarray]) -> Change:
    """Change the matrix of every projector, or a block of every factorisation."""

    def changed(
        message: ProjectorMessage | FactorisationMessage, by: Any, rng: np.random.Generator
    ) -> Any:
        if isinstance(message, ProjectorMessage):
            timed = tuple(
                dataclasses.replace(
                    each,
                    projector=dataclasses.replace(
                        each.projector, A_dagger=change(each.projector.A_dagger, by, rng)
                    ),
                )
                for each in message.projectors
            )
            return dataclasses.replace(message, projectors=timed)
        name = "PQTA"[int(rng.integers(4))]

        def wrong(factorisation: Factorisation) -> Factorisation:
            block: dict[str, Any] = {name: change(getattr(factorisation, name), by, rng)}
            return dataclasses.replace(factorisation, **block)

        factorisations = tuple(wrong(each) for each in message.factorisations)
        return dataclasses.replace(message, factorisations=factorisations)

    return _in_answer(changed)


def _opened(name: str) -> Change:
    """Scale an array of the open rows of every projector, or leave other limits open."""

    def changed(message: Any, by: float | None, rng: np.random.Generator) -> Any:
        def wrong(projector: Projector) -> Projector:
            opened = projector.open
            assert opened is not None
            array = getattr(opened, name)
            if by is None:
                fields = {name: np.sort(rng.choice(len(array) + 20, len(array), replace=False))}
            else:
                fields = {name: by * array}
            return dataclasses.replace(projector, open=dataclasses.replace(opened, **fields))

        timed = tuple(
            dataclasses.replace(each, projector=wrong(each.projector))
            for each in message.projectors
        )
        return dataclasses.replace(message, projectors=timed)

    return _in_answer(changed)


def _with_column(block: np.ndarray, by: float, rng: np.random.Generator) -> np.ndarray:
    block = block.copy()
    block[:, int(rng.integers(block.shape[1]))] += by
    return block


def _flips(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
    del codec
    return flip_bits(data, rng, bits=given["by"])


def _truncation(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
    del codec, given
    return data[: int(rng.integers(len(data)))]


def _type(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
    """Put a value of another type, or of another size, into one of the fields."""
    del codec
    fields = msgpack.unpackb(data)
    name = sorted(fields)[int(rng.integers(len(fields)))]
    other: dict[str, Any] = {
        "none": None,
        "text": "x" * 40,
        "list": [[]] * 30,
        "map": {"a": {"b": 1}},
        "minus": -1,
        "float": 0.5,
        "bytes": bytes(16),
        "true": True,
    }
    fields[name] = other[given["by"]]
    return bytes(msgpack.packb(fields))


def _missing(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
    del codec, given
    fields = msgpack.unpackb(data)
    del fields[sorted(fields)[int(rng.integers(len(fields)))]]
    return bytes(msgpack.packb(fields))


def _noise(data: bytes, codec: Codec, given: Parameters, rng: np.random.Generator) -> bytes:
    del data, codec
    return rng.bytes(given["by"])


ANY: dict[str, tuple[Drawn, Change]] = {
    "bit flips": (choose(1, 2, 8, 64), _flips),
    "truncation": (choose(0), _truncation),
    "type": (choose("none", "text", "list", "map", "minus", "float", "bytes", "true"), _type),
    "missing field": (choose(0), _missing),
    "noise": (choose(0, 1, 500, 70_000), _noise),
}
# By fault: how its parameter is drawn, and the change of an honest message.
TO_EDGE: dict[str, tuple[Drawn, Change]] = {
    "sequence": (
        choose(3000, 10**9, HUGE),
        _in_state(lambda state, by, rng: {"sequence": min(state.sequence + by, HUGE)}),
    ),
    "stamp": (
        choose(10**9, _HOUR_NS, HUGE, -(10**9)),
        _in_state(
            lambda state, by, rng: {"stamp_ns": min(max(state.stamp_ns + by, 0), HUGE)},
        ),
    ),
    "session": (
        choose(1, 2**40),
        _in_state(lambda state, by, rng: {"session": state.session + by}),
    ),
    "task time": (
        choose(10**9, _HOUR_NS),
        _in_state(lambda state, by, rng: {"time_ns": state.time_ns + by}),
    ),
    "joint": (choose(50.0, 0.6, -0.45, 1e300, float("inf"), float("nan")), _in_state(_joint)),
    "speed": (choose(1e3, 5.0, float("nan")), _in_state(_speed)),
    "quaternion": (choose(0.0, -1.0, 2.0), _in_state(_quaternion)),
    **ANY,
}
TO_ROBOT: dict[str, tuple[Drawn, Change]] = {
    "sequence": (
        choose(1, 3000, HUGE),
        _field("sequence", lambda value, by: min(value + by, HUGE)),
    ),
    "stamp": (
        choose(1, _HOUR_NS, HUGE, -1),
        _field("stamp_ns", lambda value, by: min(max(value + by, 0), HUGE)),
    ),
    "session": (choose(1, 2**40), _field("session", lambda value, by: value + by)),
    "scaled": (choose(1e6, 1e300, 0.5, 1.5, 0.0), _matrices(lambda block, by, rng: by * block)),
    "flipped": (choose(-1.0), _matrices(lambda block, by, rng: by * block)),
    "permuted": (choose(0, 1), _matrices(lambda block, by, rng: rng.permutation(block, axis=by))),
    "a column": (choose(1e3, 1e12, float("nan")), _matrices(_with_column)),
    **ANY,
}
_SCALES = choose(-1.0, 0.0, 0.9, 1.1, 1e6, 1e30)
TO_OPEN_ROWS: dict[str, tuple[Drawn, Change]] = {
    "pushes": (_SCALES, _opened("push")),
    "factors": (_SCALES, _opened("factor")),
    "limits": (choose(None), _opened("limits")),
}
