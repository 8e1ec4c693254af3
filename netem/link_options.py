"""Command line options of `replay` and `packets` for the link to emulate."""

from __future__ import annotations

import argparse

from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.process.run_options import add_run_arguments, config_from


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the network, as a positional argument or `--network`, and the options of a run."""
    parser.add_argument("profile", nargs="?", metavar="NETWORK", help="the same as --network")
    add_run_arguments(parser)


def link_config_from(arguments: argparse.Namespace, *, direct: str) -> RunConfig:
    """The settings that the arguments describe; `direct` is the error text for the network
    *direct*.
    """
    if arguments.profile is not None:
        if arguments.network is not None:
            raise ConfigError(
                f"network: expected once, got {arguments.profile!r} and {arguments.network!r}"
            )
        arguments.network = arguments.profile
    config = config_from(arguments)
    if config.link.network == "direct":
        raise ConfigError(f"network: {direct}")
    return config
