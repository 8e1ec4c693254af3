"""Check that the certificate and the key of a role can be used."""

from __future__ import annotations

import codecs
from datetime import datetime, timezone
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from shared.bus.security import AUTHORITY, certificate_file, key_file
from shared.commands import wbc
from shared.errors import ConfigError
from shared.regular_file import read_regular

_MAX_BYTES = 1_000_000
_REMEDY = "copy it from the folder that `wbc keys` made"


def check_files(folder: Path, role: str) -> None:
    """Check that the files of a role belong together and are valid now; `ConfigError` if not."""
    if not folder.is_dir():
        raise ConfigError(
            f"secure: expected a folder of certificates, got {folder}; make them with "
            f"{wbc(f'keys {folder}')}, or copy them from the folder that `wbc keys` made"
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
            f"secure: expected {path} to name {role!r}, got "
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
            "its key from the folder that `wbc keys` made, and add new ones with `wbc keys DIR "
            "--add`"
        )
    if now < certificate.not_valid_before_utc:
        raise ConfigError(
            f"secure: {path} is valid from {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC "
            f"on, got {now:%Y-%m-%d %H:%M} from this machine's clock; set the clock"
        )
    return certificate


def _read(path: Path) -> bytes:
    try:
        data = read_regular(path, at_most=_MAX_BYTES)
    except FileNotFoundError:
        raise ConfigError(f"secure: {path.parent} has no {path.name}; {_REMEDY}") from None
    except OSError as error:
        raise ConfigError(f"secure: cannot read {path}: {error.strerror}") from None
    if data.startswith(codecs.BOM_UTF8):
        # Zenoh finds no certificate and no key behind it.
        raise ConfigError(f"secure: {path} begins with a byte order mark; save it without one")
    return data
