"""The robot's tick, in two phases.

`measure` senses and returns the state to send; `command`, d* later, takes what has arrived and
produces the torque of this tick by Eq. (7): the answer to *this* state if it is here, else the
newest one in the cache, else the joints are held. `advance` then moves the simulated robot.

Time of the task begins when the first answer arrives; until then the robot stands still and sends.
A tick never raises: what goes wrong is counted and named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_node.cache import CacheEntry, ProjectorCache
from robot_node.controllers import Measurement, Source, make_controller
from robot_node.onboard import ModelledComputer, OnBoardComputer, OnBoardWindow
from robot_node.plant import Plant
from robot_node.safety import JointHold, TorqueGuard, has_fallen
from robot_node.sensors import Sensors
from shared.bus.base import new_session
from shared.config import RunConfig
from shared.motion.reference import Motion, Reference
from shared.quantities import parse_push
from shared.robots import Foot, Robot
from shared.telemetry import Schema, tick_schema
from shared.wbc.contacts import ContactMode
from shared.wbc.model import Kinematics, WholeBodyModel
from shared.wbc.stack import Stack
from shared.wbc.whole_body import WholeBodyController
from shared.wire.codec import Codec
from shared.wire.messages import RobotState


@dataclass(frozen=True, slots=True)
class Command:
    """The torque of one tick (nv − 6,) [N m], clamped; the solution behind it, if there is one.

    `entry` is the cache's that it came from; `age_ns` the time since its state was measured.
    """

    tau: np.ndarray
    y: np.ndarray | None
    source: Source
    age_ns: int
    entry: CacheEntry | None


def needs_on_board_computer(config: RunConfig, motion: Motion) -> bool:
    """Whether this run solves QPs on the robot: with LA, around contact switches."""
    switch = config.switch
    wanted = switch.prepare_on_board or switch.solve_on_board
    return config.controller == "la" and wanted and motion.next_switch(0) is not None


class RobotNode:
    """Simulated robot and local controller. `session` names this start of the robot; `computer`
    is the on-board one, by default one whose compute time is modelled.
    """

    def __init__(
        self,
        robot: Robot,
        config: RunConfig,
        motion: Motion,
        *,
        session: int | None = None,
        computer: OnBoardComputer | None = None,
    ) -> None:
        self.schema: Schema = tick_schema(nq=robot.model.nq, nv=robot.model.nv)
        self.running = False
        self.fallen = False
        self.time_ns = 0
        self.tick = 0
        self._config = config
        self._motion = motion
        self._pushes = [parse_push(push) for push in config.push]
        self._plant = Plant(robot, config.plant, timestep=config.loop.period_ns * 1e-9)
        self._sensors = Sensors(config.sensors, seed=config.seed)
        self._model = WholeBodyModel(robot)
        self._stacks = {mode: Stack(robot, config.wbc, mode) for mode in ContactMode}
        self._controller = make_controller(config.controller, self._model, self._stacks)
        self._session = new_session() if session is None else session
        self._codec = Codec(robot, config, motion)
        self.cache = ProjectorCache(self._codec, session=self._session)
        self.on_board: OnBoardWindow | None = None
        if needs_on_board_computer(config, motion):
            if computer is None:
                solver = WholeBodyController(robot, config.wbc, motion)
                ready_after_ns = config.switch.ready_after_ns(config.switch.compute_ns)
                computer = ModelledComputer(solver, ready_after_ns=ready_after_ns)
            self.on_board = OnBoardWindow(config.switch, motion, computer)
        self._guard = TorqueGuard(robot, clamp=config.robot.torque_clamp)
        self._hold = JointHold(robot)
        self._hold_after_ns = config.loop.hold_after * 1e9
        self._standing_com_height = float(motion.reference(0).com[2])
        self._measured_ns = 0
        self._set_down: dict[Foot, np.ndarray] = {}
        self._measurement: Measurement
        self._kinematics: Kinematics
        self._reference: Reference

    def measure(self, now_ns: int) -> bytes:
        """First phase: sense, form b, and return the state message to send."""
        q, v = self._sensors.measure(*self._plant.state())
        self._reference = self._motion.reference(self.time_ns)
        mode = self._reference.mode
        self._kinematics = self._model.kinematics(q, v)
        b = self._stacks[mode].right_hand_side(self._kinematics, self._reference)
        self._measurement = Measurement(q, v, b)
        self._measured_ns = now_ns
        return self._codec.encode_state(
            RobotState(
                session=self._session,
                sequence=self.tick,
                stamp_ns=now_ns,
                time_ns=self.time_ns,
                mode=mode,
                q=q,
                v=v,
            )
        )

    def receive(self, data: bytes) -> bool:
        """Offer a message from the edge to the cache; whether it was taken."""
        return self.cache.offer(data, newest_sent=self.tick)

    def command(self, now_ns: int) -> Command:
        """Second phase: the torque of this tick, Eq. (7)."""
        mode = self._reference.mode
        self._solve_on_board()
        entry = self._controller.choose(self.cache, mode, time_ns=self.time_ns)
        if entry is None:
            return self._held(age_ns=-1)
        age_ns = now_ns - entry.stamp_ns
        if age_ns > self._hold_after_ns:
            return self._held(age_ns=age_ns)
        tau, y = self._controller.command(entry, self._measurement)
        safe = self._guard.accept(tau)
        if safe is None:
            return self._held(age_ns=age_ns)
        self._hold.observe(self._measurement.q, safe)
        source = Source.FRESH if entry.sequence == self.tick else Source.CACHED
        if entry.on_board:
            source = Source.ON_BOARD
        return Command(safe, y, source, age_ns, entry)

    def advance(self, command: Command) -> None:
        """Move the plant by one period; before the first answer, only count the tick."""
        if not self.running and command.source is not Source.HELD:
            self.running = True
            self._sensors.restart()
        self.tick += 1
        if not self.running:
            return
        self._plant.step(command.tau, push=self._push())
        self.time_ns += self._config.loop.period_ns

    def record(self, row: np.ndarray, command: Command) -> None:
        """Fill the telemetry row of this tick; between `command` and `advance`."""
        columns = self.schema.slices
        q, v = self._plant.state()
        com, soles = self._model.com_and_soles(q)
        row[columns["tick"]] = self.tick
        row[columns["time_ns"]] = self.time_ns if self.running or command.y is not None else -1
        row[columns["wall_ns"]] = self._measured_ns
        row[columns["source"]] = command.source
        row[columns["mode"]] = self._reference.mode
        row[columns["q"]] = q
        row[columns["v"]] = v
        row[columns["tau"]] = command.tau
        row[columns["com"]] = com
        row[columns["com_reference"]] = self._reference.com
        error = com - self._reference.com
        row[columns["com_error_m"]] = math.sqrt(error @ error)
        row[columns["contact_violation_m_s2"]] = np.nan
        entry = command.entry
        if command.y is not None and entry is not None:
            forces = row[columns["f"]].reshape(len(Foot), -1)
            loaded = list(entry.projector.mode.feet_indices)
            forces[loaded] = command.y[self._model.nv :].reshape(len(loaded), -1)
            row[columns["contact_violation_m_s2"]] = self._contact_violation(command.y)
        row[columns["push_n"]] = self._push()
        row[columns["foot_slip_m"]] = self._foot_slips(soles)
        row[columns["projector_age_ns"]] = command.age_ns
        row[columns["projector_sequence"]] = -1 if entry is None else entry.sequence
        row[columns["active_set"]] = -1 if entry is None else entry.projector.active_set
        row[columns["on_board_qps"]] = 0 if self.on_board is None else self.on_board.solves
        row[columns["refused"]] = self.cache.refused.total_refused
        self.fallen = has_fallen(
            q, com_height=com[2], standing_com_height=self._standing_com_height
        )

    def _solve_on_board(self) -> None:
        if self.on_board is None or not self.running:
            return
        now = self._measurement
        solved = self.on_board.tick(
            now.q,
            now.v,
            time_ns=self.time_ns,
            sequence=self.tick,
            stamp_ns=self._measured_ns,
        )
        if solved is not None:
            self.cache.keep(solved)

    def _held(self, *, age_ns: int) -> Command:
        now = self._measurement
        tau = self._guard.accept(self._hold.torque(now.q, now.v))
        if tau is None:
            tau = np.zeros_like(self._guard.limit)
        return Command(tau, None, Source.HELD, age_ns, None)

    def _push(self) -> np.ndarray:
        force = np.zeros(3)
        for push in self._pushes:
            if push.active(self.time_ns):
                force += push.force
        return force

    def _foot_slips(self, soles: dict[Foot, np.ndarray]) -> list[float]:
        """Distance in the plane of each loaded sole from where it was set down, NaN in the air."""
        loaded = self._reference.mode.feet
        slips = []
        for foot, position in soles.items():
            if foot not in loaded:
                self._set_down.pop(foot, None)
                slips.append(math.nan)
                continue
            moved = position[:2] - self._set_down.setdefault(foot, position[:2])
            slips.append(math.hypot(*moved))
        return slips

    def _contact_violation(self, y: np.ndarray) -> float:
        now = self._measurement
        stack = self._stacks[self._reference.mode]
        a = y[: self._model.nv]
        acceleration = self._model.sole_acceleration(stack.support_foot, now.q, now.v, a)
        return stack.contact_violation(self._kinematics, acceleration)
