"""Prose does not make trials void; what the code does, does."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import tarfile
from pathlib import PurePosixPath

import pytest

from experiments.studies.code_identity import PARTS, ROOT, code_version, identity, present_identity
from shared.toml_file import read_toml

SOURCE = '''"""What it is."""

LIMIT = 1.45  # of the URDF's


class Clamp:
    """A limit."""

    def of(self, torque: float) -> float:
        """The torque within it."""
        return min(torque, LIMIT)

    def flag(self, parser):
        parser.add_argument("--clamp", help="of torques", metavar="X")
'''
CODES = read_toml(ROOT / "experiments/studies/published_codes.toml", what="published codes")["code"]


def of(source: str, *, name: str = "shared/clamp.py") -> str:
    return identity({name: source.encode()})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  # of the URDF's", ""),
        ('"""What it is."""', '"""It clamps."""'),
        ('    """A limit."""\n\n', ""),
        ('"""The torque within it."""', "# no docstring at all"),
        ("min(torque, LIMIT)", "min(\n            torque,\n            LIMIT,\n        )"),
        ("\n\n\n", "\n"),
        ('help="of torques"', 'help="of all torques"'),
    ],
)
def test_prose_and_layout_are_free_to_change(old: str, new: str) -> None:
    assert old in SOURCE
    assert of(SOURCE.replace(old, new)) == of(SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("1.45", "1.46"),
        ("LIMIT", "MOST"),
        ("min(torque, LIMIT)", "min(LIMIT, torque)"),
        ("        return min", "        'a string that is no docstring'; return 1 * min"),
        ("torque: float", "torque: int"),
        ("--clamp", "--limit"),
    ],
)
def test_what_the_code_does_is_not(old: str, new: str) -> None:
    assert old in SOURCE
    assert of(SOURCE.replace(old, new)) != of(SOURCE)


def test_a_file_of_another_name_is_other_code() -> None:
    assert of(SOURCE, name="shared/limit.py") != of(SOURCE)


def test_the_order_of_files_is_none() -> None:
    files = {"shared/a.py": b"A = 1", "shared/a/b.py": b"B = 1", "netem/c.py": b"C = 1"}
    assert identity(files) == identity(dict(reversed(files.items())))


def test_this_code_has_an_identity() -> None:
    assert len(code_version()) == 16
    assert present_identity(code_version()) == code_version()


def test_every_published_code_is_mapped() -> None:
    named = set()
    for about in (ROOT / "docs/results/trials").glob("*/about.json"):
        message = json.loads(about.read_text())
        named |= {message["code"], *message["other_code"]}
    of_bytes = {code["of_bytes"] for code in CODES}
    identities = {code["identity"] for code in CODES}
    assert named <= of_bytes | identities | {code_version()}
    assert {present_identity(each) for each in of_bytes} == identities


@pytest.mark.parametrize("code", CODES, ids=lambda code: code["commit"][:10])
def test_a_published_code_is_that_of_its_commit(code: dict[str, str]) -> None:
    command = ["git", "-C", str(ROOT), "archive", code["commit"], *PARTS]
    archived = subprocess.run(command, capture_output=True, check=False)
    if archived.returncode != 0:
        pytest.skip(f"no git history here: {archived.stderr.decode(errors='replace').strip()}")
    with tarfile.open(fileobj=io.BytesIO(archived.stdout)) as archive:
        sources = {
            each.name: file.read()
            for each in archive
            if each.name.endswith(".py") and (file := archive.extractfile(each)) is not None
        }
    assert identity(sources) == code["identity"]
    digest = hashlib.sha256()
    for name in sorted(sources, key=PurePosixPath):
        digest.update(name.encode() + b"\0" + sources[name])
    assert digest.hexdigest()[:16] == code["of_bytes"]
