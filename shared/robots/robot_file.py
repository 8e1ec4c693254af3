"""Reader of robot files: TOML files with all that the project needs about a robot.

    urdf = "mine.urdf"              # relative to this file, or package://NAME/path.
    srdf = "mine.srdf"              # if the posture is a state in it.
    packages = ["../.."]            # folders of packages, also of meshes.
    leg_radii = [0.07, 0.05]        # thigh and shank [m].

    [posture]
    state = "half_sitting"          # a group state of the SRDF. Or, in its place:
    angles = { knee = 0.6 }         # joints [rad], 0 for the others.
    base = [0.0, 0.0, 0.0]          # with angles: roll, pitch, yaw of the base [rad].

    [feet.left]                     # and feet.right.
    joint = "left_ankle_roll"       # or frame = "left_sole", a link.
    translation = [0.0, 0.0, -0.05] # of the sole frame in the joint's frame [m].
    rotation = [0.0, 0.0, 0.0]      # roll, pitch, yaw [rad].
    sole = { x = [-0.1, 0.1], y = [-0.05, 0.05] }   # [m], or "collision".

    [settings.walk]                 # this robot's defaults for a task.
    walk.step_length = 0.15

`package://example-robot-data` is the installed package of that name. The robot has the file's name.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shared.errors import ConfigError, one_of
from shared.robots.description import (
    Foot,
    FootDescription,
    Posture,
    RobotDescription,
    Sole,
    data_folder,
)
from shared.toml_file import read_toml

_PACKAGE = "package://"
# The name is a part of the keys on the link.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_KEYS = ("urdf", "srdf", "packages", "leg_radii", "posture", "feet", "settings")
_PLACES = ("urdf", "srdf", "packages")


def read_robot(path: Path) -> RobotDescription:
    """Return the content of a robot file.

    Raise `ConfigError`, with the key, for an unknown key and for a missing or unusable value.
    """
    what = f"robot {path.stem}"
    if not _NAME.fullmatch(path.stem):
        raise ConfigError(
            f"robot: expected a file name of letters, digits, _, . and -, got {path.name!r}"
        )
    top = _Table(read_toml(path, what="robot"), what=what, keys=_KEYS)
    packages = tuple((path.parent / each).resolve() for each in top.texts("packages"))
    for folder in packages:
        if not folder.is_dir():
            raise top.error("packages", "folders", f"{folder}, which is none")
    packages = (*packages, path.parent.resolve(), data_folder())
    feet = top.table("feet", keys=tuple(Foot), required=True)
    settings = top.table("settings")
    return RobotDescription(
        name=path.stem,
        urdf=_located(top.text("urdf", required=True), path, packages, what=f"{what}: urdf"),
        srdf=_located(top.text("srdf"), path, packages, what=f"{what}: srdf"),
        packages=packages,
        posture=_posture(top),
        feet=(_foot(feet, Foot.LEFT), _foot(feet, Foot.RIGHT)),
        leg_radii=top.pair("leg_radii", least=0.0) if top.has("leg_radii") else None,
        settings={task: settings.table(task).content for task in settings.content},
        stated=_stated(top.content),
    )


def _posture(top: _Table) -> Posture:
    table = top.table("posture", keys=("state", "angles", "base"), required=True)
    if table.has("state") == table.has("angles"):
        raise table.error("", "either state or angles", "both" if table.has("state") else "neither")
    if table.has("state"):
        if table.has("base"):
            raise table.error("base", "no base beside a state, which the SRDF has", "one")
        if not top.has("srdf"):
            raise top.error("srdf", "the file of the posture's state", "none")
        return Posture(state=table.text("state", required=True))
    angles = table.table("angles")
    return Posture(
        angles={joint: angles.number(joint) for joint in angles.content},
        base=table.vector("base"),
    )


def _foot(feet: _Table, side: Foot) -> FootDescription:
    keys = ("joint", "frame", "translation", "rotation", "sole")
    table = feet.table(side.value, keys=keys, required=True)
    if table.has("joint") == table.has("frame"):
        raise table.error("", "either joint or frame", "both" if table.has("joint") else "neither")
    sole = None
    if table.content.get("sole") != "collision":
        rectangle = table.table("sole", keys=("x", "y"), required=True, other="collision")
        sole = Sole(side, rectangle.pair("x"), rectangle.pair("y"))
    return FootDescription(
        side=side,
        sole=sole,
        joint=table.text("joint"),
        frame=table.text("frame"),
        translation=table.vector("translation"),
        rotation=table.vector("rotation"),
    )


def _located(text: str, file: Path, packages: tuple[Path, ...], *, what: str) -> Any:
    """The path for a text, None for an empty text; `ConfigError` if there is no file."""
    if not text:
        return None
    inside = text.removeprefix(_PACKAGE)
    folders = packages if inside != text else (file.parent,)
    for folder in folders:
        if (folder / inside).is_file():
            return (folder / inside).resolve()
    raise ConfigError(
        f"{what}: expected a file in {' or '.join(map(str, folders))}, got {text!r}"
        + ("; try packages, the folders of packages" if inside != text else "")
    )


def _stated(content: Mapping[str, Any]) -> str:
    kept = {key: value for key, value in content.items() if key not in _PLACES}
    return json.dumps(kept, sort_keys=True)


class _Table:
    """A table of a robot file, whose values are taken by type and key."""

    def __init__(
        self, content: dict[str, Any], *, what: str, keys: tuple[str, ...] = (), where: str = ""
    ) -> None:
        self.content = content
        self._what = what
        self._where = where
        for key in content:
            if keys and key not in keys:
                raise ConfigError(f"{self._key(key)}: {one_of(keys, key, expected='some of')}")

    def has(self, key: str) -> bool:
        return key in self.content

    def error(self, key: str, expected: str, got: object) -> ConfigError:
        return ConfigError(f"{self._key(key)}: expected {expected}, got {got}")

    def text(self, key: str, *, required: bool = False) -> str:
        value = self.content.get(key, "")
        if not isinstance(value, str) or (required and not value):
            raise self.error(key, "a text", repr(value) if key in self.content else "none")
        return value

    def texts(self, key: str) -> list[str]:
        value = self.content.get(key, [])
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise self.error(key, "a list of texts", repr(value))
        return value

    def number(self, key: str) -> float:
        return self._numbers(key, [self.content[key]], 1, "a finite number")[0]

    def pair(self, key: str, *, least: float = -math.inf) -> tuple[float, float]:
        """Two numbers: the ends of an interval, or two lengths of at least `least`."""
        lengths = least > -math.inf
        expected = "two lengths [m]" if lengths else "two numbers, the smaller one first"
        a, b = self._numbers(key, self.content.get(key), 2, expected)
        if min(a, b) < least or (a >= b and not lengths):
            raise self.error(key, expected, repr(self.content[key]))
        return a, b

    def vector(self, key: str) -> tuple[float, float, float]:
        value = self.content.get(key, [0.0, 0.0, 0.0])
        x, y, z = self._numbers(key, value, 3, "three numbers")
        return x, y, z

    def table(
        self,
        key: str,
        *,
        keys: tuple[str, ...] = (),
        required: bool = False,
        other: str = "",
    ) -> _Table:
        value = self.content.get(key, {})
        if not isinstance(value, dict) or (required and not value):
            expected = f"a table of {', '.join(keys)}" + (f", or {other!r}" if other else "")
            raise self.error(key, expected, repr(value) if key in self.content else "none")
        where = f"{self._where}.{key}" if self._where else key
        return _Table(value, what=self._what, keys=keys, where=where)

    def _numbers(self, key: str, value: Any, count: int, expected: str) -> list[float]:
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(isinstance(each, int | float) for each in value)
            or any(isinstance(each, bool) or not math.isfinite(each) for each in value)
        ):
            raise self.error(
                key, expected, repr(self.content[key]) if key in self.content else "none"
            )
        return [float(each) for each in value]

    def _key(self, key: str) -> str:
        dotted = ".".join(part for part in (self._where, key) if part)
        return f"{self._what}: {dotted}" if dotted else self._what
