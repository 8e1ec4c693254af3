"""Check a robot: its files, its standing posture, and three trials in lockstep. Draw it.

Each failed check says what to change.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from experiments.trial import write_run
from shared.config.config_file import load_config
from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.errors import ConfigError, UserError
from shared.output.fall import fall_in_words
from shared.process.cli import EXIT_FELL, EXIT_STANDING
from shared.process.entry import EXIT_ERROR
from shared.robots import ROBOTS, Robot, RobotDescription, description_of
from shared.robots.derived import derived_settings
from shared.robots.loading import checks, load
from shared.robots.meshes import mesh_files
from shared.robots.standing import leg_reach, standing_torques

_NO_PICTURE = "none"
# Largest CoM error of a robot that stands by itself [m].
_STILL = 0.01


@dataclass(frozen=True)
class Play:
    """A trial of the check: its settings, and what to change if the robot falls."""

    name: str
    settings: dict[str, Any]
    remedy: str


_LINK = {"controller": "la", "link.network": "constant:10ms"}
PLAYS = (
    Play(
        "stands without a push",
        _LINK | {"push": [], "sensors.joint_position_noise": 0.0, "duration": 2.0},
        "lower wbc.weights.force or wbc.gains.contact_damping in settings.balance, or bend the "
        "knees less",
    ),
    Play(
        "takes its push",
        _LINK | {"duration": 3.0},
        "set a smaller push in settings.balance, a larger sole or a wider stance",
    ),
    Play(
        "walks",
        _LINK | {"task": "walk", "walk.steps": 4, "walk.end_duration": 1.0},
        "set a smaller walk.step_length, another walk.step_duration or a lower "
        "wbc.gains.contact_damping in settings.walk",
    ),
)


def add_robot_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `robot check`."""
    parser.add_argument(
        "robot", metavar="ROBOT", help=f"a robot file, or one of {', '.join(ROBOTS.own)}"
    )
    parser.add_argument(
        "--no-play", action="store_true", help="check only the files, without trials"
    )
    parser.add_argument(
        "--picture",
        metavar="FILE.png",
        help="picture at the end of the walk (default NAME.png; none: no picture)",
    )


def run_robot_check(arguments: argparse.Namespace) -> int:
    """Print a line for each check. Return 0 if all pass, 2 for a faulty file, 3 after a fall."""
    name = ROBOTS.absolute(arguments.robot, Path.cwd())
    description = description_of(name)
    faults = 0
    for check, found in (*_checks_of_files(name, description), *checks(description)):
        _say(check, *found)
        faults += len(found)
    if faults:
        return EXIT_ERROR
    robot = load(description)
    print(in_words(robot))
    print("settings by the rule of mass and geometry:")
    print(rule_in_toml(robot))
    if arguments.no_play:
        return EXIT_STANDING
    fallen, result = False, None
    for play in PLAYS:
        try:
            config, result = _played(name, play)
        except ConfigError as error:
            _say(play.name, str(error))
            return EXIT_ERROR
        problem = _problem(config, result, play)
        _say(f"{play.name}: {_measured(result)}", *problem)
        fallen |= bool(problem)
    if arguments.picture != _NO_PICTURE and result is not None:
        out = Path(arguments.picture or f"{description.name}.png")
        print(_drawn(config, result, out))
    return EXIT_FELL if fallen else EXIT_STANDING


def _checks_of_files(name: str, description: RobotDescription) -> Iterator[tuple[str, list[str]]]:
    """Yield the checks that need more than the robot: its settings, and the meshes of the view."""
    faults = []
    for task in description.settings:
        try:
            TASKS.check(task)
            load_config(None, {"robot.name": name, "task": task})
        except ConfigError as error:
            text = str(error).removeprefix(f"robot {description.name}: ")
            faults.append(text if text.startswith("settings.") else f"settings.{task}: {text}")
    yield "settings that tasks have", faults
    meshes = mesh_files(description.urdf, description.packages, kind="visual", what="urdf")
    folders = " or ".join(map(str, description.packages))
    yield (
        "meshes of the view",
        [
            f"expected the mesh {mesh!r} of link {link} in {folders}, got no such file; try "
            "packages, the folders of packages, or leave its <visual> out"
            for link, mesh, path in meshes
            if path is None
        ],
    )


def in_words(robot: Robot) -> str:
    """Return the numbers of a robot that its settings depend on, in a line."""
    used = np.abs(standing_torques(robot)) / robot.effort_limit
    joint = robot.model.names[2 + int(used.argmax())]
    soles = "; ".join(
        f"{sole.side.value} sole x {sole.x[0]:.4f} … {sole.x[1]:.4f}, y {sole.y[0]:.4f} … "
        f"{sole.y[1]:.4f} m"
        for sole in robot.soles
    )
    return (
        f"{robot.name}: {robot.mass:.2f} kg, {len(robot.effort_limit)} motors, legs reach "
        f"{leg_reach(robot):.2f} m, standing takes {used.max():.2f} of the effort limit ({joint}); "
        f"{soles}"
    )


def rule_in_toml(robot: Robot) -> str:
    """Return the settings of `derived_settings` as a part of a robot file."""
    lines = []
    for task, settings in derived_settings(robot).items():
        lines.append(f"[settings.{task}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    return "\n".join(f"      {line}" for line in lines)


def _played(name: str, play: Play) -> tuple[RunConfig, TrialResult]:
    config = load_config(None, {"robot.name": name, **play.settings})
    return config, Lockstep(config).run()


def _problem(config: RunConfig, result: TrialResult, play: Play) -> list[str]:
    """Return the faults of a trial."""
    if result.summary["fell"]:
        why = fall_in_words(result.summary["fall"], controller=config.controller)
        return [f"expected a robot that stands, got a fall: {why}; {play.remedy}"]
    if not config.push and config.task == "balance" and _largest_error(result) > _STILL:
        return [
            f"expected a CoM error of at most {100 * _STILL:g} cm, got "
            f"{100 * _largest_error(result):.1f}; {play.remedy}"
        ]
    return []


def _largest_error(result: TrialResult) -> float:
    return float(result.schema.column(result.rows, "com_error_m").max())


def _measured(result: TrialResult) -> str:
    return f"largest CoM error {100 * _largest_error(result):.1f} cm"


def _drawn(config: RunConfig, result: TrialResult, out: Path) -> str:
    """Draw the end of a trial. Return a line about the picture, or why there is none."""
    # Imported here: rerun takes long to load.
    from viewer.snapshot import picture

    with tempfile.TemporaryDirectory() as folder:
        write_run(Path(folder), config, result)
        try:
            picture([Path(folder)], out)
        except UserError as error:
            return f"skipped the picture: {error}"
    return f"picture: {out}"


def _say(check: str, *faults: str) -> None:
    print(f"{'FAIL' if faults else 'ok':4}  {check}", *faults, sep="\n      ", flush=True)
