"""Who may say what to whom: certificates for mutual TLS, and the keys each neighbour may use.

Every process has a role, which is the common name of its certificate: `edge`, `netem`, `router` or
`robot-NAME`. A neighbour proves its role in the TLS handshake; what it may then send and receive is
a `Grant`. Everything that no grant names is refused, by the process that receives it and by the one
that would send it.

Files, in one folder, made by `deploy/keys`: `ca.crt`, `ROLE.crt`, `ROLE.key`. Not here: the
telemetry hub, which is on loopback and has no say in the control of anything.
"""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.bus.endpoint import SECURE_PROTOCOLS
from shared.errors import ConfigError
from shared.wire.channels import DOWNLINK, UPLINK

EDGE, NETEM, ROUTER, AUTHORITY = "edge", "netem", "router", "ca"
DEFAULT_FOLDER = "keys"
_ANY_ROBOT = "*"
_ROBOT = "robot-"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,30}")


def certificate_file(folder: Path, role: str) -> Path:
    """Where the certificate of a role is."""
    return folder / f"{role}.crt"


def key_file(folder: Path, role: str) -> Path:
    """Where the private key of a role is."""
    return folder / f"{role}.key"


def robot_role(name: str) -> str:
    """The role of a robot; `ConfigError` if the name cannot be part of a key."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"name: expected small letters, digits, - and _, at most 31 of them, got {name!r}"
        )
    return _ROBOT + name


@dataclass(frozen=True)
class Grant:
    """Keys that a node receives from a neighbour, and keys that it sends to it."""

    neighbour: str
    receives: str
    sends: str


def grants(role: str, robots: tuple[str, ...]) -> tuple[Grant, ...]:
    """What the neighbours of a role may do, where `robots` may come near it.

    States travel from robots to the edge, projectors back. A robot has its own keys only. The shim
    is the edge to the robot and the robot to the edge, and so is the router.
    """

    def towards_robot(neighbour: str, robot: str) -> Grant:
        return Grant(neighbour, receives=UPLINK.key_for(robot), sends=DOWNLINK.key_for(robot))

    def towards_edge(neighbour: str, robot: str) -> Grant:
        return Grant(neighbour, receives=DOWNLINK.key_for(robot), sends=UPLINK.key_for(robot))

    down = [towards_robot(robot_role(robot), robot) for robot in robots]
    if role == EDGE:
        relayed = [towards_robot(each, robot) for each in (NETEM, ROUTER) for robot in robots]
        return (*down, *relayed)
    if role == ROUTER:
        return (*down, towards_robot(NETEM, _ANY_ROBOT), towards_edge(EDGE, _ANY_ROBOT))
    up = [towards_edge(each, robot) for each in (EDGE, ROUTER) for robot in robots]
    if role == NETEM:
        return (*down, *up)
    return (*up, *(towards_edge(NETEM, robot) for robot in robots))


@dataclass(frozen=True)
class Credentials:
    """Files that prove a role, checked; `robots` that it has to do with."""

    role: str
    folder: Path
    robots: tuple[str, ...]

    @staticmethod
    def load(folder: Path, role: str, *, robots: tuple[str, ...] | None = None) -> Credentials:
        """Credentials of a role that deals with `robots`; None: those with a certificate in the
        folder. `ConfigError` says which file is missing, has expired or does not belong.
        """
        # Imported here: it takes long, and only secured connections need it.
        from shared.bus.certificates import check_files

        check_files(folder, role)
        if robots is None:
            files = sorted(folder.glob(f"{_ROBOT}*.crt"))
            robots = tuple(file.stem.removeprefix(_ROBOT) for file in files)
        return Credentials(role, folder, robots)

    def settings(self) -> dict[str, Any]:
        """Zenoh's settings for mutual TLS and access control."""
        certificate, key = self._files
        tls = {
            "root_ca_certificate": str(certificate_file(self.folder, AUTHORITY)),
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
        return {
            "transport/link/protocols": list(SECURE_PROTOCOLS),
            **{f"transport/link/tls/{name}": value for name, value in tls.items()},
            "access_control": self._access_control(),
        }

    def _access_control(self) -> dict[str, Any]:
        """Default deny; a key flows one way if its messages and the subscription to it may."""
        granted = grants(self.role, self.robots)
        rules, policies = [], []
        for number, grant in enumerate(granted):
            ids = (f"receives-{number}", f"sends-{number}")
            rules += [
                _rule(ids[0], ["put"], "ingress", grant.receives),
                _rule(ids[0] + "-asks", ["declare_subscriber"], "egress", grant.receives),
                _rule(ids[1], ["put"], "egress", grant.sends),
                _rule(ids[1] + "-asked", ["declare_subscriber"], "ingress", grant.sends),
            ]
            # A policy that names a rule or subject which does not exist is taken in silence.
            policies.append(
                {
                    "rules": [rule["id"] for rule in rules[-4:]],
                    "subjects": [grant.neighbour],
                }
            )
        neighbours = dict.fromkeys(grant.neighbour for grant in granted)
        subjects = [{"id": name, "cert_common_names": [name]} for name in neighbours]
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }

    def client_context(self) -> ssl.SSLContext:
        """For a TLS client that proves this role."""
        context = ssl.create_default_context(cafile=str(certificate_file(self.folder, AUTHORITY)))
        context.load_cert_chain(*self._files)
        return context

    @property
    def _files(self) -> tuple[str, str]:
        return str(certificate_file(self.folder, self.role)), str(key_file(self.folder, self.role))


def _rule(name: str, messages: list[str], flow: str, key: str) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": [flow],
        "permission": "allow",
        "key_exprs": [key],
    }
