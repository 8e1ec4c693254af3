"""Make pictures and short animations of runs, without a screen.

They show the same as the view: rerun draws the same recording with the same layout into memory. It
needs a graphics adapter with Vulkan; Mesa's software adapter suffices.
"""

from __future__ import annotations

import io
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image
from rerun.experimental import ViewerClient

from shared.errors import UserError
from viewer.blueprint import Picture
from viewer.colours import (
    CHOSEN,
    COM,
    FORCE,
    LEFT_FOOT,
    LIMIT,
    PLAN,
    PRESSURE,
    PUSH,
    RIGHT_FOOT,
    SUPPORT,
)
from viewer.recorder import TIMELINE
from viewer.recording import run_names, save
from viewer.rerun_process import HOST, RerunProcess, free_port
from viewer.run_folder import RunFolder, read_run
from viewer.video import write_mp4

# Size of a picture in points. rerun leaves an empty bar in place of its top panel.
SIZE = (1600, 960)
_EMPTY_BAR = 37
ANIMATION_WIDTH = 960
WHOLE = Picture()
FRAMES_PER_SECOND = 12
MAX_FRAMES = 600
ANIMATIONS = (".gif", ".webp", ".mp4")
_LOAD_TIMEOUT = 60.0
_SAME = 3
_ATTEMPTS = 5
_GRAPHICS = (
    "snapshot: rerun finds no graphics adapter ({reason}); install a graphics driver with Vulkan, "
    "or Mesa's software one (on Debian: apt install mesa-vulkan-drivers)"
)


def picture(
    paths: Sequence[Path],
    out: Path,
    *,
    at: float | None = None,
    size: tuple[int, int] = SIZE,
    shown: Picture = WHOLE,
) -> None:
    """Make a picture of one run or several at `at` [s] of the task, by default the end."""
    if out.suffix != ".png":
        raise UserError(f"--out: expected a name ending in .png, got {out}")
    runs = [read_run(path) for path in paths]
    duration = _duration(runs)
    at = duration if at is None else at
    if not 0.0 <= at <= duration:
        raise UserError(f"--at: expected a time in the run, 0 to {duration:.3f} s, got {at:g}")
    (drawn,) = _draw(runs, [at], size=size, shown=shown)
    _write(drawn, out)


def animation(
    paths: Sequence[Path],
    out: Path,
    *,
    begin: float,
    end: float | None,
    speed: float,
    size: tuple[int, int] = SIZE,
    shown: Picture = WHOLE,
) -> None:
    """Make an animation from `begin` to `end` [s] of the task, at `speed` times real time."""
    if out.suffix not in ANIMATIONS:
        raise UserError(
            f"--animation: expected a name ending in {', '.join(ANIMATIONS)}, got {out}"
        )
    if not (math.isfinite(speed) and speed > 0.0):
        raise UserError(f"--speed: expected a number above 0, got {speed:g}")
    runs = [read_run(path) for path in paths]
    duration = _duration(runs)
    end = duration if end is None else end
    if not 0.0 <= begin < end <= duration:
        raise UserError(
            f"--span: expected a span of the run, within 0:{duration:.3f}, got {begin:g}:{end:g}"
        )
    count = (end - begin) / speed * FRAMES_PER_SECOND
    if count > MAX_FRAMES:
        raise UserError(
            f"--animation: expected at most {MAX_FRAMES} frames, got {count:.0f}; use a shorter "
            "--span or a higher --speed"
        )
    times = [begin + k * speed / FRAMES_PER_SECOND for k in range(math.ceil(count))]
    drawn = _draw(runs, times, size=size, shown=shown)
    if out.suffix == ".mp4":
        write_mp4(out, drawn, frames_per_second=FRAMES_PER_SECOND)
        return
    height = round(ANIMATION_WIDTH / size[0] * size[1])
    frames = [each.resize((ANIMATION_WIDTH, height)) for each in drawn]
    frame_ms = round(1e3 / FRAMES_PER_SECOND)
    options: dict[str, Any] = {"save_all": True, "duration": frame_ms, "loop": 0}
    if out.suffix == ".gif":
        # One palette without dithering: parts that do not move then cost nothing.
        palette = _palette(frames[len(frames) // 2])
        frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    else:
        options |= {"quality": 60, "method": 4}
    _write(frames[0], out, append_images=frames[1:], **options)


def _duration(runs: Sequence[RunFolder]) -> float:
    """Return the duration of the longest run [s]; raise `UserError` if no task began."""
    duration = max(run.duration for run in runs)
    if duration <= 0.0:
        raise UserError(
            f"snapshot: expected a run whose task began, got {' and '.join(run_names(runs))}; "
            "play it again"
        )
    return duration


def _palette(frame: Image.Image) -> Image.Image:
    """Return a palette: the colours of a frame, and of lines and arrows, bright and shaded."""
    marks = (LIMIT, FORCE, PLAN, COM, SUPPORT, PRESSURE, PUSH, LEFT_FOOT, RIGHT_FOOT, CHOSEN)
    lines = [round(shade * part) for colour in marks for shade in (1.0, 0.7) for part in colour]
    common = 256 - len(lines) // 3
    palette = Image.new("P", (1, 1))
    palette.putpalette((frame.quantize(common).getpalette() or [])[: 3 * common] + lines)
    return palette


def _draw(
    runs: Sequence[RunFolder],
    times: Sequence[float],
    *,
    size: tuple[int, int],
    shown: Picture,
) -> Iterator[Image.Image]:
    """Yield the view at each of these times [s]; raise `UserError` if it cannot be drawn."""
    with tempfile.TemporaryDirectory(prefix="snapshot-") as folder:
        file, shot = Path(folder) / "recording.rrd", Path(folder) / "shot.png"
        save(runs, file, picture=shown)
        port = free_port()
        width, height = size[0], size[1] + _EMPTY_BAR
        window = ("--headless", "--window-size", f"{width}x{height}", "--hide-welcome-screen")
        rerun = RerunProcess(*window, "--port", str(port), str(file))
        try:
            url = f"rerun+http://{HOST}:{port}/proxy"
            reason = rerun.wait(lambda started: _loaded(url, times[-1]), timeout=_LOAD_TIMEOUT)
            if reason is not None and rerun.running:
                raise UserError(
                    f"snapshot: rerun read no run within {_LOAD_TIMEOUT:g} s; try again"
                )
            if reason is not None:
                raise UserError(_GRAPHICS.format(reason=reason))
            client = ViewerClient(url)
            _settle(client, times[0], shot)
            for at in times:
                with Image.open(io.BytesIO(_shot(client, at, shot))) as image:
                    yield image.convert("RGB").crop((0, _EMPTY_BAR, width, height))
        finally:
            rerun.stop()


def _loaded(url: str, until: float) -> bool:
    """Return whether the viewer at `url` has the recording up to the time `until` [s]."""
    try:
        recordings = ViewerClient(url).get_state().recordings
    except (ConnectionError, TimeoutError, RuntimeError):
        time.sleep(0.1)
        return False
    ends = [
        each.end
        for recording in recordings
        for each in recording.timelines
        if each.name == TIMELINE
    ]
    return any(end is not None and end >= round(until * 1e9) for end in ends)


def _settle(client: ViewerClient, at: float, shot: Path) -> None:
    """Wait until axes and colours no longer move: `_SAME` pictures in a row are equal."""
    same, before = 0, b""
    deadline = time.monotonic() + _LOAD_TIMEOUT
    while same < _SAME and time.monotonic() < deadline:
        now = _shot(client, at, shot)
        same = same + 1 if now == before else 0
        before = now


def _shot(client: ViewerClient, at: float, shot: Path) -> bytes:
    """Return the view at `at` [s] as PNG; raise `UserError` if rerun does not answer."""
    for _ in range(_ATTEMPTS):
        try:
            client.set_time(TIMELINE, duration=at, play_state="paused")
            client.save_screenshot(str(shot))
            return shot.read_bytes()
        except TimeoutError:
            continue  # A busy machine takes longer than rerun's client waits.
        except (ConnectionError, RuntimeError) as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"snapshot: rerun ended or refuses to draw ({reason})") from None
    raise UserError(
        f"snapshot: expected a picture, got none in {_ATTEMPTS} attempts; try an idle machine"
    )


def _write(image: Image.Image, out: Path, **options: Any) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        image.save(out, **options)
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror or error}") from None
