from __future__ import annotations

import errno
import ipaddress
import os
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from deploy import keys
from deploy.keys import make
from shared.errors import ConfigError
from shared.process.entry import python
from tests.processes import played

ROLES = ("edge", "netem", "router", "robot-romeo", "robot-amy")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "keys"
    make(made, robots=["romeo", "amy"], hosts=["edge.example.org", "192.0.2.7", "2001:db8::7"])
    return made


def certificate(folder: Path, role: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / f"{role}.crt").read_bytes())


def alternative_names(folder: Path, role: str) -> x509.SubjectAlternativeName:
    extensions = certificate(folder, role).extensions
    return extensions.get_extension_for_class(x509.SubjectAlternativeName).value


@pytest.mark.parametrize("role", ROLES)
def test_a_certificate_names_its_role_and_is_signed_by_the_authority(folder: Path, role: str):
    made = certificate(folder, role)
    names = made.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert [name.value for name in names] == [role]
    made.verify_directly_issued_by(certificate(folder, "ca"))
    key = serialization.load_pem_private_key((folder / f"{role}.key").read_bytes(), None)
    assert key.public_key() == made.public_key()


@pytest.mark.parametrize("role", ROLES)
def test_a_certificate_is_good_for_both_ends_of_a_connection_and_signs_no_other(
    folder: Path, role: str
):
    extensions = certificate(folder, role).extensions
    uses = extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(uses) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    assert extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False


@pytest.mark.parametrize("role", ["edge", "netem", "router"])
def test_those_that_listen_have_every_host_and_this_machine_among_their_names(
    folder: Path, role: str
):
    names = alternative_names(folder, role)
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "edge.example.org"]
    addresses = ["127.0.0.1", "::1", "192.0.2.7", "2001:db8::7"]
    assert names.get_values_for_type(x509.IPAddress) == [
        ipaddress.ip_address(address) for address in addresses
    ]


def test_a_robots_certificate_cannot_pass_for_the_edges_machine(folder: Path):
    names = alternative_names(folder, "robot-romeo")
    assert names.get_values_for_type(x509.DNSName) == ["robot-romeo"]
    assert names.get_values_for_type(x509.IPAddress) == []


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077])
def test_private_keys_are_for_their_owner_only(tmp_path: Path, mask: int):
    before = os.umask(mask)
    try:
        make(tmp_path / "keys", robots=["romeo"])
    finally:
        os.umask(before)
    keys = list((tmp_path / "keys").glob("*.key"))
    assert len(keys) == 5
    assert {stat.S_IMODE(key.stat().st_mode) for key in keys} == {0o600}


def test_nothing_is_overwritten(folder: Path):
    before = {file: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(ConfigError, match=r"with ca\.crt; name another folder, or use --add"):
        make(folder, robots=["ben"])
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_a_single_file_in_the_way_stops_everything(tmp_path: Path):
    (tmp_path / "edge.key").write_text("precious")
    with pytest.raises(ConfigError, match=r"with edge\.key"):
        make(tmp_path, robots=["romeo"])
    assert [file.name for file in tmp_path.iterdir()] == ["edge.key"]


def test_a_robot_added_later_is_signed_by_the_same_authority(folder: Path):
    before = {file: file.read_bytes() for file in folder.iterdir()}
    assert make(folder, robots=["ben"], add=True) == ["robot-ben"]
    certificate(folder, "robot-ben").verify_directly_issued_by(certificate(folder, "ca"))
    assert {file: file.read_bytes() for file in before} == before


def test_adding_what_is_there_already_says_so(folder: Path):
    with pytest.raises(ConfigError, match="name another --robot"):
        make(folder, robots=["amy"], add=True)


def test_adding_without_an_authority_says_what_is_missing(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"cannot read .*ca\.key.*leave --add out"):
        make(tmp_path, robots=["romeo"], add=True)


@pytest.mark.parametrize(
    "host",
    ["tls/192.0.2.7:7460", "edge:7460", "192.0.2", "192.0.2.700", "", "*", "a b", "-x", "edge."],
)
def test_a_host_that_is_no_name_and_no_address_is_refused_before_anything_is_written(
    tmp_path: Path, host: str
):
    with pytest.raises(ConfigError, match="host: expected"):
        make(tmp_path / "keys", robots=["romeo"], hosts=[host])
    assert not (tmp_path / "keys").exists()


@pytest.mark.parametrize("robot", ["", "Romeo", "a/b", "*", "**", "a" * 32, "-a", "ü"])
def test_a_robots_name_that_would_be_more_than_one_key_is_refused(tmp_path: Path, robot: str):
    with pytest.raises(ConfigError, match="name: expected"):
        make(tmp_path / "keys", robots=[robot])
    assert not (tmp_path / "keys").exists()


def test_the_command_says_what_belongs_where_and_what_must_stay(tmp_path: Path):
    command = python("-m", "deploy", "keys", str(tmp_path / "keys"), "--robot", "amy")
    done = played(*command)
    assert done.returncode == 0, done.stderr
    assert "robot-amy: copy ca.crt, robot-amy.crt, robot-amy.key" in done.stdout
    assert "ca.key to none of them" in done.stdout
    assert "--host" in done.stdout
    again = played(*command)
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1


def test_a_disk_that_becomes_full_leaves_no_half_made_keys(tmp_path: Path, monkeypatch):
    create = keys._create

    def full(path: Path, data: bytes, *, mode: int, created: list[Path]) -> None:
        create(path, data[:10], mode=mode, created=created)
        if path.name == "router.crt":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(keys, "_create", full)
    with pytest.raises(ConfigError, match=rf"keys: cannot write {tmp_path}/keys: No space left"):
        make(tmp_path / "keys", robots=["romeo"])
    assert not (tmp_path / "keys").exists()
    monkeypatch.undo()
    make(tmp_path / "keys", robots=["romeo"])
    monkeypatch.setattr(keys, "_create", full)
    before = sorted((tmp_path / "keys").iterdir())
    for file in (tmp_path / "keys").glob("router.*"):
        file.unlink()
    with pytest.raises(ConfigError, match="No space left"):
        make(tmp_path / "keys", robots=["romeo"], add=True)
    # The keys of the others are still there.
    left = [file for file in before if file.stem != "router"]
    assert sorted((tmp_path / "keys").iterdir()) == left
