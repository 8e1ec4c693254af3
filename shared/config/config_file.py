"""Read a `RunConfig` from a TOML file and overrides, and write one.

An unknown key or a value of the wrong type is a `ConfigError` that names the valid ones.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from shared.config.extensions import TABLES
from shared.config.robot_settings import RobotConfig
from shared.config.settings import SETTINGS, RunConfig
from shared.errors import ConfigError, one_of
from shared.robots import description_of
from shared.toml_file import read_toml


def load_config(path: Path | str | None, overrides: dict[str, Any] | None = None) -> RunConfig:
    """Return the settings of a TOML file (None: the defaults), with dotted-key overrides on top.

    Keys under `[versions]`, which a run writes into its own copy, are ignored. A file that the
    settings name, of Python or of a robot, is relative to the TOML file, and in overrides to the
    current folder.
    """
    table: dict[str, Any] = {}
    if path is not None:
        table = read_toml(Path(path), what="config")
        table.pop("versions", None)
        _locate_extensions(table, Path(path).parent)
    for key, value in (overrides or {}).items():
        _set_dotted(table, key, value)
    _locate_extensions(table, Path.cwd())
    try:
        config = _build(RunConfig, _merged(_defaults(table), table), where="")
    except ConfigError:
        _check_robots_settings(table)
        raise
    if config.walks and "duration" not in table:
        config = dataclasses.replace(config, duration=_walk_duration(config))
    return config


def _walk_duration(config: RunConfig) -> float:
    """Duration of a walk [s]. One to a goal has time for half as many steps again."""
    walk = config.walk
    if config.task == "walk":
        return walk.duration
    goal = walk.place
    way = math.hypot(goal.x, goal.y) / max(abs(walk.step_length), _SHORTEST_STEP)
    way += abs(goal.y) / _SIDEWAYS_OF_A_STEP + abs(goal.yaw) / _TURN_OF_A_STEP
    steps = 6 + math.ceil(1.5 * way)
    return dataclasses.replace(walk, steps=steps).duration


# The mean advance of a step to a goal: forward, sideways, turn [m, m, rad].
_SHORTEST_STEP, _SIDEWAYS_OF_A_STEP, _TURN_OF_A_STEP = 0.05, 0.1, 0.15


def _locate_extensions(table: dict[str, Any], folder: Path) -> None:
    """Give references to files in `folder` their whole path, in place."""
    for key, absolute in _LOCATED.items():
        *sections, name = key.split(".")
        within: Any = table
        for section in sections:
            within = within.get(section) if isinstance(within, dict) else None
        if isinstance(within, dict) and isinstance(within.get(name), str):
            within[name] = absolute(within[name], folder)


def _absolute_ground(value: str, folder: Path) -> str:
    """Return the description of a ground, with the whole path of a file."""
    return str((folder / value).resolve()) if value.endswith(".npz") else value


# The settings that may name a file, each with the function that gives it its whole path.
_LOCATED: dict[str, Callable[[str, Path], str]] = {
    **{key: names.absolute for key, names in TABLES.items()},
    "ground": _absolute_ground,
    "plant.unknown_ground": _absolute_ground,
}


def _names_in(table: dict[str, Any]) -> tuple[str, str] | None:
    """The task and the robot of a table, or None if one is no text, which `_build` refuses."""
    task, robot = table.get("task", RunConfig.task), table.get("robot", {})
    name = robot.get("name", RobotConfig.name) if isinstance(robot, dict) else None
    return (task, name) if isinstance(task, str) and isinstance(name, str) else None


def _defaults(table: dict[str, Any]) -> dict[str, Any]:
    """Return the defaults that the task, then the robot, then steps by touch of `table` change."""
    if (names := _names_in(table)) is None:
        return {}
    task, robot = names
    defaults = _merged(_PRESETS.get(task, {}), description_of(robot).settings.get(task, {}))
    stepping = table.get("stepping", {})
    if isinstance(stepping, dict) and stepping.get("mode", "off") != "off":
        defaults = _merged(defaults, _STEPS)
    return defaults


def _check_robots_settings(table: dict[str, Any]) -> None:
    """Raise a `ConfigError` that names the robot file if its settings alone are at fault."""
    if (names := _names_in(table)) is None:
        return
    task, robot = names
    description = description_of(robot)
    alone = {**_defaults(table), "task": task}
    try:
        _build(RunConfig, alone, where="")
    except ConfigError as error:
        key = str(error).partition(":")[0].partition(".")[0]
        if key in description.settings.get(task, {}):
            raise ConfigError(f"robot {description.name}: settings.{task}.{error}") from None


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        both = isinstance(value, dict) and isinstance(under, dict)
        merged[key] = _merged(below[key], value) if both else value
    return merged


# The defaults that a task changes; the robot, a file and flags come on top.
_WALK: dict[str, Any] = {
    "push": [],
    "sensors": {"joint_position_noise": 1e-3},
    "wbc": {
        "gains": {
            "com": 20.0,
            "base_orientation": 60.0,
            "contact_damping": 30.0,
        },
        "weights": {"base_orientation": 1.0},
    },
    "wire": {"projector_dtype": "float32"},
}
# A lower CoM lets the legs reach further and climb. The posture of standing must give way to it.
_GO: dict[str, Any] = {
    "wbc": {"weights": {"com": 10.0}},
    "walk": {"step_length": 0.35, "swing_height": 0.07, "com_lowering": 0.03},
}
_PRESETS: dict[str, dict[str, Any]] = {"walk": _WALK, "go": _merged(_WALK, _GO)}
# The defaults that steps by touch change, for every task and robot. With a lower weight of the CoM,
# a stale factorisation trades the CoM against the posture of standing.
_STEPS: dict[str, Any] = {
    "wbc": {
        "weights": {"com": 100.0, "swing_foot": 10.0},
        "limits": {"torque": True, "position": True},
        "balance": {"law": "dcm"},
    },
    "correction": {"on_board_budget": 0.3},
}


def dump_config(config: RunConfig, *, versions: dict[str, str]) -> str:
    """Return the configuration as TOML, which `load_config` reads back to an equal value."""
    return tomli_w.dumps({**settings_table(config), "versions": versions})


def settings_table(config: RunConfig) -> dict[str, Any]:
    """Return all settings as the table of a settings file."""
    return dataclasses.asdict(config)


def differing(table: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a table that differ from those of `default`, as a table."""
    found = {}
    for key, value in table.items():
        if isinstance(value, dict):
            value = differing(value, default[key])
            if value:
                found[key] = value
        elif value != default[key]:
            found[key] = value
    return found


def _set_dotted(table: dict[str, Any], key: str, value: Any) -> None:
    *sections, name = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise ConfigError(f"{section}: expected a table of settings, got {table!r}")
    table[name] = value


_T = TypeVar("_T")
# A study builds the settings of thousands of trials: the types of a class are read once.
_type_hints = functools.cache(typing.get_type_hints)


def _build(cls: type[_T], table: Any, *, where: str) -> _T:
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: expected a table of settings, got {table!r}")
    hints = _type_hints(cls)  # type: ignore[arg-type]
    names = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        dotted = f"{where}.{key}" if where else key
        if key not in names:
            raise ConfigError(f"{dotted}: {_unknown(key, names)}")
        values[key] = _convert(hints[key], value, where=dotted)
    return cls(**values)


def _unknown(key: str, names: list[str]) -> str:
    elsewhere = [known for known in SETTINGS if known.rpartition(".")[2] == key]
    if elsewhere:
        return f"expected some of {', '.join(names)}, got {key!r}; did you mean {elsewhere[0]}?"
    return one_of(names, key, expected="some of")


def _convert(hint: Any, value: Any, *, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, where=where)
    if isinstance(hint, types.GenericAlias):  # tuple[str, ...]
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
            raise ConfigError(f"{where}: expected a list of strings, got {value!r}")
        return tuple(value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise ConfigError(f"{where}: expected {hint.__name__}, got {value!r}")
    return value
