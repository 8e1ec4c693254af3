"""A tiny biped for tests: the robot of the template, with what a test changes in its files."""

from __future__ import annotations

from pathlib import Path

from tests.processes import ROOT

_TEMPLATE = ROOT / "experiments" / "templates" / "robot" / "NAME"


def write_biped(
    folder: Path,
    *,
    name: str = "biped",
    urdf: tuple[str, str] = ("", ""),
    file: tuple[str, str] = ("", ""),
) -> Path:
    """Write a biped's URDF and robot file into a folder; each with a text replaced, once.

    Return the path of the robot file.
    """
    for suffix, (old, new) in ((".urdf", urdf), (".toml", file)):
        text = (_TEMPLATE / f"NAME{suffix}").read_text(encoding="utf-8").replace("NAME", name)
        assert old in text
        (folder / f"{name}{suffix}").write_text(text.replace(old, new, 1), encoding="utf-8")
    return folder / f"{name}.toml"
