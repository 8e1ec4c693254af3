"""Access rules: certificates for mutual TLS, and the keys that each neighbour may use.

Every process has a role, which is the common name of its certificate: `edge`, `netem`, `router` or
`robot-NAME`. A neighbour proves its role in the TLS handshake. A `Grant` says which keys it may
then send and receive. A message without a grant is refused, both by the process that receives it
and by the process that would send it.

The files are in one folder, made by `deploy/keys`: `ca.crt`, `ROLE.crt`, `ROLE.key`. The telemetry
hub has no access rules: it is a socket of this user alone, and controls nothing.
"""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared.bus.endpoint import SECURE_PROTOCOLS
from shared.errors import ConfigError
from shared.wire.channels import DOWNLINK, PLANS, UPLINK

EDGE, NETEM, ROUTER, AUTHORITY = "edge", "netem", "router", "ca"
DEFAULT_FOLDER = "keys"
_ANY_ROBOT = "*"
_ROBOT = "robot-"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,30}")


def certificate_file(folder: Path, role: str) -> Path:
    """Return the path of a role's certificate."""
    return folder / f"{role}.crt"


def key_file(folder: Path, role: str) -> Path:
    """Return the path of a role's private key."""
    return folder / f"{role}.key"


def robot_name(name: str) -> str:
    """Return the name of a robot; raise `ConfigError` if it cannot be part of a key."""
    robot_role(name)
    return name


def robot_role(name: str) -> str:
    """Return the role of a robot; raise `ConfigError` if its name cannot be part of a key."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"name: expected small letters, digits, - and _, at most 31 of them, got {name!r}"
        )
    return _ROBOT + name


@dataclass(frozen=True)
class Grant:
    """Keys that a node receives from a neighbour, and keys that it sends to it."""

    neighbour: str
    receives: tuple[str, ...]
    sends: tuple[str, ...]


def grants(role: str, robots: tuple[str, ...]) -> tuple[Grant, ...]:
    """Return the grants of a role's neighbours, if the role deals with `robots`.

    States travel from robots to the edge, projectors and plans back. A robot has its own keys only.
    The shim and the router act as the edge for the robot, and as the robot for the edge.
    """

    def towards_robot(neighbour: str, robot: str) -> Grant:
        return Grant(neighbour, receives=_up_keys(robot), sends=_down_keys(robot))

    def towards_edge(neighbour: str, robot: str) -> Grant:
        return Grant(neighbour, receives=_down_keys(robot), sends=_up_keys(robot))

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
    """The checked files that prove a role, and the `robots` that the role deals with."""

    role: str
    folder: Path
    robots: tuple[str, ...]

    @staticmethod
    def load(folder: Path, role: str, *, robots: tuple[str, ...] | None = None) -> Credentials:
        """Return the credentials of a role; `robots` None: all with a certificate in the folder.

        Raise `ConfigError` if a file is missing, has expired or does not belong to the role.
        """
        # Imported here: it takes long, and only secured connections need it.
        from shared.bus.certificates import check_files

        check_files(folder, role)
        if robots is None:
            files = sorted(folder.glob(f"{_ROBOT}*.crt"))
            robots = tuple(file.stem.removeprefix(_ROBOT) for file in files)
        return Credentials(role, folder, robots)

    def settings(self) -> dict[str, Any]:
        """Return Zenoh's settings for mutual TLS and access control."""
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
        """Return Zenoh's access rules: deny by default, and two permissions for each key and way.

        The permissions are for its messages and for the subscription to it.
        """
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
            # Zenoh accepts in silence a policy that names a missing rule or subject.
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
        """Return the context of a TLS client that proves this role."""
        context = ssl.create_default_context(cafile=str(certificate_file(self.folder, AUTHORITY)))
        context.load_cert_chain(*self._files)
        return context

    @property
    def _files(self) -> tuple[str, str]:
        return str(certificate_file(self.folder, self.role)), str(key_file(self.folder, self.role))


def _up_keys(robot: str) -> tuple[str, ...]:
    return (UPLINK.key_for(robot),)


def _down_keys(robot: str) -> tuple[str, ...]:
    return (DOWNLINK.key_for(robot), PLANS.key_for(robot))


def _rule(name: str, messages: list[str], flow: str, keys: tuple[str, ...]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": [flow],
        "permission": "allow",
        "key_exprs": list(keys),
    }
