"""The values of a setting that others can extend, and the objects that they name.

A value is one of the project's names, a name that an installed package announces by an entry point,
or a reference to the user's own: `package.module:Name`, or `path/file.py:Name`. Settings of the
class may follow, `:gain=3`. A robot is a file of data instead, `path/file.toml`: see
`shared/robots/catalogue.py`.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

from shared.errors import ConfigError, one_of
from shared.user_code import LOAD_SECONDS, Members, UserCode


@dataclass(frozen=True)
class Names:
    """A table of the names that a setting may have.

    `what` names the setting, and `own` maps the project's names to references. Other packages add
    names by the entry points of the group `group`. `page` is the page about a user's values, and
    `forms` names the forms of a reference.
    """

    what: str
    group: str
    own: Mapping[str, str]
    page: str
    forms: ClassVar[str]

    def names(self) -> list[str]:
        """Return the project's names, then those of installed packages."""
        return [*self.own, *(name for name in announced(self.group) if name not in self.own)]

    def is_reference(self, value: str) -> bool:
        """Return whether a value has the form of a reference."""
        raise NotImplementedError

    def check(self, value: str) -> None:
        """Raise a `ConfigError` if `value` is neither a known name nor a reference."""
        if value not in self.own and not self.is_reference(value) and value not in self.names():
            raise ConfigError(
                f"{one_of(self.names(), value)}; for your own try {self.forms}, see {self.page}"
            )

    def absolute(self, value: str, folder: Path) -> str:
        """Return a reference to a file with its whole path, relative to `folder`; other values
        unchanged.
        """
        raise NotImplementedError

    def load(self, value: str) -> Any:
        """Return the object that a value names. Raise `ConfigError` if there is none."""
        raise NotImplementedError

    def identity(self, value: str) -> str:
        """Return a text that changes with the content of the object's file."""
        raise NotImplementedError


@dataclass(frozen=True)
class Extensions(Names):
    """A table of classes and functions.

    Settings may follow a value, `mine.py:Mine:gain=3:fast=true`. They are arguments by name of the
    class or function. With `capitals` the project's names are abbreviations.
    """

    capitals: bool = False
    forms = "module:Name or file.py:Name"

    def check(self, value: str) -> None:
        name, settings = _split(value)
        if settings and name in self.own:
            raise ConfigError(
                f"expected {name} without {':'.join(settings)}, got {value!r}; its settings are "
                "in docs/configuration.md"
            )
        super().check(name)

    def is_reference(self, value: str) -> bool:
        where, _, name = value.rpartition(":")
        return bool(where) and name.isidentifier()

    def absolute(self, value: str, folder: Path) -> str:
        reference, settings = _split(value)
        where, _, name = reference.rpartition(":")
        if not where.endswith(".py"):
            return value
        return ":".join((str((folder / where).resolve()), name, *settings))

    def label(self, value: str) -> str:
        """Return the name of a value in titles and tables: of a reference its last part, and its
        settings.
        """
        reference, settings = _split(value)
        name = reference.rpartition(":")[2]
        capital = self.capitals and name in self.own
        return " ".join((name.upper() if capital else name, *settings))

    def load(self, value: str) -> Any:
        """Return the class or function that a value names.

        Raise `ConfigError` if it cannot be imported.
        """
        try:
            self.check(value)
        except ConfigError as error:
            raise ConfigError(f"{self.what}: {error}") from None
        value, _ = _split(value)
        reference = self.own.get(value, value)
        if not self.is_reference(reference):
            reference = announced(self.group)[value]
        where, _, name = reference.rpartition(":")
        module = self._module(where, name, own=value in self.own)
        found = getattr(module, name, None)
        if found is None:
            candidates = [
                each
                for each, value in vars(module).items()
                if callable(value) and getattr(value, "__module__", "") == module.__name__
            ]
            raise ConfigError(f"{self.what}: {where}: {one_of(candidates, name)}")
        return found

    def _module(self, where: str, name: str, *, own: bool) -> ModuleType:
        """Import a module by its name or by the path of its file."""
        if own:
            return importlib.import_module(where)
        if where.endswith(".py") and not Path(where).is_file():
            raise ConfigError(f"{self.what}: expected a Python file, there is no {where}")
        code = UserCode(f"{self.what} {where}", where, self.page)
        load = _module_of_file if where.endswith(".py") else importlib.import_module
        try:
            module: ModuleType = code.call("its import", load, where, seconds=LOAD_SECONDS)
        except ConfigError as error:
            cause = error.__cause__
            if isinstance(cause, ModuleNotFoundError) and f"{where}.".startswith(f"{cause.name}."):
                raise ConfigError(
                    f"{self.what}: expected a module that can be imported, got {where!r}: "
                    f"{cause}; install its package into this environment, or try file.py:{name}"
                ) from None
            raise
        return module

    def make(self, value: str, *arguments: Any, members: Members, **keywords: Any) -> Any:
        """Make the object that a value names: call its class, or its function, with arguments.

        `members` are the methods and attributes that the object must have. The methods of a user's
        object are guarded. Raise `ConfigError` if the call or a member does not fit.
        """
        factory = self.load(value)
        file = getattr(sys.modules.get(getattr(factory, "__module__", "")), "__file__", None)
        code = UserCode(f"{self.what} {value}", file or "", self.page)
        if not callable(factory):
            raise code.refusal("a class or a function", repr(factory))
        if missing := sorted(getattr(factory, "__abstractmethods__", ())):
            raise code.refusal(", ".join(missing), "a class without")
        reference, stated = _split(value)
        settings = dict(_setting(text) for text in stated)
        if taken := sorted({*settings} & {*keywords}):
            raise code.refusal("settings of other names", ", ".join(taken))
        keywords |= settings
        name = reference.rpartition(":")[2]
        code.check_call(name, factory, positional=len(arguments), keywords=tuple(keywords))
        if value in self.own:
            return factory(*arguments, **keywords)
        make = functools.partial(factory, *arguments, **keywords)
        made = code.call(name, make, seconds=LOAD_SECONDS)
        return code.guard(made, members)

    def identity(self, value: str) -> str:
        """Return the identity of this value's code: its name, its settings, and a hash of
        its file, or of the Python files of its package.
        """
        loaded = self.load(value)
        module = sys.modules.get(getattr(loaded, "__module__", ""))
        digest = hashlib.sha256()
        for path in _sources(module):
            digest.update(path.read_bytes())
        name = getattr(loaded, "__qualname__", self.label(value))
        return " ".join((name, *_split(value)[1], digest.hexdigest()[:16]))


@functools.cache
def announced(group: str) -> dict[str, str]:
    """Return the references of installed packages by the names of their entry points."""
    # Imported here, as `inspect` above: most commands use the project's own names alone.
    from importlib.metadata import entry_points

    return {each.name: each.value for each in entry_points(group=group)}


def _module_of_file(file: str) -> ModuleType:
    path = Path(file).resolve()
    name = f"{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _sources(module: ModuleType | None) -> list[Path]:
    """The Python files of a module: of a package all of them, else its own file."""
    file = Path(getattr(module, "__file__", None) or "")
    top = sys.modules.get(getattr(module, "__name__", "").partition(".")[0])
    folders = [Path(each) for each in getattr(top, "__path__", ())]
    if folders:
        return sorted(path for folder in folders for path in folder.rglob("*.py"))
    return [file] if file.is_file() else []


# A setting of a user's own, NAME=VALUE. The value has no colon.
_SETTING = re.compile(r"[A-Za-z_][A-Za-z0-9_]*=[^:]*")
_WORDS = {"true": True, "false": False}


def _split(value: str) -> tuple[str, tuple[str, ...]]:
    """A value without the settings at its end, and the settings."""
    parts = value.split(":")
    kept = len(parts)
    while kept > 1 and _SETTING.fullmatch(parts[kept - 1]):
        kept -= 1
    return ":".join(parts[:kept]), tuple(parts[kept:])


def _setting(text: str) -> tuple[str, bool | int | float | str]:
    """The name and the value of a setting: true, false, a number, or else a text."""
    name, _, value = text.partition("=")
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return name, kind(value)
    return name, _WORDS.get(value, value)
