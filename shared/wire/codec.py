"""Messages to bytes and back, with every check of a received message in one place.

msgpack maps; arrays as raw little-endian `bin`. `decode_*` either returns a message whose shapes,
types and numbers are right for this robot and configuration, or raises `MessageRefused` with the
name of the check that failed. Order and freshness are judged later, by who keeps the newest.
"""

from __future__ import annotations

import math
from typing import Any

import msgpack
import numpy as np

from shared.config.settings import RunConfig
from shared.errors import ConfigError, MessageRefused
from shared.robots import Robot
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Factorisation
from shared.wbc.projector import Projector
from shared.wbc.reference import Motion
from shared.wbc.stack import RowLayout, make_stacks
from shared.wbc.whole_body import TimedProjector
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.messages import FactorisationMessage, ProjectorMessage, RobotState

SCHEMA_VERSION = 2
_STATE, _PROJECTOR, _FACTORISATION = "state", "projector", "factorisation"
_MAX_INT = 2**63 - 1
_SINGLE = np.dtype("<f4")
_DTYPES: dict[str, np.dtype[Any]] = {"float64": np.dtype("<f8"), "float32": _SINGLE}


class Codec:
    """Encoder and decoder for one robot under one configuration, the same at both ends."""

    def __init__(self, robot: Robot, config: RunConfig, motion: Motion) -> None:
        self._header = {
            "version": SCHEMA_VERSION,
            "config": config.digest,
            "plan": motion.digest,
        }
        self._nq, self._nv = robot.model.nq, robot.model.nv
        self._dtype_name = config.wire.projector_dtype
        self._dtype = _DTYPES[self._dtype_name]
        self._stacks = make_stacks(robot, config.wbc)
        self._layouts: dict[ContactMode, RowLayout] = {
            mode: stack.layout for mode, stack in self._stacks.items()
        }
        self._layout_digests = {mode: layout.digest for mode, layout in self._layouts.items()}
        self._n_inequalities = {mode: len(stack.contacts.l) for mode, stack in self._stacks.items()}

    def rounded(self, projector: Projector) -> Projector:
        """The projector as the other end will see it, after the wire's number format."""
        A_dagger = projector.A_dagger.astype(self._dtype).astype(np.float64)
        return Projector(mode=projector.mode, A_dagger=A_dagger, active=projector.active)

    def encode_state(self, state: RobotState) -> bytes:
        """A `RobotState` as bytes, at most `UPLINK.max_bytes`."""
        return self._pack(
            _STATE,
            UPLINK.max_bytes,
            session=state.session,
            sequence=state.sequence,
            stamp_ns=state.stamp_ns,
            time_ns=state.time_ns,
            mode=int(state.mode),
            q=state.q.tobytes(),
            v=state.v.tobytes(),
            holds=state.held_sequences,
        )

    def decode_state(self, data: bytes) -> RobotState:
        """A checked `RobotState`; `MessageRefused` otherwise."""
        fields = self._unpack(data, _STATE, UPLINK.max_bytes)
        return RobotState(
            session=_integer(fields, "session"),
            sequence=_integer(fields, "sequence"),
            stamp_ns=_integer(fields, "stamp_ns"),
            time_ns=_integer(fields, "time_ns"),
            mode=_mode(fields),
            q=_array(fields, "q", (self._nq,)),
            v=_array(fields, "v", (self._nv,)),
            held_sequences=_holds(fields),
        )

    def encode_projector(self, message: ProjectorMessage) -> bytes:
        """A `ProjectorMessage` as bytes; `ConfigError` if it exceeds `DOWNLINK.max_bytes`."""
        return self._pack(
            _PROJECTOR,
            DOWNLINK.max_bytes,
            session=message.session,
            sequence=message.sequence,
            stamp_ns=message.stamp_ns,
            mode=int(message.mode),
            tau=message.tau.tobytes(),
            y=message.y.tobytes(),
            projectors=[self._projector_fields(timed) for timed in message.projectors],
        )

    def decode_projector(self, data: bytes) -> ProjectorMessage:
        """A checked `ProjectorMessage`; `MessageRefused` otherwise."""
        fields = self._unpack(data, _PROJECTOR, DOWNLINK.max_bytes)
        mode = _mode(fields)
        entries = fields.get("projectors")
        if not isinstance(entries, list) or not 0 < len(entries) <= len(ContactMode):
            raise MessageRefused("shape", "projectors")
        projectors = tuple(self._decode_projector_fields(entry) for entry in entries)
        if not any(timed.projector.mode is mode for timed in projectors):
            raise MessageRefused("mode", f"no projector of {mode.name}, which the answer is for")
        return ProjectorMessage(
            session=_integer(fields, "session"),
            sequence=_integer(fields, "sequence"),
            stamp_ns=_integer(fields, "stamp_ns"),
            mode=mode,
            tau=_array(fields, "tau", (self._nv - 6,)),
            y=_array(fields, "y", (self._layouts[mode].n_unknowns,)),
            projectors=projectors,
        )

    def encode_factorisations(self, message: FactorisationMessage) -> bytes:
        """A `FactorisationMessage` as bytes, numbers in single precision."""
        return self._pack(
            _FACTORISATION,
            DOWNLINK.max_bytes,
            session=message.session,
            sequence=message.sequence,
            stamp_ns=message.stamp_ns,
            factorisations=[self._factorisation_fields(each) for each in message.factorisations],
        )

    def decode_factorisations(self, data: bytes) -> FactorisationMessage:
        """A checked `FactorisationMessage`; `MessageRefused` otherwise."""
        fields = self._unpack(data, _FACTORISATION, DOWNLINK.max_bytes)
        entries = fields.get("factorisations")
        if not isinstance(entries, list) or len(entries) > len(ContactMode):
            raise MessageRefused("shape", "factorisations")
        return FactorisationMessage(
            session=_integer(fields, "session"),
            sequence=_integer(fields, "sequence"),
            stamp_ns=_integer(fields, "stamp_ns"),
            factorisations=tuple(self._decode_factorisation_fields(entry) for entry in entries),
        )

    def _factorisation_fields(self, factorisation: Factorisation) -> dict[str, Any]:
        mode = factorisation.mode
        varying = self._stacks[mode].varying_task_rows
        arrays = {
            "P": _packed(factorisation.P),
            "Q": factorisation.Q,
            "T": _packed(factorisation.T),
            "A": factorisation.A[varying],
            "posture": factorisation.posture,
        }
        return {
            "mode": int(mode),
            "layout": self._layout_digests[mode],
            **{name: array.astype(_SINGLE).tobytes() for name, array in arrays.items()},
        }

    def _decode_factorisation_fields(self, fields: Any) -> Factorisation:
        if not isinstance(fields, dict):
            raise MessageRefused("undecodable", "factorisation")
        mode = _mode(fields)
        if fields.get("layout") != self._layout_digests[mode]:
            raise MessageRefused("layout", mode.name)
        stack = self._stacks[mode]
        n, n_e = stack.layout.n_unknowns, stack.equality_rows.stop
        varying = stack.varying_task_rows

        def array(name: str, *shape: int) -> np.ndarray:
            return _array(fields, name, shape, dtype=_SINGLE)

        A = stack.constant_task_rows.copy()
        A[varying] = array("A", len(varying), self._nv)
        return Factorisation(
            mode=mode,
            P=_unpacked(array("P", n * (n + 1) // 2), n),
            Q=array("Q", n, n_e),
            T=_unpacked(array("T", n_e * (n_e + 1) // 2), n_e),
            A=A,
            posture=array("posture", self._nv - 6),
        )

    def _projector_fields(self, timed: TimedProjector) -> dict[str, Any]:
        projector = timed.projector
        return {
            "mode": int(projector.mode),
            "layout": self._layout_digests[projector.mode],
            "dtype": self._dtype_name,
            "active": projector.active.astype(np.uint8).tobytes(),
            "A_dagger": projector.A_dagger.astype(self._dtype).tobytes(),
            "valid_from_ns": timed.valid_from_ns,
            "valid_until_ns": timed.valid_until_ns,
        }

    def _decode_projector_fields(self, fields: Any) -> TimedProjector:
        if not isinstance(fields, dict):
            raise MessageRefused("undecodable", "projector")
        mode = _mode(fields)
        if fields.get("layout") != self._layout_digests[mode]:
            raise MessageRefused("layout", mode.name)
        dtype = fields.get("dtype")
        if not isinstance(dtype, str) or dtype not in _DTYPES:
            raise MessageRefused("dtype", repr(dtype))
        layout = self._layouts[mode]
        active = fields.get("active")
        if not isinstance(active, bytes) or len(active) > layout.n_forces:
            raise MessageRefused("shape", "active")
        rows = list(active)
        if rows != sorted(set(rows)) or (rows and rows[-1] >= self._n_inequalities[mode]):
            raise MessageRefused("shape", "active")
        shape = (layout.n_unknowns, layout.n_rows)
        return TimedProjector(
            projector=Projector(
                mode=mode,
                A_dagger=_array(fields, "A_dagger", shape, dtype=_DTYPES[dtype]),
                active=np.array(rows, dtype=int),
            ),
            valid_from_ns=_integer(fields, "valid_from_ns"),
            valid_until_ns=_integer(fields, "valid_until_ns"),
        )

    def _pack(self, kind: str, max_bytes: int, **fields: Any) -> bytes:
        data = bytes(msgpack.packb({**self._header, "kind": kind, **fields}))
        if len(data) > max_bytes:
            raise ConfigError(
                f"wire: a {kind} message takes {len(data)} bytes, more than the {max_bytes} of its "
                "channel; try wire.projector_dtype = 'float32'"
            )
        return data

    def _unpack(self, data: bytes, kind: str, max_bytes: int) -> dict[str, Any]:
        if len(data) > max_bytes:
            raise MessageRefused("oversized", f"{len(data)} bytes")
        try:
            fields = msgpack.unpackb(data)
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise MessageRefused("undecodable", str(error)) from None
        if not isinstance(fields, dict):
            raise MessageRefused("undecodable", "not a map")
        if fields.get("version") != SCHEMA_VERSION:
            raise MessageRefused("version", repr(fields.get("version")))
        if fields.get("kind") != kind:
            raise MessageRefused("kind", repr(fields.get("kind")))
        if fields.get("config") != self._header["config"]:
            raise MessageRefused("config", "the two ends run different configurations")
        if fields.get("plan") != self._header["plan"]:
            raise MessageRefused("plan", "the two ends derive different motions")
        return fields


def _integer(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not -_MAX_INT <= value <= _MAX_INT:
        raise MessageRefused("shape", name)
    return value


def _packed(symmetric: np.ndarray) -> np.ndarray:
    """The lower triangle, row by row."""
    return symmetric[np.tril_indices(len(symmetric))]


def _unpacked(triangle: np.ndarray, n: int) -> np.ndarray:
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n)] = triangle
    return matrix + np.tril(matrix, -1).T


def _holds(fields: dict[str, Any]) -> tuple[int, ...] | None:
    held_sequences = fields.get("holds")
    if held_sequences is None:
        return None
    if not isinstance(held_sequences, list) or len(held_sequences) != len(ContactMode):
        raise MessageRefused("shape", "holds")
    if any(type(each) is not int or not -1 <= each <= _MAX_INT for each in held_sequences):
        raise MessageRefused("shape", "holds")
    return tuple(held_sequences)


def _mode(fields: dict[str, Any]) -> ContactMode:
    try:
        return ContactMode(_integer(fields, "mode"))
    except ValueError:
        raise MessageRefused("mode", repr(fields.get("mode"))) from None


def _array(
    fields: dict[str, Any],
    name: str,
    shape: tuple[int, ...],
    *,
    dtype: np.dtype[Any] = _DTYPES["float64"],
) -> np.ndarray:
    data = fields.get(name)
    if not isinstance(data, bytes) or len(data) != dtype.itemsize * math.prod(shape):
        raise MessageRefused("shape", name)
    numbers = np.frombuffer(data, dtype=dtype)
    if not np.isfinite(numbers).all():
        raise MessageRefused("not_finite", name)
    return numbers.astype(np.float64, copy=False).reshape(shape)
