"""The newest answers of the edge, and why the others were refused.

An answer is taken if it passes the codec, echoes a state of this start of the robot and its time,
and was computed from a newer state than the one held. Each contact mode keeps its own projector or
factorisation: one of another mode is never applied. A factorisation must be that of the robot's own
model, and a projector must obey the robot's dynamics at its first use:
`robot_node/verification.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from robot_node.sent_states import SentStates
from robot_node.verification import FactorisationVerifier
from shared.bus.base import RefusalCounter
from shared.errors import MessageRefused
from shared.wbc.answer import Factorisation, Projector, TimedProjector
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Corrector
from shared.wbc.stack import Stack
from shared.wire.codec import Codec
from shared.wire.messages import FactorisationMessage, ProjectorMessage


@dataclass(slots=True, eq=False)
class CacheEntry:
    """A projector, and the state it was computed from: its tick and the robot's clock then.

    `tau` and `y` are the full solution at that state. They are None for a projector that was solved
    on board or for another contact mode than the state's. `proven`: it comes from the
    robot itself, or has passed the test at its first use. `exact`: it has passed the test at its
    own state.
    """

    timed: TimedProjector
    sequence: int
    stamp_ns: int
    on_board: bool = False
    tau: np.ndarray | None = None
    y: np.ndarray | None = None
    proven: bool = False
    exact: bool = False

    @property
    def projector(self) -> Projector:
        return self.timed.projector


class AnswerCache(ABC):
    """Base of the caches. It takes an answer to a state of this session that is newer than the last
    one.

    `newest_stamp_ns` is the time of measurement of the state that was answered last; −1 before the
    first. With `tested_on_arrival`, a taken answer has passed its test, and an older answer of the
    same tick is stale.
    """

    tested_on_arrival = True

    def __init__(self, codec: Codec, *, session: int) -> None:
        self.refused = RefusalCounter()
        self.newest_stamp_ns = -1
        self._codec = codec
        self._session = session
        self._newest_sequence = self._settled_sequence = self._tick = -1
        self._sent: SentStates

    def offer(self, data: bytes, *, sent: SentStates) -> bool:
        """Take a received message if it is valid. Return whether it was taken."""
        self._sent = sent
        if self._tick != sent.newest:
            self._tick, self._settled_sequence = sent.newest, self._newest_sequence
        try:
            message = self._decode(data)
            self._check_echo(message.sequence, message.stamp_ns)
            self._take(message)
        except MessageRefused as refusal:
            self.refused[refusal.reason] += 1
            return False
        if message.sequence > self._newest_sequence:
            self._newest_sequence = message.sequence
            self.newest_stamp_ns = message.stamp_ns
        if self.tested_on_arrival:
            self._settled_sequence = self._newest_sequence
        return True

    @property
    def is_empty(self) -> bool:
        """Return whether only answers without content have come."""
        return False

    @property
    def held_sequences(self) -> tuple[int, ...] | None:
        """Sequences of the held factorisations, to report to the edge; see `RobotState`."""
        return None

    def _judge(self, session: int, sequence: int) -> None:
        """Raise `MessageRefused` if an answer is not wanted."""
        if session != self._session:
            raise MessageRefused("session", "answers another start of the robot")
        if sequence <= self._settled_sequence:
            raise MessageRefused("stale", f"{sequence}")
        if sequence > self._sent.newest:
            raise MessageRefused("future", f"{sequence}")

    def _check_echo(self, sequence: int, stamp_ns: int) -> None:
        """Raise `MessageRefused` if the echoed time is not that of the state."""
        sent_ns = self._sent.stamp_ns(sequence)
        if sent_ns is None:
            raise MessageRefused("stale", f"{sequence}, which is forgotten")
        if stamp_ns != sent_ns:
            raise MessageRefused("stamp", f"{stamp_ns}, sent {sent_ns}")

    @abstractmethod
    def _decode(self, data: bytes) -> Any: ...

    @abstractmethod
    def _take(self, message: Any) -> None: ...


class ProjectorCache(AnswerCache):
    """Newest projector per contact mode, and the newest full solution of any mode.

    A projector is tested at its first use. Until then the cache also keeps the projectors that it
    replaces, and older answers of the same tick.
    """

    tested_on_arrival = False

    # More than answers can come in a tick.
    _MAX_ENTRIES = 12

    def __init__(self, codec: Codec, *, session: int) -> None:
        super().__init__(codec, session=session)
        self.newest_solution: CacheEntry | None = None
        # The newest first, none behind a proven one.
        self._entries: dict[ContactMode, list[CacheEntry]] = {mode: [] for mode in ContactMode}

    def _decode(self, data: bytes) -> ProjectorMessage:
        return self._codec.decode_projector(data, self._judge)

    def _take(self, message: ProjectorMessage) -> None:
        for timed in message.projectors:
            if timed.projector.mode is message.mode:
                solution = (message.tau, message.y)
                entry = CacheEntry(timed, message.sequence, message.stamp_ns, False, *solution)
                if self.newest_solution is None or message.sequence > self.newest_solution.sequence:
                    self.newest_solution = entry
            else:
                entry = CacheEntry(timed, message.sequence, message.stamp_ns)
            self.keep(entry)

    def keep(self, entry: CacheEntry) -> None:
        """Keep an entry unless a proven one is from a newer state: the faster answer wins."""
        entries = self._entries[entry.projector.mode]
        for place, held in enumerate(entries):
            if held.proven:
                del entries[place + 1 :]
                break
        place = 0
        for held in entries:
            # If two projectors are from the same state, that of the edge wins over the on-board
            # computer's, and the first of two edges' wins.
            same_state = entry.sequence == held.sequence
            if entry.sequence > held.sequence or (same_state and held.on_board > entry.on_board):
                break
            if held.proven:
                return
            place += 1
        entries.insert(place, entry)
        if len(entries) > self._MAX_ENTRIES:
            # The last one may be proven.
            del entries[-2]

    def state_of(self, entry: CacheEntry) -> tuple[np.ndarray, np.ndarray] | None:
        """Return (q, v) of the state that an entry was computed from; None if it is forgotten."""
        return self._sent.state(entry.sequence)

    def reject(self, entry: CacheEntry) -> None:
        """Count an entry as refused and forget it. Answers to older states are then welcome."""
        self.refused["dynamics" if entry.projector.open is None else "open_rows"] += 1
        self._entries[entry.projector.mode].remove(entry)
        left = [each for entries in self._entries.values() for each in entries if not each.on_board]
        newest = max(left, key=lambda each: each.sequence, default=None)
        self._newest_sequence = -1 if newest is None else newest.sequence
        self.newest_stamp_ns = -1 if newest is None else newest.stamp_ns

    def lookup(self, mode: ContactMode, *, time_ns: int) -> CacheEntry | None:
        """Return the newest projector of a mode that may be used at a task time, or None."""
        for entry in self._entries[mode]:
            if entry.timed.valid_from_ns <= time_ns < entry.timed.valid_until_ns:
                return entry
        return None


@dataclass(frozen=True, slots=True)
class CorrectorEntry:
    """A factorisation ready for use, and the state it was computed from."""

    corrector: Corrector
    sequence: int
    stamp_ns: int
    on_board: bool = False


class FactorisationCache(AnswerCache):
    """Newest factorisation per contact mode. It never expires: corrections make up for its age."""

    def __init__(
        self,
        codec: Codec,
        stacks: dict[ContactMode, Stack],
        *,
        session: int,
        level: str,
        verifier: FactorisationVerifier,
    ) -> None:
        super().__init__(codec, session=session)
        self._verifier = verifier
        self._stacks = stacks
        self._level = level
        self._entries: dict[ContactMode, CorrectorEntry] = {}

    @property
    def is_empty(self) -> bool:
        return not self._entries

    @property
    def held_sequences(self) -> tuple[int, ...]:
        return tuple(
            entry.sequence if (entry := self._entries.get(mode)) is not None else -1
            for mode in ContactMode
        )

    def _decode(self, data: bytes) -> FactorisationMessage:
        return self._codec.decode_factorisations(data, self._judge)

    def _take(self, message: FactorisationMessage) -> None:
        measured = self._sent.posture(message.sequence)
        for factorisation in message.factorisations:
            self._verifier.check(factorisation, measured=measured)
        self.keep(message.factorisations, sequence=message.sequence, stamp_ns=message.stamp_ns)

    def keep(
        self,
        factorisations: tuple[Factorisation, ...],
        *,
        sequence: int,
        stamp_ns: int,
        on_board: bool = False,
    ) -> None:
        """Keep factorisations from a newer state. Raise `MessageRefused` if one cannot be used."""
        try:
            correctors = [self._corrector(each) for each in factorisations]
        except np.linalg.LinAlgError:
            raise MessageRefused("not_definite", "P of the forces") from None
        for corrector in correctors:
            mode = corrector.factorisation.mode
            held = self._entries.get(mode)
            if held is None or sequence > held.sequence:
                self._entries[mode] = CorrectorEntry(corrector, sequence, stamp_ns, on_board)

    def _corrector(self, factorisation: Factorisation) -> Corrector:
        stack = self._stacks[factorisation.mode]
        rows = None if stack.limits is None else self._verifier.limit_rows(factorisation)
        return Corrector(stack, factorisation, level=self._level, limit_rows=rows)

    def lookup(self, mode: ContactMode) -> CorrectorEntry | None:
        """Return the newest factorisation of a mode, or None."""
        return self._entries.get(mode)
