"""Running `convert` in-process, on samples and on files that a test writes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import pytest

from netem.convert import add_convert_arguments, run_convert
from netem.profile import DelayProfile
from netem.profile_file import read_profile
from shared.errors import UserError
from shared.process.cli import Parser

SAMPLES = Path(__file__).parent / "samples"


def run(out: Path, *arguments: object) -> DelayProfile:
    parser = Parser(prog="netem convert")
    add_convert_arguments(parser)
    words = [str(a) for a in arguments]
    flags = next((k for k, word in enumerate(words) if word.startswith("--")), len(words))
    parsed = parser.parse_args([*words[:flags], str(out), *words[flags:]])
    assert isinstance(parsed, argparse.Namespace)
    assert run_convert(parsed) == 0
    return read_profile(out)


@pytest.fixture
def convert(tmp_path: Path) -> Callable[..., DelayProfile]:
    """`convert(IN, [IN2], "--flag", …)`: the profile it wrote, exact to the nanosecond."""
    return lambda *arguments: run(tmp_path / "out.csv", *arguments)


@pytest.fixture
def refused(convert: Callable[..., DelayProfile]) -> Callable[..., str]:
    """The message of a `convert` that is refused."""

    def message(*arguments: object) -> str:
        with pytest.raises(UserError) as error:
            convert(*arguments)
        text = str(error.value)
        assert "\n" not in text
        return text

    return message


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """`written("name.txt", content)`: the path of a file of that content."""

    def write(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def sample() -> Callable[[str], Path]:
    return lambda name: SAMPLES / name
