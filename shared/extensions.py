"""The values of a setting that others can extend, and the objects that they name.

A value is one of the project's names, a name that an installed package announces by an entry point,
or a reference to the user's own: `package.module:Name`, or `path/file.py:Name`. A robot is a file
of data instead, `path/file.toml`: see `shared/robots/catalogue.py`.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

from shared.errors import ConfigError, one_of


@dataclass(frozen=True)
class Taken:
    """The arguments that a function must take: a number of positional ones, and some by name."""

    positional: int = 0
    keywords: tuple[str, ...] = ()


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

    With `capitals` the project's names are abbreviations.
    """

    capitals: bool = False
    forms = "module:Name or file.py:Name"

    def is_reference(self, value: str) -> bool:
        where, _, name = value.rpartition(":")
        return bool(where) and name.isidentifier()

    def absolute(self, value: str, folder: Path) -> str:
        where, _, name = value.rpartition(":")
        return f"{(folder / where).resolve()}:{name}" if where.endswith(".py") else value

    def label(self, value: str) -> str:
        """Return the name of a value in titles and tables: a name itself, or the last part of a
        reference.
        """
        name = value.rpartition(":")[2]
        return name.upper() if self.capitals and name in self.own else name

    def load(self, value: str) -> Any:
        """Return the object that a value names.

        Raise `ConfigError` if it cannot be imported.
        """
        try:
            self.check(value)
        except ConfigError as error:
            raise ConfigError(f"{self.what}: {error}") from None
        reference = self.own.get(value, value)
        if not self.is_reference(reference):
            reference = announced(self.group)[value]
        where, _, name = reference.rpartition(":")
        try:
            in_file = where.endswith(".py")
            module = _module_of_file(Path(where)) if in_file else importlib.import_module(where)
        except Exception as error:  # anything that a module may raise while it is imported
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise ConfigError(
                f"{self.what}: expected a module that can be imported, got {where!r}: {reason}; "
                f"install its package into this environment, or try file.py:{name}"
            ) from error
        found = getattr(module, name, None)
        if found is None:
            candidates = [
                each
                for each, value in vars(module).items()
                if callable(value) and getattr(value, "__module__", "") == module.__name__
            ]
            raise ConfigError(f"{self.what}: {where}: {one_of(candidates, name)}")
        return found

    def make(
        self, value: str, *arguments: Any, members: Mapping[str, Taken | None], **keywords: Any
    ) -> Any:
        """Make the object that a value names: call its class, or its function, with arguments.

        `members` are the methods that the object must have, with the arguments that they must take,
        and the attributes, with None. Raise `ConfigError` if the call or a member does not fit.
        """
        factory = self.load(value)
        if not callable(factory):
            raise self._refusal(value, "a class or a function", repr(factory))
        if missing := sorted(getattr(factory, "__abstractmethods__", ())):
            raise self._refusal(value, ", ".join(missing), "a class without")
        self._check_call(value, self.label(value), factory, Taken(len(arguments), tuple(keywords)))
        made = factory(*arguments, **keywords)
        for name, taken in members.items():
            member = getattr(made, name, None)
            if member is None:
                raise self._refusal(value, name, f"a {type(made).__name__} without it")
            if taken is not None:
                self._check_call(value, name, member, taken)
        return made

    def _check_call(
        self, value: str, name: str, function: Callable[..., Any], taken: Taken
    ) -> None:
        import inspect

        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            return  # compiled code: its arguments are unknown
        try:
            signature.bind(*range(taken.positional), **dict.fromkeys(taken.keywords))
        except TypeError as error:
            given = [*("…" for _ in range(taken.positional)), *(f"{k}=…" for k in taken.keywords)]
            raise self._refusal(
                value, f"{name}({', '.join(given)})", f"{name}{signature}: {error}"
            ) from None

    def _refusal(self, value: str, expected: str, got: str) -> ConfigError:
        return ConfigError(f"{self.what} {value}: expected {expected}, got {got}; see {self.page}")

    def identity(self, value: str) -> str:
        """Return the identity of this value's code: its name and a hash of its file."""
        loaded = self.load(value)
        module = sys.modules.get(getattr(loaded, "__module__", ""))
        source = Path(getattr(module, "__file__", None) or "")
        content = source.read_bytes() if source.is_file() else value.encode()
        return f"{self.label(value)} {hashlib.sha256(content).hexdigest()[:16]}"


@functools.cache
def announced(group: str) -> dict[str, str]:
    """Return the references of installed packages by the names of their entry points."""
    # Imported here, as `inspect` above: most commands use the project's own names alone.
    from importlib.metadata import entry_points

    return {each.name: each.value for each in entry_points(group=group)}


def _module_of_file(path: Path) -> ModuleType:
    path = path.resolve()
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
