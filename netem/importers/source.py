"""Reading files of other programs: plain or gzipped, line by line, in bounded memory.

Every fault of such a file ends in a `ProfileError` of one line. It names the file, the line (or
record) and the expected content.
"""

from __future__ import annotations

import gzip
import io
import itertools
import json
import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from shared.errors import ProfileError
from shared.regular_file import open_regular

MAX_RECORDS = 20_000_000
_MAX_LINE = 1 << 16
_MAX_JSON = 1 << 29
MAX_NS = 4.6e18  # 62 bits: sums and differences of two still fit 63
_GZIP = b"\x1f\x8b"
_BYTE_ORDER_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}


@contextmanager
def opened(path: Path) -> Iterator[io.BufferedReader | gzip.GzipFile]:
    """The file's bytes, unzipped if it is gzipped."""
    try:
        with open_regular(path) as file:
            if file.peek(2)[:2] == _GZIP:
                with gzip.GzipFile(fileobj=file) as unzipped:
                    yield unzipped
            else:
                yield file
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ProfileError(
            f"{path}: expected a whole gzip file, got a damaged one: {error}"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ProfileError(f"{path}: cannot read it: {reason}") from None


def head(path: Path, *, size: int) -> bytes:
    """The first `size` bytes, or fewer at the end of the file or where it is damaged."""
    with opened(path) as file:
        data = b""
        try:
            while len(data) < size and (chunk := file.read1(size - len(data))):
                data += chunk
        except (EOFError, zlib.error):
            pass  # the reader of the rest finds the damage again, and reports more of it
        return data


def decoded(data: bytes) -> str:
    """Text of any encoding that announces itself, else UTF-8. Invalid bytes are replaced."""
    return data.decode(_encoding(data), errors="replace")


def first_line(path: Path) -> str:
    """The first line with content among the first bytes of a file of any kind; empty if none."""
    text = decoded(head(path, size=1 << 12))
    return next((line for line in text.splitlines() if line.strip() and line[0] != "#"), "")


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line, without its end (any of CR LF, LF, CR)."""
    with opened(path) as file:
        text = io.TextIOWrapper(file, encoding=_encoding(file.peek(3)), errors="replace")
        for number in range(1, MAX_RECORDS + 2):
            line = text.readline(_MAX_LINE)
            if not line:
                return
            if len(line) == _MAX_LINE or number > MAX_RECORDS:
                raise ProfileError(
                    f"{path}, line {number}: expected at most {MAX_RECORDS} lines, each shorter "
                    f"than {_MAX_LINE} characters, got more; cut the file"
                )
            yield number, line.rstrip("\n")


def content_lines(path: Path, *, comments: str = "#") -> Iterator[tuple[int, str]]:
    """The lines that are neither blank nor comments."""
    return (
        (n, line) for n, line in lines(path) if line.strip() and line.lstrip()[0] not in comments
    )


def is_unfinished(path: Path, line: int) -> bool:
    """Return whether that line is the last one and has no end: its writer was stopped."""
    with opened(path) as file:
        text = io.TextIOWrapper(file, encoding=_encoding(file.peek(3)), errors="replace")
        return not next(itertools.islice(text, line - 1, None), "\n").endswith("\n")


def json_document(path: Path, writer: str) -> Any:
    """The document in a file of JSON. `ProfileError` names the line where the JSON is wrong."""
    with opened(path) as file:
        data = file.read(_MAX_JSON + 1)
    if len(data) > _MAX_JSON:
        raise ProfileError(
            f"{path}: expected at most {_MAX_JSON >> 20} MiB of JSON, got more; measure for a "
            "shorter time"
        )
    try:
        return json.loads(decoded(data))
    except json.JSONDecodeError as error:
        raise ProfileError(
            f"{path}, line {error.lineno}: expected whole JSON, as {writer} writes it, got: "
            f"{error.msg}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise ProfileError(f"{path}: expected JSON as {writer} writes it, got: {error}") from None


def wrong(path: Path, where: str, expected: str, got: object) -> ProfileError:
    """The error for one place in a file, as in `wrong(path, "line 4", "a delay", cell)`."""
    text = got if isinstance(got, str) else repr(got)
    shown = text if len(text) <= 60 else text[:60] + "…"
    return ProfileError(f"{path}, {where}: expected {expected}, got {shown!r}")


def number(text: str, path: Path, where: str, what: str) -> float:
    """A finite number."""
    try:
        value = float(text)
        if not math.isfinite(value) or "_" in text:
            raise ValueError
    except ValueError:
        raise wrong(path, where, what, text) from None
    return value


def whole(text: str, path: Path, where: str, what: str, *, low: int, high: int) -> int:
    """A whole number from `low` to `high`."""
    try:
        value = int(text)
        if not low <= value <= high or "_" in text:
            raise ValueError
    except ValueError:
        raise wrong(path, where, what, text) from None
    return value


def nanoseconds(text: str, unit_ns: int, path: Path, where: str, what: str) -> int:
    """A time in units of `unit_ns` as ns, exact if it is a whole number of units."""
    try:
        value = int(text) * unit_ns
    except ValueError:
        exact = number(text, path, where, what) * unit_ns
        value = round(exact) if abs(exact) < MAX_NS else int(MAX_NS)
    if not abs(value) < MAX_NS or "_" in text:
        raise wrong(path, where, f"{what}, within 146 years (are the units right?)", text)
    return value


def _encoding(start: bytes) -> str:
    for mark, encoding in _BYTE_ORDER_MARKS.items():
        if start.startswith(mark):
            return encoding
    return "utf-8"
