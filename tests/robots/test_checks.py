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
    ],
)
def test_a_urdf_that_cannot_work_is_refused_by_the_name_of_its_part(tmp_path, old, new, message):
    file = write_biped(tmp_path, urdf=(old, new))
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_robot(str(file))
    assert str(caught.value).startswith("robot biped: ")
    assert "\n" not in str(caught.value)


SOLE = "sole = { x = [-0.08, 0.14], y = [-0.05, 0.05] }"


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
    assert len(found) == 4
    assert sum(map(len, found.values())) == 2
