"""Processes that start late, as `--late` has them, are what they would be otherwise."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from shared.process.entry import python
from tests.late import stand_in

LATE_SECONDS = 0.3
# Says how it was started, and how long that takes a process of its own.
SAYS = """
import os, subprocess, sys, time
began = time.monotonic()
subprocess.run([sys.executable, "-c", "pass"], check=True)
print(os.getpid(), __name__, sys.argv[1:], sys.executable, time.monotonic() - began)
raise SystemExit(5)
"""


@pytest.fixture
def late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(stand_in(tmp_path, seconds=LATE_SECONDS)))


@pytest.mark.parametrize("module", ["deploy.says", "says"])
def test_a_module_is_late_and_else_the_same(late: None, tmp_path: Path, module: str) -> None:
    file = tmp_path / f"{module.replace('.', '/')}.py"
    file.parent.mkdir(exist_ok=True)
    # A package, that is found before the project's own.
    (file.parent / "__init__.py").touch()
    file.write_text(SAYS)
    began = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-m", module, "-m", "x y"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as process:
        output, _ = process.communicate()
    waited = time.monotonic() - began
    message, executable, childs = output.rsplit(" ", 2)
    assert message == f"{process.pid} __main__ ['-m', 'x y']"
    assert process.returncode == 5
    assert waited - float(childs) > LATE_SECONDS
    # What starts services makes them late.
    if module.startswith("deploy."):
        assert float(childs) > LATE_SECONDS
    assert (executable == sys.executable) == module.startswith("deploy.")


def test_code_is_late_and_else_the_same(late: None) -> None:
    began = time.monotonic()
    code = "import sys; print(sys.argv)"
    output = subprocess.check_output(python("-c", code, "-m", "x"), text=True)
    assert time.monotonic() - began > LATE_SECONDS
    assert output == "['-c', '-m', 'x']\n"
