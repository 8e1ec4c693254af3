"""Prose does not make trials void; what the code does, does."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import tarfile
from pathlib import Path, PurePosixPath

import pytest

from experiments.studies.code_identity import PARTS, ROOT, code_version, identity, present_identity
from shared.process.entry import python
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
ABOUT = [json.loads(file.read_text()) for file in ROOT.glob("docs/results/trials/*/about.json")]
# Codes that are stated as identities, by their commits. They need no mapping.
BY_COMMIT = {
    about["commit"]: about["code"]
    for about in ABOUT
    if about["code"] not in {code["of_bytes"] for code in CODES}
}


def archived(commit: str, *parts: str) -> bytes:
    """Parts of the project at a commit, as a tar archive."""
    command = ["git", "-C", str(ROOT), "archive", commit, *parts]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"no git history here: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout


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


def test_every_published_code_is_mapped_or_that_of_its_commit() -> None:
    of_bytes = {code["of_bytes"] for code in CODES}
    identities = {code["identity"] for code in CODES}
    known = of_bytes | identities | {code_version(), *BY_COMMIT.values()}
    assert {code for about in ABOUT for code in (about["code"], *about["other_code"])} <= known
    assert {present_identity(each) for each in of_bytes} == identities


@pytest.mark.parametrize("commit", BY_COMMIT)
def test_a_published_identity_is_that_of_its_commit(commit: str, tmp_path: Path) -> None:
    subprocess.run(["tar", "-x", "-C", str(tmp_path)], input=archived(commit, "."), check=True)
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r});"
        "from experiments.studies.code_identity import code_version; print(code_version())"
    )
    done = subprocess.run(python("-c", program), capture_output=True, text=True, check=False)
    assert done.stdout.strip() == BY_COMMIT[commit], done.stderr


@pytest.mark.parametrize("code", CODES, ids=lambda code: code["commit"][:10])
def test_a_published_code_is_that_of_its_commit(code: dict[str, str]) -> None:
    with tarfile.open(fileobj=io.BytesIO(archived(code["commit"], *PARTS))) as archive:
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
