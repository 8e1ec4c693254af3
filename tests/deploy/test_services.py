from __future__ import annotations

from pathlib import Path

import pytest

from deploy.services import FAILURE, IGNORED, OUTCOME, load_services, starting_order
from shared.errors import ConfigError

DEFAULTS = """
[defaults]
after = []
takes = []
report = ""
port = 0
by_default = true
ready = "READY"
ready_seconds = 60.0
stop_seconds = 10.0
restart = "no"
end = "failure"
"""


@pytest.fixture
def loaded(tmp_path: Path):
    def load(text: str, *, defaults: str = DEFAULTS):
        file = tmp_path / "services.toml"
        file.write_text(defaults + text)
        return load_services(file)

    return load


def test_the_stack_is_what_the_project_says_it_is():
    services = load_services()
    assert tuple(services) == ("edge", "netem", "robot", "viewer", "router")
    assert starting_order(services) == ("router", "edge", "netem", "viewer", "robot")
    assert [name for name, each in services.items() if each.end == OUTCOME] == ["robot"]
    assert [name for name, each in services.items() if each.end == IGNORED] == ["viewer"]
    assert [name for name, each in services.items() if not each.by_default] == ["router"]
    assert services["edge"].restarts
    assert not services["netem"].restarts


def test_beyond_its_failures_a_service_waits_before_each_start_twice_as_long():
    edge = load_services()["edge"]
    pauses = [edge.pause_seconds(failures) for failures in range(12)]
    assert pauses == [0, 0, 0, 0, 1, 2, 4, 8, 16, 30, 30, 30]
    assert [edge.degraded(failures) for failures in (0, 3, 4)] == [False, False, True]
    assert edge.window_seconds == 60.0
    assert not load_services()["netem"].degraded(7)


def test_what_a_service_does_not_say_is_in_the_defaults(loaded):
    service = loaded('[one]\ncommand = ["a", "b"]\nready_seconds = 5\n')["one"]
    assert (service.command, service.ready_seconds) == (("a", "b"), 5)
    assert (service.stop_seconds, service.end) == (10.0, FAILURE)


def test_services_start_after_those_they_wait_for_and_else_as_in_the_file(loaded):
    services = loaded(
        '[a]\ncommand = ["a"]\nafter = ["c"]\n[b]\ncommand = ["b"]\n[c]\ncommand = ["c"]\n'
    )
    assert starting_order(services) == ("b", "c", "a")
    del services["c"]
    assert starting_order(services) == ("a", "b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[one]\n", "one: expected command, here or in"),
        ('[one]\ncommand = "a"\n', "expected a list of strings, got 'a'"),
        ("[one]\ncommand = []\n", "at least the module"),
        (
            '[one]\ncommand = ["a"]\ncolour = 1\n',
            "some of command, after, .* got 'colour'",
        ),
        ('[one]\ncommand = ["a"]\nafter = ["two"]\n', "expected some of one, got 'two'"),
        ('[one]\ncommand = ["a"]\nafter = ["one"]\n', "wait for one another"),
        ('[one]\ncommand = ["a"]\nrestart = "always"\n', "no, or on-failure:N/Ts"),
        ('[one]\ncommand = ["a"]\nrestart = "on-failure:3"\n', "no, or on-failure:N/Ts"),
        ('[one]\ncommand = ["a"]\nend = "bad"\n', "one of outcome, failure, ignored"),
        ('[one]\ncommand = ["a"]\ntakes = ["hat"]\n', "some of config, telemetry"),
        ('[one]\ncommand = ["a"]\nport = 70000\n', "0 to 65535"),
        ('[one]\ncommand = ["a"]\nready_seconds = -1\n', "seconds above 0"),
        ('[one]\ncommand = ["a"]\nby_default = 1\n', "true or false"),
        ("one = 1\n", "expected tables"),
        ("[one\n", "not valid TOML"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_what_was_expected(loaded, text, message):
    with pytest.raises(ConfigError, match=message):
        loaded(text, defaults="" if text.startswith("one =") else DEFAULTS)


def test_a_file_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ConfigError, match="cannot read"):
        load_services(tmp_path / "none.toml")
