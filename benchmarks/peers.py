"""The project's tick and edge beside a complete step of TSID and of placo: ratios from one run.

All have the same robot, the same states (a balance under a push, sensed with noise), and the same
tasks, gains and weights. A step of a peer is its whole computation from (q, v) to a torque. The
project's steps are the robot's tick without its link and plant, and the edge's step. The peers run
in another process and environment, because they need other packages than the project:
`benchmarks/peer.py`. The two processes take turns on one core, a batch of all states each, and the
time is the thread's processor time. Before each step a megabyte is written, as the rest of a loop
would.

The problems differ in two points:

* TSID has one least normal force per foot instead of one per point. Where that is not active the
  torques are the same, because its regularisation of a foot's wrench is weighted as that of the
  project's point forces.
* placo has a wrench per foot, whose centre of pressure is to stay in the rectangle, and weights the
  three moments alike.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from benchmarks.timing import Ratio, header
from edge_node.node import EdgeNode
from experiments.lockstep import Lockstep
from robot_node.node import RobotNode
from robot_node.plant import Plant
from robot_node.sensors import Sensors
from shared.bus.base import Delivery
from shared.config.config_file import load_config
from shared.config.robot_settings import SensorConfig
from shared.config.settings import RunConfig
from shared.errors import LinkError, UserError
from shared.motion.standing import Standing
from shared.output.text_table import aligned
from shared.process.entry import end_with_parent, python
from shared.robots import Foot, Robot, load_robot
from shared.telemetry.row_log import RowLog
from shared.wbc.contacts import CORNER_MARGIN, ContactMode
from shared.wbc.torque import recover_torque
from shared.wbc.whole_body import WholeBodyController
from shared.wire.codec import Codec

_LOCK = Path(__file__).with_name("peers.lock")
PEERS = ("tsid", "placo")
# Ticks of a run whose push begins at 1 s: from before it until well into the recovery [ms].
_STATES_MS = range(900, 1540, 10)
_CONTROLLERS = ("pr", "la", "lc")
_WARM_UP_ROUNDS = 2

# As in `benchmarks/peer.py`.
_OTHER_WORK = np.zeros(2**20, dtype=np.uint8)

States = list[tuple[np.ndarray, np.ndarray]]
# Takes every state in turn; the processor time of each [ns].
Batch = Callable[[], np.ndarray]


def run(*, rounds: int) -> str:
    """Install the peers if need be, and measure. Return the table as text, or why there is none."""
    try:
        interpreter = environment()
    except LinkError as error:
        return f"no comparison with {' and '.join(PEERS)}: {error}"
    top = header()
    robot = load_robot(RunConfig().robot.name)
    config = dataclasses.replace(RunConfig(), sensors=SensorConfig(joint_position_noise=0.0))
    states = pushed_states()
    ours = _our_batches(robot, config, states)
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name:
        case = write_case(Path(name), robot, config, states)
        with _peer(interpreter, case) as peer:
            batches: dict[str, Batch] = {**ours, **{name: peer.batch(name) for name in PEERS}}
            for _ in range(_WARM_UP_ROUNDS):
                for batch in batches.values():
                    batch()
            durations: dict[str, list[np.ndarray]] = {name: [] for name in batches}
            for _ in range(rounds):
                for name, batch in batches.items():
                    durations[name].append(batch())
            versions, torques = peer.versions, peer.torques
    return "\n".join(
        [
            f"{top}\npeers: {versions}",
            f"{len(states)} states, {rounds} rounds, processor time; p50: median of the rounds "
            "(least–most), p99: of all",
            "",
            *_table(durations),
            "",
            *_torques(robot, config, states, torques),
        ]
    )


def environment(lock: Path = _LOCK) -> Path:
    """Return the Python of the peers' environment. Make it if there is none for this lock and
    Python.

    Raise `LinkError` with pip's last line if it cannot be installed.
    """
    identity = hashlib.sha256(lock.read_bytes() + sys.version.encode()).hexdigest()[:12]
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(root) / "remote-wbc" / f"peers-{identity}"
    interpreter, installed = folder / "bin" / "python", folder / "installed"
    if installed.exists():
        return interpreter
    print(f"installing {' and '.join(PEERS)} into {folder} (600 MB)", file=sys.stderr)
    pip = [str(interpreter), "-I", "-m", "pip", "install", "--disable-pip-version-check"]
    # Most of their modules are never imported.
    pip += ["--no-compile"]
    pip += ["--require-hashes", "--only-binary", ":all:", "--requirement", str(lock)]
    for command in (python("-m", "venv", "--clear", str(folder)), pip):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            reason = said[-1] if said else f"{command[3]} ended with {done.returncode}"
            raise LinkError(f"cannot install them: {reason}")
    installed.touch()
    return interpreter


def pushed_states() -> States:
    """States (q, v) of a balance under the default push, as its robot's sensors give them."""
    config = load_config(
        None, {"controller": "la", "link.network": "direct", "duration": _STATES_MS.stop * 1e-3}
    )
    result = Lockstep(config, all_active_sets=False).run()
    q, v = (result.schema.column(result.rows, name) for name in ("q", "v"))
    sensors = Sensors(config.sensors, seed=config.seed)
    return [sensors.measure(q[tick], v[tick]) for tick in _STATES_MS]


def write_case(folder: Path, robot: Robot, config: RunConfig, states: States) -> Path:
    """Write the input of `benchmarks/peer.py` into `folder`. Return the file."""
    reference = Standing(robot).reference(0)
    urdf, corners = _urdf_with_soles(robot, folder / "robot.urdf")
    weights, gains = config.wbc.weights, config.wbc.gains
    case: dict[str, Any] = {
        "urdf": str(urdf),
        "base_frame": _root_link(Xml.parse(urdf).getroot()),
        "joints": list(robot.model.names)[2:],
        "q": [q for q, _ in states],
        "v": [v for _, v in states],
        "q_standing": robot.q_standing,
        "com": reference.com,
        "world_from_base": reference.world_from_base,
        "posture": reference.posture,
        "corners": corners,
        # Least squares of point forces with a given wrench about the middle of their rectangle.
        "wrench_weights": 1.0 / np.array([4.0] * 3 + _second_moments(corners)),
        "friction": config.wbc.friction,
        "min_normal_force": config.wbc.min_normal_force,
        "contact_damping": gains.contact_damping,
        "force_weight": weights.force,
        **{f"{name}_kp": kp for name, kp in _by_task(gains)},
        **{f"{name}_weight": weight for name, weight in _by_task(weights)},
    }
    file = folder / "case.npz"
    np.savez(file, **case)
    return file


def _by_task(values: Any) -> list[tuple[str, float]]:
    return [
        ("com", values.com),
        ("base", values.base_orientation),
        ("posture", values.posture),
    ]


def _second_moments(corners: np.ndarray) -> list[float]:
    x, y, _ = corners.T
    return [float(y @ y), float(x @ x), float(x @ x + y @ y)]


def _urdf_with_soles(robot: Robot, file: Path) -> tuple[Path, np.ndarray]:
    """The URDF with a frame in the middle of each sole's rectangle, and without shapes; and the
    corners (4, 3) of the rectangle in it, the same of both feet.
    """
    tree = Xml.parse(robot.description.urdf)
    root = tree.getroot()
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for sole in robot.soles:
        corners = sole.corners(CORNER_MARGIN)
        middle = corners.mean(axis=0)
        frame = robot.sole_frame(sole.side)
        carrier = root.find(f"joint[@name='{robot.model.names[frame.parentJoint]}']/child")
        assert carrier is not None
        name = f"{sole.side.value}_sole"
        Xml.SubElement(root, "link", name=name)
        joint = Xml.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        Xml.SubElement(joint, "parent", link=carrier.get("link", ""))
        Xml.SubElement(joint, "child", link=name)
        xyz = " ".join(map(repr, frame.placement.act(middle).tolist()))
        rpy = " ".join(map(repr, pin.rpy.matrixToRpy(frame.placement.rotation).tolist()))
        Xml.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    tree.write(file)
    return file, corners - middle


def _root_link(root: Xml.Element) -> str:
    children = {child.get("link") for child in root.findall("joint/child")}
    (name,) = (
        link.get("name", "") for link in root.findall("link") if link.get("name") not in children
    )
    return name


class _Peer:
    """The peers' process; `torques` (n, nv − 6) of the last batch of each."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.torques: dict[str, np.ndarray] = {}
        # Their libraries also print lines.
        self.versions = self._line("READY ")

    def batch(self, name: str) -> Batch:
        """Return the batch of one of `PEERS`."""

        def batch() -> np.ndarray:
            assert self._process.stdin is not None
            self._process.stdin.write(f"{name}\n")
            self._process.stdin.flush()
            answer = json.loads("{" + self._line("{"))
            self.torques[name] = np.array(answer["tau"])
            return np.array(answer["ns"])

        return batch

    def _line(self, beginning: str) -> str:
        """Return the rest of the next line that begins with `beginning`."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(beginning):
                return line.removeprefix(beginning).strip()
        raise UserError(f"benchmarks/peer.py ended with {self._process.wait()}; see above")


@contextmanager
def _peer(interpreter: Path, case: Path) -> Iterator[_Peer]:
    script = Path(__file__).with_name("peer.py")
    process = subprocess.Popen(
        [str(interpreter), "-I", "-X", "utf8", "-u", str(script), str(case)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=end_with_parent(),
    )
    with process:
        try:
            yield _Peer(process)
        finally:
            process.kill()


class _Posed:
    """A plant that takes each of the given states in turn and ignores the torques."""

    def __init__(self, states: States) -> None:
        self._states = states
        self._step = 0

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        raise NotImplementedError("its states are given")

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return self._states[self._step % len(self._states)]

    def contact_forces(self) -> dict[Foot, np.ndarray]:
        raise NotImplementedError("its states are given")

    def step(self, tau: np.ndarray, *, push: np.ndarray) -> None:
        self._step += 1


class _PosedRobot(RobotNode):
    """A robot in given states."""

    def __init__(self, robot: Robot, config: RunConfig, states: States) -> None:
        self._posed = _Posed(states)
        super().__init__(robot, config, Standing(robot), session=1)

    def _make_plant(self, robot: Robot) -> Plant:
        return self._posed


def _our_batches(robot: Robot, config: RunConfig, states: States) -> dict[str, Batch]:
    return {
        **{
            f"{controller.upper()} robot tick": _tick_batch(
                robot, dataclasses.replace(config, controller=controller), states
            )
            for controller in _CONTROLLERS
        },
        **_edge_batches(robot, dataclasses.replace(config, controller="la"), states),
    }


def _tick_batch(robot: Robot, config: RunConfig, states: States) -> Batch:
    """Measure, receive the answer to the state, command, record."""
    node = _PosedRobot(robot, config, states)
    edge = EdgeNode(robot, config, Standing(robot))
    log = RowLog(node.schema, complete=node.tick_row.complete)

    def tick() -> int:
        now_ns = node.tick * config.loop.period_ns
        _OTHER_WORK.fill(1)
        started = time.thread_time_ns()
        state = node.measure(now_ns)
        duration = time.thread_time_ns() - started
        edge.receive(state, now_ns)
        answer = edge.step()
        _OTHER_WORK.fill(1)
        started = time.thread_time_ns()
        if answer is not None and answer.data is not None:
            node.receive(Delivery(answer.data, None))
        node.advance(node.command(now_ns), log.row())
        return duration + time.thread_time_ns() - started

    return lambda: np.array([tick() for _ in states])


def _edge_batches(robot: Robot, config: RunConfig, states: States) -> dict[str, Batch]:
    """The edge's whole step, from bytes to bytes; and the solution and the projector alone."""
    motion = Standing(robot)
    edge, solver = (EdgeNode(robot, config, motion) for _ in range(2))
    robot_node, codec = _PosedRobot(robot, config, states), Codec(robot, config, motion)

    def next_message() -> tuple[bytes, int]:
        now_ns = robot_node.tick * config.loop.period_ns
        message = robot_node.measure(now_ns)
        robot_node.running = True
        robot_node.advance(robot_node.command(now_ns))
        return message, now_ns

    def step() -> int:
        message, now_ns = next_message()
        _OTHER_WORK.fill(1)
        started = time.thread_time_ns()
        edge.receive(message, now_ns)
        edge.step()
        return time.thread_time_ns() - started

    def solve() -> int:
        state = codec.decode_state(next_message()[0])
        _OTHER_WORK.fill(1)
        started = time.thread_time_ns()
        solver.solve(state)
        return time.thread_time_ns() - started

    return {
        "edge step for LA": lambda: np.array([step() for _ in states]),
        "edge: solution and A†": lambda: np.array([solve() for _ in states]),
    }


def _table(durations: dict[str, list[np.ndarray]]) -> list[str]:
    """A line for each of the project's steps, and for placo beside TSID, as ratios."""
    lines = [["", *(f"{cell} / {peer} step" for peer in PEERS for cell in ("p50", "p99"))]]
    for name, ours in durations.items():
        cells = []
        for peer in PEERS:
            ratio = Ratio.of(ours, durations[peer])
            cells += ["", ""] if name == peer else [ratio.p50_text, f"{ratio.p99:.2f}"]
        lines.append([name if name not in PEERS else f"{name} step", *cells])
    return aligned(lines, left=1)


def _torques(
    robot: Robot, config: RunConfig, states: States, torques: dict[str, np.ndarray]
) -> list[str]:
    """Distance of the peers' torques from those of the project's full QP. The problems are nearly
    the same.
    """
    full = WholeBodyController(robot, config, Standing(robot))
    mode = ContactMode.DOUBLE_SUPPORT
    ours = []
    for q, v in states:
        solution, b = full.solve(q, v, time_ns=0, mode=mode)
        assert solution.projector is not None
        y = solution.projector.apply(b)
        ours.append(recover_torque(full.model, full.stacks[mode].contacts, q, v, y))
    lines = []
    for peer in PEERS:
        apart = np.abs(torques[peer] - ours).max(axis=1)
        lines.append(
            f"torques of {peer} and ours are at most {np.median(apart):.2g} N m apart in half of "
            f"the states, {apart.max():.2g} N m in all, of {np.abs(ours).max():.0f} N m"
        )
    return lines
