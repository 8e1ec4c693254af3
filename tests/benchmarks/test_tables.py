"""The commands `bench core`, `floor` and `peers`: tables with their rows, refusals in a line."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import core, floor, limits, messages, peers
from shared.config.settings import RunConfig
from shared.robots import load_robot


@pytest.fixture
def no_messages(monkeypatch):
    times = np.arange(1.0, 101.0) * 1e3
    monkeypatch.setattr(messages, "measure", lambda connect: (times, times))
    for module in (core, floor, limits, peers):
        monkeypatch.setattr(module, "header", lambda: "a machine")


@pytest.mark.parametrize(
    "words",
    [
        "core --repetitions 0",
        "core --seconds 0.1",
        "core --rounds 0",
        "core --against no-such-commit",
        "floor --repetitions 0",
        "limits --rounds 0",
        "peers --rounds 0",
    ],
)
def test_a_flag_that_cannot_be_used_is_refused_in_a_line(typed, words):
    done = typed("bench", *words.split())
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: --")


def test_core_has_trials_alternatives_messages_and_start_up(no_messages, monkeypatch):
    monkeypatch.setattr(core, "start_up_ns", lambda module: 500_000_000)
    monkeypatch.setattr(core, "_TRIALS", (("balance", "la"),))
    text = core.run(repetitions=2, seed=0, seconds=0.3)
    assert text.startswith("a machine; seed 0")
    for row in ("balance, LA", "  tick ", "  edge step ", "    measure ", "      terms of b "):
        assert f"\n{row}" in text
    assert "\nQP in forces, proxsuite warm " in text
    assert "\nsend 720 B" in text
    assert text.splitlines()[-1].split() == ["viewer", "0.50", "0.50–0.50"]


def test_limits_has_a_ratio_for_each_controller_and_kind(no_messages):
    lines = limits.run(rounds=1).splitlines()[-6:]
    assert [line.split()[0] for line in lines] == ["LA"] * 3 + ["LC"] * 3
    assert [line.split()[1].strip(",") for line in lines] == ["none", "torque", "torque"] * 2


def test_floor_has_a_sum_for_each_loop(no_messages):
    text = floor.run(repetitions=2)
    for name, parts in floor.SUMS.items():
        (line,) = (each for each in text.splitlines() if each.startswith(f"{name}: "))
        assert line.endswith(f" µs of {', '.join(parts)}")
    assert "\nreceive 28300 B" in text


def test_the_peers_are_told_of_the_same_robot_states_and_tasks(tmp_path):
    config, robot = RunConfig(), load_robot("romeo")
    states = [(robot.q_standing, np.zeros(robot.model.nv))] * 3
    case = dict(np.load(peers.write_case(tmp_path, robot, config, states)))
    assert case["q"].shape == (3, robot.model.nq)
    assert case["base_frame"] == "base_link"
    assert case["joints"].tolist() == list(robot.model.names)[2:]
    assert case["com_weight"] == config.wbc.weights.com
    np.testing.assert_allclose(case["corners"].mean(axis=0), 0.0, atol=1e-12)


def test_peers_that_cannot_be_installed_are_left_out_with_the_reason(
    no_messages, monkeypatch, tmp_path
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    lock = tmp_path / "peers.lock"
    lock.write_text("tsid==1.7.1 --hash=sha256:" + 64 * "0" + "\n")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    monkeypatch.setattr(peers, "_LOCK", lock)
    text = peers.run(rounds=1)
    assert text.startswith("no comparison with tsid and placo: cannot install them: ERROR: ")
    assert "\n" not in text
