"""Robot files: what they state, where they may lie, and what is refused."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from experiments.lockstep import Lockstep
from shared.config.config_file import load_config
from shared.errors import ConfigError
from shared.robots import CATALOGUE, ROBOTS, Foot, description_of, load_robot
from shared.robots.standing import placements
from tests.robots.biped import write_biped

LEFT_SOLE = 'joint = "left_ankle_roll"\nsole = "collision"'


def test_a_copy_of_a_file_of_the_catalogue_is_the_same_robot(tmp_path):
    shutil.copy(CATALOGUE["talos"], tmp_path / "copy.toml")
    copy, talos = load_robot(str(tmp_path / "copy.toml")), load_robot("talos")
    assert copy.name == "copy"
    np.testing.assert_array_equal(copy.q_standing, talos.q_standing)
    assert copy.soles == talos.soles
    assert copy.description.settings == talos.description.settings


def test_a_trial_is_played_with_the_robot_of_a_file(tmp_path):
    file = write_biped(tmp_path)
    config = load_config(
        None, {"robot.name": str(file), "duration": 0.3, "link.network": "constant:5ms"}
    )
    assert config.push == ("80N@1.0s:0.2s:+y",)
    result = Lockstep(config).run()
    assert not result.summary["fell"]
    assert config.robot.label == "biped"


def test_a_relative_file_is_of_the_settings_file_or_of_the_current_folder(tmp_path, monkeypatch):
    write_biped(tmp_path)
    settings = tmp_path / "run.toml"
    settings.write_text('robot.name = "biped.toml"\n')
    expected = str(tmp_path / "biped.toml")
    assert load_config(settings).robot.name == expected
    monkeypatch.chdir(tmp_path)
    assert load_config(None, {"robot.name": "biped.toml"}).robot.name == expected


def test_a_package_announces_a_robot_by_an_entry_point(tmp_path, monkeypatch):
    package = tmp_path / "their_robots"
    package.mkdir()
    (package / "__init__.py").touch()
    write_biped(package, name="walker")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        "shared.robots.catalogue.announced", lambda group: {"walker": "their_robots"}
    )
    monkeypatch.setattr("shared.extensions.announced", lambda group: {"walker": "their_robots"})
    assert ROBOTS.names() == [*CATALOGUE, "walker"]
    assert description_of("walker").name == "walker"


def test_both_ends_agree_only_on_the_same_content_of_the_files(tmp_path):
    here, there, other = (tmp_path / name for name in ("here", "there", "other"))
    for folder in (here, there, other):
        folder.mkdir()

    def digest(file):
        return load_config(None, {"robot.name": str(file)}).digest

    mine = digest(write_biped(here))
    assert digest(write_biped(there)) == mine
    assert digest(write_biped(other, urdf=('mass value="24.0"', 'mass value="25.0"'))) != mine
    assert digest(write_biped(other, file=("left_knee = 0.7", "left_knee = 0.71"))) != mine


def test_the_sole_is_read_off_the_collision_shapes(tmp_path):
    robot = load_robot(str(write_biped(tmp_path)))
    for sole in robot.soles:
        # The box of the foot in the URDF: 0.22 m by 0.11 m about x = 0.03, its bottom at -0.07.
        np.testing.assert_allclose([*sole.x, *sole.y], [-0.08, 0.14, -0.055, 0.055], atol=1e-9)
        height = robot.sole_frame(sole.side).placement.translation[2]
        assert height == pytest.approx(-0.07, abs=1e-9)


def test_a_placement_turns_the_sole_frame(tmp_path):
    """An ankle whose axes are y right and z down, as an iCub has them."""
    turned = write_biped(
        tmp_path,
        urdf=(
            '<child link="left_foot"/>\n    <origin xyz="0 0 0"/><axis xyz="1 0 0"/>',
            '<child link="left_foot"/>\n    <origin xyz="0 0 0" rpy="3.141592653589793 0 0"/>'
            '<axis xyz="1 0 0"/>',
        ),
        file=(
            LEFT_SOLE,
            'joint = "left_ankle_roll"\nrotation = [3.141592653589793, 0.0, 0.0]\n'
            "translation = [0.0, 0.0, 0.07]\nsole = { x = [-0.08, 0.14], y = [-0.05, 0.05] }",
        ),
    )
    sole = placements(load_robot(str(turned)))[Foot.LEFT]
    np.testing.assert_allclose(sole.rotation, np.eye(3), atol=1e-9)
    assert sole.translation[2] == pytest.approx(0.0, abs=1e-9)


def test_a_foot_by_a_frame_is_the_foot_by_its_joint(tmp_path):
    by_joint = load_robot(str(write_biped(tmp_path)))
    by_frame = load_robot(
        str(write_biped(tmp_path, file=('joint = "left_ankle_roll"', 'frame = "left_foot"')))
    )
    a, b = by_joint.sole_frame(Foot.LEFT), by_frame.sole_frame(Foot.LEFT)
    assert a.parentJoint == b.parentJoint
    np.testing.assert_allclose(a.placement.homogeneous, b.placement.homogeneous, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("urdf =", "udrf ="), "udrf: expected some of urdf, srdf, .*, got 'udrf'; did you mean"),
        (('"NAME.urdf"', '"no.urdf"'), "urdf: expected a file in .*, got 'no.urdf'"),
        (
            ('"NAME.urdf"', '"package://no_such/r.urdf"'),
            "expected a file in .* got 'package://no_such/r.urdf'; try packages",
        ),
        (("left_knee = 0.7", "left_kne = 0.7"), "posture.angles: .*'left_kne'; did you mean"),
        (("left_knee = 0.7", "left_knee = nan"), "left_knee: expected a finite number, got nan"),
        (
            ("left_knee = 0.7", 'left_knee = "0.7"'),
            "left_knee: expected a finite number, got '0.7'",
        ),
        (
            ("[posture.angles]", "[posture]\nstate = 'up'\n[posture.angles]"),
            "state or angles, got b",
        ),
        (("[posture.angles]", "[posture.angels]"), "angels: expected some of state, angles, base"),
        (("[feet.left]", "[feet.middle]"), "feet.middle: expected some of left, right"),
        (("\n[feet.right]", "\n[settings.x]"), "feet.right: expected a table of joint, .*got none"),
        (
            (LEFT_SOLE, 'sole = "collision"'),
            "feet.left: expected either joint or frame, got neither",
        ),
        ((LEFT_SOLE, 'joint = "toe"\nsole = "collision"'), "feet.left.joint: .* got 'toe'"),
        ((LEFT_SOLE, 'frame = "toe"\nsole = "collision"'), "feet.left.frame: .* got 'toe'"),
        (
            (LEFT_SOLE, 'joint = "left_ankle_roll"\nsole = "mesh"'),
            "left.sole: expected a table of x, y, or 'collision', got 'mesh'",
        ),
        (
            (LEFT_SOLE, 'joint = "left_ankle_roll"\nsole = { x = [0.1, -0.1], y = [0, 1] }'),
            "left.sole.x: expected two numbers, the smaller one first, got .0.1, -0.1.",
        ),
        (
            (LEFT_SOLE, 'joint = "left_knee"\nsole = "collision"\ntranslation = [0, 1]'),
            "left.translation: expected three numbers, got .0, 1.",
        ),
        (("leg_radii = [0.05, 0.045]", "leg_radii = [0.05]"), "leg_radii: expected two lengths"),
    ],
    ids=range(17),
)
def test_a_file_that_cannot_be_used_is_refused_in_a_line_with_its_key(tmp_path, change, message):
    old, new = (text.replace("NAME", "biped") for text in change)
    file = write_biped(tmp_path, file=(old, new))
    with pytest.raises(ConfigError, match=message) as caught:
        load_robot(str(file))
    assert str(caught.value).startswith("robot biped: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_name_that_no_key_can_have_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"robot: cannot read .*: No such file"):
        load_config(None, {"robot.name": str(tmp_path / "none.toml")})
    (tmp_path / "my robot.toml").touch()
    with pytest.raises(ConfigError, match="expected a file name of letters, digits"):
        load_config(None, {"robot.name": str(tmp_path / "my robot.toml")})


def test_a_setting_that_does_not_exist_is_refused_where_the_task_is_used(tmp_path):
    file = write_biped(tmp_path, file=("push =", "shove ="))
    with pytest.raises(ConfigError, match="shove"):
        load_config(None, {"robot.name": str(file)})


def _srdf(base: str) -> str:
    return (
        '<robot name="biped"><group_state name="up" group="all">'
        f'<joint name="root_joint" value="0 0 0.8 {base}"/>'
        '<joint name="left_knee" value="0.6"/></group_state></robot>'
    )


def test_a_posture_is_a_state_of_an_srdf(tmp_path):
    state = ("[posture.angles]", '[posture]\nstate = "up"\n[ignored]')
    file = write_biped(tmp_path, file=state)
    text = file.read_text()
    start, end = text.index("[ignored]"), text.index("# The last joint above")
    file.write_text('srdf = "biped.srdf"\n' + text[:start] + text[end:])
    (tmp_path / "biped.srdf").write_text(_srdf("0 0 0 1"))
    with pytest.raises(ConfigError, match=r"tilt of .* at the left foot|z \w+ at the left foot"):
        load_robot(str(file))  # one knee bent
    (tmp_path / "biped.srdf").write_text(_srdf("0 0 0 2"))
    with pytest.raises(ConfigError, match="expected a unit quaternion of the base"):
        load_robot(str(file))
    (tmp_path / "biped.srdf").write_text(_srdf("0 0 0 1").replace('"up"', '"down"'))
    with pytest.raises(ConfigError, match=r"posture.state: expected one of down, got 'up'"):
        load_robot(str(file))


def test_a_base_that_is_turned_upside_down_shows_in_the_sole_axes(tmp_path):
    angles = ("[posture.angles]", f"[posture]\nbase = [{math.pi}, 0.0, 0.0]\n[posture.angles]")
    with pytest.raises(ConfigError, match=r"z down at the left foot; try feet.left.rotation"):
        load_robot(str(write_biped(tmp_path, file=angles)))


def test_the_digest_covers_the_mesh_of_a_sole_and_no_other_one(tmp_path):
    trunk, foot = '<box size="0.16 0.28 0.45"/>', '<box size="0.22 0.11 0.03"/>'
    file = write_biped(tmp_path)
    urdf, text = tmp_path / "biped.urdf", file.read_text()
    parts = urdf.read_text().split("<collision>")
    parts[0] = parts[0].replace(trunk, '<mesh filename="trunk.stl"/>')
    parts[-1] = parts[-1].replace(foot, '<mesh filename="package://foot.stl"/>')
    urdf.write_text("<collision>".join(parts))

    def digest(mesh, *, of):
        (tmp_path / mesh).write_text(of)
        return ROBOTS.identity(str(file))

    before = digest("foot.stl", of="a foot")
    assert digest("trunk.stl", of="a trunk") == before
    assert digest("foot.stl", of="another foot") != before
    numbers = "translation = [0, 0, -0.07]\nsole = { x = [-0.08, 0.14], y = [-0.05, 0.05] }"
    file.write_text(text.replace('sole = "collision"', numbers))
    assert digest("foot.stl", of="a foot") == digest("foot.stl", of="another foot")


def test_a_fault_in_a_robots_settings_names_its_file(tmp_path):
    file = str(write_biped(tmp_path, file=("push =", "pussh =")))
    with pytest.raises(ConfigError, match=r"robot biped: settings.balance.pussh: expected some of"):
        load_config(None, {"robot.name": file})
    sound = str(write_biped(tmp_path, name="sound"))
    with pytest.raises(ConfigError, match=r"^duration: expected a number"):
        load_config(None, {"robot.name": sound, "duration": -1.0})
    with pytest.raises(ConfigError, match=r"^robot: expected a table"):
        load_config(None, {"robot": "sound"})
