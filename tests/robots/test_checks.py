"""Robots that cannot work are refused by name before anything is simulated."""

from __future__ import annotations

import re

import pytest

from shared.errors import ConfigError
from shared.robots import description_of, load_robot
from shared.robots.loading import checks
from tests.robots.biped import write_biped

KNEE_LIMIT = 'lower="0.0" upper="2.3" effort="180"'
SHANK = '<link name="left_shank">'


def _without_inertial(text):
    start = text.index(SHANK)
    end = text.index("</inertial>", start) + len("</inertial>")
    return text[start:end]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (KNEE_LIMIT, KNEE_LIMIT.replace("180", "0"), "effort limit, got 0 at joint left_knee"),
        (KNEE_LIMIT, KNEE_LIMIT.replace("180", "inf"), "effort limit, got inf at joint left_knee"),
        (KNEE_LIMIT, 'lower="0.0" upper="2.3"', "effort limit, got none at joint left_knee"),
        (KNEE_LIMIT, 'effort="180"', "range of angles, got lower 0 and upper 0 at joint left_knee"),
        ('velocity="12"', 'velocity="0"', "velocity limit, got 0 at joint left_hip_yaw"),
        (
            'name="left_knee" type="revolute"',
            'name="left_knee" type="continuous"',
            "hinges with limits, got left_knee, which is continuous",
        ),
        (
            'name="left_knee" type="revolute"',
            'name="left_knee" type="prismatic"',
            "hinges with limits, got left_knee, which is prismatic",
        ),
        (
            '<parent link="left_thigh"/>',
            '<mimic joint="left_hip_pitch"/><parent link="left_thigh"/>',
            "got left_knee, which mimics left_hip_pitch",
        ),
        (
            "</robot>",
            '<joint name="bar" type="fixed"><parent link="left_thigh"/><child link="left_foot"/>'
            "</joint></robot>",
            "link left_foot below two joints, left_ankle_roll and bar",
        ),
        (
            "</robot>",
            '<link name="lost"/></robot>',
            "one root link, got trunk, lost",
        ),
        (
            '<parent link="left_thigh"/>',
            '<parent link="left_thig"/>',
            "'left_thig' in joint left_knee",
        ),
        (
            'mass value="2.4"',
            'mass value="0"',
            "mass above 0, got none at link left_shank, which joint left_kn",
        ),
        ('mass value="2.4"', 'mass value="-1"', "at least 0, got -1 kg at link left_shank"),
        ("<robot name", "<robt name", "is not valid XML"),
        ('effort="180"', 'effort="lots"', "got effort='lots' in <limit> of joint left_knee; corr"),
        ('mass value="2.4"', 'mass value="nan"', "got value='nan' in <mass> of link left_shank"),
        ('origin xyz="0 0', 'origin xyz="nan 0', "got xyz='nan 0 0.2' in <origin> of link trunk"),
        ('origin xyz="0 0', 'origin xyz="0', "got xyz='0 0.2' in <origin> of link trunk"),
        (
            '<axis xyz="0 1 0"/>',
            '<axis xyz="0 0 0"/>',
            "expected an axis, got (0.0, 0.0, 0.0) at joint left_hip_pitch",
        ),
        ('ixx="', 'ixx="-', "of inertia of at least 0, got -0.5618 kg m² at link trunk"),
        ("</robot>", '<link name="trunk"/></robot>', "got link trunk twice; rename one of them"),
        ('name="left_hip_pitch"', 'name="left_hip_roll"', "got joint left_hip_roll twice; rename"),
        (
            '<parent link="left_thigh"/>',
            '<parent link="left_foot"/>',
            "left_shank, left_ankle_link, left_foot in a loop of their own",
        ),
    ],
)
def test_a_urdf_that_cannot_work_is_refused_by_the_name_of_its_part(tmp_path, old, new, message):
    file = write_biped(tmp_path, urdf=(old, new))
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_robot(str(file))
    assert str(caught.value).startswith("robot biped: ")
    assert "\n" not in str(caught.value)


SOLE = "sole = { x = [-0.08, 0.14], y = [-0.05, 0.05] }"


BELOW = f"translation = [0, 0, -0.07]\n{SOLE}"


def _feet(left: str, right: str) -> tuple[str, str]:
    return (
        '[feet.left]\njoint = "left_ankle_roll"\nsole = "collision"\n\n[feet.right]\n'
        'joint = "right_ankle_roll"\nsole = "collision"',
        f"[feet.left]\n{left}\n\n[feet.right]\n{right}",
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            _feet(
                'joint = "right_ankle_roll"\nsole = "collision"',
                'joint = "left_ankle_roll"\nsole = "collision"',
            ),
            "expected the left foot on the left (y), got it at -0.100 m",
        ),
        (
            _feet(
                'joint = "left_ankle_roll"\nsole = "collision"',
                'joint = "left_ankle_roll"\nsole = "collision"',
            ),
            "feet.left and feet.right on one joint",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\nrotation = [3.14159, 0, 0]\n{SOLE}',
                f'joint = "right_ankle_roll"\n{SOLE}',
            ),
            "got x forward and z down at the left foot; try feet.left.rotation = [0, 0, 0]",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\nrotation = [0, 0, 1.5708]\n{SOLE}',
                f'joint = "right_ankle_roll"\n{SOLE}',
            ),
            "got x left and z up at the left foot",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\ntranslation = [0, 0, -0.07]\n{SOLE}',
                f'joint = "right_ankle_roll"\ntranslation = [0, 0, -0.03]\n{SOLE}',
            ),
            "both soles at one height, got the left one 0.040 m lower",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\ntranslation = [0, 0, 0.07]\n{SOLE}',
                f'joint = "right_ankle_roll"\ntranslation = [0, 0, 0.07]\n{SOLE}',
            ),
            "expected the soles below all joints, got joint left_ankle_pitch 0.070 m below",
        ),
        (("left_ankle_pitch = -0.35", "left_ankle_pitch = -0.3"), "tilt of 2.9° at the left foot"),
        (
            _feet(
                f'joint = "left_ankle_roll"\ntranslation = [0, 0, -0.07]\n{SOLE}',
                f'joint = "right_knee"\ntranslation = [0, 0, -0.07]\n{SOLE}',
            ),
            "tilt of 20° at the right foot",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\n{BELOW}',
                f'joint = "right_ankle_roll"\n{BELOW}'.replace("0.14", "140"),
            ),
            "got 140 m along x at the right sole; correct feet.right.sole, in metres",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\n{BELOW}'.replace("0.14", "-0.075"),
                f'joint = "right_ankle_roll"\n{BELOW}',
            ),
            "got 0.005 m along x at the left sole",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\n{BELOW}'.replace("-0.07]", "-70]"),
                f'joint = "right_ankle_roll"\n{BELOW}'.replace("-0.07]", "-70]"),
            ),
            "expected the left sole within a leg's length of its joint, 0.66 m, got 70 m",
        ),
        (
            _feet(
                f'joint = "left_ankle_roll"\n{BELOW}'.replace("[-0.05", "[-0.18"),
                f'joint = "right_ankle_roll"\n{BELOW}',
            ),
            "got an overlap of 0.030 m in y",
        ),
        (("left_knee = 0.7", "left_knee = -0.7"), "joint left_knee between 0 and 2.3 rad"),
        (
            _feet(
                f'joint = "left_ankle_roll"\ntranslation = [0.3, 0, -0.07]\n{SOLE}',
                f'joint = "right_ankle_roll"\ntranslation = [0.3, 0, -0.07]\n{SOLE}',
            ),
            "expected the centre of mass above the feet, x between",
        ),
    ],
)
def test_a_robot_that_cannot_stand_is_refused_with_a_remedy(tmp_path, change, message):
    file = write_biped(tmp_path, file=change)
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_robot(str(file))
    assert "; " in str(caught.value) or "same joint" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_stretched_legs_and_weak_motors_are_found_among_the_checks(tmp_path):
    file = write_biped(tmp_path, urdf=('effort="180"', 'effort="5"'))
    text = file.read_text()
    for angle in ("-0.35", "0.7"):
        text = text.replace(angle, "0.0")
    found = dict(checks(description_of(str(file))))
    (weak,) = found["torques of standing within the effort limits"]
    assert "joint left_knee that can hold the posture" in weak
    file.write_text(text)
    found = dict(checks(description_of(str(file))))
    (stretched,) = found["legs bent, so that steps are in reach"]
    assert "bend hips, knees and ankles" in stretched


def test_a_robot_with_faults_in_its_urdf_shows_all_of_them_and_is_not_loaded(tmp_path):
    file = write_biped(tmp_path, urdf=(KNEE_LIMIT, 'effort="0"'))
    found = dict(checks(description_of(str(file))))
    assert len(found) == 5
    assert sum(map(len, found.values())) == 2


STATE = """<robot name="biped"><group_state name="half" group="all">
    <joint name="root_joint" value="0 0 0.7 0 0 0 1"/><joint name="head" value="bent"/>
    <joint name="left_knee" value="0.7"/><joint name="right_knee" value="0.7"/>
    <joint name="left_hip_pitch" value="-0.35"/><joint name="right_hip_pitch" value="-0.35"/>
    <joint name="left_ankle_pitch" value="-0.35"/><joint name="right_ankle_pitch" value="-0.35"/>
</group_state></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0 0 0 1", "0 0 0 2", "unit quaternion of the base, got one of length 2; correct root_j"),
        ("0 0 0 1", "0 0 0 nan", "finite numbers for joint root_joint, got '0 0 0.7 0 0 0 nan'"),
        ("0 0 0 1", "1", "expected 7 numbers for joint root_joint, got 4; correct it in"),
        ("left_knee", "left_kne", "a joint of the URDF, got 'left_kne'; did you mean left_knee?"),
        ('"half"', '"hlaf"', "expected one of hlaf, got 'half'; did you mean hlaf?"),
        ('<group_state name="half" group="all">', "", "not valid XML"),
        (STATE, "<robot />", "expected a group_state, got none of name 'half'"),
        (STATE, "", "not valid XML: no element found"),
    ],
)
def test_a_state_of_an_srdf_that_cannot_be_used_is_refused(tmp_path, old, new, message):
    file = write_biped(tmp_path)
    text = file.read_text()
    angles = text[text.index("[posture.angles]") : text.index("# The last joint")]
    text = text.replace(angles, '[posture]\nstate = "half"\n')
    file.write_text('srdf = "biped.srdf"\n' + text)
    usable = STATE.replace('<joint name="head" value="bent"/>', '<joint name="head" value="0"/>')
    (tmp_path / "biped.srdf").write_text(usable)
    assert load_robot(str(file)).q_standing[10] == 0.7
    (tmp_path / "biped.srdf").write_text(new if old == STATE else usable.replace(old, new))
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_robot(str(file))
    assert "\n" not in str(caught.value)


FOOT = '<box size="0.22 0.11 0.03"/>'


@pytest.mark.parametrize(
    ("filename", "content", "message"),
    [
        ("meshes/foot.stl", None, "expected the mesh 'meshes/foot.stl' of link right_foot"),
        ("package://nowhere/foot.stl", None, "the mesh 'package://nowhere/foot.stl' of link r"),
        ("foot.stl", "no mesh", "expected meshes that can be read, got message: Could not load"),
    ],
)
def test_a_sole_of_a_mesh_that_is_none_is_refused(tmp_path, filename, content, message):
    file = write_biped(tmp_path)
    urdf = tmp_path / "biped.urdf"
    text, mesh = urdf.read_text(), f'<mesh filename="{filename}"/>'
    before, collision, after = text.rpartition("<collision>")
    # The right foot is the last link with shapes.
    assert FOOT in after
    urdf.write_text(before + collision + after.replace(FOOT, mesh, 1))
    if content is not None:
        (tmp_path / filename).write_text(content)
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_robot(str(file))
    assert "\n" not in str(caught.value)


def test_a_folder_of_packages_that_is_none_is_refused(tmp_path):
    file = write_biped(tmp_path, file=("urdf =", 'packages = ["nowhere"]\nurdf ='))
    with pytest.raises(ConfigError, match=r"packages: expected folders, got .*nowhere, which"):
        description_of(str(file))
