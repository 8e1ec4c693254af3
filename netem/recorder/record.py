"""Measure a real path as a profile: `./wbc netem record`, one end on either machine.

The two ends take the places of robot and edge, with the same keys, rate, sizes and quality of
service. A path that carries the stack therefore carries their messages too. `probe_near` and
`probe_far` have the protocol of the ends, `record_loops` the schedule, `clock_offset` and
`recording` the evaluation.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from netem.profile import DelayProfile
from netem.profile_file import write_profile
from netem.recorder.probe import MAX_PERIOD_NS, MIN_PERIOD_NS, ProbeSettings, parse_bytes
from netem.recorder.probe_far import FarEnd
from netem.recorder.probe_near import NearEnd
from netem.recorder.record_loops import (
    CONNECT_SECONDS,
    DRAIN_SECONDS,
    SETTLE_SECONDS,
    START_FAR,
    FarLoop,
    NearLoop,
)
from netem.recorder.record_report import progress_in_words, say, summary_lines
from netem.recorder.recording import Recorded, estimate_clock, reconstruct
from shared.bus.base import new_session
from shared.bus.security import EDGE, Credentials
from shared.bus.zenoh_bus import ZenohBus
from shared.config.robot_settings import RobotConfig
from shared.errors import ConfigError, LinkError, ProfileError
from shared.output.screen import StatusLine
from shared.process.cli import EXIT_STANDING
from shared.process.entry import EXIT_INTERRUPTED
from shared.process.realtime import prepare, suspend_garbage_collection
from shared.process.service import StopSignal, add_identity_arguments, identity_from
from shared.wire.channels import DOWNLINK, UPLINK

_PRIORITY = 30
_MAX_SECONDS = 3600.0
_CLOCKS = ("own", "synchronised")
# Options of the near end, with their defaults.
_NEAR_DEFAULTS = {
    "seconds": 60.0,
    "out": None,
    "rate": float(UPLINK.rate_hz),
    "uplink": f"{UPLINK.max_bytes}B",
    "downlink": f"{DOWNLINK.max_bytes}B",
    "clock": _CLOCKS[0],
}


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `record`."""
    end = parser.add_mutually_exclusive_group(required=True)
    end.add_argument(
        "--listen", metavar="ENDPOINT", help="be the far end until Ctrl-C: tcp/0.0.0.0:7460"
    )
    end.add_argument(
        "--connect", metavar="ENDPOINT", help="be the near end, which measures and writes the file"
    )
    add_identity_arguments(parser)
    near = parser.add_argument_group("the near end")
    near.add_argument("--out", metavar="FILE", type=Path, help="profile to write, .npz or .csv")
    near.add_argument("--seconds", type=float, help="duration (default 60); Ctrl-C ends it early")
    near.add_argument("--rate", type=float, help="messages per second each way (default 1000)")
    near.add_argument("--uplink", metavar="SIZE", help="size of a message up (default 1000B)")
    near.add_argument("--downlink", metavar="SIZE", help="size of a message down (default 40000B)")
    near.add_argument(
        "--clock",
        choices=_CLOCKS,
        help="own: two clocks, whose offset is estimated (default); synchronised: the time of day, "
        "which PTP or GNSS keeps equal on both machines",
    )


def run_record(arguments: argparse.Namespace) -> int:
    """Run one end of a recording. Return 0."""
    if arguments.listen is None:
        return _run_near(arguments)
    for name in _NEAR_DEFAULTS:
        if getattr(arguments, name) is not None:
            raise ConfigError(f"{name}: expected beside --connect, got it beside --listen; omit it")
    return _run_far(arguments)


def _run_near(arguments: argparse.Namespace) -> int:
    for name, value in _NEAR_DEFAULTS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)
    settings = _settings(arguments)
    seconds, out = arguments.seconds, _writable(arguments.out)
    if not 0.1 <= seconds <= _MAX_SECONDS:
        raise ConfigError(f"seconds: expected from 0.1 to {_MAX_SECONDS:g}, got {seconds:g}")
    longest_seconds = CONNECT_SECONDS + SETTLE_SECONDS + seconds + 2 * DRAIN_SECONDS
    near = NearEnd(
        settings, session=new_session(), capacity=round(longest_seconds * 1e9 / settings.period_ns)
    )
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    me = identity_from(arguments, role=None, kind=RobotConfig().name)
    say(f"dialling {arguments.connect} ({scheduling})")
    bus = _dial(arguments.connect, me.credentials, lambda: stop.requested)
    try:
        loop = NearLoop(near, bus.publisher(UPLINK.key_for(me.robot)))
        bus.subscribe(DOWNLINK.key_for(me.robot), loop.receive)
        suspend_garbage_collection()
        if not loop.connect(arguments.connect, lambda: stop.requested):
            return EXIT_INTERRUPTED
        say(
            f"recording {seconds:g} s to {out}: {1e9 / settings.period_ns:g} messages a second, "
            f"{settings.uplink_bytes} B up, {settings.downlink_bytes} B down; Ctrl-C ends it early"
        )
        loop.left_seconds = seconds
        with StatusLine(lambda: progress_in_words(loop), stream=sys.stdout):
            start_ns, end_ns = loop.measure(seconds=seconds, stopping=lambda: stop.requested)
        early = stop.requested
        # A second signal ends the wait for the last stamps.
        again = StopSignal()
        loop.drain(lambda: again.requested)
        recorded = _reconstruct(loop, arguments, start_ns=start_ns, end_ns=end_ns, early=early)
        for line in summary_lines(recorded, _keep(recorded.profile, out)):
            say(line)
    finally:
        # Last, because a neighbour that is cut off makes it wait.
        bus.close()
    return EXIT_STANDING


def _keep(profile: DelayProfile, out: Path) -> Path:
    """Write a profile; if its disk is full by now, into the folder for temporary files."""
    try:
        write_profile(profile, out)
    except ProfileError as error:
        elsewhere = Path(tempfile.mkdtemp(prefix="wbc-record-")) / out.name
        write_profile(profile, elsewhere)
        say(f"warning: {error}; the profile is in {elsewhere}")
        return elsewhere
    return out


def _reconstruct(
    loop: NearLoop, arguments: argparse.Namespace, *, start_ns: int, end_ns: int, early: bool
) -> Recorded:
    near = loop.near
    up, down = near.stamps()
    clock, warning = estimate_clock(
        up, down, same_clock=near.one_clock, same_time=near.settings.synchronised
    )
    if warning:
        say(f"warning: {warning}")
    if not near.drained:
        say(
            "warning: no message of the far end arrived after the measurement; the last messages "
            "up without a report count as lost"
        )
    return reconstruct(
        up,
        down,
        clock,
        settings=near.settings,
        name=arguments.out.stem,
        start_ns=start_ns,
        end_ns=end_ns,
        metadata={
            "source": "wbc netem record",
            "recorded": loop.began.isoformat(timespec="seconds"),
            "far_end": arguments.connect,
            "ended_early": early,
            "given_up_by_near_end": loop.given_up,
            "unread": loop.missed,
            "refused": dict(near.refused),
        },
    )


def _run_far(arguments: argparse.Namespace) -> int:
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    me = identity_from(arguments, role=EDGE, kind=RobotConfig().name)
    bus = ZenohBus(listen=[arguments.listen], credentials=me.credentials)
    try:
        loop = FarLoop(FarEnd(), bus.publisher(DOWNLINK.key_for(me.robot)), say)
        bus.subscribe(UPLINK.key_for(me.robot), loop.receive)
        suspend_garbage_collection()
        say(f"READY {arguments.listen} ({scheduling}); waits for `wbc netem record --connect`")
        loop.run(lambda: stop.requested)
    finally:
        bus.close()
    say(f"stopped; refused messages: {dict(loop.far.refused) or 'none'}")
    return EXIT_STANDING


def _dial(endpoint: str, credentials: Credentials | None, stopping: Callable[[], bool]) -> ZenohBus:
    try:
        return ZenohBus.dial(
            endpoint, within=CONNECT_SECONDS, credentials=credentials, stopping=stopping
        )
    except LinkError as error:
        raise LinkError(f"{error}; start the far end of a recording by: {START_FAR}") from None


def _settings(arguments: argparse.Namespace) -> ProbeSettings:
    slowest, fastest = 1e9 / MAX_PERIOD_NS, 1e9 / MIN_PERIOD_NS
    if not slowest <= arguments.rate <= fastest:
        raise ConfigError(
            f"rate: expected from {slowest:g} to {fastest:g} messages per second, got "
            f"{arguments.rate:g}"
        )
    return ProbeSettings(
        # A file has the period in whole µs.
        period_ns=round(1e6 / arguments.rate) * 1000,
        uplink_bytes=parse_bytes(arguments.uplink, option="uplink"),
        downlink_bytes=parse_bytes(arguments.downlink, option="downlink"),
        synchronised=arguments.clock == "synchronised",
    )


def _writable(out: Path | None) -> Path:
    """The file to write; `ConfigError`, before the measurement, if it cannot be written."""
    if out is None:
        raise ConfigError("out: expected a file for the profile, got none; try --out mylink.npz")
    if out.suffix not in (".npz", ".csv"):
        raise ConfigError(f"out: expected a name that ends in .npz or .csv, got {out}")
    trial = out.with_name(out.name + ".part")
    try:
        if out.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        out.parent.mkdir(parents=True, exist_ok=True)
        trial.write_bytes(b"")
        trial.unlink(missing_ok=True)  # another recorder may have tried the same name
    except OSError as error:
        raise ConfigError(f"out: cannot write {out}: {error.strerror or error}") from None
    return out
