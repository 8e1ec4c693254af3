"""A field with what is known of it is all that a setting takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from shared.config.config_file import load_config
from shared.config.setting import sections_of, setting
from shared.config.settings import SETTINGS
from shared.errors import ConfigError
from shared.process.cli import Parser
from shared.process.run_options import _add_flag, _given


@dataclass(frozen=True)
class Lamp:
    """A lamp."""

    power: float = setting(5.0, help="at 100 %", unit="W", at_least=0.0, below=20.0, flag="--power")
    dark_after: float = setting(1.0, help="as long it shines", at_least=0.0, may_be_infinite=True)
    share: float = setting(0.5, help="of the room", at_most=1.0)
    offset: float = setting(0.0, help="from the middle", unit="m")
    colour: str = setting("red", help="it has", choices=("red", "green"), flag="--colour")
    kind: str = setting("arc", help="of lamp", choices=("arc", "led"))
    lit: bool = setting(True, help="at the beginning", flag="--lamp-lit")
    flashes: tuple[str, ...] = setting((), help="in between", flag="--flash", metavar="1s@2s")


@dataclass(frozen=True)
class Room:
    """A room."""

    doors: int = setting(1, help="to it", at_least=1, flag="--doors")
    lamp: Lamp = field(default_factory=Lamp)


KNOWN = {key: each for section in sections_of(Room) for key, each in section.settings.items()}


def test_sections_come_with_their_names_and_their_settings_with_dotted_keys():
    room, lamp = sections_of(Room)
    assert (room.name, room.cls, list(room.settings)) == ("", Room, ["doors"])
    assert (lamp.name, lamp.cls) == ("lamp", Lamp)
    assert list(lamp.settings)[:2] == ["lamp.power", "lamp.dark_after"]


def test_the_default_is_that_of_the_field():
    assert Room().lamp == Lamp(power=5.0, colour="red", lit=True, flashes=())


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("doors", 0, "expected a number ≥ 1, got 0"),
        ("lamp.power", -1.0, "expected a number ≥ 0 and < 20, got -1.0"),
        ("lamp.power", 20.0, "expected a number ≥ 0 and < 20, got 20.0"),
        ("lamp.power", math.nan, "expected a number ≥ 0 and < 20, got nan"),
        ("lamp.dark_after", math.nan, "expected a number ≥ 0, got nan"),
        ("lamp.share", 1.5, "expected a number ≥ -1e+06 and ≤ 1, got 1.5"),
        ("lamp.share", -math.inf, "expected a number ≥ -1e+06 and ≤ 1, got -inf"),
        ("lamp.offset", math.inf, "expected a number ≥ -1e+06 and ≤ 1e+06, got inf"),
        ("lamp.offset", -1e300, "expected a number ≥ -1e+06 and ≤ 1e+06, got -1e+300"),
        ("lamp.colour", "blue", "expected one of red, green, got 'blue'"),
        ("lamp.kind", "gas", "expected one of arc, led, got 'gas'"),
    ],
)
def test_a_value_that_a_setting_cannot_have_is_refused(key, value, message):
    with pytest.raises(ConfigError) as error:
        KNOWN[key].check(key, value)
    assert str(error.value) == f"{key}: {message}"


@pytest.mark.parametrize(
    ("key", "value"),
    [("doors", 1), ("lamp.power", 0.0), ("lamp.dark_after", math.inf), ("lamp.share", 1.0)],
)
def test_bounds_themselves_are_allowed(key, value):
    KNOWN[key].check(key, value)


FLAGGED = {key: each for key, each in KNOWN.items() if each.flag}


@pytest.fixture
def parser():
    parser = Parser(prog="room")
    for each in FLAGGED.values():
        _add_flag(parser, each)
    return parser


@pytest.fixture
def given(parser):
    def parse(*words):
        arguments = parser.parse_args(words)
        values = {key: _given(arguments, key, each) for key, each in FLAGGED.items()}
        return {key: value for key, value in values.items() if value is not None}

    return parse


def test_a_flag_gives_a_value_of_the_settings_kind(given):
    assert given() == {}
    assert given("--power", "7", "--doors", "2") == {"lamp.power": 7.0, "doors": 2}
    assert given("--colour", "green", "--no-lamp-lit") == {
        "lamp.colour": "green",
        "lamp.lit": False,
    }
    assert given("--flash", "1s@2s", "--flash", "2s@4s") == {"lamp.flashes": ["1s@2s", "2s@4s"]}
    assert given("--flash", "none") == {"lamp.flashes": []}


def test_a_list_is_either_none_or_what_it_has(given):
    with pytest.raises(ConfigError, match=r"lamp\.flashes: expected none by itself, got 1s and no"):
        given("--flash", "1s", "--flash", "none")


def test_the_help_tells_what_a_setting_is_with_its_unit_or_words(parser):
    told = parser.format_help()
    assert "at 100 % [W]" in told
    assert "it has; one of red, green" in told


def test_a_default_is_a_value_that_its_setting_can_have():
    for key, each in SETTINGS.items():
        each.check(key, each.default)


@pytest.mark.parametrize(
    ("key", "sign", "bound"),
    [(key, *bound) for key, each in SETTINGS.items() for bound in each.bounds],
)
def test_a_run_beyond_a_bound_is_refused(key, sign, bound):
    beyond = bound if sign == "<" else bound + {"≥": -1, "≤": 1}[sign]
    with pytest.raises(ConfigError, match=f"^{key}: expected a number"):
        load_config(None, {key: beyond})
