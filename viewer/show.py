"""Show finished runs on a screen, one or several side by side, until the window is closed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from shared.output.screen import has_screen
from viewer.display import Display
from viewer.recording import blueprint, log_runs, new_recording, run_names
from viewer.run_folder import read_run

_LOOK = 0.1


def show(
    paths: Sequence[Path],
    *,
    view: str,
    stopped: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Show runs until `stopped` or the window is closed.

    `auto` opens a window, or a browser if there is no screen. Raise `UserError` if a path is no
    run, or if nothing can be opened.
    """
    runs = [read_run(path) for path in paths]
    recording = new_recording(" and ".join(run_names(runs)))
    if view == "auto":
        view = "native" if has_screen() else "web"
    display = Display(recording, view, blueprint=blueprint(runs), file=None)
    try:
        log_runs(recording, runs)
        recording.flush()
        say(f"{' and '.join(run_names(runs))}: {display.state}; Ctrl-C ends")
        if display.address:
            say(display.address)
        while display.shown and not stopped():
            time.sleep(_LOOK)
    finally:
        display.close()
