"""`convert`: a measurement in a foreign format, or a profile, as a profile."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from netem.importers.both_ways import files_by_way, read_both_ways, way_in_name
from netem.importers.formats import FORMATS, PROFILE, Format, format_named, format_of
from netem.importers.measured import Measured, with_one_clock
from netem.importers.ns3 import is_ns3_sendings
from netem.importers.ns3_phy import NOTE, read_phy
from netem.importers.options import (
    Options,
    parse_columns,
    parse_fraction,
    parse_load,
    parse_marks,
    parse_period_ns,
    parse_size,
    per_way,
)
from netem.importers.pauses import TREATMENTS
from netem.importers.resample import to_profile
from netem.importers.source import first_line
from netem.profile import DIRECTIONS, DOWNLINK, LOST, UPLINK, DelayProfile
from netem.profile_file import read_profile, write_profile
from netem.statistics import delays_ms, longest_run
from shared.config.quantities import parse_duration_ns
from shared.errors import ConfigError, ProfileError
from shared.process.cli import EXIT_STANDING

# Each flag: its name, the field of `Options` that it sets, its parser, an example and its help.
_FLAGS: tuple[tuple[str, str, Callable[[str], Any], str, str], ...] = (
    ("period", "period_ns", parse_period_ns, "1ms", "length of a period of the profile (1ms)"),
    ("pause", "pause", str, "cut", "a time of 1 s or longer without packets: refuse "
     "(default), cut, or lost"),
    ("lone-loss", "lone_loss", str, "period", "duration of a loss between two packets that "
     "arrived: interval (until the next packet, default) or period"),
    ("interval", "interval_ns", parse_duration_ns, "10ms", "time between pings, or between rows "
     "without times"),
    ("columns", "columns", parse_columns, "sent=t(s),delay=d(ms)", "columns of a table by their "
     "meaning"),
    ("unit", "unit", str, "ms", "unit of the columns that do not name one: s, ms, us, ns"),
    ("lost", "lost", parse_marks, "-1", "value of a lost packet in a table, beside nan, empty, …; "
     "several as in --lost=-1,0"),
    ("clock", "clock", str, "offset", "two clocks: offset (shortest delays equal) or half (of the "
     "round trip each way)"),
    ("imsi", "imsi", int, "N", "IMSI of the terminal, if ns-3's files have several"),
    ("cell", "cell", int, "N", "cell of the terminal, if ns-3's files have several"),
    ("rnti", "rnti", int, "N", "RNTI of the terminal, its number in the cell"),
    ("phy", "phy", Path, "FILE", "RxPacketTrace.txt of the same run, for the capacity"),
    ("robot", "robot", str, "ADDRESS", "the robot's IP address in captures"),
    ("load", "load", lambda t: per_way(t, parse_load), "1000B@500Hz/1000B@1kHz",
     "traffic through a trace of capacity, uplink/downlink"),
    ("base-delay", "base_delay_ns", lambda t: per_way(t, parse_duration_ns), "2ms",
     "delay of a trace of capacity without its queue (0)"),
    ("queue", "queue_bytes", parse_size, "20MiB", "length of the queue (20MiB)"),
    ("delay", "delay_ns", lambda t: per_way(t, parse_duration_ns), "10ms", "mean of a netem table"),
    ("jitter", "jitter_ns", lambda t: per_way(t, parse_duration_ns), "2ms", "standard "
     "deviation of a netem table"),
    ("correlation", "correlation", parse_fraction, "25%", "correlation of one delay with the "
     "next"),
    ("duration", "duration_ns", parse_duration_ns, "60s", "duration of a drawn or computed "
     "profile"),
    ("seed", "seed", int, "0", "seed of a drawn profile"),
)  # fmt: skip


def add_convert_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `convert`."""
    parser.usage = "%(prog)s IN [IN2] OUT [options]"
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="one file of both ways, or uplink then downlink, or the captures on the robot's side "
        "and on the edge's; last the profile to write (.npz or .csv)",
    )
    parser.add_argument(
        "--format", help=f"{', '.join(each.name for each in FORMATS)} (default: by content)"
    )
    parser.add_argument("--uplink", type=Path, metavar="FILE", help="file of the uplink")
    parser.add_argument("--downlink", type=Path, metavar="FILE", help="file of the downlink")
    parser.add_argument(
        "--other-way",
        metavar="same|constant:5ms",
        help="the other way of a file with one way",
    )
    for flag, field, _, example, words in _FLAGS:
        parser.add_argument(f"--{flag}", dest=field, metavar=example, help=words)


def run_convert(arguments: argparse.Namespace) -> int:
    """Write the profile and print the assumptions. Return 0."""
    *inputs, out = arguments.files
    if out.suffix not in (".npz", ".csv"):
        raise ProfileError(f"convert: expected the profile to write last, .npz or .csv, got {out}")
    options = _options(arguments)
    options, inputs = _with_receivers(options, inputs)
    options, inputs = _with_sendings(options, inputs, arguments)
    files = files_by_way(inputs, arguments.uplink, arguments.downlink)
    if "id" in options.columns:
        files = {UPLINK if way is None else way: file for way, file in files.items()}
    formats = [
        format_named(arguments.format) if arguments.format else format_of(file, options)
        for file in files.values()
    ]
    every = [each for file in files.values() for each in (file, options.beside.get(file)) if each]
    name = ", ".join(str(file) for file in every)
    _refuse_flags(arguments, formats, name)
    if PROFILE in formats:
        if len(formats) > 1 or arguments.other_way:
            raise ProfileError(
                f"{name}: expected a profile alone, because it has both ways, got it with another "
                "file or --other-way; give the profile alone"
            )
        profile = read_profile(next(iter(files.values())))
    else:
        measured, constant_ns = read_both_ways(files, formats, arguments.other_way, options)
        measured = with_one_clock(measured, clock=options.clock, name=name)
        profile = to_profile(
            _with_capacity(measured, options), options, name=name, constant_ns=constant_ns
        )
        source = [file.name for file in every]
        origin = {"source": source[0] if len(source) == 1 else source, "format": formats[0].name}
        profile = replace(profile, name=out.stem, metadata={**origin, **profile.metadata})
    write_profile(profile, out)
    _print(profile, out, formats)
    return EXIT_STANDING


def _options(arguments: argparse.Namespace) -> Options:
    given = {}
    for flag, field, parse, example, _ in _FLAGS:
        text = getattr(arguments, field)
        if text is not None:
            try:
                given[field] = parse(text)
            except ValueError:
                raise ConfigError(f"--{flag}: expected {example}, got {text!r}") from None
            except ConfigError as error:
                raise ConfigError(f"--{flag}: {error}") from None
    options = Options(**given)
    if options.clock not in (None, "offset", "half"):
        raise ConfigError(f"--clock: expected offset or half, got {options.clock!r}")
    if options.pause not in TREATMENTS:
        raise ConfigError(
            f"--pause: expected one of {', '.join(TREATMENTS)}, got {options.pause!r}"
        )
    if options.lone_loss not in ("interval", "period"):
        raise ConfigError(f"--lone-loss: expected interval or period, got {options.lone_loss!r}")
    if options.seed < 0:
        raise ConfigError(f"--seed: expected 0 or more, got {options.seed}")
    return options


def _with_receivers(options: Options, inputs: list[Path]) -> tuple[Options, list[Path]]:
    """Put the receivers' tables beside the senders' if an id joins the packets."""
    if "id" not in options.columns:
        return options, inputs
    if len(inputs) not in (2, 4):
        raise ProfileError(
            "convert: expected the sender's and the receiver's table to join by id, of one way or "
            f"of the uplink and then of the downlink, got {len(inputs)} files"
        )
    senders, receivers = inputs[::2], inputs[1::2]
    beside = dict(zip(senders, receivers, strict=True))
    return replace(options, beside=beside), senders


def _with_sendings(
    options: Options, inputs: list[Path], arguments: argparse.Namespace
) -> tuple[Options, list[Path]]:
    """Put ns-3's sendings beside the receptions of the same way."""
    sendings = [file for file in inputs if is_ns3_sendings(first_line(file))]
    rest = [file for file in inputs if file not in sendings]
    named = {UPLINK: arguments.uplink, DOWNLINK: arguments.downlink}
    ways: dict[Path, int | None]
    ways = {file: way for way, file in named.items() if file is not None}
    ways |= {file: way_in_name(file) for file in rest}
    if not sendings or not ways:
        return options, inputs
    beside = {}
    for file in sendings:
        way = way_in_name(file)
        of = [each for each, other in ways.items() if len(ways) == 1 or other == way]
        if len(of) != 1 or of[0] in beside:
            raise ProfileError(
                f"{file}: expected one file of receptions of the same sendings, got {len(of)}; "
                "give the file of the receptions beside it"
            )
        beside[of[0]] = file
    return replace(options, beside=beside), rest


def _refuse_flags(arguments: argparse.Namespace, formats: list[Format], name: str) -> None:
    """Raise `ConfigError` for a flag that none of the formats takes."""
    for flag, field, *_ in _FLAGS:
        key = flag.replace("-", "_")
        if getattr(arguments, field) is not None and not any(key in f.options for f in formats):
            takers = ", ".join(each.name for each in FORMATS if key in each.options)
            raise ConfigError(
                f"--{flag}: expected a file of {takers}, got {formats[0].name} in {name}; leave "
                f"--{flag} out, or name the --format"
            )


def _with_capacity(measured: Measured, options: Options) -> Measured:
    if options.phy is None:
        return measured
    series = {**measured.series, **read_phy(options.phy, options)}
    notes = (*measured.notes, f"{options.phy.name}: {NOTE}")
    return replace(measured, series=series, notes=notes)


def _print(profile: DelayProfile, out: Path, formats: list[Format]) -> None:
    n = profile.delays_ns.shape[1]
    print(
        f"{out}: {n} periods of {profile.period_ns / 1000:g} µs, "
        f"{profile.duration_ns * 1e-9:.6g} s, from {formats[0].name}"
    )
    imported = PROFILE not in formats
    for direction, name in enumerate(DIRECTIONS):
        delays = delays_ms(profile, name)
        passed = delays[np.isfinite(delays)]
        print(
            f"  {name}: shortest {passed.min():.3f}, median {np.median(passed):.3f}, longest "
            f"{passed.max():.3f} ms"
        )
        print(f"    {_losses_in_words(profile, direction, imported=imported)}")
    if profile.columns:
        print(f"  columns: {', '.join(profile.columns)}")
    for note in profile.metadata.get("notes", []) if imported else []:
        print(f"  {note}")


def _losses_in_words(profile: DelayProfile, direction: int, *, imported: bool) -> str:
    """The packets lost of the packets sent, and the time lost, in words."""
    lost = profile.delays_ns[direction] == LOST
    longest_s = longest_run(lost) * profile.period_ns * 1e-9
    words = [f"{100 * lost.mean():.2f} % of the time lost"]
    if lost.any():
        words.append(f"{longest_s:g} s of it at a stretch")
    name = DIRECTIONS[direction]
    if imported and name in profile.metadata["packets"]:
        sent, missing = (profile.metadata[key][name] for key in ("packets", "packets_lost"))
        words.insert(
            0,
            f"{sent} packets, of lost ones nothing is known"
            if missing is None
            else f"{missing} of {sent} packets lost ({100 * missing / sent:.2f} %)",
        )
        words.append(f"{100 * profile.metadata['interpolated'][name]:.1f} % of it interpolated")
        words.append(f"packets {profile.metadata['spacing_ms'][name]:.4g} ms apart")
    return ", ".join(words)
