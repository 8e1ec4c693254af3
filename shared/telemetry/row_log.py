"""Rows of measurements, from a real-time loop to a file, a live view and statistics.

A loop fills one row of numbers per tick, message or solve into a block; a full block is handed to a
background thread, which appends it to a file and publishes it. So the loop is never blocked, and
its memory does not grow. Afterwards the file becomes a Parquet table. In lockstep there is no file:
the blocks stay in memory.

The file begins with a line of JSON, the columns. If the process is killed, `read_rows` returns the
rows, without those of the last block. The process locks the file, which tells a killed process from
a living one.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
from collections.abc import Callable, Iterator
from io import BufferedWriter
from pathlib import Path

import msgpack
import numpy as np

from shared.file_lock import lock
from shared.telemetry.schema import Column, Schema

BLOCK_ROWS = 100
# An hour at 1 kHz: a service that runs for days should not fill the disk.
MAX_ROWS = 3_600_000
_FLOAT_BYTES = np.dtype(np.float64).itemsize
# A longer first line is not the line of columns.
_MAX_HEADER_BYTES = 65_536
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
# Others hold the lock for a moment, to see whether this process lives.
_LOCK_SECONDS = 1.0


class RowLog:
    """Rows under one schema. `row()` gives the next row to fill; `close()` ends the log.

    With a `path`, blocks go to `path` as raw float64 and memory stays bounded; without one, blocks
    stay in memory. `publish` receives each block's encoding on the background thread. The file
    holds at most `at_most` rows. Later rows are only published, and so are rows that cannot be
    written: `failure` is then the error.

    `complete` fills, in each block (n, width), the columns that follow from others. It runs on the
    background thread if there is one.
    """

    def __init__(
        self,
        schema: Schema,
        *,
        path: Path | None = None,
        publish: Callable[[bytes], None] | None = None,
        at_most: int | None = None,
        complete: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        self.schema = schema
        self.path = path
        self.failure: OSError | None = None
        self._publish = publish
        self._left = at_most
        self._complete = complete
        self._kept: list[np.ndarray] = []
        self._block = np.zeros((BLOCK_ROWS, schema.width))
        self._used = 0
        self._queue: queue.SimpleQueue[np.ndarray | None] = queue.SimpleQueue()
        self._file: BufferedWriter | None = None
        self._removed: np.ndarray | None = None
        if path is not None:
            # For this user alone: others could hold its lock.
            self._file = os.fdopen(os.open(path, _NEW_FILE, 0o600), "wb")
            with self._keeping_failure():
                lock(self._file, within=_LOCK_SECONDS)
                self._file.write(_header(schema))
                self._file.flush()
        self._thread: threading.Thread | None = None
        if self._file is not None or publish is not None:
            self._thread = threading.Thread(target=self._drain, name="row-log", daemon=True)
            self._thread.start()

    def row(self) -> np.ndarray:
        """Return the next row, shape (schema.width,), zeroed; fill it before the next call."""
        if self._used == BLOCK_ROWS:
            self.hand_over()
        self._used += 1
        row: np.ndarray = self._block[self._used - 1]
        return row

    def close(self) -> None:
        """Hand over the last rows, and wait at most ten seconds until they are written."""
        self.hand_over()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(timeout=10.0)
            self._thread = None
        if self._file is not None:
            if self.path is not None and not self.path.exists():
                # The rows of a file that was removed can be read while it is open, or mapped.
                with contextlib.suppress(OSError, ValueError):
                    self._removed = read_rows(Path(f"/dev/fd/{self._file.fileno()}"))[1]
            with contextlib.suppress(OSError):  # the same error as in `failure`
                self._file.close()
            self._file = None

    def rows(self) -> np.ndarray:
        """Return all rows of a closed log, shape (n, schema.width); memory-mapped from a file."""
        if self.path is None:
            return np.concatenate(self._kept) if self._kept else np.zeros((0, self.schema.width))
        if self._removed is not None:
            return self._removed
        try:
            return read_rows(self.path)[1]
        except ValueError:
            # The disk had no room for the first line.
            return np.zeros((0, self.schema.width))

    def give_way(self, n_bytes: int) -> None:
        """Remove the last rows of a closed log's file, as many as make room for `n_bytes`.

        Arrays that `rows` has returned must not be used any more.
        """
        if self.path is not None:
            kept = self.path.stat().st_size - n_bytes
            with self._keeping_failure():
                os.truncate(self.path, max(kept, len(_header(self.schema))))

    def hand_over(self) -> None:
        """Give the rows so far to the background thread, before their block is full."""
        block, self._block = self._block[: self._used], np.zeros_like(self._block)
        self._used = 0
        if not len(block):
            return
        if self.path is None:
            self._kept.append(block)
        if self._thread is not None:
            self._queue.put(block)
        elif self._complete is not None:
            self._complete(block)

    def _drain(self) -> None:
        while (block := self._queue.get()) is not None:
            if self._complete is not None:
                self._complete(block)
            if self._file is not None and self.failure is None:
                kept = block[: self._left]
                with self._keeping_failure():
                    self._file.write(kept.data)
                    self._file.flush()
                if self._left is not None:
                    self._left -= len(kept)
            if self._publish is not None:
                # No error of a watcher's session may end this thread, which writes the file.
                with contextlib.suppress(Exception):
                    self._publish(encode_rows(self.schema, block))

    @contextlib.contextmanager
    def _keeping_failure(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = error


def _header(schema: Schema) -> bytes:
    """Return the line of columns, padded so that the rows after it are aligned."""
    columns = [(column.name, column.width, column.kind) for column in schema.columns]
    line = json.dumps(columns).encode()
    return line + b" " * (-(len(line) + 1) % _FLOAT_BYTES) + b"\n"


def read_rows(path: Path) -> tuple[Schema, np.ndarray]:
    """Return the schema and the rows (n, width) of a log's file, memory-mapped.

    A row that is not complete is left out. Raise `ValueError` if the file is not one of a log.
    """
    with path.open("rb") as file:
        line = file.readline(_MAX_HEADER_BYTES)
    try:
        schema = Schema(*(Column(*column) for column in json.loads(line)))
        count = (path.stat().st_size - len(line)) // (schema.width * _FLOAT_BYTES)
    except (TypeError, ValueError, ArithmeticError):
        raise ValueError(f"expected the rows of a run in {path}, got another file") from None
    if count == 0:
        return schema, np.zeros((0, schema.width))
    shape = (count, schema.width)
    return schema, np.memmap(path, dtype=np.float64, mode="r", offset=len(line), shape=shape)


def encode_rows(schema: Schema, rows: np.ndarray) -> bytes:
    """Encode a block of rows with its schema, for the telemetry session."""
    columns = [(column.name, column.width, column.kind) for column in schema.columns]
    return bytes(msgpack.packb({"columns": columns, "rows": rows.tobytes()}))


def decode_rows(data: bytes, *schemas: Schema) -> tuple[Schema, np.ndarray]:
    """Return schema and rows (n, width), n ≥ 1, of a telemetry block.

    Raise `ValueError` if it is none, or if its columns are those of none of the `schemas`.
    """
    try:
        block = msgpack.unpackb(data)
        columns = tuple(Column(*column) for column in block["columns"])
        values = np.frombuffer(block["rows"], dtype=np.float64)
    except (msgpack.UnpackException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"not a telemetry block: {error}") from None
    schema = next((each for each in schemas if each.columns == columns), None)
    if schema is None:
        names = ", ".join(str(column.name) for column in columns)
        raise ValueError(f"not a telemetry block: unexpected columns {names[:200]}")
    if not len(values) or len(values) % schema.width:
        raise ValueError(
            f"not a telemetry block: expected rows of {schema.width} numbers, got {len(values)}"
        )
    return schema, values.reshape(-1, schema.width)


def row_chunks(rows: np.ndarray, *, size: int = 20_000) -> Iterator[np.ndarray]:
    """Yield the rows in chunks of at most `size`."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]
