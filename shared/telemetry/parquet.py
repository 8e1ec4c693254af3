"""Rows as Parquet tables: written at the end of a run, read whole or in chunks."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shared.telemetry.row_log import row_chunks
from shared.telemetry.schema import Column, Schema

if TYPE_CHECKING:
    import pyarrow as pa


def write_parquet(schema: Schema, rows: np.ndarray, path: Path) -> None:
    """Write rows as a Parquet table, whole or not at all.

    Each column of the schema is a column; vectors are fixed-size lists. Raise `OSError` if the file
    cannot be written.
    """
    # Imported here: control loops, which only fill rows, should not hold Arrow's memory.
    import pyarrow as pa
    import pyarrow.parquet as pq

    def field(column: Column) -> pa.DataType:
        kind = pa.from_numpy_dtype(np.dtype(column.kind))
        return kind if column.width == 1 else pa.list_(kind, column.width)

    arrow_schema = pa.schema([(column.name, field(column)) for column in schema.columns])
    unfinished = path.with_name(f"{path.name}.part")
    try:
        with pq.ParquetWriter(unfinished, arrow_schema, compression="zstd") as writer:
            for chunk in row_chunks(rows):
                arrays = []
                for column in schema.columns:
                    values = np.ascontiguousarray(chunk[:, schema.slices[column.name]])
                    flat = pa.array(values.astype(column.kind).ravel())
                    arrays.append(
                        flat
                        if column.width == 1
                        else pa.FixedSizeListArray.from_arrays(flat, column.width)
                    )
                writer.write_table(pa.table(arrays, schema=arrow_schema))
        unfinished.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise


def read_parquet(path: Path, *, columns: Sequence[str] | None = None) -> tuple[Schema, np.ndarray]:
    """Return the schema and the rows of a table of `write_parquet`, or of some of its columns."""
    import pyarrow.parquet as pq

    # In this thread: Arrow waits for ever for threads for which there is no memory.
    with pq.ParquetFile(path, pre_buffer=False) as file:
        table = file.read(columns=None if columns is None else list(columns), use_threads=False)
    return _schema_of(table.schema), _rows_of(table)


def parquet_shape(path: Path) -> tuple[Schema, int]:
    """Return the schema and the number of rows of such a table, without reading the rows."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        return _schema_of(file.schema_arrow), file.metadata.num_rows


def parquet_chunks(path: Path, *, size: int = 20_000) -> Iterator[tuple[Schema, np.ndarray]]:
    """Yield such a table in chunks of at most `size` rows, each with its schema."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        # One row group at a time: over several groups, Arrow keeps all that it has read.
        for group in range(file.num_row_groups):
            for batch in file.iter_batches(batch_size=size, row_groups=[group]):
                yield _schema_of(batch.schema), _rows_of(pa.Table.from_batches([batch]))


def _schema_of(fields: pa.Schema) -> Schema:
    import pyarrow as pa

    columns = []
    for field in fields:
        width, kind = 1, field.type
        if pa.types.is_fixed_size_list(kind):
            width, kind = kind.list_size, kind.value_type
        columns.append(Column(field.name, width, str(kind).replace("double", "float64")))
    return Schema(*columns)


def _rows_of(table: pa.Table) -> np.ndarray:
    import pyarrow as pa

    parts = []
    for chunked in table.columns:
        array, width = chunked.combine_chunks(), 1
        if pa.types.is_fixed_size_list(array.type):
            width, array = array.type.list_size, array.flatten()
        parts.append(array.to_numpy(zero_copy_only=False).astype(np.float64).reshape(-1, width))
    return np.hstack(parts)
