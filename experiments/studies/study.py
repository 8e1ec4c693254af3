"""Trials of a study: every cell with the same seeds, as complete configurations."""

from __future__ import annotations

import functools
import hashlib
import zlib
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.studies.trial_sequence import (
    Bisection,
    Bracket,
    Outcome,
    Trial,
    TrialSequence,
    outcome_of,
)
from netem.networks import CAPACITY, GENERATED, load_profile, shipped_names
from shared.config.config_file import dump_config, load_config
from shared.config.settings import RunConfig, extended
from shared.errors import ConfigError, UserError, one_of

PROFILES = "profiles:"


@dataclass(frozen=True)
class Cell:
    """A variant: the settings that distinguish it, and all its settings with those of the base."""

    shown: dict[str, Any]
    settings: dict[str, Any]

    @property
    def names(self) -> list[str]:
        """Names of the cell for `--only`: its name, and each value of the grid."""
        named = self.shown.items()
        return [v if k == "cell" else f"{k}={value_in_words(v)}" for k, v in named]

    def __str__(self) -> str:
        return ", ".join(self.names) or "the only cell"


@dataclass(frozen=True)
class Study:
    """A study that has been read and checked; `table` is its TOML."""

    name: str
    seeds: int
    columns: tuple[str, ...]
    cells: tuple[Cell, ...]
    varied: tuple[str, ...]
    random: dict[str, dict[str, Any]]
    table: dict[str, Any]
    all_active_sets: bool = False
    bisection: Bisection | None = None

    @functools.cached_property
    def trials(self) -> list[Trial]:
        """Every cell with seed 0, then every cell with seed 1, …: a first part is a fair sample.

        For a bisection these are the first trials of its sequences.
        """
        return [sequence.next for sequence in self.sequences() if sequence.next is not None]

    def max_left(self, sequences: Iterable[TrialSequence]) -> int:
        """The maximum number of trials that are left of these sequences."""
        max_trials = 1 if self.bisection is None else self.bisection.max_trials
        return sum(
            max_trials - len(sequence.played) for sequence in sequences if sequence.next is not None
        )

    def sequences(self) -> list[TrialSequence]:
        """A new sequence for every cell and seed, in the order of `trials`."""
        return [
            TrialSequence(index, seed, self._sequence(index, seed))
            for seed in range(self.seeds)
            for index in range(len(self.cells))
        ]

    def sequences_of(self, rows: Sequence[dict[str, Any]]) -> list[tuple[TrialSequence, list[int]]]:
        """Every sequence as far as it was played in `rows`, and the row number of each trial."""
        numbers = {self._place(row): number for number, row in enumerate(rows)}

        def outcome(trial: Trial) -> Outcome | None:
            number = numbers.get(self._place(trial.label))
            return None if number is None else outcome_of(rows[number]["error"], rows[number])

        followed = []
        for sequence in self.sequences():
            sequence.follow(outcome)
            at = [numbers[self._place(trial.label)] for trial in sequence.played]
            followed.append((sequence, at))
        return followed

    def only(self, names: Iterable[str]) -> set[int]:
        """Indices of the cells that have at least one of these names."""
        valid = [name for cell in self.cells for name in cell.names]
        for name in names:
            if name not in valid:
                known = dict.fromkeys(valid) or ["none, there is a single cell"]
                raise ConfigError(f"--only: {one_of(known, name)}")
        return {k for k, cell in enumerate(self.cells) if set(names) & set(cell.names)}

    def _place(self, label: dict[str, Any]) -> tuple[Any, ...]:
        """The values that distinguish a trial within the study, from its label or its row."""
        names = [*self.cells[0].shown, "seed"]
        if self.bisection is not None:
            names.append(self.bisection.setting)
        values = (label.get(name) for name in names)
        return tuple(tuple(value) if isinstance(value, list) else value for value in values)

    def _sequence(self, index: int, seed: int) -> Generator[Trial, bool, Bracket | None]:
        if self.bisection is None:
            yield self._trial(index, seed, {})
            return None
        search = self.bisection.search()
        at = next(search)
        while True:
            stood = yield self._trial(index, seed, self.bisection.settings(at))
            try:
                at = search.send(stood)
            except StopIteration as end:
                bracket: Bracket = end.value
                return bracket

    @functools.cached_property
    def _dealt(self) -> dict[tuple[int, int, str], Trial]:
        return {}

    def _trial(self, index: int, seed: int, bisected: dict[str, Any]) -> Trial:
        key = (index, seed, repr(bisected))
        if key not in self._dealt:
            self._dealt[key] = self._deal(index, seed, bisected)
        return self._dealt[key]

    def _deal(self, index: int, seed: int, bisected: dict[str, Any]) -> Trial:
        cell = self.cells[index]
        drawn = {key: draw(key, spec, seed=seed) for key, spec in self.random.items()}
        asked = {**cell.settings, **drawn, **bisected}
        given = {**asked, "seed": seed}
        try:
            if isinstance(network := asked.get("link.network"), str):
                given["link.network"] = _network_of(network, seed)
            config = load_config(None, given)
            identity = _identity(config, all_active_sets=self.all_active_sets)
        except UserError as error:
            raise ConfigError(f"study {self.name}, {cell}: {error}") from None
        varied = {key: asked[key] if key in asked else _get(config, key) for key in self.varied}
        name = {"cell": cell.shown["cell"]} if "cell" in cell.shown else {}
        label = {**name, **varied, "seed": seed}
        return Trial(index, label, config, identity, self.all_active_sets)


def draw(key: str, spec: dict[str, Any], *, seed: int) -> Any:
    """The value of a random setting for a seed. It does not depend on other random settings."""
    rng = np.random.default_rng([seed, 11, zlib.crc32(key.encode())])
    if spec["kind"] == "uniform":
        return float(rng.uniform(spec["low"], spec["high"]))
    if spec["kind"] == "cut":
        return [f"cut@{rng.uniform(*spec['start']):.3f}s"]
    force, start, duration = (
        rng.uniform(*value) if isinstance(value := spec[name], list) else value
        for name in ("force", "start", "duration")
    )
    direction = spec["directions"][rng.integers(len(spec["directions"]))]
    return [f"{force:.3f}N@{start:.3f}s:{duration:.3f}s:{direction}"]


def value_in_words(value: Any) -> str:
    """A setting's value as it is written on the command line."""
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _network_of(network: str, seed: int) -> str:
    """The profile of a seed of `profiles:SCENARIO` or `generated:SCENARIO`; else `network` itself.

    The prefix `capacity:` stays before the profile.
    """
    capacity = CAPACITY if network.startswith(CAPACITY) else ""
    wanted = network.removeprefix(capacity)
    if wanted.startswith(GENERATED) and "/" not in wanted:
        return f"{network}/{seed}"
    if not wanted.startswith(PROFILES):
        return network
    shipped = _shipped()
    names = [name for name in shipped if PROFILES + name.rpartition("/")[0] == wanted]
    if not names:
        valid = sorted({PROFILES + name.rpartition("/")[0] for name in shipped})
        text = one_of(valid, network)
        raise ConfigError(f"link.network: {text}; {CAPACITY} may come before it")
    return capacity + names[seed % len(names)]


@functools.cache
def _shipped() -> tuple[str, ...]:
    return tuple(shipped_names())


def _identity(config: RunConfig, *, all_active_sets: bool) -> str:
    digest = hashlib.sha256(dump_config(config, versions={}).encode())
    if config.link.network != "direct":
        digest.update(load_profile(config.link.network.removeprefix(CAPACITY)).delays_ns.tobytes())
    if all_active_sets:
        digest.update(b"all active sets")
    for table, value in extended(config):
        digest.update(table.identity(value).encode())
    return digest.hexdigest()[:16]


def _get(config: RunConfig, key: str) -> Any:
    value: Any = config
    for name in key.split("."):
        value = getattr(value, name, None)  # an unknown setting is an error elsewhere
    return list(value) if isinstance(value, tuple) else value
