"""The robots at an edge: for each start of each robot its newest state, and what belongs to it.

A robot's sequence and clock cannot run ahead of the edge's own clock. A state that claims so is
refused, because all later honest states would be stale beside it. If only refused states come for a
while, the last taken state was wrong, and the session begins anew. A state in which no robot can be
is refused, unless the states before it lead there, as in a fall. Sessions are served in turn, each
with its newest state, so that a robot that sends too much takes no time from the others.
"""

from __future__ import annotations

from collections import Counter

from edge_node.posture import PostureEstimate
from edge_node.refresh import FactorisationRefresh
from edge_node.step_planning import StepDelivery
from shared.config.settings import RunConfig
from shared.errors import MessageRefused
from shared.robots import Robot
from shared.robots.state_limits import StateLimits
from shared.wbc.contacts import ContactMode
from shared.wbc.continuity import continues
from shared.wbc.reference import Motion
from shared.wbc.whole_body import ActiveSet
from shared.wire.messages import RobotState

# More than the variation of one-way delays. The delay of the first states is still unknown.
_AHEAD_NS, _SETTLING_NS = 1_000_000_000, 100_000_000
# A session that has had nothing but refused states for this long begins anew.
_STUCK_NS = 100_000_000
# Two sessions that both send within the first time, and are both older than the second, are two
# robots; a robot that has started anew does not send in its old session.
_SHARED_NS, _STARTING_NS = 200_000_000, 500_000_000
_MAX_SESSIONS = 8
# The largest time [ns] and the largest jump of a joint [rad] between successive states beyond the
# limits.
_CONTINUES_NS, _JUMP = 5_000_000, 0.5
# Only a session that has been silent for this long may be forgotten for another.
_SILENT_NS = 20_000_000


class RobotSession:
    """One start of one robot.

    `newest` is the state to answer next, None if it has been answered. `last_active` are the active
    sets of the last solutions. `prepared` is the contact mode whose projector was prepared last,
    beside that of a state. `heard_ns` is the edge's time of the last state, and `n_states` is
    their number.
    """

    def __init__(self, config: RunConfig, motion: Motion, *, now_ns: int) -> None:
        self.newest: RobotState | None = None
        self.posture = PostureEstimate(config.correction.average_ns)
        self.refresh = FactorisationRefresh(config.correction, motion)
        self.steps = StepDelivery(config.correction.retry_ns)
        self.last_active: dict[ContactMode, ActiveSet] = {}
        self.prepared: ContactMode | None = None
        self.began_ns = self.heard_ns = now_ns
        self.n_states = 0
        # The number of the turn in which the session was served last.
        self.served = -1
        self._period_ns = config.loop.period_ns
        self._last: RobotState | None = None
        # The largest lead of the robot's clock and ticks over the edge's clock.
        self._clock_ns = self._ticks_ns = -(2**63)
        self._refused_since_ns: int | None = None

    def take(self, state: RobotState, *, now_ns: int) -> None:
        """Take a state that has arrived. Raise `MessageRefused` if it is not newer than the last
        one, or too far ahead.
        """
        clock_ns = state.stamp_ns - now_ns
        ticks_ns = state.sequence * self._period_ns - now_ns
        last = self._last
        if last is not None:
            reason = None
            if state.sequence <= last.sequence or state.stamp_ns < last.stamp_ns:
                reason = "stale"
            elif now_ns - self.began_ns > _SETTLING_NS and (
                clock_ns - self._clock_ns > _AHEAD_NS or ticks_ns - self._ticks_ns > _AHEAD_NS
            ):
                reason = "ahead"
            if reason is not None:
                if self._refused_since_ns is None:
                    self._refused_since_ns = now_ns
                raise MessageRefused(reason, f"{state.sequence} after {last.sequence}")
        self._refused_since_ns = None
        self._clock_ns = max(self._clock_ns, clock_ns)
        self._ticks_ns = max(self._ticks_ns, ticks_ns)
        self._last = self.newest = state
        self.heard_ns = now_ns
        self.n_states += 1

    def leads_to(self, state: RobotState) -> bool:
        """Return whether a state follows from the last one."""
        last = self._last
        if last is None or not 0 < state.stamp_ns - last.stamp_ns <= _CONTINUES_NS:
            return False
        seconds = (state.stamp_ns - last.stamp_ns) * 1e-9
        return bool(continues(last.q, state.q, state.v, seconds=seconds, jump=_JUMP).all())

    def is_stuck(self, now_ns: int) -> bool:
        """Return whether only refused states have come for a while."""
        since_ns = self._refused_since_ns
        return since_ns is not None and now_ns - since_ns >= _STUCK_NS


class Sessions:
    """All sessions of an edge.

    `shared` counts, by the robot's name, how often a second robot of this name began to send, and
    `renewed` how often a session began anew.
    """

    def __init__(self, robot: Robot, config: RunConfig, motion: Motion) -> None:
        self._limits = StateLimits(robot)
        self.shared: Counter[str] = Counter()
        self.renewed: Counter[str] = Counter()
        self._config = config
        self._motion = motion
        self._sessions: dict[tuple[str, int], RobotSession] = {}
        self._turn = 0
        self._sharing: set[str] = set()

    def take(self, robot: str, state: RobotState, *, now_ns: int) -> None:
        """Take a state of a robot of that name. Raise `MessageRefused` if it is refused."""
        key = (robot, state.session)
        session = self._sessions.get(key)
        try:
            self._limits.check(state.q, state.v)
        except MessageRefused:
            if session is None or not session.leads_to(state):
                raise
        if session is None:
            self._make_room(robot, now_ns)
            session = self._begin(key, now_ns)
        try:
            session.take(state, now_ns=now_ns)
        except MessageRefused:
            if not session.is_stuck(now_ns):
                raise
            self.renewed[robot] += 1
            self._begin(key, now_ns).take(state, now_ns=now_ns)
        if len(self._sessions) > 1:
            self._note_sharing(robot, now_ns)

    @property
    def waiting(self) -> bool:
        """Return whether a state waits for an answer."""
        return any(session.newest is not None for session in self._sessions.values())

    def next(self) -> tuple[str, RobotSession, RobotState] | None:
        """Return the robot, the session and the state to answer now; None if none waits.

        The session whose turn is longest ago comes first.
        """
        waiting = [item for item in self._sessions.items() if item[1].newest is not None]
        if not waiting:
            return None
        (robot, _), session = min(waiting, key=lambda item: item[1].served)
        self._turn += 1
        session.served = self._turn
        state, session.newest = session.newest, None
        assert state is not None
        return robot, session, state

    def _begin(self, key: tuple[str, int], now_ns: int) -> RobotSession:
        session = RobotSession(self._config, self._motion, now_ns=now_ns)
        # It gets its turn after the waiting sessions.
        session.served = self._turn
        self._sessions[key] = session
        return session

    def _make_room(self, robot: str, now_ns: int) -> None:
        """Forget the shortest of the silent sessions of a robot that has too many.

        Raise `MessageRefused` if none is silent.
        """
        own = [(key, each) for key, each in self._sessions.items() if key[0] == robot]
        if len(own) < _MAX_SESSIONS:
            return
        silent = [item for item in own if now_ns - item[1].heard_ns >= _SILENT_NS]
        if not silent:
            raise MessageRefused("crowded", f"{_MAX_SESSIONS} others of this name send states")
        del self._sessions[min(silent, key=lambda item: item[1].n_states)[0]]

    def _note_sharing(self, robot: str, now_ns: int) -> None:
        live = [
            each
            for (name, _), each in self._sessions.items()
            if name == robot
            and now_ns - each.heard_ns < _SHARED_NS
            and each.heard_ns - each.began_ns > _STARTING_NS
        ]
        if len(live) < 2:
            self._sharing.discard(robot)
        elif robot not in self._sharing:
            self._sharing.add(robot)
            self.shared[robot] += 1
