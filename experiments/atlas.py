"""Map of the falls of a robot over constant round trip × push × controller.

`./wbc atlas --task balance --delays 0ms,50ms --pushes 60N,100N` plays every pair of delay and push
with each controller and the same seeds. The trials are a study: it runs on all cores or on a
cluster, and the same command resumes it. The command writes a heat map with counts, and
`atlas.parquet` with a row per square.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from experiments.figure import FELL, draw_figure
from experiments.studies.study import Study
from experiments.studies.study_file import make_study
from experiments.studies.study_tables import flattened
from experiments.studies.sweep import sweep, workers_from
from experiments.studies.trial_table import errors_in_words, wilson_interval
from experiments.studies.workers import EXAMPLE
from shared.config.config_file import differing, load_config, settings_table
from shared.config.extensions import CONTROLLERS, TASKS
from shared.config.quantities import parse_duration_ns, parse_push
from shared.config.settings import RunConfig
from shared.errors import ConfigError, writing
from shared.output.text_table import aligned
from shared.process.cli import EXIT_STANDING
from shared.robots import load_robot

DEFAULT_DELAYS = "0ms,10ms,25ms,50ms,90ms,150ms,200ms,400ms"
# The default direction is sideways, where the feet are long enough to show a margin. In a walk the
# push comes within the third step, when the robot stands on one foot. A task of your own has the
# defaults of the balance.
DEFAULT_PUSHES = {
    "balance": "40N,60N,80N,100N,110N,120N,130N,150N",
    "walk": "10N,20N,30N,40N,50N,60N,80N,100N",
}
DEFAULT_PUSH_AT = {"balance": "1.0s", "walk": "3.0s"}
# Names of the axes of the map.
DELAY, PUSH = "round trip", "push"

Row = dict[str, Any]


def add_atlas_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `atlas`."""
    parser.add_argument("--config", type=Path, metavar="FILE.toml", help="settings of all trials")
    parser.add_argument(
        "--task", help=f"one of {', '.join(TASKS.own)} (default: the file's, or balance)"
    )
    parser.add_argument("--robot", metavar="NAME", help="a robot (default: the file's, or romeo)")
    parser.add_argument(
        "--controllers", default="pr,la,lc", metavar="pr,la,…", help="the controllers"
    )
    parser.add_argument(
        "--delays", default=DEFAULT_DELAYS, metavar="0ms,25ms,…", help="the round trips"
    )
    parser.add_argument("--pushes", metavar="0N,60N,…", help="forces on the base")
    parser.add_argument(
        "--direction", default="+y", help="direction of the pushes, as in --direction=-x"
    )
    parser.add_argument("--push-at", metavar="1.0s", help="time at which the push begins")
    parser.add_argument("--push-for", default="0.2s", metavar="0.2s", help="duration of the push")
    parser.add_argument(
        "--seeds", type=int, default=3, metavar="N", help="seeds per square (default 3)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: all cores)"
    )
    parser.add_argument("--scheduler", metavar=EXAMPLE, help="play on this Dask cluster instead")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the trials (default runs/atlas-TASK)"
    )


def run_atlas(arguments: argparse.Namespace) -> int:
    """Play the missing trials, draw the map and print it."""
    if arguments.scheduler is not None and arguments.workers is not None:
        raise ConfigError("--workers: expected without --scheduler, got both; leave out --workers")
    workers = workers_from(arguments.workers)
    study = study_from(arguments)
    out = arguments.out or Path("runs") / study.name
    rows = sweep(study, out=out, workers=workers, scheduler=arguments.scheduler)
    squares = squares_of(rows)
    text = in_words(squares)
    shown = [_shown(row) for row in rows]
    picture = out / "atlas.png"
    print(text)
    with writing(out, what="out"):
        (out / "atlas.txt").write_text(text + "\n", encoding="utf-8")
        pq.write_table(pa.Table.from_pylist(squares), out / "atlas.parquet")
    draw_figure(shown, [FELL], x=DELAY, by=PUSH, panels="controller", as_map=True, out=picture)
    print("\n".join([*errors_in_words(rows), str(picture)]))
    return EXIT_STANDING


def study_from(arguments: argparse.Namespace) -> Study:
    """The study that the options describe; ConfigError for a value that no trial can have."""
    asked = {"task": arguments.task, "robot.name": arguments.robot}
    given = {key: value for key, value in asked.items() if value is not None}
    config = load_config(arguments.config, given)
    load_robot(config.robot.name)  # an unknown one is an error now, not in a worker
    task = config.task
    like = task if task in DEFAULT_PUSHES else "balance"
    controllers = _axis("--controllers", arguments.controllers, _controller)
    delays = sorted(_axis("--delays", arguments.delays, _delay), key=parse_duration_ns)
    pushes = DEFAULT_PUSHES[like] if arguments.pushes is None else arguments.pushes
    forces = _axis("--pushes", pushes, _force)
    # In a map the first row is on top: the strongest push.
    forces.sort(key=lambda force: -float(force.removesuffix("N")))
    if not re.fullmatch("[+-][xyz]", arguments.direction):
        raise ConfigError(f"--direction: expected ±x, ±y or ±z, got {arguments.direction!r}")
    at = _seconds(
        "--push-at", DEFAULT_PUSH_AT[like] if arguments.push_at is None else arguments.push_at
    )
    if not float(at.removesuffix("s")) < config.duration:
        raise ConfigError(f"--push-at: expected before the end at {config.duration:g} s, got {at}")
    lasting = _seconds("--push-for", arguments.push_for)
    return make_study(
        {
            "name": re.sub(r"[^\w.=-]+", "-", f"atlas-{TASKS.label(task)}"),
            "description": "how often a robot falls over constant round trip, push and controller",
            "base": {"task": task, **_changed(config)},
            "grid": {
                "controller": controllers,
                "link.network": [f"constant:{delay}" for delay in delays],
                "push": [[f"{force}@{at}:{lasting}:{arguments.direction}"] for force in forces],
            },
        },
        seeds=arguments.seeds,
    )


def squares_of(rows: list[Row]) -> list[Row]:
    """A row per square of the map: trials played, falls, and P(fall) with its Wilson interval.

    The interval is that of 95 %. Trials that ended with an error are not counted.
    """
    trials: dict[tuple[str, str, str], list[bool]] = {}
    for row in rows:
        fell = trials.setdefault((row["controller"], row["link.network"], row["push"][0]), [])
        if row["error"] is None:
            fell.append(row["fell"])
    squares = []
    for (controller, network, push), fell in trials.items():
        low, high = wilson_interval(sum(fell), len(fell))
        squares.append(
            {
                "controller": controller,
                "delay_ns": _delay_ns(network),
                "push": push,
                "force": _force_of(push),
                "fell": sum(fell),
                "played": len(fell),
                "p_fall": sum(fell) / len(fell) if fell else None,
                "low": low,
                "high": high,
            }
        )
    return squares


def in_words(squares: list[Row]) -> str:
    """A line per controller and push: at each delay, the falls of the trials played."""
    delays = sorted({square["delay_ns"] for square in squares})
    lines = [["", "", *(f"{delay * 1e-6:g} ms" for delay in delays)]]
    counts = {(s["controller"], s["force"], s["delay_ns"]): s for s in squares}
    for controller, force in dict.fromkeys((s["controller"], s["force"]) for s in squares):
        found = [counts[controller, force, delay] for delay in delays]
        words = [f"{square['fell']}/{square['played']}" for square in found]
        lines.append([CONTROLLERS.label(controller), f"{force:g} N", *words])
    return "\n".join(["trials that fell / trials played, by round trip", *aligned(lines, left=0)])


def _shown(row: Row) -> Row:
    """A trial's row with the words of the map's axes."""
    delay_ns, force = _delay_ns(row["link.network"]), _force_of(row["push"][0])
    return {
        **row,
        "controller": CONTROLLERS.label(row["controller"]),
        DELAY: f"{delay_ns * 1e-6:g} ms",
        PUSH: f"{force:g} N",
    }


def _delay_ns(network: str) -> int:
    return parse_duration_ns(network.removeprefix("constant:"))


def _force_of(push: str) -> float:
    return float(push.partition("N@")[0])


def _changed(config: RunConfig) -> dict[str, Any]:
    """Settings that differ from the task's defaults, by dotted key, without the map's axes."""
    default = settings_table(load_config(None, {"task": config.task}))
    changed = flattened(differing(settings_table(config), default), "--config")
    left_out = ("controller", "link.network", "push", "seed")
    return {key: value for key, value in changed.items() if key not in left_out}


def _axis(option: str, text: str, check: Callable[[str], str]) -> list[str]:
    """The values of an axis, in the form that `check` returns; `ConfigError` for a value given
    twice.
    """
    values = []
    for given in text.split(","):
        try:
            value = check(given.strip())
        except ConfigError as error:
            raise ConfigError(f"{option}: {error}") from None
        if value in values:
            raise ConfigError(f"{option}: expected each value once, got {given.strip()!r} twice")
        values.append(value)
    return values


def _controller(text: str) -> str:
    CONTROLLERS.check(text)
    return text


def _delay(text: str) -> str:
    return f"{_decimal(parse_duration_ns(text) * 1e-6)}ms"


def _force(text: str) -> str:
    try:
        push = parse_push(f"{text}@0s:0s:+x")
    except ConfigError:
        raise ConfigError(f"expected forces as in 60N, got {text!r}") from None
    return f"{_decimal(push.force[0])}N"


def _seconds(option: str, text: str) -> str:
    try:
        return f"{_decimal(parse_duration_ns(text) * 1e-9)}s"
    except ConfigError as error:
        raise ConfigError(f"{option}: {error}") from None


def _decimal(number: float) -> str:
    """The number without an exponent and without trailing zeros."""
    return f"{number:.6f}".rstrip("0").rstrip(".")
