"""The network that `replay` and `packets` are told to emulate."""

from __future__ import annotations

import pytest

from netem.link_options import add_link_arguments, link_config_from
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.process.cli import Parser


def config_of(*words: str) -> RunConfig:
    parser = Parser(prog="netem")
    add_link_arguments(parser)
    return link_config_from(parser.parse_args(list(words)), direct="try something else")


@pytest.mark.parametrize("words", [("constant:7ms",), ("--network", "constant:7ms")])
def test_a_network_is_named_by_its_place_or_its_option(words: tuple[str, ...]) -> None:
    assert config_of(*words, "--loss", "0.5").link.network == "constant:7ms"
    assert config_of(*words, "--loss", "0.5").link.loss == 0.5


def test_two_networks_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"once, got 'constant:7ms' and 'constant:8ms'"):
        config_of("constant:7ms", "--network", "constant:8ms")


def test_a_direct_link_is_none_to_emulate() -> None:
    with pytest.raises(ConfigError, match="network: try something else"):
        config_of("direct")
