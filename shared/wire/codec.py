"""Messages to bytes and back, with every check of a received message in one place.

Messages are msgpack maps, with arrays as raw little-endian `bin`. `decode_*` either returns a
message whose shapes, types and numbers are right for this robot and configuration, or raises
`MessageRefused` with the name of the check that failed. The keeper of the newest message judges
order and freshness.

Two messages cross the link each millisecond: a state, and an answer of one projector. They have a
`Form`. A message that has no form, or that holds an error, is decoded field by field, which finds
the reason.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from operator import lt
from typing import Any

import msgpack
import numpy as np

from shared.config.settings import RunConfig
from shared.errors import ConfigError, MessageRefused
from shared.robots import Robot
from shared.wbc.answer import Factorisation, Openness, Projector, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.finite import all_finite
from shared.wbc.limits import Limits
from shared.wbc.reference import Motion
from shared.wbc.stack import RowLayout, make_stacks
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.fields import (
    DOUBLE,
    MAX_INT,
    SINGLE,
    array_of,
    finite_numbers,
    held_sequences_of,
    integer_of,
    mode_of,
)
from shared.wire.form import INTEGER, SMALL, Form, binary
from shared.wire.messages import FactorisationMessage, ProjectorMessage, RobotState
from shared.wire.step_reports import STEP_SLOTS, step_values, steps_in, steps_of

SCHEMA_VERSION = 4
_STATE, _PROJECTOR, _FACTORISATION = "state", "projector", "factorisation"
_DTYPES: dict[str, np.dtype[Any]] = {"float64": DOUBLE, "float32": SINGLE}

_NO_FACTOR = np.zeros((0, 0), SINGLE)

# Raises `MessageRefused` if an answer with this session and sequence is not wanted. It is called
# before the numbers of a message with a form are checked, and after all checks of any other
# message.
Judge = Callable[[int, int], None]


def _anything(session: int, sequence: int) -> None:
    """Accept every answer."""


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
        self._stacks = make_stacks(robot, config.wbc)
        self._layouts: dict[ContactMode, RowLayout] = {
            mode: stack.layout for mode, stack in self._stacks.items()
        }
        self._shapes = {
            mode: (layout.n_unknowns, layout.n_rows) for mode, layout in self._layouts.items()
        }
        self._layout_digests = {mode: layout.digest for mode, layout in self._layouts.items()}
        limits = Limits.of(robot, config)
        self._n_limits = 0 if limits is None else limits.n_entries
        self._n_inequalities = {mode: len(stack.contacts.l) for mode, stack in self._stacks.items()}
        # Only a robot with a balance law sends its command of the CoM.
        self._commands_com = config.wbc.balance.law != "com"
        # Only a robot that decides on its steps reports them.
        self._reports_steps = config.stepping.mode != "off"
        self._state_form = self._make_state_form(None)
        self._holding_form = self._make_state_form([INTEGER] * len(ContactMode))
        self._answer_forms = {
            (mode, name, n_active): self._make_answer_form(layout, name, n_active)
            for mode, layout in self._layouts.items()
            for name in _DTYPES
            for n_active in range(layout.n_forces + 1)
        }
        # For each size of a message: the shape and number format of its projector, and its form.
        # Those with open rows are too many: each is made when a message first has it.
        self._answer_forms_by_size: dict[int, tuple[tuple[int, int], str, Form]] = {}
        self._open_forms: dict[tuple[ContactMode, int, int], Form] = {}
        if not self._n_limits:
            self._answer_forms_by_size = {
                form.size: (self._shapes[mode], name, form)
                for (mode, name, _), form in self._answer_forms.items()
            }

    def rounded(self, projector: Projector) -> Projector:
        """Return the projector as the other end will see it, after the wire's number format."""
        dtype = _DTYPES[self._dtype_of(projector)]
        if dtype == projector.A_dagger.dtype:
            return projector
        opened = projector.open
        if opened is not None:
            opened = Openness(
                opened.limits, _rounded(opened.push, dtype), _rounded(opened.factor, dtype)
            )
        A_dagger = _rounded(projector.A_dagger, dtype)
        return dataclasses.replace(projector, A_dagger=A_dagger, open=opened)

    def n_bytes(self, projector: Projector) -> int:
        """Return the length of a projector's numbers in a message [bytes]."""
        return projector.size * _DTYPES[self._dtype_of(projector)].itemsize

    def _dtype_of(self, projector: Projector) -> str:
        """The number format of a projector: with open rows it would be too long in double."""
        return self._dtype_name if projector.open is None else "float32"

    def encode_state(self, state: RobotState) -> bytes:
        """Encode a `RobotState`, in at most `UPLINK.max_bytes`."""
        held_sequences = state.held_sequences
        form = self._state_form if held_sequences is None else self._holding_form
        return form.write(
            state.session,
            state.sequence,
            state.stamp_ns,
            state.time_ns,
            state.mode,
            state.q.tobytes(),
            state.v.tobytes(),
            *self._com_command_bytes(state),
            *(() if state.steps is None else step_values(state.steps)),
            *(held_sequences or ()),
        )

    def _com_command_bytes(self, state: RobotState) -> tuple[bytes, ...]:
        if not self._commands_com:
            return ()
        return (b"" if state.com_command is None else state.com_command.tobytes(),)

    def decode_state(self, data: bytes) -> RobotState:
        """Decode and check a `RobotState`. Raise `MessageRefused` if a check fails."""
        state = self._read_state(data)
        if state is not None:
            return state
        fields = self.unpack(data, (_STATE,), UPLINK.max_bytes)
        return RobotState(
            session=integer_of(fields, "session"),
            sequence=integer_of(fields, "sequence"),
            stamp_ns=integer_of(fields, "stamp_ns"),
            time_ns=integer_of(fields, "time_ns"),
            mode=mode_of(fields),
            q=array_of(fields, "q", (self._nq,)),
            v=array_of(fields, "v", (self._nv,)),
            held_sequences=held_sequences_of(fields),
            com_command=array_of(fields, "com_command", (2,)) if self._commands_com else None,
            steps=steps_in(fields.get("steps"), mode_of(fields)) if self._reports_steps else None,
        )

    def encode_projector(self, message: ProjectorMessage) -> bytes:
        """Encode a `ProjectorMessage`. Raise `ConfigError` if it exceeds `DOWNLINK.max_bytes`."""
        if len(message.projectors) == 1:
            return self._write_answer(message, message.projectors[0])
        return self.pack(
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

    def decode_projector(self, data: bytes, judge: Judge = _anything) -> ProjectorMessage:
        """Decode and check a `ProjectorMessage`. Raise `MessageRefused` if a check fails."""
        message = self._read_answer(data, judge)
        if message is not None:
            return message
        fields = self.unpack(data, (_PROJECTOR,), DOWNLINK.max_bytes)
        mode = mode_of(fields)
        entries = fields.get("projectors")
        if not isinstance(entries, list) or not 0 < len(entries) <= len(ContactMode):
            raise MessageRefused("shape", "projectors")
        projectors = tuple(self._decode_projector_fields(entry) for entry in entries)
        if not any(timed.projector.mode is mode for timed in projectors):
            raise MessageRefused("mode", f"no projector of {mode.name}, which the answer is for")
        message = ProjectorMessage(
            session=integer_of(fields, "session"),
            sequence=integer_of(fields, "sequence"),
            stamp_ns=integer_of(fields, "stamp_ns"),
            mode=mode,
            tau=array_of(fields, "tau", (self._nv - 6,)),
            y=array_of(fields, "y", (self._layouts[mode].n_unknowns,)),
            projectors=projectors,
        )
        judge(message.session, message.sequence)
        if len(projectors) == 1:
            self._form_of(projectors[0].projector)
        return message

    def encode_factorisations(self, message: FactorisationMessage) -> bytes:
        """Encode a `FactorisationMessage`, with numbers in single precision."""
        return self.pack(
            _FACTORISATION,
            DOWNLINK.max_bytes,
            session=message.session,
            sequence=message.sequence,
            stamp_ns=message.stamp_ns,
            factorisations=[self._factorisation_fields(each) for each in message.factorisations],
        )

    def decode_factorisations(self, data: bytes, judge: Judge = _anything) -> FactorisationMessage:
        """Decode and check a `FactorisationMessage`. Raise `MessageRefused` if a check fails."""
        fields = self.unpack(data, (_FACTORISATION,), DOWNLINK.max_bytes)
        entries = fields.get("factorisations")
        if not isinstance(entries, list) or len(entries) > len(ContactMode):
            raise MessageRefused("shape", "factorisations")
        message = FactorisationMessage(
            session=integer_of(fields, "session"),
            sequence=integer_of(fields, "sequence"),
            stamp_ns=integer_of(fields, "stamp_ns"),
            factorisations=tuple(self._decode_factorisation_fields(entry) for entry in entries),
        )
        judge(message.session, message.sequence)
        return message

    def _make_state_form(self, holds: Any) -> Form:
        return Form(
            {
                **self._header,
                "kind": _STATE,
                "session": INTEGER,
                "sequence": INTEGER,
                "stamp_ns": INTEGER,
                "time_ns": INTEGER,
                "mode": SMALL,
                "q": binary(DOUBLE.itemsize * self._nq),
                "v": binary(DOUBLE.itemsize * self._nv),
                **({"com_command": binary(DOUBLE.itemsize * 2)} if self._commands_com else {}),
                **({"steps": dict(STEP_SLOTS)} if self._reports_steps else {}),
                "holds": holds,
            }
        )

    def _read_state(self, data: bytes) -> RobotState | None:
        """The state in a message of its form, or None if it has another form or an error."""
        size = len(data)
        if size == self._state_form.size:
            values = self._state_form.read(data)
        elif size == self._holding_form.size:
            values = self._holding_form.read(data)
        else:
            return None
        if values is None:
            return None
        session, sequence, stamp_ns, time_ns, mode, q_bytes, v_bytes, *holds = values
        q, v = finite_numbers(q_bytes), finite_numbers(v_bytes)
        com_command = None
        if self._commands_com:
            command_bytes, *holds = holds
            com_command = finite_numbers(command_bytes)
            if com_command is None:
                return None
        steps = None
        if self._reports_steps:
            of_steps, holds = holds[: len(STEP_SLOTS)], holds[len(STEP_SLOTS) :]
            if mode not in self._layouts:
                return None
            steps = steps_of(ContactMode(mode), *of_steps)
            if steps is None:
                return None
        if mode not in self._layouts or q is None or v is None:
            return None
        if min(session, sequence, stamp_ns, time_ns) < -MAX_INT or min(holds, default=0) < -1:
            return None
        held_sequences = tuple(holds) if holds else None
        return RobotState(
            session,
            sequence,
            stamp_ns,
            time_ns,
            ContactMode(mode),
            q,
            v,
            held_sequences,
            com_command,
            steps,
        )

    def _form_of(self, projector: Projector) -> Form:
        """The form of an answer with this projector alone. With open rows it is known from now."""
        mode, n_active, opened = projector.mode, len(projector.active), projector.open
        if opened is None:
            return self._answer_forms[mode, self._dtype_name, n_active]
        k = len(opened.limits)
        form = self._open_forms.get((mode, n_active, k))
        if form is None:
            form = self._make_answer_form(self._layouts[mode], "float32", n_active, n_open=k)
            self._open_forms[mode, n_active, k] = form
        self._answer_forms_by_size[form.size] = (self._shapes[mode], "float32", form)
        return form

    def _make_answer_form(
        self, layout: RowLayout, dtype_name: str, n_active: int, *, n_open: int | None = None
    ) -> Form:
        numbers = layout.n_unknowns * layout.n_rows
        opened = {}
        if n_open is not None:
            opened = {
                "limits": binary(n_open),
                "push": binary(SINGLE.itemsize * layout.n_unknowns * (n_open + layout.n_forces)),
                "factor": binary(SINGLE.itemsize * n_open**2),
            }
        projector = {
            "mode": SMALL,
            "layout": binary(len(layout.digest)),
            "dtype": dtype_name,
            "active": binary(n_active),
            **opened,
            "A_dagger": binary(_DTYPES[dtype_name].itemsize * numbers),
            "valid_from_ns": INTEGER,
            "valid_until_ns": INTEGER,
        }
        return Form(
            {
                **self._header,
                "kind": _PROJECTOR,
                "session": INTEGER,
                "sequence": INTEGER,
                "stamp_ns": INTEGER,
                "mode": SMALL,
                "tau": binary(DOUBLE.itemsize * (self._nv - 6)),
                "y": binary(DOUBLE.itemsize * layout.n_unknowns),
                "projectors": [projector],
            }
        )

    def _write_answer(self, message: ProjectorMessage, timed: TimedProjector) -> bytes:
        projector = timed.projector
        form = self._form_of(projector)
        _check_size(_PROJECTOR, form.size, DOWNLINK.max_bytes)
        return form.write(
            message.session,
            message.sequence,
            message.stamp_ns,
            message.mode,
            message.tau.tobytes(),
            message.y.tobytes(),
            projector.mode,
            self._layout_digests[projector.mode],
            projector.active.astype(np.uint8).tobytes(),
            *(() if projector.open is None else _open_fields(projector.open).values()),
            projector.A_dagger.astype(_DTYPES[self._dtype_of(projector)], copy=False).tobytes(),
            timed.valid_from_ns,
            timed.valid_until_ns,
        )

    def _read_answer(self, data: bytes, judge: Judge) -> ProjectorMessage | None:
        """The answer in a message of its form, or None if it has another form or an error."""
        known = self._answer_forms_by_size.get(len(data))
        if known is None:
            return None
        shape, dtype_name, form = known
        values = form.read(data)
        if values is None:
            return None
        session, sequence, stamp_ns, mode_value, tau_bytes, y_bytes, *of_projector = values
        judge(session, sequence)
        of_mode, layout, active, *of_open, numbers, from_ns, until_ns = of_projector
        if of_mode != mode_value or layout != self._layout_digests.get(of_mode):
            return None
        mode = ContactMode(of_mode)
        rows = list(active)
        if shape != self._shapes[mode] or not self._are_active_rows(rows, mode):
            return None
        tau, y = finite_numbers(tau_bytes), finite_numbers(y_bytes)
        A_dagger = finite_numbers(numbers, _DTYPES[dtype_name])
        if tau is None or y is None or A_dagger is None:
            return None
        if min(session, sequence, stamp_ns, from_ns, until_ns) < -MAX_INT:
            return None
        opened = None
        if of_open:
            opened = self._read_open_rows(*of_open, n=shape[0])
            if opened is None:
                return None
        projector = Projector(mode, A_dagger.reshape(shape), np.array(rows, dtype=int), opened)
        timed = TimedProjector(projector, from_ns, until_ns)
        return ProjectorMessage(session, sequence, stamp_ns, mode, tau, y, (timed,))

    def _read_open_rows(
        self, limits: bytes, push_bytes: bytes, factor_bytes: bytes, *, n: int
    ) -> Openness | None:
        """The open rows of an answer with n unknowns, or None if there is an error in them."""
        # The numbers stay in single precision: most ticks do not need them.
        push, factor, k = np.frombuffer(push_bytes, SINGLE), _NO_FACTOR, len(limits)
        if k:
            factor = np.frombuffer(factor_bytes, SINGLE).reshape(k, k)
            if not (all_finite(factor) and self._are_limits(limits)):
                return None
        if not all_finite(push):
            return None
        return Openness(np.frombuffer(limits, np.uint8), push.reshape(n, -1), factor)

    def _are_active_rows(self, rows: list[int], mode: ContactMode) -> bool:
        """Return whether `rows` ascend and are rows of C."""
        if not rows:
            return True
        return rows == sorted(set(rows)) and rows[-1] < self._n_inequalities[mode]

    def _are_limits(self, entries: bytes) -> bool:
        """Return whether `entries` ascend and are those of limits in b."""
        if not entries:
            return True
        return entries[-1] < self._n_limits and all(map(lt, entries, entries[1:]))

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
            **{name: array.astype(SINGLE).tobytes() for name, array in arrays.items()},
        }

    def _decode_factorisation_fields(self, fields: Any) -> Factorisation:
        if not isinstance(fields, dict):
            raise MessageRefused("undecodable", "factorisation")
        mode = mode_of(fields)
        if fields.get("layout") != self._layout_digests[mode]:
            raise MessageRefused("layout", mode.name)
        stack = self._stacks[mode]
        n, n_e = stack.layout.n_unknowns, stack.equality_rows.stop
        varying = stack.varying_task_rows

        def array(name: str, *shape: int) -> np.ndarray:
            return array_of(fields, name, shape, dtype=SINGLE)

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
        dtype = self._dtype_of(projector)
        return {
            "mode": int(projector.mode),
            "layout": self._layout_digests[projector.mode],
            "dtype": dtype,
            "active": projector.active.astype(np.uint8).tobytes(),
            **({} if projector.open is None else _open_fields(projector.open)),
            "A_dagger": projector.A_dagger.astype(_DTYPES[dtype]).tobytes(),
            "valid_from_ns": timed.valid_from_ns,
            "valid_until_ns": timed.valid_until_ns,
        }

    def _decode_projector_fields(self, fields: Any) -> TimedProjector:
        if not isinstance(fields, dict):
            raise MessageRefused("undecodable", "projector")
        mode = mode_of(fields)
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
        if not self._are_active_rows(rows, mode):
            raise MessageRefused("shape", "active")
        return TimedProjector(
            projector=Projector(
                mode=mode,
                A_dagger=array_of(fields, "A_dagger", self._shapes[mode], dtype=_DTYPES[dtype]),
                active=np.array(rows, dtype=int),
                open=self._decode_open_rows(fields, layout) if self._n_limits else None,
            ),
            valid_from_ns=integer_of(fields, "valid_from_ns"),
            valid_until_ns=integer_of(fields, "valid_until_ns"),
        )

    def _decode_open_rows(self, fields: dict[str, Any], layout: RowLayout) -> Openness:
        limits = fields.get("limits")
        if not isinstance(limits, bytes) or not self._are_limits(limits):
            raise MessageRefused("shape", "limits")
        k = len(limits)
        push = array_of(fields, "push", (layout.n_unknowns, k + layout.n_forces), dtype=SINGLE)
        factor = array_of(fields, "factor", (k, k), dtype=SINGLE)
        return Openness(np.frombuffer(limits, np.uint8), push, factor)

    def pack(self, kind: str, max_bytes: int, **fields: Any) -> bytes:
        """Return a message of a kind; raise `ConfigError` if it is longer than its channel's."""
        data = bytes(msgpack.packb({**self._header, "kind": kind, **fields}))
        _check_size(kind, len(data), max_bytes)
        return data

    def unpack(self, data: bytes, kinds: tuple[str, ...], max_bytes: int) -> dict[str, Any]:
        """Return the fields of a message of one of these kinds; raise `MessageRefused`."""
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
        if fields.get("kind") not in kinds:
            raise MessageRefused("kind", repr(fields.get("kind")))
        if fields.get("config") != self._header["config"]:
            raise MessageRefused("config", "the two ends run different configurations")
        if fields.get("plan") != self._header["plan"]:
            raise MessageRefused("plan", "the two ends derive different motions")
        return fields


def _check_size(kind: str, size: int, max_bytes: int) -> None:
    if size > max_bytes:
        raise ConfigError(
            f"wire: a {kind} message takes {size} bytes, more than the {max_bytes} of its "
            "channel; try wire.projector_dtype = 'float32'"
        )


def _rounded(array: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray:
    rounded: np.ndarray = array.astype(dtype).astype(np.float64)
    return rounded


def _open_fields(opened: Openness) -> dict[str, bytes]:
    return {
        "limits": bytes(opened.limits.tolist()),
        "push": opened.push.astype(SINGLE).tobytes(),
        "factor": opened.factor.astype(SINGLE).tobytes(),
    }


def _packed(symmetric: np.ndarray) -> np.ndarray:
    """The lower triangle, row by row."""
    return symmetric[np.tril_indices(len(symmetric))]


def _unpacked(triangle: np.ndarray, n: int) -> np.ndarray:
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n)] = triangle
    return matrix + np.tril(matrix, -1).T
