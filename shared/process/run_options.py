"""The options of a run: a flag for each setting that has one, and the settings that they give."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from shared.config.config_file import load_config
from shared.config.quantities import parse_duration_ns, parse_seconds
from shared.config.setting import Setting
from shared.config.settings import SETTINGS, RunConfig
from shared.errors import ConfigError
from shared.extensions import Names

_FLAGGED = {key: each for key, each in SETTINGS.items() if each.flag}
_VIEW = "view"
_ASKS_FOR_HELP = {"-h", "--help"}


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a run. Each overrides the configuration file."""
    group = parser.add_argument_group("the run (flags override --config)")
    group.add_argument("--config", metavar="FILE.toml", help="settings; see docs/configuration.md")
    walk = parser.add_argument_group("the walk (with --task walk or go)")
    for key, each in _FLAGGED.items():
        if key != _VIEW:
            _add_flag(walk if key.startswith("walk.") else group, each)
    walk.add_argument(
        "--on-board-delay",
        metavar="25ms",
        help="time from a state to its full QP's solution on board (Table III: the link's delay)",
    )


def add_view_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for the live view."""
    _add_flag(parser, SETTINGS[_VIEW])


def _add_flag(group: argparse._ActionsContainer, setting: Setting) -> None:
    text = setting.help + (f" [{setting.unit}]" if setting.unit else "")
    if isinstance(setting.choices, Names):
        # To find the names of installed packages takes long.
        names = setting.choices.names() if _ASKS_FOR_HELP & set(sys.argv) else setting.choices.own
        text += f"; one of {', '.join(names)}, {setting.choices.forms}"
    elif setting.words:
        text += f"; one of {', '.join(setting.words)}"
    options: dict[str, Any] = {"help": text.replace("%", "%%")}
    if setting.kind is bool:
        options |= {"action": argparse.BooleanOptionalAction}
    elif setting.kind is tuple:
        options["help"] += "; repeatable; or none"
        options |= {"action": "append", "metavar": setting.metavar}
    else:
        options |= {"type": _reader(setting), "metavar": setting.metavar}
    group.add_argument(*setting.flags, **options)


def _reader(setting: Setting) -> Callable[[str], Any]:
    """Return the function that makes the setting's value from its text on the command line."""
    if isinstance(setting.choices, Names):
        return partial(_extension, setting.choices)
    if setting.words:
        return str.lower  # all words of the settings are in lower case
    seconds = setting.kind is float and setting.unit == "s"
    read = setting.read or (parse_seconds if seconds else None)
    if read is None:
        return setting.kind

    def value(text: str) -> Any:
        try:
            return read(text)
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return value


def _extension(choices: Names, text: str) -> str:
    return text.lower() if text.lower() in choices.own else text


def _given(arguments: argparse.Namespace, key: str, setting: Setting) -> Any:
    """Return the value of a setting on the command line; None if its flag is not given."""
    value = getattr(arguments, setting.flag.removeprefix("--").replace("-", "_"), None)
    if setting.kind is not tuple or value is None or "none" not in value:
        return value
    if len(value) > 1:
        raise ConfigError(f"{key}: expected none by itself, got {' and '.join(value)}")
    return []


def config_from(arguments: argparse.Namespace) -> RunConfig:
    """Return the settings of the run that the arguments describe."""
    given = {key: _given(arguments, key, each) for key, each in _FLAGGED.items()}
    overrides = {key: value for key, value in given.items() if value is not None}
    delay = getattr(arguments, "on_board_delay", None)
    if delay is not None:
        overrides["switch.compute_ns"] = parse_duration_ns(delay)
        overrides["switch.compute_time_scale"] = 1.0
    config = load_config(arguments.config, overrides)
    walking = [key for key in overrides if key.startswith(("walk.", "switch."))]
    if walking and not config.walks:
        raise ConfigError(f"{walking[0]}: only a walk has this setting; add --task walk")
    if "walk.goal" in overrides and config.task != "go":
        raise ConfigError("walk.goal: only the task go has a goal; add --task go")
    return config
