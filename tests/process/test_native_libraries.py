"""What native libraries are told before they are loaded."""

from __future__ import annotations

import platform
import subprocess
from pathlib import Path

import pytest

from shared.output.versions import versions
from shared.process.entry import python
from shared.process.native_libraries import AVX2, KERNEL, instruction_set

SAYS = "from shared.output.versions import versions; print(versions()['blas'])"
needs_avx2 = pytest.mark.skipif(
    instruction_set() != AVX2, reason=f"not {AVX2}: {instruction_set()}"
)


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("flags\t\t: fpu sse2 fma avx avx2 sha_ni", AVX2),
        ("flags\t\t: fpu sse2 avx avx2", "x86-64"),
        ("flags\t\t: fpu sse2", "x86-64"),
        ("model name\t: none", "x86-64"),
    ],
)
def test_instructions_are_those_that_linux_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: str, expected: str
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    (tmp_path / "cpuinfo").write_text(f"processor\t: 0\n{flags}\n")
    assert instruction_set(tmp_path / "cpuinfo") == expected
    assert instruction_set(tmp_path / "none") == "x86-64"
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert instruction_set(tmp_path / "cpuinfo") == "aarch64"


@needs_avx2
@pytest.mark.parametrize(
    ("asked", "used"),
    [(None, KERNEL), ("", KERNEL), ("Zen", KERNEL), ("SkylakeX", KERNEL), ("Nehalem", "Nehalem")],
)
def test_newer_kernels_give_way_to_one_and_an_older_one_may_be_tried(
    monkeypatch: pytest.MonkeyPatch, asked: str | None, used: str
) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    if asked is not None:
        monkeypatch.setenv("OPENBLAS_CORETYPE", asked)
    done = subprocess.run(python("-c", SAYS), capture_output=True, text=True, check=True)
    assert done.stdout == f"{used}\n"


def test_a_run_tells_what_its_bits_depend_on() -> None:
    message = versions()
    assert message["instructions"] == instruction_set()
    assert {"blas", "numpy", "scipy", "pin", "mujoco", "daqp"} <= message.keys()
