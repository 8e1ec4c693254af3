"""Calls into a user's code: an error, a wrong result, or none in time, is a `ConfigError`.

The message is one line, with the place in the user's file. The exception that the code raised is
its cause. The limit of time holds on the main thread, where nodes run, and for code that lets
Python handle signals.
"""

from __future__ import annotations

import inspect
import signal
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from shared.errors import ConfigError, UserError

# Limits of time for a call in a run, and for the import of a module or the making of an object [s].
CALL_SECONDS, LOAD_SECONDS = 10.0, 60.0


def no_fault(value: Any, *arguments: Any) -> str:
    """Find no fault in a value."""
    return ""


@dataclass(frozen=True)
class Method:
    """A method that an object must have: a number of positional arguments, and some by name.

    `fault` takes a result and the positional arguments. It returns the fault of the result,
    `expected …, got …`, or an empty text. With `same_kind` the result must have the members of the
    object.
    """

    positional: int = 0
    keywords: tuple[str, ...] = ()
    fault: Callable[..., str] = no_fault
    same_kind: bool = False


@dataclass(frozen=True)
class Attribute:
    """An attribute that an object must have; `fault` takes its value, and is as in `Method`."""

    fault: Callable[[Any], str] = no_fault


Members = Mapping[str, Method | Attribute]


class _TooLong(BaseException):
    """A call has taken longer than its limit."""


@dataclass(frozen=True)
class UserCode:
    """Code of a user: its name in errors, its file, and the page that documents how to write it."""

    name: str
    file: str
    page: str

    def refusal(self, expected: str, got: str) -> ConfigError:
        """Return the error that the code is not as expected."""
        return self.error(f"expected {expected}, got {got}")

    def error(self, fault: str) -> ConfigError:
        """Return the error of a fault, `expected …, got …`."""
        return ConfigError(f"{self.name}: {fault}; see {self.page}")

    def call(
        self,
        name: str,
        function: Callable[..., Any],
        *arguments: Any,
        seconds: float = CALL_SECONDS,
    ) -> Any:
        """Return what a function of the code returns. Raise `ConfigError` for any failure."""
        limited = threading.current_thread() is threading.main_thread()
        if limited and signal.getsignal(signal.SIGALRM) is not _interrupt:
            signal.signal(signal.SIGALRM, _interrupt)
        # A call may be made inside another one, whose limit comes back after it.
        outer = signal.setitimer(signal.ITIMER_REAL, seconds) if limited else (0.0, 0.0)
        try:
            return function(*arguments)
        except UserError:
            raise
        except _TooLong as error:
            place = self._place(error)
            raise self.refusal(
                f"{name} to return within {seconds:g} s", f"no end of it{place}"
            ) from None
        except (Exception, SystemExit) as error:
            raise self.refusal(
                f"no error from {name}", f"{in_words(error)}{self._place(error)}"
            ) from error
        finally:
            if limited:
                signal.setitimer(signal.ITIMER_REAL, *outer)

    def check_call(
        self, name: str, function: Callable[..., Any], *, positional: int, keywords: tuple[str, ...]
    ) -> None:
        """Raise `ConfigError` if a function does not take these arguments."""
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            return  # compiled code: its arguments are unknown
        try:
            signature.bind(*range(positional), **dict.fromkeys(keywords))
        except TypeError as error:
            given = [*("…" for _ in range(positional)), *(f"{key}=…" for key in keywords)]
            raise self.refusal(
                f"{name}({', '.join(given)})", f"{name}{signature}: {error}"
            ) from None

    def check_members(self, made: Any, members: Members) -> None:
        """Raise `ConfigError` if an object lacks a member, or a method takes other arguments."""
        for name, wanted in members.items():
            member = self.call(name, getattr, made, name, None)
            if member is None:
                raise self.refusal(name, f"a {type(made).__name__} without it")
            if isinstance(wanted, Attribute):
                if fault := wanted.fault(member):
                    raise self.error(f"{name}: {fault}")
            else:
                self.check_call(
                    name, member, positional=wanted.positional, keywords=wanted.keywords
                )

    def guard(self, made: Any, members: Members) -> Any:
        """Return an object after its members have been checked; its methods are then guarded.

        A guarded method raises `ConfigError` for an error, a faulty result, or none in time.
        """
        self.check_members(made, members)
        for name, wanted in members.items():
            method = getattr(made, name)
            if isinstance(wanted, Method) and not isinstance(method, _Guarded):
                try:
                    object.__setattr__(made, name, _Guarded(self, name, method, wanted, members))
                except AttributeError:
                    raise self.refusal("a class without __slots__", type(made).__name__) from None
        return made

    def _place(self, error: BaseException) -> str:
        """The line of the user's file at which an error was raised, in words; else the last line.

        The text of a syntax error has its place.
        """
        if isinstance(error, SyntaxError):
            return ""
        frames = traceback.extract_tb(error.__traceback__)[1:]
        frames = [frame for frame in frames if "importlib" not in frame.filename]
        own = [frame for frame in frames if frame.filename == self.file]
        for frame in reversed(own or frames):
            return f" at line {frame.lineno} of {Path(frame.filename).name}"
        return ""


@dataclass(frozen=True)
class _Guarded:
    """A method of a user's object whose failures are errors in a line."""

    code: UserCode
    name: str
    method: Callable[..., Any]
    wanted: Method
    members: Members

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        result = self.code.call(self.name, partial(self.method, *arguments, **keywords))
        if fault := self.wanted.fault(result, *arguments):
            raise self.code.error(f"{self.name}: {fault}")
        return self.code.guard(result, self.members) if self.wanted.same_kind else result


def in_words(error: BaseException) -> str:
    """Return the kind and the first line of an error."""
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]:.200}" if lines else type(error).__name__


def _interrupt(number: int, frame: Any) -> None:
    raise _TooLong


def array_fault(value: Any, shape: tuple[int, ...], what: str) -> str:
    """Return the fault of an array of finite numbers, `expected …, got …`, or an empty text."""
    # Imported here: most commands use the project's own names alone.
    import numpy as np

    expected = f"expected {what} as a float array of shape {shape}"
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        kind = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else _a(type(value))
        return f"{expected}, got {kind}"
    if value.shape != shape:
        return f"{expected}, got {value.shape}"
    if not np.isfinite(value).all():
        place = [int(k) for k in np.argwhere(~np.isfinite(value))[0]]
        return f"{expected} with finite numbers, got {value[tuple(place)]} at {place}"
    return ""


def kind_fault(value: Any, kind: type, *, or_none: bool = False) -> str:
    """Return the fault of a value that has to be of a class, or an empty text."""
    if isinstance(value, kind) or (or_none and value is None):
        return ""
    return f"expected {_a(kind)}{' or None' if or_none else ''}, got {_a(type(value))}"


def _a(kind: type) -> str:
    """The name of a class with its article."""
    name = kind.__name__
    if kind is type(None):
        return "None"
    return f"an {name}" if name[0] in "AEIOaeio" or name == "ndarray" else f"a {name}"
