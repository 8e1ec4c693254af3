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
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from shared.bus.endpoint import SECURE_PROTOCOLS
from shared.commands import wbc
from shared.errors import ConfigError
from shared.wire.channels import DOWNLINK, UPLINK

EDGE, NETEM, ROUTER, AUTHORITY = "edge", "netem", "router", "ca"
DEFAULT_FOLDER = "keys"
_ANY_ROBOT = "*"
_ROBOT = "robot-"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,30}")
_REMEDY = "copy it from where `wbc keys` made it"


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
        _check_files(folder, role)
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


def _check_files(folder: Path, role: str) -> None:
    """The files of a role are there, belong together and are valid today."""
    if not folder.is_dir():
        raise ConfigError(
            f"secure: expected a folder of certificates, {folder} is none; make them with "
            f"{wbc(f'keys {folder}')}, or copy them from where they were made"
        )
    authority = _load_certificate(certificate_file(folder, AUTHORITY))
    path = certificate_file(folder, role)
    certificate = _load_certificate(path)
    key_path = key_file(folder, role)
    try:
        key = serialization.load_pem_private_key(_read(key_path), password=None)
    except (ValueError, TypeError):
        raise ConfigError(f"secure: {key_path} is not a private key in PEM; {_REMEDY}") from None
    if key.public_key() != certificate.public_key():
        raise ConfigError(f"secure: {key_path} is not the key of {path.name}; copy both again")
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if [name.value for name in names] != [role]:
        raise ConfigError(
            f"secure: expected {path} to name {role!r}, it names "
            f"{certificate.subject.rfc4514_string()!r}; {_REMEDY}"
        )
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        raise ConfigError(
            f"secure: {path} is not signed by the ca.crt beside it; copy both from one folder"
        ) from None


def _load_certificate(path: Path) -> x509.Certificate:
    try:
        certificate = x509.load_pem_x509_certificate(_read(path))
    except ValueError:
        raise ConfigError(f"secure: {path} is not a certificate in PEM; {_REMEDY}") from None
    now = datetime.now(timezone.utc)
    if now > certificate.not_valid_after_utc:
        raise ConfigError(
            f"secure: {path} expired on {certificate.not_valid_after_utc:%Y-%m-%d}; remove it and "
            "its key where they were made, and make new ones with `wbc keys DIR --add`"
        )
    if now < certificate.not_valid_before_utc:
        raise ConfigError(
            f"secure: {path} is valid from {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC, "
            f"this machine's clock says {now:%Y-%m-%d %H:%M}; set the clock"
        )
    return certificate


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"secure: {path.parent} has no {path.name}; {_REMEDY}") from None
    except OSError as error:
        raise ConfigError(f"secure: cannot read {path}: {error.strerror}") from None
