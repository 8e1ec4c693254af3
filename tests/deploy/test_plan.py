from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from deploy.keys import make
from deploy.plan import Options, Plan, check_credentials, make_plan, services_of
from deploy.services import load_services
from deploy.up import _new_folder
from shared.errors import ConfigError, LinkError

TLS = "tls/edge.example.org:7460"


def plan_of(only: str | None = None, *, direct: bool = False, view: str = "off", **flags) -> Plan:
    return make_plan(
        Options(**flags),
        services_of(load_services(), only, direct=direct),
        view=view,
        free_port=itertools.count(9001).__next__,
    )


def commands(plan: Plan) -> dict[str, str]:
    return {step.name: " ".join(step.arguments) for step in plan.steps}


def test_everything_runs_on_loopback_with_the_shim_in_the_middle():
    plan = plan_of(view="web")
    assert commands(plan) == {
        "edge": "edge_node --listen tcp/127.0.0.1:9001",
        "netem": "netem replay --listen tcp/127.0.0.1:9002 --connect tcp/127.0.0.1:9001",
        "viewer": "viewer live --view web",
        "robot": "robot_node --connect tcp/127.0.0.1:9002",
    }
    assert plan.opens is None
    assert plan.secure is None
    assert plan.notes == ()


def test_a_direct_link_has_no_shim():
    assert commands(plan_of(direct=True)) == {
        "edge": "edge_node --listen tcp/127.0.0.1:9001",
        "robot": "robot_node --connect tcp/127.0.0.1:9001",
    }


def test_with_certificates_every_connection_of_the_local_stack_is_tls():
    plan = plan_of(secure=Path("mine"))
    assert "tcp/" not in " ".join(commands(plan).values())
    assert plan.secure == Path("mine")


def test_robot_and_viewer_dial_an_edge_elsewhere():
    plan = plan_of("robot,viewer", edge=TLS, view="web")
    assert commands(plan) == {
        "viewer": "viewer live --view web",
        "robot": f"robot_node --connect {TLS}",
    }


@pytest.mark.parametrize("endpoint", [TLS, "quic/192.0.2.7:7460"])
def test_an_endpoint_with_tls_implies_the_folder_of_certificates(endpoint):
    assert plan_of("robot", edge=endpoint).secure == Path("keys")


def test_the_shim_can_stand_alone_between_two_other_machines():
    plan = plan_of("netem", edge="tcp/192.0.2.7:7460", listen="tcp/0.0.0.0:7461")
    assert commands(plan) == {
        "netem": "netem replay --listen tcp/0.0.0.0:7461 --connect tcp/192.0.2.7:7460"
    }


def test_the_shim_can_stand_on_the_edges_machine():
    plan = plan_of("edge,netem", listen="tcp/0.0.0.0:7461")
    assert commands(plan) == {
        "edge": "edge_node --listen tcp/127.0.0.1:9001",
        "netem": "netem replay --listen tcp/0.0.0.0:7461 --connect tcp/127.0.0.1:9001",
    }


def test_the_shim_can_stand_on_the_robots_machine():
    plan = plan_of("netem,robot", edge=TLS)
    assert commands(plan) == {
        "netem": f"netem replay --listen tls/127.0.0.1:9001 --connect {TLS}",
        "robot": "robot_node --connect tls/127.0.0.1:9001",
    }


def test_edge_and_robot_both_dial_a_router():
    router = "tls/router.example.org:7447"
    assert commands(plan_of("edge", router=router)) == {"edge": f"edge_node --connect {router}"}
    assert commands(plan_of("robot", router=router)) == {"robot": f"robot_node --connect {router}"}
    assert commands(plan_of("robot", edge=router)) == commands(plan_of("robot", router=router))


def test_a_router_beside_its_edge_starts_first_and_listens_for_the_robot():
    plan = plan_of("edge,router", listen="tls/0.0.0.0:7447")
    assert [step.name for step in plan.steps] == ["router", "edge"]
    assert commands(plan) == {
        "router": "deploy.router --listen tls/0.0.0.0:7447",
        "edge": "edge_node --connect tls/127.0.0.1:7447",
    }


@pytest.mark.parametrize(
    ("only", "port"), [("edge", 7460), ("netem", 7461), ("router", 7447), ("edge,netem", 7461)]
)
def test_without_certificates_nobody_else_is_let_in_unless_told(only, port):
    far: dict[str, Any] = {"edge": "tcp/127.0.0.1:1"} if only == "netem" else {}
    plan = plan_of(only, **far)
    assert f"--listen tcp/127.0.0.1:{port}" in " ".join(commands(plan).values())
    assert "for this machine only" in plan.notes[-1]
    assert f"--listen tls/0.0.0.0:{port}" in plan.notes[-1]


def test_with_certificates_an_edge_listens_for_other_machines():
    plan = plan_of("edge", secure=Path("keys"))
    assert commands(plan) == {"edge": "edge_node --listen tls/0.0.0.0:7460"}
    assert "with a certificate" in plan.notes[0]


@pytest.mark.parametrize("listen", ["tcp/0.0.0.0:7460", "tcp/[::]:7460", "udp/192.0.2.7:1"])
def test_a_plain_endpoint_that_others_reach_is_called_unprotected(listen):
    assert "UNPROTECTED" in plan_of("edge", listen=listen).notes[0]


def test_a_plain_edge_elsewhere_is_called_unprotected():
    assert "UNPROTECTED" in plan_of("robot", edge="tcp/192.0.2.7:7460").notes[0]


@pytest.mark.parametrize(
    ("only", "flags", "message"),
    [
        ("edge,robots", {}, "expected some, with commas, of edge, netem, robot, viewer, router"),
        ("", {}, "only: expected some, with commas, of"),
        ("viewer", {}, "name both or neither"),
        ("recorder", {}, "of edge, netem"),
        ("robot", {}, "--edge tls/HOST:7460"),
        ("netem", {}, "netem needs an edge"),
        (None, {"edge": TLS}, "edge is started here"),
        ("edge", {"edge": TLS}, "edge is started here"),
        ("router", {"edge": TLS}, "router is started here"),
        ("robot", {"edge": TLS, "router": TLS}, "got both"),
        ("router,edge", {"router": TLS}, "got both"),
        ("robot", {"edge": TLS, "listen": TLS}, "robot dials"),
        ("edge", {"router": TLS, "listen": TLS}, "edge dials"),
        (None, {"listen": TLS}, "robot dials"),
    ],
)
def test_options_that_contradict_each_other_are_refused(only, flags, message):
    with pytest.raises(ConfigError, match=message):
        plan_of(only, **flags)


@pytest.mark.parametrize(
    "flags",
    [{"secure": Path("keys"), "edge": "tcp/192.0.2.7:1"}, {"edge": "edge:7460"}, {"edge": "tls/x"}],
)
def test_an_endpoint_that_cannot_be_used_is_refused_before_anything_starts(flags):
    with pytest.raises(LinkError, match="endpoint: expected"):
        plan_of("robot", **flags)


def test_a_direct_link_with_a_shim_is_refused():
    with pytest.raises(ConfigError, match="leave netem out"):
        plan_of("edge,netem,robot", direct=True)


def test_a_certificate_that_is_missing_is_named_before_anything_starts(tmp_path):
    make(tmp_path, robots=["amy"])
    plan = plan_of(secure=tmp_path)
    check_credentials(plan, robot="amy")
    with pytest.raises(ConfigError, match=r"has no robot-ben\.crt"):
        check_credentials(plan, robot="ben")
    (tmp_path / "netem.key").unlink()
    with pytest.raises(ConfigError, match=r"has no netem\.key"):
        check_credentials(plan, robot="amy")


def test_two_runs_of_one_second_have_two_folders(tmp_path):
    names = [_new_folder(tmp_path / "runs" / "20261130-120000-balance").name for _ in range(3)]
    assert names == [f"20261130-120000-balance{end}" for end in ("", "-2", "-3")]
