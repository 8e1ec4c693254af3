"""`compose.yaml` and the Dockerfile say the same as `services.toml`.

With a daemon: tests/live/test_docker.py.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from deploy.container import READY_FILE
from deploy.services import Service, load_services
from shared.config.config_file import load_config
from shared.robots import CATALOGUE, description_of
from shared.robots.description import data_folder

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
# It is part of ./deploy/up itself.
HUB = "telemetry"


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    read: dict[str, Any] = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    return read


@pytest.fixture(scope="module")
def declared() -> dict[str, Service]:
    return {name: each for name, each in load_services().items() if each.by_default}


@pytest.fixture(scope="module")
def dockerfile() -> str:
    return (DEPLOY / "Dockerfile").read_text().replace("\\\n", "")


def networks(compose: dict[str, Any], name: str) -> set[str]:
    return set(compose["services"][name]["networks"])


def test_the_services_are_those_that_run_by_default_and_a_hub(compose, declared):
    assert set(compose["services"]) == {*declared, HUB}


def test_every_container_runs_its_service_with_flags_that_it_takes(compose, declared):
    for name, service in declared.items():
        container = compose["services"][name]
        assert "entrypoint" not in container
        first, *arguments = container["command"]
        assert first == name
        flags = {argument[2:] for argument in arguments if argument.startswith("--")}
        assert flags <= {*service.takes, "listen", "connect", "view"}, name
        assert {"config", "out"} <= flags


def test_services_wait_for_those_before_them_to_be_healthy(compose, declared):
    for name, service in declared.items():
        waits_for = compose["services"][name].get("depends_on", {})
        assert all(each == {"condition": "service_healthy"} for each in waits_for.values())
        assert set(waits_for) - {HUB} == set(service.after) & set(declared)


def test_a_container_is_healthy_when_its_service_is_ready(compose, declared):
    for name, service in declared.items():
        health = compose["services"][name]["healthcheck"]
        assert health["test"] == ["CMD", "test", "-e", str(READY_FILE)]
        assert health["start_period"] == f"{service.ready_seconds:g}s"


def test_services_end_and_come_back_alike(compose, declared):
    for name, service in declared.items():
        container = compose["services"][name]
        # Docker waits before a start by itself, twice as long each time.
        assert container["restart"] == service.restart.partition(":")[0]
        assert container["stop_grace_period"] == f"{service.stop_seconds:g}s"


def test_the_shim_is_the_only_way_from_the_robot_to_the_edge(compose):
    both = networks(compose, "netem")
    assert both == set(compose["networks"])
    assert networks(compose, "edge") == {"edge-side"}
    for name in ("robot", "viewer", HUB):
        assert networks(compose, name) == {"robot-side"}
    assert compose["networks"]["edge-side"] == {"internal": True}
    assert all("ports" not in each for each in compose["services"].values())
    assert all("network_mode" not in each for each in compose["services"].values())


def test_each_dials_where_the_next_one_listens(compose, declared):
    for dialling, listening in (("robot", "netem"), ("netem", "edge")):
        port = declared[listening].port
        assert f"tcp/{listening}:{port}" in compose["services"][dialling]["command"]
        assert f"tcp/0.0.0.0:{port}" in compose["services"][listening]["command"]
    hub = compose["services"][HUB]["command"][-1]
    folder = Path(hub.removeprefix("unixsock-stream/")).parent
    connected = {
        name for name, container in compose["services"].items() if hub in container["command"]
    }
    # Never over the link: the edge does not report.
    assert connected == {"netem", "viewer", "robot", HUB}
    for name, container in compose["services"].items():
        assert (f"hub:{folder}" in container["volumes"]) == (name in connected)


def test_the_settings_are_a_run_that_has_a_shim(compose):
    assert load_config(DEPLOY / "compose.toml").link.network != "direct"
    for container in compose["services"].values():
        mounted = "${RUN_CONFIG:-./compose.toml}:/config.toml:ro"
        assert mounted in container["volumes"]


def test_others_are_stopped_before_the_hub_which_sums_up_what_they_leave(compose, declared):
    for name in declared:
        assert HUB in compose["services"][name]["depends_on"], name
    folder = "runs:/runs"
    assert all(folder in each["volumes"] for each in compose["services"].values())


def test_real_time_can_be_done_without(compose):
    assert {each["ulimits"]["rtprio"] for each in compose["services"].values()} == {"${RTPRIO:-40}"}


def test_old_compose_reads_the_file_too(compose):
    assert {key for key in compose if not key.startswith("x-")} == {
        "services",
        "networks",
        "volumes",
    }
    assert (DEPLOY / ".env").read_text() == "COMPOSE_PROJECT_NAME=remote-wbc\n"


def test_the_image_keeps_the_models_of_all_robots_of_the_catalogue(dockerfile):
    kept = set(re.findall(r"! -name (\w+)", dockerfile))
    assert kept == {_folder(description_of(name).urdf) for name in CATALOGUE}


def _folder(urdf):
    """The folder of a robot among those of the installed package."""
    return urdf.relative_to(data_folder() / "example-robot-data" / "robots").parts[0]


def test_the_image_has_what_the_lock_names_and_what_the_services_are_made_of(dockerfile, declared):
    assert re.search(r"^FROM python:3\.\d+-slim$", dockerfile, re.M)
    (source, lock), (everything, here) = re.findall(r"^COPY (\S+) (\S+)$", dockerfile, re.M)
    assert (DEPLOY.parent / source).is_file()
    assert re.search(rf"pip install .*--require-hashes .*--requirement {lock} ", dockerfile)
    assert (everything, here) == (".", ".")
    modules = {service.command[0].split(".")[0] for service in declared.values()}
    admitted = {*modules, "shared", "deploy", "*.py"}
    ignored = (DEPLOY.parent / ".dockerignore").read_text().splitlines()[1:]
    assert ignored[0] == "*"
    assert {f"!{name}" for name in admitted} == {line for line in ignored if line[0] == "!"}
    assert 'ENTRYPOINT ["python", "-I", "-m", "deploy.container"]' in dockerfile
