"""The commands of the viewer and their options."""

from __future__ import annotations

import argparse
import functools
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path

from shared.config.config_file import load_config
from shared.errors import UserError
from shared.process.cli import EXIT_STANDING
from shared.process.service import StopSignal, add_held_argument, wait_while_held
from viewer.blueprint import Picture
from viewer.camera import CAMERAS, DEFAULT
from viewer.display import VIEWS
from viewer.live import watch
from viewer.page.watch import watch_page
from viewer.recording import record
from viewer.show import show
from viewer.snapshot import ANIMATION_WIDTH, ANIMATIONS, SIZE, animation, picture

_LEAST_SIZE, _LARGEST_SIZE = 200, 4096


def add_live_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", metavar="FILE.toml", required=True, help="settings of the run")
    parser.add_argument(
        "--telemetry",
        metavar="ENDPOINT",
        required=True,
        help="telemetry hub, as in tcp/127.0.0.1:7450",
    )
    parser.add_argument(
        "--view",
        choices=VIEWS,
        default="native",
        help="a window, a browser, the light page, or a recording only (default %(default)s)",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="also write DIR/recording.rrd")
    add_held_argument(parser)


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", type=Path, help="the run's folder")


def add_open_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", metavar="RUN", type=Path, nargs=1, help="the run's folder")
    _add_view(parser)


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", metavar="RUN", type=Path, nargs="+", help="the runs' folders")
    _add_view(parser)


def _add_view(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--view",
        choices=("auto", "native", "web"),
        default="auto",
        help="a window or a browser (default: a window if there is a screen)",
    )


def add_snapshot_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs", metavar="RUN", type=Path, nargs="+", help="a run's folder; several are compared"
    )
    parser.add_argument("--out", metavar="FILE.png", type=Path, help="file for a picture")
    parser.add_argument(
        "--at",
        metavar="SECONDS",
        type=float,
        help="task time of the picture (default: end of the run)",
    )
    parser.add_argument(
        "--animation",
        metavar="FILE",
        type=Path,
        help=f"file for an animation, {' or '.join(ANIMATIONS)}",
    )
    parser.add_argument(
        "--size",
        metavar="WIDTHxHEIGHT",
        help=f"size in pixels (default {SIZE[0]}x{SIZE[1]}); a gif or webp is "
        f"{ANIMATION_WIDTH} wide",
    )
    parser.add_argument(
        "--camera",
        choices=CAMERAS,
        default=DEFAULT,
        help="side from which the robot is seen (default %(default)s)",
    )
    parser.add_argument(
        "--scene-only", action="store_true", help="the robot alone, without title and plots"
    )
    parser.add_argument(
        "--span", metavar="FROM:TO", help="span of the animation [s] (default: the whole run)"
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="speed of the animation, × real time (default %(default)g)",
    )


def _leaving_at_once(
    command: Callable[[argparse.Namespace], int],
) -> Callable[[argparse.Namespace], int]:
    """Make a command end its process without unloading the libraries.

    All files are closed by then. On a busy machine, unloading would take seconds more.
    """

    @functools.wraps(command)
    def run(arguments: argparse.Namespace) -> int:
        code = command(arguments)
        sys.stdout.flush()
        os._exit(code)

    return run


@_leaving_at_once
def run_live(arguments: argparse.Namespace) -> int:
    wait_while_held(arguments)
    stop = StopSignal()
    if arguments.view == "page":
        watch_page(
            load_config(arguments.config),
            telemetry=arguments.telemetry,
            stopped=lambda: stop.requested,
            say=_say,
        )
        return EXIT_STANDING
    watch(
        load_config(arguments.config),
        telemetry=arguments.telemetry,
        view=arguments.view,
        out=arguments.out,
        stopped=lambda: stop.requested,
        say=_say,
    )
    return EXIT_STANDING


@_leaving_at_once
def run_open(arguments: argparse.Namespace) -> int:
    stop = StopSignal()
    show(arguments.runs, view=arguments.view, stopped=lambda: stop.requested, say=_say)
    return EXIT_STANDING


run_compare = run_open


@_leaving_at_once
def run_snapshot(arguments: argparse.Namespace) -> int:
    if arguments.out is None and arguments.animation is None:
        raise UserError("snapshot: expected --out FILE.png or --animation FILE.gif, got neither")
    size = SIZE if arguments.size is None else _size(arguments.size)
    shown = Picture(arguments.camera, scene_only=arguments.scene_only)
    if arguments.out is not None:
        picture(arguments.runs, arguments.out, at=arguments.at, size=size, shown=shown)
        _say(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB")
    if arguments.animation is not None:
        begin, end = _span(arguments.span)
        animation(
            arguments.runs,
            arguments.animation,
            begin=begin,
            end=end,
            speed=arguments.speed,
            size=size,
            shown=shown,
        )
        _say(f"{arguments.animation}: {arguments.animation.stat().st_size / 1e6:.2f} MB")
    return EXIT_STANDING


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[x×](\d+)", text)
    if match is not None:
        width, height = int(match[1]), int(match[2])
        if all(_LEAST_SIZE <= length <= _LARGEST_SIZE for length in (width, height)):
            return width, height
    raise UserError(
        f"--size: expected WIDTHxHEIGHT in pixels, each {_LEAST_SIZE} to {_LARGEST_SIZE}, as in "
        f"1600x960, got {text!r}"
    )


def _span(text: str | None) -> tuple[float, float | None]:
    if text is None:
        return 0.0, None
    begin, _, end = text.partition(":")
    try:
        return float(begin), float(end)
    except ValueError:
        raise UserError(f"--span: expected FROM:TO in seconds as in 0.5:2, got {text!r}") from None


@_leaving_at_once
def run_record(arguments: argparse.Namespace) -> int:
    began = time.monotonic()
    recorded = record(arguments.run)
    _say(
        f"{recorded.path}: {recorded.rows} rows in {recorded.size_bytes / 1e6:.1f} MB, "
        f"made in {time.monotonic() - began:.1f} s; open it with: rerun {recorded.path}"
    )
    return EXIT_STANDING


def _say(line: str) -> None:
    print(line, flush=True)
