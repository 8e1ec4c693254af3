from __future__ import annotations

import shutil
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from deploy.keys import make
from shared.bus.security import Credentials, Grant, grants
from shared.errors import ConfigError

NOW = datetime.now(timezone.utc)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make(folder, robots=["romeo", "talos"])
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "keys"))


def allowed(role: str, *robots: str) -> set[tuple[str, str, str]]:
    """(neighbour, what, key) of everything that a role lets pass."""
    found = set()
    for grant in grants(role, robots):
        found |= {(grant.neighbour, "receives", key) for key in grant.receives}
        found |= {(grant.neighbour, "sends", key) for key in grant.sends}
    return found


def test_a_robot_receives_its_own_projectors_and_sends_its_own_state_and_nothing_else():
    assert allowed("robot-romeo", "romeo") == {
        (neighbour, what, key)
        for neighbour in ("edge", "netem", "router")
        for what, key in (
            ("receives", "wbc/romeo/projector"),
            ("receives", "wbc/romeo/plan"),
            ("sends", "wbc/romeo/state"),
        )
    }


def test_the_edge_receives_states_and_sends_projectors_and_nothing_else():
    assert allowed("edge", "romeo") == {
        (neighbour, what, key)
        for neighbour in ("robot-romeo", "netem", "router")
        for what, key in (
            ("receives", "wbc/romeo/state"),
            ("sends", "wbc/romeo/projector"),
            ("sends", "wbc/romeo/plan"),
        )
    }


def test_the_shim_is_the_edge_to_the_robot_and_the_robot_to_the_edge():
    towards_edge = {
        (neighbour, what, key)
        for neighbour in ("edge", "router")
        for what, key in (
            ("receives", "wbc/romeo/projector"),
            ("receives", "wbc/romeo/plan"),
            ("sends", "wbc/romeo/state"),
        )
    }
    assert allowed("netem", "romeo") == towards_edge | {
        ("robot-romeo", "receives", "wbc/romeo/state"),
        ("robot-romeo", "sends", "wbc/romeo/projector"),
        ("robot-romeo", "sends", "wbc/romeo/plan"),
    }


def test_a_router_lets_every_robot_use_its_own_keys_only():
    robots = [each for each in grants("router", ("amy", "ben")) if "robot" in each.neighbour]
    assert robots == [
        Grant("robot-amy", ("wbc/amy/state",), ("wbc/amy/projector", "wbc/amy/plan")),
        Grant("robot-ben", ("wbc/ben/state",), ("wbc/ben/projector", "wbc/ben/plan")),
    ]
    assert ("edge", "receives", "wbc/*/projector") in allowed("router", "amy")
    assert ("edge", "sends", "wbc/*/state") in allowed("router", "amy")


def test_a_router_admits_the_robots_whose_certificates_it_has(folder: Path):
    (folder / "robot-talos.crt").unlink()
    assert Credentials.load(folder, "router").robots == ("romeo",)


@pytest.mark.parametrize("role", ["edge", "netem", "router", "robot-romeo"])
def test_policies_name_only_rules_and_subjects_that_exist(made: Path, role: str):
    # Zenoh takes a policy that names a missing rule in silence, and denies what was meant.
    control = Credentials.load(made, role, robots=("romeo",)).settings()["access_control"]
    assert control["enabled"] is True
    assert control["default_permission"] == "deny"
    rules = [rule["id"] for rule in control["rules"]]
    subjects = [subject["id"] for subject in control["subjects"]]
    assert len(rules) == len(set(rules))
    assert len(subjects) == len(set(subjects))
    assert sorted(rule for policy in control["policies"] for rule in policy["rules"]) == sorted(
        rules
    )
    assert {name for policy in control["policies"] for name in policy["subjects"]} == set(subjects)
    assert {subject["id"]: subject["cert_common_names"] for subject in control["subjects"]} == {
        name: [name] for name in subjects
    }


def test_a_key_passes_only_with_its_messages_and_the_subscription_to_them(made: Path):
    control = Credentials.load(made, "robot-romeo", robots=("romeo",)).settings()["access_control"]
    rules = {rule["id"]: rule for rule in control["rules"]}
    policy = next(each for each in control["policies"] if each["subjects"] == ["edge"])
    passed = {
        (rules[name]["flows"][0], rules[name]["messages"][0], rules[name]["key_exprs"][0])
        for name in policy["rules"]
    }
    assert passed == {
        ("ingress", "put", "wbc/romeo/projector"),
        ("egress", "declare_subscriber", "wbc/romeo/projector"),
        ("egress", "put", "wbc/romeo/state"),
        ("ingress", "declare_subscriber", "wbc/romeo/state"),
    }


def test_both_ends_of_every_connection_are_verified(made: Path):
    settings = Credentials.load(made, "edge", robots=("romeo",)).settings()
    assert settings["transport/link/tls/enable_mtls"] is True
    assert settings["transport/link/tls/verify_name_on_connect"] is True
    assert settings["transport/link/protocols"] == ["tls", "quic"]


def refusal(folder: Path, role: str = "edge") -> str:
    with pytest.raises(ConfigError) as refused:
        Credentials.load(folder, role, robots=("romeo",))
    text = str(refused.value)
    assert "\n" not in text
    assert text.startswith("secure: ")
    return text


def test_a_folder_that_is_not_there_says_how_to_make_it(tmp_path: Path):
    assert f"wbc keys {tmp_path / 'keys'}" in refusal(tmp_path / "keys")


@pytest.mark.parametrize("name", ["ca.crt", "edge.crt", "edge.key"])
def test_a_missing_file_is_named(folder: Path, name: str):
    (folder / name).unlink()
    assert f"has no {name}" in refusal(folder)


@pytest.mark.parametrize("name", ["ca.crt", "edge.crt", "edge.key"])
def test_a_file_that_cannot_be_read_is_named_with_the_reason(folder: Path, name: str):
    # Not by its permissions: the tests may run as root.
    (folder / name).unlink()
    (folder / name).mkdir()
    assert f"cannot read {folder / name}: Is a directory" in refusal(folder)


@pytest.mark.parametrize("name", ["ca.crt", "edge.crt", "edge.key"])
@pytest.mark.parametrize("content", [b"", b"nonsense", b"\xff\x00"])
def test_a_damaged_file_is_named(folder: Path, name: str, content: bytes):
    (folder / name).write_bytes(content)
    assert f"{folder / name} is not a" in refusal(folder)


@pytest.mark.parametrize("name", ["ca.crt", "edge.crt", "edge.key"])
def test_a_byte_order_mark_is_named_because_zenoh_cannot_read_behind_it(folder: Path, name: str):
    (folder / name).write_bytes(b"\xef\xbb\xbf" + (folder / name).read_bytes())
    assert f"{folder / name} begins with a byte order mark; save it" in refusal(folder)


def test_an_expired_certificate_says_when(tmp_path: Path):
    make(tmp_path, robots=["romeo"], now=NOW - timedelta(days=1000))
    assert "edge.crt expired on 20" in refusal(tmp_path)


def test_a_certificate_of_tomorrow_says_to_set_the_clock(tmp_path: Path):
    make(tmp_path, robots=["romeo"], now=NOW + timedelta(days=3))
    assert "set the clock" in refusal(tmp_path)


def test_another_roles_certificate_under_this_name_is_refused(folder: Path):
    for suffix in ("crt", "key"):
        (folder / f"edge.{suffix}").write_bytes((folder / f"robot-talos.{suffix}").read_bytes())
    assert "to name 'edge', got 'CN=robot-talos'" in refusal(folder)


def test_a_key_of_another_certificate_is_refused(folder: Path):
    (folder / "edge.key").write_bytes((folder / "netem.key").read_bytes())
    assert "is not the key of edge.crt" in refusal(folder)


def test_a_certificate_of_another_authority_is_refused(folder: Path, tmp_path: Path):
    make(tmp_path / "other", robots=["romeo"])
    (folder / "ca.crt").write_bytes((tmp_path / "other/ca.crt").read_bytes())
    assert "is not signed by the ca.crt beside it" in refusal(folder)
