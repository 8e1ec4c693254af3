from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.config.config_file import dump_config, load_config
from shared.config.control_settings import Gains, WbcConfig
from shared.config.link_settings import LinkConfig, WireConfig
from shared.config.quantities import parse_duration_ns, parse_goal, parse_outage, parse_push
from shared.config.robot_settings import RobotConfig, SensorConfig
from shared.config.settings import SETTINGS, RunConfig
from shared.errors import ConfigError
from shared.toml_file import read_toml

MS = 1_000_000
# Digests and identities of published trials are of these: they are not to change by themselves.
DEFAULT: dict[str, str] = {}
WALK = {"task": "walk"}


def refusal(**overrides):
    """The message of a configuration with dotted keys (`__` for the dot) that is refused."""
    with pytest.raises(ConfigError) as error:
        load_config(None, {key.replace("__", "."): value for key, value in overrides.items()})
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "run.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_without_a_file_everything_has_its_default():
    assert load_config(None) == RunConfig()


def test_a_file_changes_what_it_names_and_nothing_else(file):
    path = file('seed = 7\n[link]\nnetwork = "constant:30ms"\n[wbc.gains]\ncom = 12\n')
    expected = dataclasses.replace(
        RunConfig(),
        seed=7,
        link=LinkConfig(network="constant:30ms"),
        wbc=WbcConfig(gains=Gains(com=12.0)),
    )
    assert load_config(path) == expected


def test_overrides_win_over_the_file(file):
    path = file('seed = 7\n[link]\nnetwork = "direct"\nloss = 0.1\n')
    config = load_config(path, {"seed": 8, "link.loss": 0.2})
    assert (config.seed, config.link.loss, config.link.network) == (8, 0.2, "direct")


CONFIGS = st.builds(
    RunConfig,
    controller=st.sampled_from(["la", "pr"]),
    duration=st.floats(1e-3, 1e5),
    seed=st.integers(0, 2**62),
    push=st.lists(st.sampled_from(["100N@1.0s:0.2s:+y", "5N@0s:1s:-z"]), max_size=3).map(tuple),
    robot=st.builds(RobotConfig, torque_clamp=st.floats(0.01, 1e6)),
    wbc=st.builds(
        WbcConfig,
        gains=st.builds(Gains, com=st.floats(0, 1e6), contact_damping=st.floats(0, 1e6)),
        friction=st.floats(1e-3, 10),
    ),
    sensors=st.builds(SensorConfig, joint_position_noise=st.floats(0, 1)),
    link=st.builds(
        LinkConfig,
        network=st.text(st.characters(exclude_categories=["Cs", "Cc"])),
        loss=st.floats(0, 1, exclude_max=True),
        keep_order=st.booleans(),
    ),
    wire=st.builds(WireConfig, projector_dtype=st.sampled_from(["float32", "float64"])),
)


@settings(max_examples=80)
@given(config=CONFIGS)
def test_a_dumped_configuration_is_read_back_equal(config, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "roundtrip.toml"
    path.write_text(dump_config(config, versions={"python": "3.11"}), encoding="utf-8")
    assert load_config(path) == config


def test_the_dump_names_every_setting_and_the_versions():
    text = dump_config(RunConfig(), versions={"numpy": "2.4.6"})
    assert 'numpy = "2.4.6"' in text

    def names(config):
        for field in dataclasses.fields(config):
            yield field.name
            value = getattr(config, field.name)
            if dataclasses.is_dataclass(value):
                yield from names(value)

    for name in names(RunConfig()):
        assert name in text


def test_a_robot_changes_the_defaults_of_a_task_and_a_file_and_flags_those_of_the_robot(file):
    config = load_config(None, {"robot.name": "talos", "task": "walk"})
    assert config.wbc.gains.contact_damping == 15.0  # not the walk's 30
    assert config.wbc.gains.com == 20.0  # the walk's, of which the robot file does not speak
    assert config.push == ()
    assert load_config(None, {"robot.name": "talos"}).push == ("223N@1.0s:0.2s:+y",)
    path = file('[robot]\nname = "talos"\ntorque_clamp = 2.0\n')
    config = load_config(path, {"wbc.gains.contact_damping": 7.0})
    assert (config.robot.torque_clamp, config.wbc.gains.contact_damping) == (2.0, 7.0)
    assert config.wbc.weights.force == 2e-6


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ('[robot]\nname = "juliet"', "robot: expected one of g1, icub, romeo, talos, got 'juliet'"),
        ("[robot]\nname = [1]", "robot.name: expected str"),
        ('robot = "talos"', "robot: expected a table of settings"),
        ('task = ["walk"]', "task: expected str"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(file, text, output):
    with pytest.raises(ConfigError, match=output):
        load_config(file(text))


def test_an_infinite_setting_survives_the_dump(file):
    config = load_config(None, {"loop.hold_after": math.inf})
    assert load_config(file(dump_config(config, versions={}))) == config


def test_an_unknown_setting_is_refused_with_those_that_are_valid_there():
    message = refusal(robot__weight=3)
    assert "robot.weight" in message
    for field in dataclasses.fields(RobotConfig):
        assert field.name in message


def test_an_unknown_section_is_refused_with_the_sections(file):
    with pytest.raises(ConfigError) as error:
        load_config(file("[netem]\nloss = 1\n"))
    for name in ("netem", "link", "wbc", "task"):
        assert name in str(error.value)


def test_an_unknown_setting_three_levels_down_is_named_in_full():
    assert refusal(wbc__gains__toes=1.0) == (
        "wbc.gains.toes: expected some of com, base_orientation, posture, contact_damping, "
        "swing_foot, angular_momentum, got 'toes'"
    )
    assert refusal(wbc__gains__postur=1.0).endswith("got 'postur'; did you mean posture?")
    assert refusal(wbc__hold_after=1.0).endswith("got 'hold_after'; did you mean loop.hold_after?")


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("seed", 1.5, "int"),
        ("seed", "1", "int"),
        ("seed", True, "int"),
        ("duration", "5", "float"),
        ("duration", True, "float"),
        ("controller", 3, "str"),
        ("push", "100N@1.0s:0.2s:+y", "list of strings"),
        ("push", [1], "list of strings"),
        ("link", "direct", "table"),
        ("link.keep_order", 1, "bool"),
        ("link.keep_order", "yes", "bool"),
        ("wbc.gains", 3, "table"),
        ("link.loss", None, "float"),
    ],
)
def test_a_value_of_another_type_is_refused(key, value, expected):
    message = refusal(**{key: value})
    assert message.startswith(f"{key}:")
    assert expected in message


def test_an_override_below_a_value_is_refused(file):
    with pytest.raises(ConfigError, match="link: expected a table"):
        load_config(file('link = "direct"\n'), {"link.loss": 0.1})


def test_a_whole_number_may_stand_for_a_float():
    config = load_config(None, {"duration": 3})
    assert config.duration == 3.0
    assert isinstance(config.duration, float)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("task", "dance"),
        ("controller", "pid"),
        ("view", "cinema"),
        ("wire.projector_dtype", "float16"),
        ("correction.level", "a"),
        ("wbc.solver", "simplex"),
        ("plant.kind", "soft"),
    ],
)
def test_a_word_that_is_not_one_of_the_valid_ones_is_refused_with_those(key, value):
    message = refusal(**{key: value})
    assert message.startswith(f"{key}: expected one of ")
    assert repr(value) in message


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("duration", 0.0),
        ("duration", -1.0),
        ("duration", math.nan),
        ("duration", math.inf),
        ("seed", -1),
        ("walk.steps", 0),
        ("walk.step_length", math.nan),
        ("robot.torque_clamp", 0.0),
        ("robot.torque_clamp", math.nan),
        ("sensors.joint_position_noise", -1e-3),
        ("sensors.joint_velocity_noise", math.nan),
        ("wbc.friction", 0.0),
        ("wbc.min_normal_force", -1.0),
        ("wbc.weights.force", 0.0),
        ("plant.friction", 0.0),
        ("loop.connect_timeout", -1.0),
        ("loop.hold_after", math.nan),
        ("loop.edge_compute_ns", -1),
        ("loop.fresh_within_ns", 0),
        ("loop.fresh_within_ns", 1_000_000),
        ("loop.period_ns", 2_000_000),
        ("link.loss", -0.1),
        ("link.loss", 1.0),
        ("link.loss", math.nan),
        # The controller takes their square roots in every tick.
        ("wbc.gains.com", -1.0),
        ("wbc.gains.base_orientation", -1.0),
        ("wbc.gains.posture", math.nan),
        ("wbc.gains.contact_damping", -1.0),
        ("wbc.weights.com", -1.0),
        ("wbc.weights.base_orientation", -0.1),
        ("wbc.weights.posture", math.nan),
        # Simulated time is a whole number of nanoseconds.
        ("loop.connect_timeout", math.inf),
        ("correction.iterations", -1),
        ("correction.iterations_at_switch", -1),
        ("correction.damping", -0.1),
        ("correction.damping", math.inf),
        ("correction.refresh_distance", -0.1),
        ("correction.refresh_distance", math.nan),
        ("correction.refresh_interval_ns", -1),
        ("correction.retry_ns", 999_999),
    ],
)
def test_a_number_out_of_range_is_refused_under_its_name(key, value):
    assert key in refusal(**{key: value})


def test_a_robot_welded_to_the_floor_cannot_be_asked_to_walk():
    assert load_config(None, {"plant.kind": "rigid"}).plant.kind == "rigid"
    message = refusal(task="walk", plant__kind="rigid")
    assert message.startswith("plant.kind: expected mujoco for a walk")


def test_limits_themselves_are_allowed():
    for key, value in (
        ("sensors.joint_position_noise", 0.0),
        ("loop.hold_after", math.inf),
        ("correction.refresh_distance", math.inf),
        ("correction.refresh_distance", 0.0),
        ("correction.iterations", 0),
        ("loop.connect_timeout", 0.0),
        ("link.loss", 0.0),
        ("wbc.min_normal_force", 0.0),
        ("push", []),
    ):
        load_config(None, {key: value})


@pytest.mark.parametrize(
    "text", ["seed = ", "= 3", "[link\n", b"seed = 1 # \xff\xfe", "seed = 1\nseed = 2\n"]
)
def test_a_file_that_is_no_toml_is_refused_by_its_name(file, text):
    with pytest.raises(ConfigError, match=r"run\.toml is not valid TOML"):
        load_config(file(text))


def test_a_missing_file_is_refused_by_its_name(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot read .*absent\.toml: No such file"):
        load_config(tmp_path / "absent.toml")


def test_both_ends_must_agree_on_robot_and_controller_settings_only():
    digest = RunConfig().digest
    assert len(digest) == 8
    for key, value in (("seed", 3), ("link.loss", 0.5), ("controller", "pr"), ("duration", 1.0)):
        assert load_config(None, {key: value}).digest == digest
    for key, value in (("wbc.friction", 0.4), ("robot.torque_clamp", 1.0), ("wbc.gains.com", 1.0)):
        assert load_config(None, {key: value}).digest != digest


@pytest.mark.parametrize(
    ("overrides", "digest"), [(DEFAULT, "019cfc9369a5f6cd"), (WALK, "5fae31cbd3f70189")]
)
def test_the_digest_of_the_defaults_changes_only_on_purpose(overrides, digest):
    assert load_config(None, overrides).digest.hex() == digest


def test_the_ground_is_agreed_on_and_the_unknown_one_is_not():
    flat, stairs = load_config(None), load_config(None, {"ground": "stairs:3x6cm"})
    assert flat.digest != stairs.digest
    assert stairs.plant_ground == "stairs:3x6cm"
    blocks = load_config(None, {"plant.unknown_ground": "blocks:2cm"})
    assert (blocks.digest, blocks.plant_ground) == (flat.digest, "blocks:2cm")


def test_a_file_of_a_ground_is_relative_to_the_file_that_names_it(file):
    config = load_config(file('ground = "yard.npz"\n'))
    assert config.ground == str(file("").parent / "yard.npz")


def test_grounds_and_goals_that_do_not_fit_are_refused():
    assert "expected flat for the equal steps" in refusal(ground="gap:10cm", **WALK)
    assert "expected mujoco" in refusal(plant__unknown_ground="gap:10cm", plant__kind="rigid")
    assert "expected flat, blocks:2cm" in refusal(ground="hill")
    for goal in ("", "1,2,3,4", "x", "99,0", "1,0,900deg", "nan,0"):
        assert "goal: expected X,Y,HEADING" in refusal(walk__goal=goal)


def test_a_walk_to_a_goal_has_time_for_its_steps():
    near, far = (load_config(None, {"task": "go", "walk.goal": goal}) for goal in ("1", "3,1"))
    assert near.walk.place == parse_goal("100cm,0,0deg")
    assert near.duration < far.duration


def test_pushes_and_outages_are_read_once_and_are_no_part_of_the_settings():
    config = load_config(None, {"push": ["1N@1s:1s:+x"], "link.outage": ["cut@4s"]})
    assert config.pushes == (parse_push("1N@1s:1s:+x"),)
    assert config.link.outages == (parse_outage("cut@4s"),)
    assert config.pushes is config.pushes
    unread = LinkConfig(outage=("cut@4s",))
    assert (unread, repr(unread)) == (config.link, repr(config.link))
    assert dataclasses.replace(config, push=()).pushes == ()


@pytest.mark.parametrize(
    ("text", "force", "start_ns", "duration_ns"),
    [
        ("100N@1.0s:0.2s:+y", (0.0, 100.0, 0.0), 1000 * MS, 200 * MS),
        ("60N@0s:1s:-x", (-60.0, 0.0, 0.0), 0, 1000 * MS),
        (" 7.5N@.5s:2.s:-z ", (0.0, 0.0, -7.5), 500 * MS, 2000 * MS),
        ("0N@0.0000001s:0s:+x", (0.0, 0.0, 0.0), 100, 0),
        (
            "50N@1s:1s:-x+y",
            (-50.0 / math.sqrt(2.0), 50.0 / math.sqrt(2.0), 0.0),
            1000 * MS,
            1000 * MS,
        ),
    ],
)
def test_a_push_is_read_with_its_direction_and_times(text, force, start_ns, duration_ns):
    push = parse_push(text)
    assert push.force == force
    assert (push.start_ns, push.duration_ns) == (start_ns, duration_ns)


def test_a_push_acts_from_its_start_until_before_its_end():
    push = parse_push("1N@0.002s:0.003s:+x")
    assert [ms for ms in range(7) if push.active(ms * MS)] == [2, 3, 4]
    assert push.active(5 * MS - 1)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "none",
        "100",
        "100N",
        "100N@1.0s",
        "100N@1.0s:0.2s",
        "100N@1.0s:0.2s:y",
        "100N@1.0s:0.2s:+w",
        "100N@1.0s:0.2s:+y+x",
        "100N@1.0s:0.2s:+x+z",
        "-100N@1.0s:0.2s:+y",
        "100N@1.0:0.2:+y",
        "100 N@1.0s:0.2s:+y",
        "1.2.3N@1.0s:0.2s:+y",
        ".N@1.0s:0.2s:+y",
        "1e3N@1.0s:0.2s:+y",
        "100N@1.0s:0.2s:+y;20N@1s:1s:+x",
        "nanN@1.0s:0.2s:+y",
        pytest.param("9" * 400 + "N@1s:1s:+x", id="endless force"),
        pytest.param("1N@" + "9" * 400 + "s:1s:+x", id="endless start"),
        pytest.param("1N@1s:" + "9" * 400 + "s:+x", id="endless duration"),
    ],
)
def test_a_push_in_another_form_is_refused_with_an_example(text):
    with pytest.raises(ConfigError, match=r"100N@1\.0s:0\.2s:\+y"):
        parse_push(text)


def test_a_bad_push_of_a_file_is_refused_when_it_is_loaded(file):
    with pytest.raises(ConfigError, match="push"):
        load_config(file('push = ["100N@1.0s:0.2s:+y", "hard"]\n'))


@pytest.mark.parametrize(
    ("text", "expected_ns"),
    [
        ("30ms", 30 * MS),
        ("1.5s", 1500 * MS),
        ("800us", 800_000),
        ("0ms", 0),
        (".5ms", 500_000),
        (" 2s ", 2000 * MS),
        ("0.0004us", 0),
    ],
)
def test_durations_are_read_with_their_unit(text, expected_ns):
    assert parse_duration_ns(text) == expected_ns


@pytest.mark.parametrize(
    "text",
    ["", "30", "ms", "-3ms", "3 ms", "3min", "3MS", "1e3ms", "nanms", "3.ms", "9" * 400 + "s"],
    ids=lambda text: text[:9] or "empty",
)
def test_other_durations_are_refused_with_examples(text):
    with pytest.raises(ConfigError, match="30ms"):
        parse_duration_ns(text)


def test_an_outage_has_a_beginning_and_perhaps_an_end():
    stall, cut = parse_outage("389ms@1.2s"), parse_outage("cut@4s")
    assert (stall.start_ns, stall.duration_ns) == (1200 * MS, 389 * MS)
    assert [stall.begun(at * MS) for at in (1199, 1200, 1588, 1589)] == [False, True, True, False]
    assert (cut.start_ns, cut.duration_ns) == (4000 * MS, None)
    assert not cut.begun(3999 * MS)
    assert cut.begun(10**18)


@pytest.mark.parametrize(
    "text", ["", "389ms", "@1s", "389@1s", "cut", "-1ms@1s", "1ms@-1s", "inf@1s"]
)
def test_an_outage_that_makes_no_sense_is_refused(text):
    assert "389ms@1.2s" in refusal(link__outage=[text])


def test_a_walk_needs_projectors_that_fit_into_one_message():
    assert "float32" in refusal(task="walk", wire__projector_dtype="float64")


def test_a_byte_order_mark_before_a_settings_file_does_not_matter(tmp_path):
    path = tmp_path / "run.toml"
    path.write_bytes("\ufeffseed = 3\n".encode())
    assert read_toml(path, what="settings") == {"seed": 3}


STEPPING = {"stepping.mode": "on"}


@pytest.mark.parametrize(
    ("asked", "error"),
    [
        ({**STEPPING, "wbc.balance.law": "com"}, "expected wbc"),
        ({**STEPPING, "plant.kind": "rigid"}, "expected mujoco"),
        ({**STEPPING, "task": "balance", "ground": "stairs:3x6cm"}, "expected flat"),
    ],
)
def test_a_robot_that_cannot_step_as_asked_is_refused(asked, error):
    with pytest.raises(ConfigError, match=error):
        load_config(None, asked)


def test_steps_change_the_defaults_of_a_robot_and_a_file_and_flags_those_of_steps(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text('stepping.mode = "on"\nwbc.weights.com = 50.0\n')
    config = load_config(file, {"wbc.limits.position": False})
    assert config.wbc.balance.law == "dcm"
    assert (config.wbc.weights.com, config.wbc.weights.swing_foot) == (50.0, 10.0)
    assert (config.wbc.limits.torque, config.wbc.limits.position) == (True, False)
    assert config.correction.on_board_budget == 0.3
    assert load_config(None, {"stepping.mode": "off"}) == load_config(None)


def test_both_ends_must_agree_on_steps():
    on = load_config(None, STEPPING)
    as_on = {"limits": {"torque": True, "position": True}, "balance": {"law": "dcm"}}
    settings = {**as_on, "weights": {"com": 100.0, "swing_foot": 10.0}}
    assert on.digest != load_config(None, {"wbc": settings}).digest
    assert load_config(None, {**STEPPING, "stepping.ahead": 0.1}).digest != on.digest


@pytest.mark.parametrize("double_support", [0.71, 0.8, 0.9])
def test_a_step_has_time_on_one_foot(double_support):
    message = refusal(task="walk", walk__double_support=double_support)
    assert message.startswith("walk.double_support: expected at most 0.7 s")
    assert load_config(None, {"task": "walk", "walk.double_support": 0.7}).walks


def test_no_real_number_is_so_large_that_its_square_is_none():
    for key, each in SETTINGS.items():
        if each.kind is float and not each.may_be_infinite:
            with pytest.raises(ConfigError, match=f"^{key}: expected a number"):
                load_config(None, {key: 1e300})
