"""Your own plant: the robot of somebody else's MuJoCo model, that of `wbc new plant`.

    ./deploy/python -m examples.own_plant

The model has another order of joints than the robot, and gears.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from robot_node.plant import from_mujoco, to_mujoco
from shared.config.config_file import load_config
from shared.config.robot_settings import PlantConfig
from shared.robots import Foot, Robot

FOLDER, MODEL = Path(__file__).parent, "experiments/templates/plant/NAME/NAME.xml"


class MjcfPlant:
    def __init__(self, robot: Robot, config: PlantConfig, *, timestep: float) -> None:
        self._model = model = mujoco.MjModel.from_xml_path(str(FOLDER.parent / MODEL))
        model.opt.timestep, self._data = timestep, mujoco.MjData(model)
        joints = [model.joint(name).id for name in list(robot.model.names)[2:]]
        self._q = [*range(7), *model.jnt_qposadr[joints]]
        self._v = [*range(6), *model.jnt_dofadr[joints]]
        self._motors = [list(model.actuator_trnid[:, 0]).index(joint) for joint in joints]
        self.set_state(robot.q_standing, np.zeros(robot.model.nv))

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._q], self._data.qvel[self._v] = to_mujoco(q, v)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return from_mujoco(self._data.qpos[self._q], self._data.qvel[self._v])

    def contact_forces(self) -> dict[Foot, np.ndarray]:
        mujoco.mj_rnePostConstraint(self._model, self._data)
        return {foot: self._data.body(f"{foot.value}_foot").cfrc_ext[3:].copy() for foot in Foot}

    def step(self, tau: np.ndarray, *, push: np.ndarray) -> None:
        self._data.ctrl[self._motors] = tau / self._model.actuator_gear[self._motors, 0]
        self._data.xfrc_applied[1, :3] = push  # on the first body, the base
        mujoco.mj_step(self._model, self._data)


def main(duration: float = 3.0) -> TrialResult:
    settings = {"robot.name": str(FOLDER / "biped.toml"), "plant.kind": f"{__file__}:MjcfPlant"}
    settings |= {"controller": "lc", "link.network": "constant:200ms"}
    result = Lockstep(load_config(None, {**settings, "duration": duration})).run()
    print("falls" if result.summary["fell"] else "stands")
    return result


if __name__ == "__main__":
    main()
