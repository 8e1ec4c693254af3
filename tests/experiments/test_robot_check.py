"""`wbc robot check`: a line for each check, and what to change."""

from __future__ import annotations

import argparse

import pytest

from experiments import robot_check
from experiments.robot_check import run_robot_check
from shared.robots import load_robot
from tests.robots.biped import write_biped


def check(robot, **options):
    asked = {"robot": str(robot), "no_play": False, "picture": "none"} | options
    return run_robot_check(argparse.Namespace(**asked))


def test_a_robot_is_checked_and_played(tmp_path, capsys, monkeypatch):
    shorter = [
        robot_check.Play(each.name, each.settings | {"duration": 0.4}, each.remedy)
        for each in robot_check.PLAYS
    ]
    monkeypatch.setattr(robot_check, "PLAYS", shorter)
    assert check(write_biped(tmp_path)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[:4] for line in lines if line.startswith(("ok", "FAIL"))] == ["ok  "] * 18
    assert any(line.startswith("biped: 42.00 kg, 12 motors") for line in lines)
    assert any("wbc.weights.force = " in line for line in lines)


def test_a_robot_that_falls_is_told_what_to_change(tmp_path, capsys, monkeypatch):
    hard = robot_check.Play("takes a hard push", {"push": ["2000N@0.1s:0.2s:+y"]}, "push less")
    monkeypatch.setattr(robot_check, "PLAYS", [hard])
    assert check(write_biped(tmp_path)) == 3
    assert "expected a robot that stands, got a fall: " in (said := capsys.readouterr().out)
    assert "; push less" in said


def test_all_faults_of_a_file_are_shown_and_nothing_is_played(tmp_path, capsys):
    limit = 'lower="0.0" upper="2.3" effort="180"'
    assert check(write_biped(tmp_path, urdf=(limit, 'effort="0"'))) == 2
    said = capsys.readouterr().out
    assert said.count("FAIL") == 2
    assert "got lower 0 and upper 0 at joint left_knee; write its limits" in said
    assert "got 0 at joint left_knee; write that of its motor" in said
    assert "kg" not in said.splitlines()[-1]


@pytest.mark.parametrize("name", ["romeo", "talos"])
def test_a_robot_of_the_catalogue_is_checked_by_name(name, capsys):
    assert check(name, no_play=True) == 0
    assert capsys.readouterr().out.count("ok") == 15


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("push =", "pussh =", "settings.balance.pussh: expected some of task, controller,"),
        ("[settings.balance]", "[settings.balanc]", "settings.balanc: expected one of balance, wa"),
    ],
)
def test_settings_that_no_task_has_are_faults(old, new, expected, tmp_path, capsys):
    assert check(write_biped(tmp_path, file=(old, new)), no_play=True) == 2
    assert expected in capsys.readouterr().out


def test_a_missing_mesh_of_the_view_is_a_fault_of_the_check_alone(tmp_path, capsys):
    shape = ('<box size="0.16 0.28 0.45"/>', '<mesh filename="package://mine/trunk.dae"/>')
    file = write_biped(tmp_path, urdf=shape)
    assert check(file, no_play=True) == 2
    assert "the mesh 'package://mine/trunk.dae' of link trunk in" in capsys.readouterr().out
    assert load_robot(str(file)).name == "biped"
