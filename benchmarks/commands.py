"""The commands of the benchmarks: their options, and what they do."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import (
    against,
    capacity,
    core,
    edges,
    flood,
    floor,
    limits,
    lockstep,
    netem,
    peers,
    recording,
    session,
    viewer,
)
from benchmarks.termination import exit_at_termination
from shared.errors import ConfigError
from shared.process.cli import EXIT_STANDING


def add_core_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--repetitions",
        type=int,
        default=2000,
        help="repetitions of a single call (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the states (default 0)")
    parser.add_argument(
        "--seconds",
        type=float,
        default=2.0,
        help="duration of each trial [s] (default %(default)g)",
    )
    parser.add_argument("--against", metavar="COMMIT", help="print ratios to this commit instead")
    parser.add_argument(
        "--rounds",
        type=int,
        default=10,
        help="rounds of trials, with --against (default %(default)s)",
    )


def run_core(arguments: argparse.Namespace) -> int:
    _check_count("--repetitions", arguments.repetitions)
    _check_count("--rounds", arguments.rounds)
    # The first ticks of a trial are left out.
    if not 0.2 <= arguments.seconds <= 60.0:
        raise ConfigError(f"--seconds: expected 0.2 to 60, got {arguments.seconds:g}")
    exit_at_termination()
    if arguments.against is not None:
        print(against.run(arguments.against, rounds=arguments.rounds, seconds=arguments.seconds))
    else:
        print(
            core.run(
                repetitions=arguments.repetitions,
                seed=arguments.seed,
                seconds=arguments.seconds,
            )
        )
    return EXIT_STANDING


def add_edges_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = edges.__doc__
    parser.add_argument("trial", choices=("flood", "kills"), help="what happens to the edges")
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="duration [min] (default %(default)g)"
    )
    parser.add_argument(
        "--controller", choices=("la", "lc"), default="la", help="of kills (default %(default)s)"
    )
    parser.add_argument(
        "--rate",
        type=int,
        default=edges.RATE,
        help="higher rate of the other robot of flood [1/s] (default %(default)s)",
    )


def run_edges(arguments: argparse.Namespace) -> int:
    if not 0.2 <= arguments.minutes <= 600.0:
        raise ConfigError(f"--minutes: expected 0.2 to 600, got {arguments.minutes:g}")
    if not 1000 <= arguments.rate <= 1_000_000:
        raise ConfigError(f"--rate: expected 1000 to 1000000, got {arguments.rate}")
    exit_at_termination()
    seconds = 60.0 * arguments.minutes
    if arguments.trial == "flood":
        print(edges.run_flood(seconds=seconds, rate=arguments.rate))
    else:
        print(edges.run_kills(seconds=seconds, controller=arguments.controller))
    return EXIT_STANDING


def add_floor_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--repetitions",
        type=int,
        default=2000,
        help="repetitions of each call (default %(default)s)",
    )


def run_floor(arguments: argparse.Namespace) -> int:
    _check_count("--repetitions", arguments.repetitions)
    exit_at_termination()
    print(floor.run(repetitions=arguments.repetitions))
    return EXIT_STANDING


def add_peers_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rounds", type=int, default=40, help="rounds of all states (default %(default)s)"
    )


def run_peers(arguments: argparse.Namespace) -> int:
    _check_count("--rounds", arguments.rounds)
    exit_at_termination()
    print(peers.run(rounds=arguments.rounds))
    return EXIT_STANDING


def _check_count(flag: str, count: int) -> None:
    if count < 1:
        raise ConfigError(f"{flag}: expected at least 1, got {count}")


def add_netem_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds",
        type=float,
        default=10.0,
        help="duration of each measurement [s] (default %(default)g)",
    )


def run_netem(arguments: argparse.Namespace) -> int:
    # The shim logs 3.6 million messages.
    if not 1.0 <= arguments.seconds <= 1200.0:
        raise ConfigError(f"--seconds: expected 1 to 1200, got {arguments.seconds:g}")
    exit_at_termination()
    print(netem.run(seconds=arguments.seconds))
    return EXIT_STANDING


def add_capacity_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def run_capacity(arguments: argparse.Namespace) -> int:
    del arguments
    print(capacity.run())
    return EXIT_STANDING


def add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds",
        type=float,
        default=10.0,
        help="duration of each recording [s] (default %(default)g)",
    )


def run_recording(arguments: argparse.Namespace) -> int:
    if not 1.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds: expected 1 to 600, got {arguments.seconds:g}")
    exit_at_termination()
    print(recording.run(seconds=arguments.seconds))
    return EXIT_STANDING


def add_limits_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rounds", type=int, default=50, help="of 20 ticks of each robot; 50")


def run_limits(arguments: argparse.Namespace) -> int:
    _check_count("--rounds", arguments.rounds)
    exit_at_termination()
    print(limits.run(rounds=arguments.rounds))
    return EXIT_STANDING


def add_lockstep_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--repetitions", type=int, default=3, help="repetitions of each trial (default %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=float, help="duration of each trial [s] (default: its whole task)"
    )


def run_lockstep(arguments: argparse.Namespace) -> int:
    _check_count("--repetitions", arguments.repetitions)
    if arguments.seconds is not None and not 0.1 <= arguments.seconds <= 3600.0:
        raise ConfigError(f"--seconds: expected 0.1 to 3600, got {arguments.seconds:g}")
    print(lockstep.run(repetitions=arguments.repetitions, seconds=arguments.seconds))
    return EXIT_STANDING


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, default=0, help="seed of the commands (default 0)")
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="duration [min] (default %(default)g)"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="keep the run in DIR/run")


def run_session(arguments: argparse.Namespace) -> int:
    if not 0.1 <= arguments.minutes <= 600.0:
        raise ConfigError(f"--minutes: expected 0.1 to 600, got {arguments.minutes:g}")
    exit_at_termination()
    print(session.run(seed=arguments.seed, minutes=arguments.minutes, folder=arguments.out))
    return EXIT_STANDING


def add_flood_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rounds", type=int, default=15, help="number of rounds (default %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=float, default=2.0, help="duration of a span [s] (default %(default)g)"
    )


def run_flood(arguments: argparse.Namespace) -> int:
    if arguments.rounds < 2:
        raise ConfigError(f"--rounds: expected at least 2, got {arguments.rounds}")
    if not 0.5 <= arguments.seconds <= 60.0:
        raise ConfigError(f"--seconds: expected 0.5 to 60, got {arguments.seconds:g}")
    exit_at_termination()
    print(flood.run(rounds=arguments.rounds, seconds=arguments.seconds))
    return EXIT_STANDING


def add_viewer_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--repetitions", type=int, default=5, help="repetitions of each run (default %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="duration of each run [s] (default %(default)g)"
    )


def run_viewer(arguments: argparse.Namespace) -> int:
    _check_count("--repetitions", arguments.repetitions)
    # The viewer is disturbed after two seconds.
    if not 3.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds: expected 3 to 600, got {arguments.seconds:g}")
    exit_at_termination()
    print(viewer.run(seconds=arguments.seconds, repetitions=arguments.repetitions))
    return EXIT_STANDING
