"""Write pictures as an mp4 film, with the encoder that the package `av` brings along."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from shared.errors import UserError

# Constant quality, from 0 (no loss) to 51: lines of a pixel stay sharp.
_QUALITY = "20"


def write_mp4(out: Path, pictures: Iterable[Image.Image], *, frames_per_second: int) -> None:
    """Write pictures of one size as H.264, which all browsers play.

    Raise `UserError` if the package is not installed, or the file cannot be written.
    """
    try:
        import av
    except ImportError:
        raise UserError(
            "--animation: an .mp4 needs the package av, which is not installed; try "
            "pip install av, or a name ending in .gif or .webp"
        ) from None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(out), "w") as film:
            stream = film.add_stream("libx264", rate=frames_per_second)
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": _QUALITY}
            for number, picture in enumerate(pictures):
                # 2 × 2 pixels share their colour, so both lengths are even.
                width, height = (length // 2 * 2 for length in picture.size)
                if number == 0:
                    stream.width, stream.height = width, height
                pixels = np.asarray(picture.crop((0, 0, width, height)))
                film.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
            film.mux(stream.encode())
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror or error}") from None
