"""The files of both directions of a link, or one file and the user's setting for the other
direction.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from netem.importers.captures import read_captures
from netem.importers.formats import PCAP, Format
from netem.importers.measured import Measured
from netem.importers.options import Options
from netem.profile import DIRECTIONS, DOWNLINK, UPLINK
from shared.config.quantities import parse_duration_ns
from shared.errors import ConfigError, ProfileError

# As in UlPdcpStats.txt, NrDlPdcpRxStats.txt, downlink.csv or LTE-driving.up.
_WAY = re.compile(
    r"(?:^|[^A-Za-z])(?:Nr)?([Uu][LlPp]|[Dd][Ll]|[Dd][Oo][Ww][Nn])(?=(?i:link|stream)|[^a-z]|$)"
)


def files_by_way(
    inputs: list[Path], uplink: Path | None, downlink: Path | None
) -> dict[int | None, Path]:
    """The files by direction. The key None has a file that may be of either direction."""
    named: dict[int | None, Path] = {}
    for direction, path in ((UPLINK, uplink), (DOWNLINK, downlink)):
        if path is not None:
            named[direction] = path
    if named and inputs:
        raise ProfileError(
            "convert: expected files in order, or by --uplink and --downlink, got both; use one "
            "form"
        )
    if named:
        return named
    if len(inputs) not in (1, 2):
        raise ProfileError(
            f"convert: expected IN [IN2] OUT, got {len(inputs)} files to read; give one file of "
            "both directions, or uplink and downlink"
        )
    ways = [way_in_name(path) for path in inputs]
    if len(inputs) == 2:
        if ways[0] == DOWNLINK or ways[1] == UPLINK:
            raise ProfileError(
                f"convert: expected the uplink first, got {inputs[0]} and {inputs[1]}; change the "
                "order, or name them by --uplink and --downlink"
            )
        return {UPLINK: inputs[0], DOWNLINK: inputs[1]}
    return {ways[0]: inputs[0]}


def way_in_name(path: Path) -> int | None:
    """The direction that a file's name tells."""
    match = _WAY.search(path.name)
    if match is None:
        return None
    return UPLINK if match[1].lower().startswith("u") else DOWNLINK


def read_both_ways(
    files: dict[int | None, Path], formats: list[Format], other_way: str | None, options: Options
) -> tuple[Measured, int | None]:
    """The measurement of both directions, and the constant delay of a direction without a file
    [ns].
    """
    paths = list(files.values())
    if PCAP in formats:
        if len(paths) != 2 or formats[0] != formats[1]:
            raise ProfileError(
                f"{paths[0]}: expected two captures, on the robot's side and on the edge's, got "
                f"{' and '.join(each.name for each in formats)}; give both captures"
            )
        measured = read_captures(paths[0], paths[1], options)
    else:
        parts = []
        for (direction, path), each in zip(files.items(), formats, strict=True):
            assert each.read is not None
            parts.append(each.read(path, options, UPLINK if direction is None else direction))
        if len(parts) == 2:
            for path, part in zip(paths, parts, strict=True):
                if None not in part.ways:
                    raise ProfileError(
                        f"{path}: expected a file of one direction, got both directions; give it "
                        "alone"
                    )
            _expect_none(other_way)
            return _together(parts[0], parts[1]), None
        measured = parts[0]
    if None not in measured.ways:
        _expect_none(other_way)
        return measured, None
    return _completed(measured, files, formats[0], other_way, options)


def _completed(
    measured: Measured,
    files: dict[int | None, Path],
    each: Format,
    other_way: str | None,
    options: Options,
) -> tuple[Measured, int | None]:
    """Add the missing direction. Return the measurement, and the constant delay of that direction
    [ns] if it has one.
    """
    path = next(iter(files.values()))
    known = UPLINK if measured.ways[DOWNLINK] is None else DOWNLINK
    if other_way is None and not each.either_way:
        raise ProfileError(
            f"{path}: expected both directions, got one; give the other file too (--uplink FILE "
            "--downlink FILE), or --other-way same or --other-way constant:5ms"
        )
    if other_way in (None, "same"):
        note = f"{DIRECTIONS[1 - known]}: from the same file as the {DIRECTIONS[known]}"
        if each.read is None:
            same = measured.ways[known]
            return replace(measured, ways=(same, same), notes=(*measured.notes, note)), None
        other = each.read(path, options, 1 - known)
        return _together(measured, replace(other, notes=(*other.notes, note))), None
    kind, _, text = (other_way or "").partition(":")
    if kind != "constant":
        raise ConfigError(f"--other-way: expected same or constant:5ms, got {other_way!r}")
    if None in files:
        raise ProfileError(
            f"{path}: expected a known direction, got a file name without one; try "
            f"--uplink {path.name} or --downlink {path.name}"
        )
    try:
        constant_ns = parse_duration_ns(text)
    except ConfigError as error:
        raise ConfigError(f"--other-way: {error}") from None
    note = f"{DIRECTIONS[1 - known]}: not measured, {constant_ns * 1e-6:g} ms throughout"
    return replace(measured, notes=(*measured.notes, note)), constant_ns


def _expect_none(other_way: str | None) -> None:
    if other_way is not None:
        raise ConfigError(
            "--other-way: expected a measurement of one way, got both ways; leave --other-way out"
        )


def _together(first: Measured, second: Measured) -> Measured:
    up, down = (a or b for a, b in zip(first.ways, second.ways, strict=True))
    return Measured(
        (up, down),
        tuple(dict.fromkeys(first.notes + second.notes)),
        {**first.metadata, **second.metadata},
        {**first.series, **second.series},
        first.two_clocks or second.two_clocks,
    )
