"""Arrays in a user's `.npz` file, without pickles and of bounded size."""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from shared.regular_file import read_regular

_READ_HEADER = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_npz(path: Path, *, at_most: int, array_at_most: int) -> dict[str, np.ndarray]:
    """Return the arrays of a file of `at_most` bytes, each of `array_at_most` bytes.

    Raise `ValueError` if it is no such file, `OSError` if it cannot be read.
    """
    try:
        data = io.BytesIO(read_regular(path, at_most=at_most))
        _check_claims(data, array_at_most)
        with np.load(data, allow_pickle=False) as archive:
            return {key: np.asarray(archive[key]) for key in archive.files}
    except (
        *(KeyError, TypeError, AttributeError, EOFError, NotImplementedError, RuntimeError),
        *(zipfile.BadZipFile, zlib.error, tokenize.TokenError),
    ) as error:
        raise ValueError(str(error)) from None


def _check_claims(data: io.BytesIO, at_most: int) -> None:
    """Check the sizes that an archive and its arrays claim, before memory is allocated.

    Raise `ValueError` if an array has more than `at_most` bytes, or claims more than it has.
    """
    with zipfile.ZipFile(data) as archive:
        for info in archive.infolist():
            with archive.open(info) as member:
                version = np.lib.format.read_magic(member)
                read = _READ_HEADER.get(version)
                if read is None:
                    raise ValueError(f"{info.filename}: unknown version {version} of an array")
                shape, _, kind = read(member)
                n_bytes = math.prod(shape) * kind.itemsize
                if n_bytes > info.file_size or info.file_size > at_most:
                    raise ValueError(
                        f"{info.filename}: expected the claimed {n_bytes:.4g} bytes, and at most "
                        f"{at_most:.4g}, got {info.file_size:.4g}"
                    )
    data.seek(0)
