"""Controllers, tasks and plants of one's own: by reference, by file, by entry point; refusals."""

from __future__ import annotations

import importlib.metadata
import textwrap

import pytest

from experiments.lockstep import Lockstep
from robot_node.plant import make_plant
from shared import extensions
from shared.config.config_file import load_config
from shared.config.extensions import CONTROLLERS, PLANTS, TABLES, TASKS, corrects
from shared.errors import ConfigError
from shared.motion.plan import make_motion
from shared.process.cli import Parser
from shared.process.run_options import add_run_arguments, config_from

SHORT = {"duration": 0.05, "link.network": "constant:5ms"}
CONTROLLER = """
    from examples.own_controller import LastSolution

    class Mine(LastSolution):
        pass
"""
TASK = """
    from shared.motion.standing import Standing

    def still(robot, config):
        return Standing(robot)

    class Motionless:
        def __init__(self, robot, config):
            self.digest = b"12345678"

        def reference(self, time_ns):
            raise NotImplementedError

        def next_switch(self, time_ns):
            return None
"""
PLANT = """
    from robot_node.plant import MujocoPlant

    class Slow(MujocoPlant):
        steps = 0

        def step(self, tau, *, push):
            Slow.steps += 1
            super().step(tau, push=push)

    class Pushless(MujocoPlant):
        def step(self, tau):
            pass
"""


@pytest.fixture
def file(tmp_path):
    def write(text, name="mine.py"):
        path = tmp_path / name
        path.write_text(textwrap.dedent(text), encoding="utf-8")
        return path

    return write


@pytest.fixture
def announced(monkeypatch):
    """Entry points as if packages that announce them were installed."""

    def announce(*entries):
        points = [
            importlib.metadata.EntryPoint(name, value, group) for group, name, value in entries
        ]
        monkeypatch.setattr(
            importlib.metadata,
            "entry_points",
            lambda group: [each for each in points if each.group == group],
        )
        extensions.announced.cache_clear()

    yield announce
    monkeypatch.undo()
    extensions.announced.cache_clear()


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_name_of_the_project_can_be_loaded(table):
    for name in table.own:
        loaded = table.load(name)
        assert callable(loaded) or loaded.name == name


def test_a_trial_uses_the_controller_the_task_and_the_plant_of_files(file):
    names = {
        "controller": f"{file(CONTROLLER, 'controller.py')}:Mine",
        "task": f"{file(TASK, 'task.py')}:still",
        "plant.kind": f"{file(PLANT, 'plant.py')}:Slow",
    }
    config = load_config(None, SHORT | names)
    result = Lockstep(config).run()
    assert type(result.summary["controller"]) is str
    assert PLANTS.load(names["plant.kind"]).steps >= 50
    assert load_config(None, SHORT).digest != config.digest
    assert CONTROLLERS.label(names["controller"]) == "Mine"
    assert TASKS.label(names["task"]) == "still"


def test_a_reference_to_an_installed_module_needs_no_file():
    config = load_config(None, SHORT | {"controller": "examples.own_controller:LastSolution"})
    assert not Lockstep(config).run().summary["fell"]


def test_a_package_announces_a_controller_by_an_entry_point(announced):
    announced(("remote_wbc.controllers", "last", "examples.own_controller:LastSolution"))
    assert CONTROLLERS.names() == ["la", "lc", "pr", "last"]
    config = load_config(None, SHORT | {"controller": "last"})
    assert not Lockstep(config).run().summary["fell"]
    assert CONTROLLERS.label("last") == "last"
    with pytest.raises(ConfigError, match="expected one of la, lc, pr, last, got 'lst'; did you"):
        load_config(None, {"controller": "lst"})


def test_an_announced_name_cannot_replace_one_of_the_project(announced):
    announced(("remote_wbc.controllers", "la", "examples.own_controller:LastSolution"))
    assert CONTROLLERS.load("la").__name__ == "LocallyAssisted"


def test_help_lists_what_packages_announce(announced, monkeypatch, capsys):
    announced(("remote_wbc.tasks", "dance", "their.dances:Waltz"))
    monkeypatch.setattr("sys.argv", ["wbc", "--help"])
    parser = Parser(prog="trial")
    add_run_arguments(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(["--help"])
    assert "balance, walk, go, dance" in " ".join(capsys.readouterr().out.split())


def test_a_file_on_the_command_line_is_of_the_current_folder(file, monkeypatch, tmp_path):
    file(CONTROLLER)
    monkeypatch.chdir(tmp_path)
    parser = Parser(prog="trial")
    add_run_arguments(parser)
    config = config_from(parser.parse_args(["--controller", "mine.py:Mine"]))
    assert config.controller == f"{tmp_path / 'mine.py'}:Mine"


def test_a_file_in_a_settings_file_is_of_that_files_folder(file, tmp_path):
    file(CONTROLLER)
    settings = file('controller = "mine.py:Mine"\n', "run.toml")
    assert load_config(settings).controller == f"{tmp_path / 'mine.py'}:Mine"


def test_a_module_is_no_file(tmp_path):
    assert TASKS.absolute("package.module:Name", tmp_path) == "package.module:Name"
    assert CONTROLLERS.absolute("la", tmp_path) == "la"


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("class Mine(: pass", "Mine", "invalid syntax"),
        ("import no_such_package", "Mine", "No module named 'no_such_package'"),
        ("raise RuntimeError('two\\nlines')", "Mine", "got .*: two;"),
        (CONTROLLER, "Mien", "expected one of Mine, got 'Mien'; did you mean Mine"),
        ("Mine = 3", "Mine", "expected a class or a function, got 3"),
        ("class Mine: pass", "Mine", r"expected Mine\(…\), got Mine\(\)"),
        ("def mine(parts): return 3", "mine", "expected cache, got a int without it"),
        (
            "from robot_node.controllers import Controller\nclass Mine(Controller): pass",
            "Mine",
            "expected command, got a class without",
        ),
        (
            CONTROLLER + "    def command(self, time): pass\n    Mine.command = command",
            "Mine",
            r"expected command\(time_ns=…\), got command\(time\)",
        ),
    ],
)
def test_a_controller_that_does_not_fit_is_an_error_in_a_line(file, text, name, message):
    config = load_config(None, SHORT | {"controller": f"{file(text)}:{name}"})
    with pytest.raises(ConfigError, match=message) as caught:
        Lockstep(config)
    assert "\n" not in str(caught.value)


def test_a_module_that_failed_is_imported_anew_once_it_is_mended(file):
    path = file("import no_such_package")
    with pytest.raises(ConfigError):
        CONTROLLERS.load(f"{path}:Mine")
    path.write_text(textwrap.dedent(CONTROLLER), encoding="utf-8")
    assert CONTROLLERS.load(f"{path}:Mine").__name__ == "Mine"


def test_a_task_without_a_member_is_refused(file, robot):
    config = load_config(None, {"task": f"{file(TASK)}:Motionless"})
    with pytest.raises(ConfigError, match="expected stopped, got a Motionless without it"):
        make_motion(robot, config)


def test_a_plant_whose_step_takes_no_push_is_refused(file, robot):
    config = load_config(None, {"plant.kind": f"{file(PLANT)}:Pushless"})
    with pytest.raises(ConfigError, match=r"expected step\(…, push=…\), got step\(tau\)"):
        make_plant(robot, config.plant, timestep=1e-3)


def test_the_digest_does_not_depend_on_where_a_task_lies(file, tmp_path):
    here = load_config(None, {"task": f"{file(TASK)}:still"})
    there = load_config(None, {"task": "/elsewhere/task.py:still"})
    assert here.digest == there.digest


@pytest.mark.parametrize(("name", "expected"), [("pr", False), ("la", False), ("lc", True)])
def test_only_lc_corrects(name, expected):
    assert corrects(name) is expected
