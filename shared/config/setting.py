"""A setting as a field of a dataclass: its default, its help, its bounds and its flag.

The field is the only place that describes a setting. Its check is made from the field here, its
flag in `shared/process/run_options.py`, its key in `config_file`, and its line of
`docs/configuration.md` in `experiments/settings_page.py`.
"""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from shared.errors import ConfigError, one_of
from shared.extensions import Names

_METADATA = "setting"
# The largest real number of a setting that gives no bound. The square of a much larger one
# overflows.
_LARGEST = 1e6
_HOLDS = {"≥": operator.ge, "≤": operator.le, "<": operator.lt}

_T = TypeVar("_T")


@dataclass(frozen=True)
class Setting:
    """The description of a setting.

    A number has to be within its bounds, and finite unless it `may_be_infinite`. A word has to be
    one of `choices`, which is a table of `Names` if others may add some. `flag` is the option on
    the command line, `short` another name for it, `metavar` an example of its value, and `read`
    makes the value from its text.
    """

    default: Any
    help: str
    unit: str = ""
    at_least: float | None = None
    at_most: float | None = None
    below: float | None = None
    may_be_infinite: bool = False
    choices: Sequence[str] | Names = ()
    flag: str = ""
    short: str = ""
    metavar: str | None = None
    read: Callable[[str], Any] | None = None

    @property
    def kind(self) -> type:
        """The type of the setting's values."""
        return type(self.default)

    @property
    def flags(self) -> list[str]:
        """The setting's options on the command line, the longer one first."""
        return [name for name in (self.flag, self.short) if name]

    @property
    def words(self) -> Sequence[str]:
        """The project's allowed words; empty if every value of its type is allowed."""
        return list(self.choices.own) if isinstance(self.choices, Names) else self.choices

    @property
    def bounds(self) -> list[tuple[str, float]]:
        """The bounds, each after its sign."""
        bounds = (("≥", self.at_least), ("≤", self.at_most), ("<", self.below))
        return [(sign, bound) for sign, bound in bounds if bound is not None]

    def check(self, key: str, value: Any) -> None:
        """Raise a `ConfigError` with the allowed values if `key` cannot have this one."""
        if isinstance(self.choices, Names):
            try:
                self.choices.check(value)
            except ConfigError as error:
                raise ConfigError(f"{key}: {error}") from None
        elif self.words and value not in self.words:
            raise ConfigError(f"{key}: {one_of(self.words, value)}")
        if self.kind in (int, float) and not self._holds(value):
            within = " and ".join(f"{sign} {bound:g}" for sign, bound in self._limits)
            raise ConfigError(
                f"{key}: expected a number {within or 'that is finite'}, got {value!r}"
            )

    def _holds(self, number: float) -> bool:
        finite = math.isfinite(number) or (self.may_be_infinite and not math.isnan(number))
        return finite and all(_HOLDS[sign](number, bound) for sign, bound in self._limits)

    @property
    def _limits(self) -> list[tuple[str, float]]:
        """The bounds, and those of every real number."""
        limits = self.bounds
        if self.kind is float and not self.may_be_infinite:
            signs = [sign for sign, _ in limits]
            limits = [*([] if "≥" in signs else [("≥", -_LARGEST)]), *limits]
            limits += [] if "≤" in signs or "<" in signs else [("≤", _LARGEST)]
        return limits


def setting(default: _T, *, help: str, **known: Any) -> _T:
    """Return a dataclass field that is a setting; `known` are further fields of `Setting`."""
    return dataclasses.field(default=default, metadata={_METADATA: Setting(default, help, **known)})


@dataclass(frozen=True)
class Section:
    """A dataclass of settings: its dotted name, empty for the root, and its settings by key."""

    name: str
    cls: type
    settings: Mapping[str, Setting]


def sections_of(cls: type, *, name: str = "") -> Iterator[Section]:
    """Yield a dataclass of settings and, in order, all dataclasses inside it."""
    own: dict[str, Setting] = {}
    within: dict[str, type] = {}
    for each in dataclasses.fields(cls):
        key = f"{name}.{each.name}" if name else each.name
        if isinstance(each.default_factory, type):
            within[key] = each.default_factory
        else:
            own[key] = each.metadata[_METADATA]
    yield Section(name, cls, own)
    for key, part in within.items():
        yield from sections_of(part, name=key)
