"""Pages of the reference that are made from the code: commands, files, messages."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
from collections.abc import Iterator

from remote_wbc import __version__, commands
from shared.config.settings import RunConfig
from shared.process.cli import Group, Parser, Subcommand, command_parser
from shared.robots import load_robot
from shared.telemetry.schema import (
    LINK_SCHEMA,
    SOLVE_SCHEMA,
    STEP_SCHEMA,
    Schema,
    Source,
    tick_schema,
)
from shared.wire import channels, messages

_HEAD = "---\nsearch: {boost: 0.7}\n---\n"


def pages() -> dict[str, str]:
    """Return the Markdown of every page by its path in docs/."""
    return {
        "reference/commands.md": commands_page(),
        "reference/columns.md": columns_page(),
        "reference/messages.md": messages_page(),
    }


def commands_page() -> str:
    """Return the page of all commands, from their parsers."""
    parser = command_parser(None, commands(), version=__version__)
    lines = [
        "# Commands\n",
        "`./wbc COMMAND` runs a command, and `./wbc COMMAND --help` shows the text of this page. "
        "The exit code is 0 if the command did its work or the robot finished standing, 3 if the "
        "robot fell, 2 after an error, and 130 after Ctrl-C.\n",
    ]
    for command in commands():
        subparser = _subparsers(parser)[command.name]
        if isinstance(command, Group):
            lines += [f"## {command.name}\n", f"{_sentence(command.help)}\n"]
            for each in command.commands:
                name = f"{command.name} {each.name}"
                lines += _command(name, each, _subparsers(subparser)[each.name], level=3)
        else:
            lines += _command(command.name, command, subparser, level=2)
    return _HEAD + "\n".join(lines)


def _command(
    name: str, command: Subcommand, parser: argparse.ArgumentParser, *, level: int
) -> Iterator[str]:
    yield f"{'#' * level} {name}\n"
    yield f"{_sentence(parser.description or command.help)}\n"
    formatter = argparse.HelpFormatter(prog="")
    positional = [
        formatter._format_args(action, str(action.metavar or action.dest))
        for action in parser._get_positional_actions()
    ]
    yield f"```sh\n{' '.join(['./wbc', name, *positional, '[OPTIONS]'])}\n```\n"
    for group in parser._action_groups:
        rows = [
            f"| `{formatter._format_action_invocation(action)}` | {_cell(_help(action))} |"
            for action in group._group_actions
            if action.help is not argparse.SUPPRESS and action.dest != "help"
        ]
        if rows:
            # argparse's own groups are "positional arguments" and "options".
            name = group.title or ""
            title = {"positional arguments": "argument", "options": "option"}.get(name, _cell(name))
            yield "\n".join([f"| {title} | |", "|---|---|", *rows]) + "\n"
    if parser.epilog:
        yield f"{parser.epilog}\n"


def _help(action: argparse.Action) -> str:
    formatter = argparse.HelpFormatter(prog="")
    return formatter._expand_help(action) if action.help else ""


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, Parser]:
    (action,) = (each for each in parser._actions if isinstance(each, argparse._SubParsersAction))
    return dict(action.choices)


def columns_page() -> str:
    """Return the page of the files of a run and their columns, from the schemas."""
    model = load_robot(RunConfig().robot.name).model
    tables = (
        ("telemetry.parquet", "a row per tick of the robot", tick_schema(nq=model.nq, nv=model.nv)),
        ("link.parquet", "a row per message through the shim", LINK_SCHEMA),
        ("edge.parquet", "a row per state that the edge worked on", SOLVE_SCHEMA),
        ("steps.parquet", "a row per footprint of a robot that steps by touch", STEP_SCHEMA),
    )
    lines = [
        "# Files and columns\n",
        "A run leaves these tables beside its `summary.json`: see "
        "[runs](../running.md#what-a-run-leaves). `shared.telemetry.parquet.read_parquet` reads "
        "them, and so does every reader of Parquet. A vector is a fixed-size list. Widths are "
        "Romeo's.\n",
    ]
    for file, content, schema in tables:
        lines += [f"## {file}\n", f"{_sentence(content)}\n", *_columns(schema)]
    lines += ["## The numbers of `source`\n", "| number | source |", "|---|---|"]
    lines += [f"| {source.value} | {source.label} |" for source in Source]
    lines += ["", "[Runs](../running.md#when-things-go-wrong) explains the sources."]
    return _HEAD + "\n".join(lines)


def _columns(schema: Schema) -> Iterator[str]:
    yield "| column | type | unit | |\n|---|---|---|---|"
    for column in schema.columns:
        kind = column.kind if column.width == 1 else f"{column.width} × {column.kind}"
        yield f"| `{column.name}` | {kind} | {column.unit} | {_cell(column.help)} |"
    yield ""


def messages_page() -> str:
    """Return the page of channels and messages, from their declarations."""
    lines = [
        "# Messages\n",
        "The fields of each message in Python. [What crosses the link](../wire.md) describes their "
        "encoding and the checks of a receiver.\n",
        "| channel | key | rate [Hz] | at most [bytes] |\n|---|---|---|---|",
    ]
    for channel in (channels.UPLINK, channels.DOWNLINK, channels.PLANS):
        lines.append(
            f"| {channel.name} | `{channel.key}` | {channel.rate_hz} | {channel.max_bytes} |"
        )
    lines.append("")
    for _, kind in inspect.getmembers(messages, inspect.isclass):
        if kind.__module__ == messages.__name__:
            lines += [f"## {kind.__name__}\n", f"{inspect.getdoc(kind)}\n"]
            lines += ["| field | type |\n|---|---|"]
            lines += [f"| `{field.name}` | `{field.type}` |" for field in dataclasses.fields(kind)]
            lines.append("")
    return _HEAD + "\n".join(lines)


def _sentence(words: str) -> str:
    words = words.strip()
    return f"{words[0].upper()}{words[1:].removesuffix('.')}."


def _cell(words: str) -> str:
    """Return words for a cell of a table: in one line, with the marks of Markdown as they are."""
    return re.sub(r"[|<*\[\]]", lambda found: f"&#{ord(found[0])};", " ".join(words.split()))
