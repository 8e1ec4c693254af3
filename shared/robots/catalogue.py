"""The robots by name. To add a robot, write a robot file; no module of the project names a robot.

The files of the project's own robots are in the folder `files`. `docs/own-robot.md` says where to
read off each number of a file.
"""

from __future__ import annotations

import functools
import importlib.util
from dataclasses import dataclass
from pathlib import Path

from shared.errors import ConfigError
from shared.extensions import Names, announced
from shared.robots.description import Robot, RobotDescription
from shared.robots.robot_file import read_robot

_FILES = Path(__file__).with_name("files")
# The file of each of the project's robots.
CATALOGUE: dict[str, Path] = {path.stem: path for path in sorted(_FILES.glob("*.toml"))}


@dataclass(frozen=True)
class RobotNames(Names):
    """The table of robots.

    A reference is the path of a robot file. The entry point NAME of another package names a Python
    package, in whose folder the file NAME.toml lies.
    """

    forms = "FILE.toml"

    def is_reference(self, value: str) -> bool:
        return value.endswith(".toml")

    def absolute(self, value: str, folder: Path) -> str:
        return str((folder / value).resolve()) if self.is_reference(value) else value

    def label(self, value: str) -> str:
        """Return the name of a robot, which is that of its file."""
        return Path(value).stem if self.is_reference(value) else value

    def load(self, value: str) -> RobotDescription:
        return description_of(value)

    def identity(self, value: str) -> str:
        return self.load(value).digest

    def file(self, value: str) -> Path:
        """Return the path of a robot's file. Raise `ConfigError` if there is no such robot."""
        try:
            self.check(value)
        except ConfigError as error:
            raise ConfigError(f"{self.what}: {error}") from None
        if self.is_reference(value):
            return Path(value)
        return Path(self.own[value]) if value in self.own else self._in_package(value)

    def _in_package(self, name: str) -> Path:
        package = announced(self.group)[name]
        try:
            spec = importlib.util.find_spec(package)
        except ImportError:
            spec = None
        if spec is None or not spec.submodule_search_locations:
            raise ConfigError(
                f"{self.what} {name}: expected the entry point to name a package with the file "
                f"{name}.toml, got {package!r}; see {self.page}"
            )
        return Path(next(iter(spec.submodule_search_locations))) / f"{name}.toml"


ROBOTS = RobotNames(
    "robot",
    "remote_wbc.robots",
    {name: str(path) for name, path in CATALOGUE.items()},
    "docs/own-robot.md",
)


def description_of(name: str) -> RobotDescription:
    """Return the content of a robot's file, by the robot's name or by the path of the file.

    Raise `ConfigError` if there is no such robot, or if its file cannot be used.
    """
    path = ROBOTS.file(name)
    try:
        status = path.stat()
    except OSError:
        return read_robot(path)  # which refuses it
    return _read_once(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=16)
def _read_once(path: Path, changed_ns: int, size: int) -> RobotDescription:
    return read_robot(path)


def load_robot(name: str) -> Robot:
    """Load a robot by its name or by the path of its file; raise `ConfigError` as
    `description_of`, and if the robot fails a check.
    """
    # Imported here: a process that needs only a robot's settings, as the shim, loads no Pinocchio.
    from shared.robots.loading import load

    return load(description_of(name))
