"""The services of the stack, as `services.toml` declares them. Nothing is started here.

The keys of a service. The table [defaults] has a value for a key that a service leaves out:

    command         Arguments of `python -m`.
    after           Services that have to be ready first, if they run on this machine too.
    takes           Flags that it gets: config, telemetry, out, name, secure, events, held. With
                    held, it loads at once, and then waits until the services of `after` are ready.
    report          Stem of its files in the run's folder; empty: no files.
    port            Port for other machines, unless --listen gives another; 0: none.
    by_default      Whether it runs without --only.
    ready           Beginning of the line that it prints when it can be used.
    ready_seconds   Time until that line, beyond the time it may wait for a connection.
    stop_seconds    Time from the signal to end until it is killed.
    restart         no, or on-failure:N/Ts: it is started again after an error. After more than N
                    errors, each within T seconds of running, it is degraded: it waits before each
                    start, twice as long each time, until it has run for T seconds.
    end             The meaning of its end. outcome: the run is over and has its exit code.
                    failure: the run has failed. ignored: the run goes on.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.errors import ConfigError, one_of
from shared.toml_file import read_toml

EDGE, ROUTER, NETEM, ROBOT, VIEWER = "edge", "router", "netem", "robot", "viewer"
FILE = Path(__file__).with_name("services.toml")
OUTCOME, FAILURE, IGNORED = "outcome", "failure", "ignored"
HELD = "held"
FLAGS = ("config", "telemetry", "out", "name", "secure", "events", HELD)
_RESTART = re.compile(r"no|on-failure:([1-9]\d?)/([1-9]\d{0,4})s")
_MAX_PAUSE_SECONDS = 30.0


@dataclass(frozen=True)
class Service:
    """One service, with the keys that the module describes."""

    name: str
    command: tuple[str, ...]
    after: tuple[str, ...]
    takes: tuple[str, ...]
    report: str
    port: int
    by_default: bool
    ready: str
    ready_seconds: float
    stop_seconds: float
    restart: str
    end: str

    @property
    def restarts(self) -> bool:
        """Return whether it is started again after an error."""
        return self.restart != "no"

    @property
    def window_seconds(self) -> float:
        """The length of a life after which earlier failures no longer count [s]."""
        match = _RESTART.fullmatch(self.restart)
        return float(match[2]) if match is not None and match[2] else float("inf")

    def degraded(self, failures: int) -> bool:
        """Return whether it is degraded after a number of failures."""
        return self._beyond(failures) > 0

    def pause_seconds(self, failures: int) -> float:
        """Return the wait before the next start after a number of failures [s]."""
        beyond = self._beyond(failures)
        return min(2.0 ** (beyond - 1), _MAX_PAUSE_SECONDS) if beyond > 0 else 0.0

    def _beyond(self, failures: int) -> int:
        match = _RESTART.fullmatch(self.restart)
        return failures - int(match[1]) if match is not None and match[1] else 0


def load_services(path: Path = FILE) -> dict[str, Service]:
    """Return the services by name, in the order of the file.

    Raise `ConfigError` if a key or a value cannot be used.
    """
    tables = read_toml(path, what="services")
    defaults = tables.pop("defaults", {})
    services = {name: _service(name, defaults, table) for name, table in tables.items()}
    for service in services.values():
        for name in service.after:
            _check(service.name, "after", name, name in services, f"some of {', '.join(services)}")
    starting_order(services)
    return services


def starting_order(services: dict[str, Service]) -> tuple[str, ...]:
    """Return the names, each after the services it waits for, otherwise in the order given."""
    order: list[str] = []
    while len(order) < len(services):
        free = [
            name
            for name, service in services.items()
            if name not in order
            and all(each in order or each not in services for each in service.after)
        ]
        if not free:
            left = ", ".join(name for name in services if name not in order)
            raise ConfigError(
                f"services: expected an order, got {left}, which wait for one another; "
                "change their `after`"
            )
        order.append(free[0])
    return tuple(order)


def _service(name: str, defaults: dict[str, Any], own: Any) -> Service:
    fields = {field.name: field for field in dataclasses.fields(Service) if field.name != "name"}
    if not isinstance(own, dict):
        raise ConfigError(f"services: expected tables, got {name} = {own!r}")
    table = {**defaults, **own}
    for key in table:
        if key not in fields:
            raise ConfigError(f"services: {name}: {one_of(fields, key, expected='some of')}")
    for key in fields:
        if key not in table:
            raise ConfigError(f"services: {name}: expected {key}, here or in [defaults], got none")
    for key in ("command", "after", "takes"):
        is_list = isinstance(table[key], list) and all(isinstance(e, str) for e in table[key])
        _check(name, key, table[key], is_list, "a list of strings")
        table[key] = tuple(table[key])
    for key in ("report", "ready", "restart", "end"):
        _check(name, key, table[key], isinstance(table[key], str), "a string")
    for key in ("ready_seconds", "stop_seconds"):
        value = table[key]
        is_time = isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0
        _check(name, key, value, is_time, "a number of seconds above 0")
    port, restart, end = table["port"], table["restart"], table["end"]
    _check(name, "command", [], bool(table["command"]), "at least the module")
    _check(name, "port", port, type(port) is int and 0 <= port < 65536, "0 to 65535")
    by_default = table["by_default"]
    _check(name, "by_default", by_default, isinstance(by_default, bool), "true or false")
    _check(name, "restart", restart, _RESTART.fullmatch(restart), "no, or on-failure:N/Ts")
    ends = (OUTCOME, FAILURE, IGNORED)
    _check(name, "end", end, end in ends, f"one of {', '.join(ends)}")
    for flag in table["takes"]:
        _check(name, "takes", flag, flag in FLAGS, f"some of {', '.join(FLAGS)}")
    return Service(name=name, **table)


def _check(name: str, key: str, value: object, good: object, expected: str) -> None:
    if not good:
        raise ConfigError(f"services: {name}: {key}: expected {expected}, got {value!r}")
