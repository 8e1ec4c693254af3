"""Rows of measurements, from a real-time loop to a file, a live view and statistics.

A loop fills one row of numbers per tick, message or solve into a block; a full block is handed to a
background thread, which appends it to a file and publishes it. So the loop is never blocked, and
its memory does not grow. Afterwards the file becomes a Parquet table. In lockstep there is no file:
the blocks stay in memory.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import numpy as np

from shared.telemetry.schema import Column, Schema

BLOCK_ROWS = 100


class RowLog:
    """Rows under one schema. `row()` gives the next row to fill; `close()` ends the log.

    With a `path`, blocks go to `path` as raw float64 and memory stays bounded; without one, blocks
    stay in memory. `publish` receives each block's encoding on the background thread. The file
    holds at most `at_most` rows. Later rows are only published, and so are rows that cannot be
    written: `failure` is then the error.
    """

    def __init__(
        self,
        schema: Schema,
        *,
        path: Path | None = None,
        publish: Callable[[bytes], None] | None = None,
        at_most: int | None = None,
    ) -> None:
        self.schema = schema
        self.path = path
        self.failure: OSError | None = None
        self._publish = publish
        self._left = at_most
        self._kept: list[np.ndarray] = []
        self._block = np.zeros((BLOCK_ROWS, schema.width))
        self._used = 0
        self._queue: queue.SimpleQueue[np.ndarray | None] = queue.SimpleQueue()
        self._file = path.open("wb") if path is not None else None
        self._thread: threading.Thread | None = None
        if self._file is not None or publish is not None:
            self._thread = threading.Thread(target=self._drain, name="row-log", daemon=True)
            self._thread.start()

    def row(self) -> np.ndarray:
        """Return the next row, shape (schema.width,), zeroed; fill it before the next call."""
        if self._used == BLOCK_ROWS:
            self._hand_over()
        self._used += 1
        row: np.ndarray = self._block[self._used - 1]
        return row

    def close(self) -> None:
        """Hand over the last rows and wait until they are written."""
        self._hand_over()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(timeout=10.0)
            self._thread = None
        if self._file is not None:
            with contextlib.suppress(OSError):  # the same error as in `failure`
                self._file.close()
            self._file = None

    def rows(self) -> np.ndarray:
        """Return all rows of a closed log, shape (n, schema.width); memory-mapped from a file."""
        if self.path is None:
            return np.concatenate(self._kept) if self._kept else np.zeros((0, self.schema.width))
        width = self.schema.width
        count = self.path.stat().st_size // (width * np.dtype(np.float64).itemsize)
        if count == 0:
            return np.zeros((0, width))
        return np.memmap(self.path, dtype=np.float64, mode="r", shape=(count, width))

    def _hand_over(self) -> None:
        block, self._block = self._block[: self._used], np.zeros_like(self._block)
        self._used = 0
        if not len(block):
            return
        if self.path is None:
            self._kept.append(block)
        if self._thread is not None:
            self._queue.put(block)

    def _drain(self) -> None:
        while (block := self._queue.get()) is not None:
            if self._file is not None and self.failure is None:
                kept = block[: self._left]
                try:
                    self._file.write(kept.data)
                    self._file.flush()
                except OSError as error:
                    self.failure = error
                if self._left is not None:
                    self._left -= len(kept)
            if self._publish is not None:
                self._publish(encode_rows(self.schema, block))


def encode_rows(schema: Schema, rows: np.ndarray) -> bytes:
    """Encode a block of rows with its schema, for the telemetry session."""
    columns = [(column.name, column.width, column.kind) for column in schema.columns]
    return bytes(msgpack.packb({"columns": columns, "rows": rows.tobytes()}))


def decode_rows(data: bytes) -> tuple[Schema, np.ndarray]:
    """Return schema and rows (n, width) of a telemetry block; `ValueError` if it is not one."""
    try:
        block = msgpack.unpackb(data)
        schema = Schema(*(Column(*column) for column in block["columns"]))
        rows = np.frombuffer(block["rows"], dtype=np.float64).reshape(-1, schema.width)
    except (msgpack.UnpackException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"not a telemetry block: {error}") from None
    return schema, rows


def row_chunks(rows: np.ndarray, *, size: int = 20_000) -> Iterator[np.ndarray]:
    """Yield the rows in chunks of at most `size`."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]
