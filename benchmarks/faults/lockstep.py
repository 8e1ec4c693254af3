"""Faults of link and sensors in lockstep trials: PR, LA and LC, standing and walking.

Cuts, outages and loss are settings of the link. Duplication, reordering and bit flips act on the
messages between the link and the node that receives them. Glitches act on the sensors' values, and
jumps and drifts on the estimate of the base.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.faults.cases import Case, Draw, Parameters
from experiments.lockstep import Lockstep, TrialResult
from shared.bus.base import Delivery, Inbox
from shared.config.config_file import load_config
from shared.config.robot_settings import RobotConfig
from shared.config.settings import RunConfig
from shared.motion.plan_frame import PlanFrame
from shared.robots import CATALOGUE, load_robot

_MS = 1_000_000
CONTROLLERS = ("lc", "la", "pr")
STANDING, WALKING = "balance", "walk"
# One trial in this number is played twice, and both have to be the same to the last bit.
_TWICE = 10
_RANK_DELIVERY = 0

# Turns a sent message into the arriving messages, each with its delay [ns].
Disturb = Callable[[Delivery], Iterator[tuple[int, Delivery]]]
# Changes a measured q (nq,) and v (nv,) in place, at a time of the task [ns].
Wrong = Callable[[np.ndarray, np.ndarray, int], None]


class FaultyLockstep(Lockstep):
    """A trial in which each message passes through `disturb` before a node receives it."""

    def __init__(self, config: RunConfig, *, disturb: Disturb) -> None:
        self._disturb = disturb
        super().__init__(config, all_active_sets=False)

    def _connect(self, robot: str) -> None:
        self._robot_inbox = _Disturbed(lambda delivery: self._arrive(delivery, self._take))
        super()._connect(robot)

    def _take(self, delivery: Delivery) -> None:
        Inbox.put(self._robot_inbox, delivery)

    def _edge_receives(self, delivery: Delivery) -> None:
        self._arrive(delivery, super()._edge_receives)

    def _arrive(self, delivery: Delivery, take: Callable[[Delivery], None]) -> None:
        for delay_ns, message in self._disturb(delivery):
            if delay_ns == 0:
                take(message)
            else:

                def later(message: Delivery = message) -> None:
                    take(message)

                self.at(self.clock.now_ns() + delay_ns, _RANK_DELIVERY, later)


class _Disturbed(Inbox):
    def __init__(self, arrive: Callable[[Delivery], None]) -> None:
        super().__init__()
        self._arrive = arrive

    def put(self, delivery: Delivery) -> None:
        self._arrive(delivery)


def flip_bits(data: bytes, rng: np.random.Generator, *, bits: int) -> bytes:
    """Return the bytes with `bits` of their bits flipped."""
    flipped = bytearray(data)
    for place in rng.integers(8 * len(flipped), size=bits):
        flipped[place // 8] ^= 1 << (place % 8)
    return bytes(flipped)


def play(case: Case) -> dict[str, Any]:
    """Play a trial, and return its outcome."""
    result = _trial(case)
    config = config_of(case)
    tau = result.schema.column(result.rows, "tau")
    limit = config.robot.torque_clamp * load_robot(config.robot.name).effort_limit
    outcome = {
        "fell": result.summary["fell"],
        "ended": result.summary["fell"] or result.summary["task_seconds"] == config.duration,
        "finite": bool(np.isfinite(tau).all()),
        "clamped": bool(np.all(np.abs(tau) <= limit + 1e-12)),
        "task_seconds": result.summary["task_seconds"],
        "refused": {way: result.summary["link"][way]["refused"] for way in ("uplink", "downlink")},
        "sensor_faults": result.summary.get("sensor_faults", {}),
        "base_estimate": result.summary.get("base_estimate", {}),
        "held": result.summary["commands"]["held"],
        "log_hash": result.summary["log_hash"],
    }
    if is_played_twice(case):
        outcome["same_again"] = _trial(case).summary["log_hash"] == outcome["log_hash"]
    return outcome


def is_played_twice(case: Case) -> bool:
    """Return whether a case is played twice, to compare both trials."""
    return case.number % _TWICE == 0


def config_of(case: Case) -> RunConfig:
    """Return the settings of a case's trial."""
    return load_config(None, {"seed": case.seed + case.number, **case.parameters["settings"]})


def _trial(case: Case) -> TrialResult:
    rng = case.rng()
    given = case.parameters
    trial = FaultyLockstep(config_of(case), disturb=_disturbance(case, rng))
    if case.fault == "glitch":
        _glitch(trial, given, rng)
    elif case.fault in LATER_DRAWS:
        _move_estimate(trial, given)
    with np.errstate(over="ignore", invalid="ignore"):
        return trial.run()


def _disturbance(case: Case, rng: np.random.Generator) -> Disturb:
    """Return the fault of the messages in a case; cuts and loss are the link's own."""
    given = case.parameters
    share = given.get("share", 0.0)

    def disturb(delivery: Delivery) -> Iterator[tuple[int, Delivery]]:
        hit = share > 0.0 and rng.random() < share
        if hit and case.fault == "reordering":
            yield int(rng.integers(given["within_ms"] * _MS)), delivery
        elif hit and case.fault == "bit flips":
            data = flip_bits(delivery.data, rng, bits=given["bits"])
            yield 0, Delivery(data, delivery.envelope)
        else:
            yield 0, delivery
            if hit and case.fault == "duplication":
                for _ in range(given["copies"]):
                    yield int(rng.integers(given["within_ms"] * _MS)), delivery

    return disturb


def disturb_sensors(trial: Lockstep, wrong: Wrong) -> None:
    """Let `wrong` change each measurement of a trial's robot in place."""
    sensors = trial.robot._sensors
    honest = sensors.measure

    def measure(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q, v = honest(q, v)
        wrong(q, v, trial.robot.time_ns)
        return q, v

    sensors.measure = measure  # type: ignore[method-assign]


def _glitch(trial: Lockstep, given: Parameters, rng: np.random.Generator) -> None:
    """Make a joint's sensor wrong by `by` [rad] for `ticks` ticks, at each of the times."""
    joint = int(rng.integers(load_robot(trial.config.robot.name).model.nv - 6))
    begins = [round(at * 1e3) for at in given["at"]]

    def wrong(q: np.ndarray, v: np.ndarray, time_ns: int) -> None:
        if any(begin <= time_ns // _MS < begin + given["ticks"] for begin in begins):
            q[7 + joint] += given["by"]

    disturb_sensors(trial, wrong)


def _move_estimate(trial: Lockstep, given: Parameters) -> None:
    """Move the frame of the base's estimate by `by`, (x, y, z [m], turn [rad]), at once or in each
    second from then on.
    """
    x, y, z, yaw = given["by"]

    def wrong(q: np.ndarray, v: np.ndarray, time_ns: int) -> None:
        part = time_ns * 1e-9 - given["at"]
        if part >= 0.0:
            part = part if given["each_second"] else 1.0
            q[:] = PlanFrame(part * x, part * y, part * yaw, part * z).in_world(q)

    disturb_sensors(trial, wrong)


def _trial_of(
    turn: int,
    rng: np.random.Generator,
    *,
    push: bool = True,
    standing: bool = False,
    seconds: float = 2.2,
) -> tuple[Parameters, Parameters]:
    """Return the parameters that every case has, and the settings in them."""
    # Every controller meets every fault, twice standing and once walking.
    controller = CONTROLLERS[turn % len(CONTROLLERS)]
    walks = not standing and turn // len(CONTROLLERS) % 3 == 2
    settings: Parameters = {
        "controller": controller,
        "task": WALKING if walks else STANDING,
        "duration": seconds + (0.8 if walks else 0.0),
        "link.network": f"constant:{int(rng.integers(2, 31))}ms",
    }
    pushed = push and not walks and rng.random() < 0.5
    axis = ("+y", "-y")[int(rng.integers(2))]
    settings["push"] = [f"100N@0.3s:0.2s:{axis}"] if pushed else []
    if not walks and turn % 8 == 7:
        name = settings["robot.name"] = sorted(CATALOGUE)[turn // 8 % len(CATALOGUE)]
        # The push of the default robot may be too strong for a smaller one.
        if name != RobotConfig.name:
            settings["push"] = []
    return {"controller": controller, "settings": settings}, settings


def _cut(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, settings = _trial_of(turn, rng)
    settings["link.outage"] = [f"cut@{int(rng.integers(100, 1500))}ms"]
    return parameters


def _outage(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, settings = _trial_of(turn, rng)
    # LA is promised to stand up to 0.4 s, outside a push.
    short = parameters["controller"] == "la"
    duration, start = int(rng.integers(50, 401 if short else 1200)), int(rng.integers(100, 1300))
    if short and settings["push"]:
        start = int(rng.integers(1200, 1500))
    settings["link.outage"] = [f"{duration}ms@{start}ms"]
    return parameters


def _holds(turn: int, rng: np.random.Generator) -> Parameters:
    """Outages so long that LA holds its joints."""
    parameters, settings = _trial_of(turn, rng, push=False, standing=True, seconds=6.0)
    starts = (300, 2200, 4100)
    settings["link.outage"] = [f"{int(rng.integers(700, 1300))}ms@{start}ms" for start in starts]
    return parameters


def _loss(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, settings = _trial_of(turn, rng)
    settings["link.loss"] = round(float(rng.uniform(0.02, 0.5)), 3)
    return parameters


def _duplication(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng)
    copies, within = int(rng.integers(1, 4)), int(rng.integers(1, 60))
    share = round(float(rng.uniform(0.1, 1.0)), 3)
    return {**parameters, "copies": copies, "within_ms": within, "share": share}


def _reordering(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng)
    share, within = round(float(rng.uniform(0.1, 1.0)), 3), int(rng.integers(2, 30))
    return {**parameters, "within_ms": within, "share": share}


def _bit_flips(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng)
    share, bits = round(float(rng.uniform(0.01, 0.3)), 3), int(rng.integers(1, 9))
    return {**parameters, "bits": bits, "share": share}


def _rounded(numbers: Iterable[float]) -> list[float]:
    return [round(float(each), 3) for each in numbers]


def _glitches(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng)
    by = float(rng.choice([50.0, -50.0, 3.0, -1.0, 0.6, -0.45, float("1e6")]))
    at = sorted(_rounded(rng.uniform(0.1, 2.0, 3)))
    return {**parameters, "by": by, "ticks": int(rng.integers(1, 4)), "at": at}


def _jump(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng)
    size = float(rng.choice([0.03, 0.2, 1.0, 30.0]))
    by = [*(size * rng.uniform(-1.0, 1.0, 2)), rng.uniform(-0.3, 0.3), rng.uniform(-3.0, 3.0)]
    at = round(float(rng.uniform(0.4, 1.2)), 3)
    return {**parameters, "by": _rounded(by), "at": at, "each_second": False}


def _drift(turn: int, rng: np.random.Generator) -> Parameters:
    parameters, _ = _trial_of(turn, rng, push=False, standing=True, seconds=5.0)
    angle, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0.02, 0.06)
    by = [speed * np.cos(angle), speed * np.sin(angle), 0.0, rng.uniform(-0.1, 0.1)]
    return {**parameters, "by": _rounded(by), "at": 0.5, "each_second": True}


# The faults that came later: `cases.LATER`.
LATER_DRAWS: dict[str, Draw] = {"jump of the estimate": _jump, "drift of the estimate": _drift}
DRAWS: dict[str, Draw] = {
    "cut": _cut,
    "outage": _outage,
    "repeated holds": _holds,
    "loss": _loss,
    "duplication": _duplication,
    "reordering": _reordering,
    "bit flips": _bit_flips,
    "glitch": _glitches,
}
