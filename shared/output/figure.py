"""Write figures to files."""

from __future__ import annotations

from pathlib import Path

from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from shared.errors import ConfigError


def save_figure(figure: Figure, path: Path, *, what: str, dpi: int = 110) -> None:
    """Write a figure and close it; make its folder if there is none.

    Raise `ConfigError`, which begins with `what`, if it cannot be written.
    """
    figure.tight_layout()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{what}: cannot write {path}: {error}") from None
    finally:
        plt.close(figure)
