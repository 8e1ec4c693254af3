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


def use_motion(robot, config):
    motion = make_motion(robot, config)
    return motion.reference(7), motion.next_switch(7), motion.stopped(7)


def use_plant(robot, config):
    plant = make_plant(robot, config, timestep=1e-3)
    return plant.state(), plant.contact_forces()


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
        (
            "raise RuntimeError('two\\nlines')",
            "Mine",
            "from its import, got RuntimeError: two at li",
        ),
        (CONTROLLER, "Mien", "expected one of Mine, got 'Mien'; did you mean Mine"),
        ("Mine = 3", "Mine", "expected a class or a function, got 3"),
        ("class Mine: pass", "Mine", r"expected Mine\(…\), got Mine\(\)"),
        ("def mine(parts): return 3", "mine", "expected cache, got a int without it"),
        (
            "def mine(parts): return parts.speed",
            "mine",
            "got AttributeError: .* at line 1 of mine.py",
        ),
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


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return 1 / 0", "expected no error from command, got ZeroDivisionError"),
        ("return decision.tau", "command: expected a Decision or None, got an ndarray"),
        (
            "decision.tau = decision.tau[:3]",
            "torques tau as a float array of shape .31,., got .3,.",
        ),
        ("decision.y = decision.y * float('nan')", "solution y .* with finite numbers, got nan"),
        ("decision.mode = 0", "command: mode: expected a ContactMode, got an int"),
    ],
)
def test_a_decision_that_is_none_ends_the_trial_in_a_line(file, body, message):
    text = f"""
        from examples.own_controller import LastSolution

        class Mine(LastSolution):
            def command(self, *, time_ns):
                decision = super().command(time_ns=time_ns)
                if decision is not None:
                    {body}
                return decision
    """
    config = load_config(None, SHORT | {"controller": f"{file(text)}:Mine"})
    with pytest.raises(ConfigError, match=message) as caught:
        Lockstep(config).run()
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


@pytest.mark.parametrize(
    ("member", "message"),
    [
        ("digest = 'two'", "digest: expected eight bytes, got 'two'; try motion_digest"),
        ("def reference(self, t): pass", "reference: expected a Reference, got None"),
        (
            "def reference(self, t): return replace(super().reference(t), com=None)",
            "reference: expected com as a float array",
        ),
        (
            "def reference(self, t): return replace(super().reference(t), mode=ContactMode(1))",
            "reference: expected a swing foot in single support alone",
        ),
        ("def next_switch(self, t): return t", "next_switch: expected a time after 7 ns, got 7"),
        ("def stopped(self, t): return None", "expected digest, got a NoneType without it"),
    ],
)
def test_a_task_with_a_faulty_member_is_refused(file, robot, member, message):
    text = f"""
        from dataclasses import replace
        from shared.motion.standing import Standing
        from shared.wbc.contacts import ContactMode

        class Mine(Standing):
            def __init__(self, robot, config):
                super().__init__(robot)
                self.digest = getattr(type(self), "digest", self.digest)

            {member}
    """
    config = load_config(None, {"task": f"{file(text)}:Mine"})
    with pytest.raises(ConfigError, match=message):
        use_motion(robot, config)


@pytest.mark.parametrize(
    ("member", "message"),
    [
        ("def step(self, tau): pass", r"expected step\(…, push=…\), got step\(tau\)"),
        ("contact_forces = None", "expected contact_forces, got a Mine without it"),
        ("def state(self): return self._qpos", "state: expected a pair q, v, got a"),
        ("def state(self): return self._qpos[:3], self._qvel", "state: expected q as a float arr"),
        ("def contact_forces(self): return {}", "contact_forces: expected a force for each of"),
    ],
)
def test_a_plant_with_a_faulty_member_is_refused(file, robot, member, message):
    text = f"""
        from robot_node.plant import MujocoPlant

        class Mine(MujocoPlant):
            {member}
    """
    config = load_config(None, {"plant.kind": f"{file(text)}:Mine"})
    with pytest.raises(ConfigError, match=message):
        use_plant(robot, config.plant)


OWN_SETTINGS = """
    from shared.motion.standing import Standing

    class Mine(Standing):
        def __init__(self, robot, config, *, depth=0.1, fast=False, name=""):
            super().__init__(robot)
            self.stated = (depth, fast, name)
"""


def test_settings_of_its_own_follow_a_value(file, robot, tmp_path):
    path = file(OWN_SETTINGS)
    value = f"{path}:Mine:depth=0.02:fast=true:name=low"
    motion = make_motion(robot, load_config(None, {"task": value}))
    assert vars(motion)["stated"] == (0.02, True, "low")
    assert TASKS.label(value) == "Mine depth=0.02 fast=true name=low"
    assert TASKS.absolute("mine.py:Mine:depth=1", tmp_path) == f"{path}:Mine:depth=1"
    assert load_config(None, {"task": f"{path}:Mine:depth=1"}).digest != (
        load_config(None, {"task": f"{path}:Mine:depth=2"}).digest
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (":deep=1", r"got Mine\(robot, config, \*, depth=0.1, fast=False, name=''\): .*'deep'"),
        (":depth=1:", "expected one of balance, walk, go, got"),
    ],
)
def test_settings_that_it_does_not_have_are_refused(file, robot, given, message):
    with pytest.raises(ConfigError, match=message):
        make_motion(robot, load_config(None, {"task": f"{file(OWN_SETTINGS)}:Mine{given}"}))


def test_a_name_of_the_project_takes_no_settings_of_its_own():
    with pytest.raises(ConfigError, match=r"controller: expected la without gain=3, got 'la:gain"):
        load_config(None, {"controller": "la:gain=3"})


def test_the_digest_depends_on_the_content_of_a_task_and_not_on_where_it_lies(file, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "changed").mkdir()
    here, there = file(TASK), file(TASK, "elsewhere/mine.py")
    changed = file(TASK + "\n    # changed", "changed/mine.py")
    digests = [load_config(None, {"task": f"{path}:still"}).digest for path in (here, there)]
    assert digests[0] == digests[1]
    assert load_config(None, {"task": f"{changed}:still"}).digest != digests[0]


def test_the_identity_of_a_package_covers_all_its_modules(file, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "their_tasks").mkdir()
    file("", "their_tasks/__init__.py")
    part = file("DEPTH = 1", "their_tasks/part.py")
    file(TASK, "their_tasks/tasks.py")
    before = TASKS.identity("their_tasks.tasks:still")
    part.write_text("DEPTH = 2")
    assert TASKS.identity("their_tasks.tasks:still") != before


@pytest.mark.parametrize(("name", "expected"), [("pr", False), ("la", False), ("lc", True)])
def test_only_lc_corrects(name, expected):
    assert corrects(name) is expected
