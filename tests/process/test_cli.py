from __future__ import annotations

import math
import os
import subprocess

import pytest

from shared.config.settings import RunConfig
from shared.errors import ConfigError, LinkError, MessageRefused, ProfileError, UserError
from shared.process.cli import EXIT_FELL, EXIT_STANDING, Parser, run
from shared.process.entry import EXIT_ERROR, python
from shared.process.run_options import add_run_arguments, add_view_argument, config_from
from tests.processes import PATIENCE_SECONDS


@pytest.fixture
def parser():
    parser = Parser(prog="robot")
    add_run_arguments(parser)
    add_view_argument(parser)
    return parser


@pytest.fixture
def config_of(parser):
    return lambda *arguments: config_from(parser.parse_args(list(arguments)))


def test_without_flags_everything_has_its_default(config_of):
    assert config_of() == RunConfig()


def test_every_flag_reaches_its_setting(config_of):
    config = config_of(
        "--task", "balance", "--controller", "pr", "--network", "constant:30ms",
        "--duration", "2.5", "--seed", "4", "--noise", "0.02", "--loss", "0.25", "--view", "off",
        "--push", "1N@1s:1s:+x", "--push", "2N@2s:1s:-y",
    )  # fmt: skip
    assert (config.task, config.controller, config.view) == ("balance", "pr", "off")
    assert (config.link.network, config.link.loss) == ("constant:30ms", 0.25)
    assert (config.duration, config.seed) == (2.5, 4)
    assert config.sensors.joint_position_noise == 0.02
    assert config.push == ("1N@1s:1s:+x", "2N@2s:1s:-y")


def test_every_walk_flag_reaches_its_setting(config_of):
    config = config_of(
        "--task", "walk", "--steps", "8", "--step-length", "-0.1", "--step-sideways", "0.02",
        "--step-turn", "15deg", "--step-width", "0.2", "--step-duration", "0.9",
        "--double-support", "0.005", "--swing-height", "0.04", "--com-plan", "mpc",
        "--on-board-delay", "25ms",
    )  # fmt: skip
    walk = config.walk
    assert (walk.steps, walk.step_length, walk.step_sideways) == (8, -0.1, 0.02)
    assert walk.step_turn == pytest.approx(math.radians(15.0))
    assert (walk.step_width, walk.step_duration, walk.double_support) == (0.2, 0.9, 0.005)
    assert (walk.swing_height, walk.com_plan) == (0.04, "mpc")
    assert config.switch.ready_after_ns(config.switch.compute_ns) == 25_000_000
    assert config.duration == pytest.approx(walk.duration)


@pytest.mark.parametrize("flag", ["--steps=3", "--on-board-delay=3ms", "--com-plan=dcm"])
def test_a_walk_flag_without_a_walk_is_refused(config_of, flag):
    with pytest.raises(ConfigError, match="add --task walk"):
        config_of(flag)


@pytest.mark.parametrize("text", ["5", "5s", "5000ms", "5.0"])
def test_a_duration_has_a_unit_or_is_in_seconds(config_of, text):
    assert config_of("--duration", text).duration == 5.0


def test_words_may_be_in_capitals(config_of):
    config = config_of("--controller", "LC", "--task", "WALK", "--robot", "Talos")
    assert (config.controller, config.task, config.robot.name) == ("lc", "walk", "talos")


@pytest.mark.parametrize("angle", ["15 degrees", "deg", "", "1e3", "nan"])
def test_a_turn_that_is_no_angle_is_refused(parser, capsys, angle):
    with pytest.raises(SystemExit):
        parser.parse_args(["--task", "walk", "--step-turn", angle])
    assert "argument --step-turn: expected an angle as in 15deg" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "meant"), [("--controler", "--controller"), ("--newtork", "--network")]
)
def test_the_error_about_an_unknown_flag_names_the_flag_that_was_meant(
    parser, capsys, typed, meant
):
    with pytest.raises(SystemExit):
        parser.parse_args([typed, "x"])
    assert f"unrecognized arguments: {typed} x; did you mean {meant}?" in capsys.readouterr().err


def test_an_unknown_flag_like_no_other_gets_no_guess(parser, capsys):
    with pytest.raises(SystemExit):
        parser.parse_args(["--zzz"])
    assert "did you mean" not in capsys.readouterr().err


def test_a_zero_is_a_value_and_not_a_missing_flag(config_of):
    config = config_of("--noise", "0", "--loss", "0", "--seed", "0")
    assert config.sensors.joint_position_noise == 0.0


def test_flags_win_over_the_file(config_of, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("seed = 7\nduration = 9.0\npush = []\n[link]\nloss = 0.5\n")
    config = config_of("--config", str(path), "--seed", "8")
    assert (config.seed, config.duration, config.push) == (8, 9.0, ())
    assert config.link.loss == 0.5


def test_no_push_is_asked_for_by_name(config_of):
    assert config_of("--push", "none").push == ()


def test_no_outage_is_asked_for_by_name(config_of, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('[link]\noutage = ["cut@4s"]\n')
    assert config_of("--config", str(path)).link.outage == ("cut@4s",)
    assert config_of("--config", str(path), "--outage", "none").link.outage == ()


def test_no_push_and_a_push_contradict_each_other(config_of):
    with pytest.raises(ConfigError, match="none"):
        config_of("--push", "none", "--push", "1N@1s:1s:+x")


@pytest.mark.parametrize(
    "arguments",
    [["--speed", "3"], ["--seed", "one"], ["--seed"], ["positional"], ["--duration", "long"]],
)
def test_a_wrong_flag_is_one_line_and_exit_code_two(parser, capsys, arguments):
    with pytest.raises(SystemExit) as exit_:
        parser.parse_args(arguments)
    assert exit_.value.code == EXIT_ERROR
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("robot: error: ")
    assert captured.err.count("\n") == 1
    assert "--help" in captured.err


@pytest.mark.parametrize("code", [EXIT_STANDING, EXIT_FELL, 7])
def test_the_result_of_main_is_the_exit_code(code):
    with pytest.raises(SystemExit) as exit_:
        run(lambda: code)
    assert exit_.value.code == code


@pytest.mark.parametrize("kind", [UserError, ConfigError, ProfileError, LinkError])
def test_a_users_mistake_is_one_line_and_exit_code_two(capsys, kind):
    def main():
        raise kind("seed: expected a number, got 'x'")

    with pytest.raises(SystemExit) as exit_:
        run(main)
    assert exit_.value.code == EXIT_ERROR == 2
    assert capsys.readouterr().err == "error: seed: expected a number, got 'x'\n"


def test_a_mistake_of_ours_keeps_its_traceback():
    def main():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(main)


def test_an_interrupt_exits_as_shells_expect(capsys):
    def main():
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as exit_:
        run(main)
    assert exit_.value.code == 130
    assert capsys.readouterr().err == ""


def test_the_command_line_is_there_before_numpy():
    script = "import sys, shared.process.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run(python("-c", script), check=False).returncode == 0


def test_a_reader_that_left_is_no_traceback():
    script = (
        "from shared.process import cli\n"
        "def main():\n"
        "    for _ in range(100_000):\n"
        "        print('a line that nobody reads')\n"
        "    return 0\n"
        "cli.run(main)\n"
    )
    reader, writer = os.pipe()
    os.close(reader)
    finished = subprocess.run(
        python("-c", script),
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=PATIENCE_SECONDS,
    )
    os.close(writer)
    assert finished.stderr == ""
    assert finished.returncode == EXIT_ERROR


def test_a_refused_message_is_not_a_users_mistake():
    assert not issubclass(MessageRefused, UserError)


def test_an_entry_point_without_a_view_has_the_same_run():
    parser = Parser(prog="trial")
    add_run_arguments(parser)
    assert config_from(parser.parse_args([])) == RunConfig()


def test_the_robot_is_one_of_the_catalogue(config_of):
    assert config_of("--robot", "talos").robot.name == "talos"
    with pytest.raises(
        ConfigError, match=r"robot: expected one of g1, icub, romeo, talos, got 'juliet'"
    ):
        config_of("--robot", "juliet")
