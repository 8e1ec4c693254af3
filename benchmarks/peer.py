"""A complete step of TSID and of placo, as a process in a separate environment.

`python -I benchmarks/peer.py CASE.npz` reads the robot, the tasks and the states from CASE.npz,
which `benchmarks.peers` has written. It prints READY and the versions. Then it prints a line of
JSON for each name that it reads, `tsid` or `placo`: the processor time [ns] of the step at every
state, and the torques. It imports nothing of this project, whose packages are other versions of the
same ones.
"""

from __future__ import annotations

import gc
import importlib.metadata
import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import placo
import tsid.tsid_pywrap as tsid

SIDES = ("left", "right")
# Greatest force of a contact [N], which TSID needs; no contact of such a robot reaches it.
MAX_FORCE = 1e4

# Written before each step: the rest of a loop leaves little in the caches.
OTHER_WORK = np.zeros(2**20, dtype=np.uint8)

Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


def main() -> None:
    case = dict(np.load(sys.argv[1]))
    steps: dict[str, Step] = {"tsid": TsidStep(case), "placo": PlacoStep(case)}
    names = ("tsid", "placo", "pin", "eiquadprog")
    print("READY", ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names))
    gc.disable()
    for line in sys.stdin:
        print(json.dumps(batch(steps[line.strip()], case["q"], case["v"])), flush=True)


def batch(step: Step, q: np.ndarray, v: np.ndarray) -> dict[str, Any]:
    """Take a step at every state. Return the processor times and the torques."""
    durations, torques = [], []
    for k in range(len(q)):
        OTHER_WORK.fill(k)
        started = time.thread_time_ns()
        tau = step(q[k], v[k])
        durations.append(time.thread_time_ns() - started)
        torques.append(tau.tolist())
    return {"ns": durations, "tau": torques}


class TsidStep:
    """Rigid contacts as equalities, one force per corner of a sole, eiquadprog-fast."""

    def __init__(self, case: dict[str, Any]) -> None:
        robot = tsid.RobotWrapper(
            str(case["urdf"]), pin.StdVec_StdString(), pin.JointModelFreeFlyer(), False
        )
        check_joints(robot.model(), case)
        self._formulation = tsid.InverseDynamicsFormulationAccForce("tsid", robot, False)
        self._formulation.computeProblemData(0.0, case["q_standing"], np.zeros(robot.nv))
        contacts = [self._contact(robot, case, side) for side in SIDES]
        for contact in contacts:
            self._formulation.addRigidContact(contact, float(case["force_weight"]), 1.0, False)
        tasks = self._tasks(robot, case)
        for task, weight in tasks:
            self._formulation.addMotionTask(task, weight, 1, 0.0)
        # The formulation does not own its parts.
        self._kept = robot, contacts, tasks
        self._solver = tsid.SolverHQuadProgFast("eiquadprog-fast")
        formulation = self._formulation
        self._solver.resize(formulation.nVar, formulation.nEq, formulation.nIn)

    def __call__(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        solution = self._solver.solve(self._formulation.computeProblemData(0.0, q, v))
        tau: np.ndarray = self._formulation.getActuatorForces(solution)
        return tau

    def _contact(self, robot: Any, case: dict[str, Any], side: str) -> Any:
        corners = case["corners"]
        contact = tsid.Contact6d(
            side,
            robot,
            f"{side}_sole",
            corners.T,
            np.array([0.0, 0.0, 1.0]),
            float(case["friction"]),
            float(case["min_normal_force"]) * len(corners),
            MAX_FORCE,
        )
        contact.setKp(np.zeros(6))
        contact.setKd(np.full(6, float(case["contact_damping"])))
        contact.setRegularizationTaskWeightVector(np.sqrt(case["wrench_weights"]))
        frame = robot.model().getFrameId(f"{side}_sole")
        contact.setReference(robot.framePosition(self._formulation.data(), frame))
        return contact

    @staticmethod
    def _tasks(robot: Any, case: dict[str, Any]) -> list[tuple[Any, float]]:
        com = tsid.TaskComEquality("com", robot)
        com.setReference(tsid.TrajectoryEuclidianConstant("", case["com"]).computeNext())
        base = tsid.TaskSE3Equality("base", robot, str(case["base_frame"]))
        base.setMask(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
        placement = pin.SE3(case["world_from_base"], np.zeros(3))
        base.setReference(tsid.TrajectorySE3Constant("", placement).computeNext())
        posture = tsid.TaskJointPosture("posture", robot)
        posture.setReference(tsid.TrajectoryEuclidianConstant("", case["posture"]).computeNext())
        tasks = {"com": (com, 3), "base": (base, 6), "posture": (posture, robot.nv - 6)}
        for name, (task, size) in tasks.items():
            kp = float(case[f"{name}_kp"])
            task.setKp(np.full(size, kp))
            task.setKd(np.full(size, 2.0 * math.sqrt(kp)))
        return [(task, float(case[f"{name}_weight"])) for name, (task, _) in tasks.items()]


class PlacoStep:
    """Contacts as equalities, one wrench per sole with its centre of pressure in the rectangle."""

    def __init__(self, case: dict[str, Any]) -> None:
        self._robot = placo.RobotWrapper(str(case["urdf"]), placo.Flags.ignore_collisions)
        check_joints(self._robot.model, case)
        self._robot.state.q = case["q_standing"]
        self._robot.update_kinematics()
        self._solver = placo.DynamicsSolver(self._robot)
        self._solver.torque_cost = 0.0
        for side in SIDES:
            self._add_contact(case, side)
        com = self._solver.add_com_task(case["com"])
        base = self._solver.add_orientation_task(str(case["base_frame"]), case["world_from_base"])
        posture = self._solver.add_joints_task()
        joints = zip(case["joints"].tolist(), case["posture"].tolist(), strict=True)
        posture.set_joints(dict(joints))
        for name, task in (("com", com), ("base", base), ("posture", posture)):
            task.configure(name, "soft", float(case[f"{name}_weight"]))
            task.kp = float(case[f"{name}_kp"])
            task.kd = 2.0 * math.sqrt(task.kp)

    def __call__(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        self._robot.state.q, self._robot.state.qd = q, v
        self._robot.update_kinematics()
        tau: np.ndarray = self._solver.solve().tau[6:]
        return tau

    def _add_contact(self, case: dict[str, Any], side: str) -> None:
        frame = f"{side}_sole"
        sole = self._solver.add_frame_task(frame, self._robot.get_T_world_frame(frame))
        sole.configure(side, "hard", 1.0)
        for task in (sole.position(), sole.orientation()):
            task.kp, task.kd = 0.0, float(case["contact_damping"])
        contact = self._solver.add_planar_contact(sole)
        contact.length, contact.width, _ = np.ptp(case["corners"], axis=0).tolist()
        contact.mu = float(case["friction"])
        weights = float(case["force_weight"]) * case["wrench_weights"]
        contact.weight_forces, contact.weight_tangentials = float(weights[0]), 0.0
        contact.weight_moments = float(weights[3:].mean())


def check_joints(model: Any, case: dict[str, Any]) -> None:
    """Check that the joints are those of the states, in the same order. Exit otherwise."""
    found, expected = list(model.names)[2:], case["joints"].tolist()
    if found != expected:
        sys.exit(f"expected the joints {', '.join(expected)}, got {', '.join(found)}")


if __name__ == "__main__":
    main()
