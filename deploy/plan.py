"""Plan which services to start, and which one dials which. Nothing is started here.

`services.toml` declares the services; this module joins them. From the edge to the robot they form
a chain, `edge ← router ← netem ← robot`. Each service dials the nearest one to its left, on this
machine or on another. The last service on this machine listens for the machine where the chain
goes on, unless it is the robot. The edge itself dials a router.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from deploy.services import EDGE, NETEM, ROBOT, ROUTER, VIEWER, Service, starting_order
from shared.bus.endpoint import Endpoint, parse_endpoint
from shared.bus.security import DEFAULT_FOLDER, Credentials, robot_role
from shared.errors import ConfigError, one_of
from shared.process.service import names_on_the_link

_CHAIN = (EDGE, ROUTER, NETEM, ROBOT)


@dataclass(frozen=True)
class Options:
    """The flags that name the services of this machine, and the places of the others.

    `edge`, `router` and `listen` are endpoints; `secure` is the folder of certificates.
    """

    only: str | None = None
    edge: str | None = None
    router: str | None = None
    listen: str | None = None
    secure: Path | None = None


@dataclass(frozen=True)
class PlannedService:
    """A service and its `arguments` for `python -m`. It also gets the flags that it `takes`."""

    service: Service
    arguments: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.service.name


@dataclass(frozen=True)
class Plan:
    """The services in starting order, the folder of certificates, and notes for the user.

    `opens` is the endpoint on which the last service of the chain listens; None if it does not.
    """

    steps: tuple[PlannedService, ...]
    secure: Path | None
    notes: tuple[str, ...]
    opens: Endpoint | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the services."""
        return tuple(step.name for step in self.steps)

    def has(self, name: str) -> bool:
        """Return whether the plan has a service of this name."""
        return name in self.names


def services_of(
    declared: dict[str, Service], only: str | None, *, direct: bool
) -> tuple[Service, ...]:
    """Return the services that `--only` names; without it, the default ones.

    A direct link needs no shim, so netem is then no default service.
    """
    if only is None:
        return tuple(
            service
            for name, service in declared.items()
            if service.by_default and not (direct and name == NETEM)
        )
    names = tuple(dict.fromkeys(name.strip() for name in only.split(",")))
    for name in names:
        if name not in declared:
            raise ConfigError(f"only: {one_of(declared, name, expected='some, with commas, of')}")
    if VIEWER in names and ROBOT not in names:
        raise ConfigError(
            "only: expected robot beside viewer, which shows the robot of this machine, got "
            f"{only}; name both or neither"
        )
    if NETEM in names and direct:
        raise ConfigError(
            "network: expected a profile for netem, got direct, which has no shim; leave netem out "
            "of --only"
        )
    if not any(name in names for name in _CHAIN):
        raise ConfigError(f"only: expected at least one of {', '.join(_CHAIN)}, got {only}")
    return tuple(declared[name] for name in names)


def make_plan(
    options: Options, services: tuple[Service, ...], *, view: str, free_port: Callable[[], int]
) -> Plan:
    """Return the plan for these services; `view` is `off` for no viewer.

    Raise `ConfigError` or `LinkError` if the endpoints do not fit the services or the certificates.
    """
    chosen = {service.name: service for service in services}
    _check_who_dials(options, chosen)
    given = [each for each in (options.edge, options.router, options.listen) if each is not None]
    secure = options.secure
    if secure is None and any(each.startswith(("tls/", "quic/")) for each in given):
        secure = Path(DEFAULT_FOLDER)
    secured = secure is not None
    for each in given:
        parse_endpoint(each, secured=secured)

    here = [chosen[name] for name in _CHAIN if name in chosen]
    listens = _listening(options, here, secured=secured, free_port=free_port)
    far = options.edge or options.router
    dialled = parse_endpoint(far, secured=secured) if far is not None else None
    notes = [] if dialled is None else _notes_on_dialling(dialled)
    arguments: dict[str, tuple[str, ...]] = {VIEWER: ("--view", view)}
    for service in here:
        name = service.name
        ends: list[str] = []
        if name in listens:
            ends += ["--listen", str(listens[name])]
        router = listens.get(ROUTER, dialled) if name == EDGE else dialled
        if name != ROUTER and router is not None:
            ends += ["--connect", str(router.dialled_here)]
        arguments[name] = tuple(ends)
        dialled = listens.get(name, dialled)
    opens = listens.get(here[-1].name)
    if opens is not None:
        notes.append(_note_on_listening(here[-1], opens))
    steps = tuple(
        PlannedService(chosen[name], (*chosen[name].command, *arguments.get(name, ())))
        for name in starting_order(chosen)
        if name != VIEWER or view != "off"
    )
    return Plan(steps, secure, tuple(notes), opens)


def check_credentials(plan: Plan, *, robot: str) -> None:
    """Check that every service of the plan finds its certificate; raise `ConfigError` if not.

    `robot` is its name on the link. For an edge without a robot or a shim it may be several names.
    """
    robots = names_on_the_link(robot)
    if len(robots) > 1 and (plan.has(ROBOT) or plan.has(NETEM)):
        raise ConfigError(
            f"name: expected one name, because a robot or a shim runs here, got {robot!r}; several "
            "are for --only edge"
        )
    own_role = robot_role(robots[0])
    if plan.secure is None:
        return
    for name in _CHAIN:
        if plan.has(name):
            role = own_role if name == ROBOT else name
            Credentials.load(plan.secure, role, robots=None if name == ROUTER else robots)


def _check_who_dials(options: Options, services: Collection[str]) -> None:
    dials = [name for name in (NETEM, ROBOT) if name in services]
    if options.edge is not None:
        if options.router is not None:
            raise ConfigError("edge: expected --edge or --router, got both")
        if EDGE in services or ROUTER in services:
            raise ConfigError(
                f"edge: {EDGE if EDGE in services else ROUTER} is started here, so nothing dials "
                f"{options.edge}; name the services of this machine, as in --only robot,viewer"
            )
    elif options.router is not None:
        if ROUTER in services:
            raise ConfigError(
                "router: expected a router here (--only …) or elsewhere (--router), got both"
            )
    elif dials and EDGE not in services and ROUTER not in services:
        raise ConfigError(
            f"edge: {dials[-1]} needs an edge; add edge to --only, or give its endpoint, as in "
            "--edge tls/HOST:7460"
        )


def _listening(
    options: Options, here: list[Service], *, secured: bool, free_port: Callable[[], int]
) -> dict[str, Endpoint]:
    """Return the endpoint of each service that listens.

    Between two services of this machine it is on loopback.
    """
    protocol = "tls" if secured else "tcp"
    edge_dials = options.router is not None or any(each.name == ROUTER for each in here)
    listens = {}
    for service in here:
        name = service.name
        if name == ROBOT or (name == EDGE and edge_dials):
            continue
        if service is not here[-1]:
            listens[name] = Endpoint(protocol, "127.0.0.1", free_port())
        elif options.listen is not None:
            listens[name] = parse_endpoint(options.listen, secured=secured)
        else:
            # Without certificates, only this machine has access unless --listen says otherwise.
            host = "0.0.0.0" if secured else "127.0.0.1"
            listens[name] = Endpoint(protocol, host, service.port)
    if options.listen is not None and here[-1].name not in listens:
        raise ConfigError(
            f"listen: expected no --listen, because {here[-1].name} dials and no service here "
            f"waits for another machine, got {options.listen}; leave it out"
        )
    return listens


def _note_on_listening(service: Service, endpoint: Endpoint) -> str:
    name = service.name
    if endpoint.on_loopback:
        port = endpoint.port or service.port
        return (
            f"{name} listens on {endpoint}, for this machine only; for others: "
            f"--listen tls/0.0.0.0:{port} (see docs/real-network.md)"
        )
    if endpoint.secured:
        return f"{name} listens on {endpoint}, for machines with a certificate"
    return (
        f"{name} listens on {endpoint}, UNPROTECTED: anyone who reaches this port can move the "
        "robot; on any network but your own use tls (see docs/real-network.md)"
    )


def _notes_on_dialling(endpoint: Endpoint) -> list[str]:
    if endpoint.secured or endpoint.on_loopback:
        return []
    return [
        f"{endpoint} is UNPROTECTED: any machine on the way can move the robot; on any network but "
        "your own use tls (see docs/real-network.md)"
    ]
