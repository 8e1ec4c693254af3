"""Make certificates for mutual TLS: your own authority, and one certificate for each role.

The roles are edge, netem, router, and one for each robot. The authority's key, ca.key, signs new
certificates. No other machine needs it.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from shared.bus.security import (
    AUTHORITY,
    EDGE,
    NETEM,
    ROUTER,
    certificate_file,
    key_file,
    robot_role,
)
from shared.config.robot_settings import RobotConfig
from shared.errors import ConfigError, writing
from shared.process.cli import EXIT_STANDING
from shared.regular_file import read_regular

LISTENERS = (EDGE, NETEM, ROUTER)
THIS_MACHINE = ("localhost", "127.0.0.1", "::1")
_AUTHORITY_DAYS, _DAYS = 3650, 825
_MAX_BYTES = 1_000_000
_HOST = re.compile(
    r"(?=.{1,253}$)([a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9])?)(\.[a-z0-9_-]{1,63})*", re.I
)


@dataclass(frozen=True)
class Signer:
    """A certificate and its private key. The authority's pair signs other certificates."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def add_keys_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `keys`."""
    parser.description = __doc__
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder for the files")
    parser.add_argument(
        "--robot",
        metavar="NAME",
        nargs="+",
        action="extend",
        help=f"names of the robots on the link (default {RobotConfig.name})",
    )
    parser.add_argument(
        "--host",
        metavar="NAME_OR_IP",
        nargs="+",
        action="extend",
        default=[],
        help="names or addresses at which other machines reach edge, netem and router",
    )
    parser.add_argument(
        "--add",
        action="store_true",
        help="make the missing certificates with the authority in DIR; replace nothing",
    )


def run_keys(arguments: argparse.Namespace) -> int:
    """Make the certificates and say where to copy them."""
    robots = tuple(dict.fromkeys(arguments.robot or [RobotConfig.name]))
    made = make(arguments.folder, robots=robots, hosts=arguments.host, add=arguments.add)
    print(_in_words(arguments.folder, made, hosts=arguments.host))
    return EXIT_STANDING


def make(
    folder: Path,
    *,
    robots: Sequence[str],
    hosts: Sequence[str] = (),
    add: bool = False,
    now: datetime | None = None,
) -> list[str]:
    """Make the authority and a certificate for every role. Return the roles made, in order.

    With `add`, the authority in the folder signs, and a role that has a file already is skipped.
    Raise `ConfigError` before anything is written if a name is invalid or a file would be
    overwritten.
    """
    names = [*THIS_MACHINE, *(_checked_host(host) for host in hosts)]
    roles = [*LISTENERS, *(robot_role(robot) for robot in robots)]
    now = now or datetime.now(timezone.utc)
    there = [role for role in roles if _files_of(folder, role)]
    if add:
        authority = _load_authority(folder)
        roles = [role for role in roles if role not in there]
        if not roles:
            raise ConfigError(
                f"keys: expected a role without certificates, got {folder} with those of "
                f"{', '.join(there)}; remove a role's files to make them again, or name another "
                "--robot"
            )
    else:
        taken = [
            *_files_of(folder, AUTHORITY),
            *(f for role in there for f in _files_of(folder, role)),
        ]
        if taken:
            raise ConfigError(
                f"keys: expected a folder without certificates, got {folder} with {taken[0].name}; "
                "name another folder, or use --add to make the missing ones with its authority"
            )
        authority = _new_authority(now)
    made = {} if add else {AUTHORITY: authority}
    for role in roles:
        made[role] = _issue(authority, role, names if role in LISTENERS else [role], now)
    _write(folder, made)
    return roles


def _new_authority(now: datetime) -> Signer:
    key = ec.generate_private_key(ec.SECP256R1())
    # A random name, so that two authorities are not taken for each other.
    name = _name(f"remote-wbc {secrets.token_hex(4)}")
    builder = (
        _builder(name, name, key, now, days=_AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
    )
    return Signer(builder.sign(key, hashes.SHA256()), key)


def _issue(authority: Signer, role: str, hosts: Sequence[str], now: datetime) -> Signer:
    key = ec.generate_private_key(ec.SECP256R1())
    issuer = authority.certificate
    builder = (
        _builder(_name(role), issuer.subject, key, now, days=_DAYS)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(
            x509.SubjectAlternativeName([_general_name(host) for host in hosts]), critical=False
        )
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.public_key()),  # type: ignore[arg-type]
            critical=False,
        )
    )
    return Signer(builder.sign(authority.key, hashes.SHA256()), key)


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    now: datetime,
    *,
    days: int,
) -> x509.CertificateBuilder:
    # Valid from yesterday on, because a robot's clock may be behind.
    begin = now - timedelta(days=1)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _checked_host(host: str) -> str:
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        # A dotted number that is no address is a mistyped address, not a name.
        if _HOST.fullmatch(host) and not re.fullmatch(r"[\d.]+", host):
            return host
    raise ConfigError(
        f"host: expected a name or an address as in edge.example.org or 192.0.2.7, without "
        f"protocol and port, got {host!r}"
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _files_of(folder: Path, role: str) -> list[Path]:
    files = (certificate_file(folder, role), key_file(folder, role))
    return [file for file in files if file.exists()]


def _load_authority(folder: Path) -> Signer:
    certificate, key = certificate_file(folder, AUTHORITY), key_file(folder, AUTHORITY)
    try:
        loaded = serialization.load_pem_private_key(_read(key), password=None)
        signer = x509.load_pem_x509_certificate(_read(certificate))
    except OSError as error:
        raise ConfigError(
            f"keys: cannot read {error.filename or folder}: {error.strerror}; --add needs the "
            "folder of an authority; leave --add out to make a new authority"
        ) from None
    except (ValueError, TypeError):
        raise ConfigError(
            f"keys: expected a certificate and its key in PEM, got {certificate} and {key}; "
            "name the folder of an authority"
        ) from None
    if not isinstance(loaded, ec.EllipticCurvePrivateKey):
        raise ConfigError(
            f"keys: expected an elliptic-curve key, got another kind in {key}; name the folder of "
            "an authority that deploy/keys made"
        )
    return Signer(signer, loaded)


def _write(folder: Path, made: Mapping[str, Signer]) -> None:
    """Write the files of all roles, or none."""
    created: list[Path] = []
    new = not folder.exists()
    try:
        with writing(folder, what="keys"):
            folder.mkdir(parents=True, exist_ok=True)
            for role, signer in made.items():
                private = signer.key.private_bytes(
                    serialization.Encoding.PEM,
                    serialization.PrivateFormat.PKCS8,
                    serialization.NoEncryption(),
                )
                public = signer.certificate.public_bytes(serialization.Encoding.PEM)
                _create(key_file(folder, role), private, mode=0o600, created=created)
                _create(certificate_file(folder, role), public, mode=0o644, created=created)
    except ConfigError:
        for path in created:
            path.unlink(missing_ok=True)
        if new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _create(path: Path, data: bytes, *, mode: int, created: list[Path]) -> None:
    """Create a file that does not exist yet, with the permissions `mode` from the start."""
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
    created.append(path)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


def _read(path: Path) -> bytes:
    return read_regular(path, at_most=_MAX_BYTES)


def _in_words(folder: Path, roles: Sequence[str], *, hosts: Sequence[str]) -> str:
    """Return text: the files made, and the machine to which each one belongs."""
    ends = datetime.now(timezone.utc) + timedelta(days=_DAYS)
    lines = [f"made in {folder}, valid until {ends:%Y-%m-%d}:"]
    for role in roles:
        where = (
            f"the machine of {role.removeprefix('robot-')}"
            if role not in LISTENERS
            else f"the machine that runs {role}"
        )
        also = " and every robot-*.crt" if role == ROUTER else ""
        lines.append(f"  {role}: copy ca.crt, {role}.crt, {role}.key{also} to {where}")
    lines.append(
        f"  copy {key_file(folder, AUTHORITY)} to none of them: it signs valid certificates"
    )
    if not hosts:
        lines.append(
            "  valid on this machine only: give the edge's or router's name or address with --host"
        )
    return "\n".join(lines)
