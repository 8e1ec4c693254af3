"""Commands work from any folder and in any environment, or say in one line what is wrong."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import venv
from importlib.metadata import version
from pathlib import Path

import pytest

from deploy.installed import missing
from shared.process.entry import python
from tests.processes import ROOT

# What a folder of the caller's may have in it: of names of ours, and of packages that we use.
FOREIGN = ("shared", "deploy", "numpy", "pinocchio", "zenoh")
COMMANDS = {
    "ps": [str(ROOT / "deploy/ps"), "--name", "nobody-of-this-name"],
    "trial": [sys.executable, "-m", "experiments", "trial", "--duration", "0.01", "--push", "none"],
    "help": [str(ROOT / "deploy/ps"), "--help"],
}
TELLS = {"ps": "nothing is running", "trial": "Stands after 0.01 s", "help": "usage: "}


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder with packages of other people's, which cannot be imported, and such libraries."""
    for name in FOREIGN:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('of other people')\n")
    (tmp_path / "lib").mkdir()
    # As in a workspace of ROS: the loader would take it for the Pinocchio of our package.
    (tmp_path / "lib/libpinocchio_default.so").write_text("no library")
    return tmp_path


def ran(command: list[str], *, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        timeout=300.0,
    )


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    "environment",
    [
        {},
        # Each of several is enough to fail.
        {"PYTHONPATH": "{foreign}", "PYTHONIOENCODING": "ascii", "LC_ALL": "C"},
        {
            "LD_LIBRARY_PATH": "{foreign}/lib:",
            "PYTHONSTARTUP": "{foreign}/none",
            "PYTHONOPTIMIZE": "2",
            "PYTHONWARNINGS": "error",
            "CDPATH": "{foreign}:/",
            "OPENBLAS_CORETYPE": "SkylakeX",
            "MPLBACKEND": "module://no.such",
            "MUJOCO_GL": "none of these",
        },
    ],
    ids=lambda environment: next(iter(environment), "folder"),
)
def test_a_command_does_not_depend_on_the_callers_folder_or_environment(
    foreign: Path, environment: dict[str, str], name: str
) -> None:
    given = {key: value.format(foreign=foreign) for key, value in environment.items()}
    done = ran(COMMANDS[name], cwd=foreign, **given)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(TELLS[name])
    assert done.stderr == ""


def test_deploys_commands_work_where_no_python_would_start(tmp_path: Path) -> None:
    done = ran(COMMANDS["ps"], cwd=tmp_path, PYTHONHOME=str(tmp_path))
    assert (done.returncode, done.stdout) == (0, "nothing is running\n"), done.stderr


def test_a_child_has_nothing_of_the_callers_python_and_speaks_utf_8(foreign: Path) -> None:
    script = "import sys; print(sys.flags.isolated, sys.stdout.encoding, 'é→', *sys.path)"
    done = ran(python("-c", script), cwd=foreign, PYTHONPATH=str(foreign), PYTHONIOENCODING="ascii")
    assert done.stdout.startswith("1 utf-8 é→ "), done.stderr
    assert str(foreign) not in done.stdout


def stand_in(folder: Path, *, config: str, version: str) -> Path:
    """A Python that tells how it was built, and ends where it would make an environment."""
    folder.mkdir()
    script = folder / "python3.11"
    script.write_text(
        "#!/bin/sh\n"
        'case "$*" in\n'
        f"    *--version*) echo 'Python {version}' ;;\n"
        f"    *sysconfig*) exit {int(config == 'optimised')} ;;\n"
        "    *'-m venv'*) exit 3 ;;\n"
        "esac\n"
    )
    script.chmod(0o755)
    return script


@pytest.mark.parametrize(
    ("others", "taken"),
    [
        ([("plain", "3.99.9"), ("optimised", "3.99.2")], 1),
        ([("optimised", "3.99.9"), ("optimised", "3.99.2")], 0),
        ([("plain", "3.99.9"), ("plain", "3.99.2"), ("optimised", "3.99.1")], 2),
        ([("plain", "3.99.9"), ("optimised", "3.98.2")], 0),
    ],
)
def test_setup_takes_an_optimised_python_of_the_same_version(
    others: list[tuple[str, str]], taken: int, tmp_path: Path
) -> None:
    checkout = tmp_path / "checkout"
    (checkout / "deploy").mkdir(parents=True)
    for name in ("setup", "python"):
        shutil.copy(ROOT / "deploy" / name, checkout / "deploy")
    (checkout / "requirements.lock").touch()
    pythons = [
        stand_in(tmp_path / f"bin{k}", config=config, version=version)
        for k, (config, version) in enumerate(others)
    ]
    path = os.pathsep.join([*(str(each.parent) for each in pythons), "/usr/bin", "/bin"])
    done = ran([str(checkout / "deploy/setup")], cwd=tmp_path, PATH=path, PYTHON="")
    assert done.returncode == 3, done.stderr
    told = [line for line in done.stdout.splitlines() if "creating .venv" in line]
    name = str(pythons[taken]) if taken else "python3.11"
    assert told[0].startswith(f"setup: creating .venv with Python {others[taken][1]}, {name}, ")


def bare(folder: Path, *importable: Path) -> str:
    """The Python of a new environment without packages, where some folders are importable."""
    venv.create(folder, symlinks=True)
    (packages,) = (folder / "lib").glob("python3*/site-packages")
    (packages / "project.pth").write_text("".join(f"{each}\n" for each in importable))
    return str(folder / "bin/python")


def test_a_python_without_the_project_is_one_line(tmp_path: Path) -> None:
    other = bare(tmp_path / "bare")
    done = ran([other, "-m", "experiments", "trial"], cwd=ROOT)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"got {other}; run ./deploy/setup and" in done.stderr


def test_a_missing_package_is_one_line(tmp_path: Path) -> None:
    other = bare(tmp_path / "bare", ROOT)
    done = ran([other, "-m", "experiments", "trial"], cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: expected the package numpy in {tmp_path / 'bare'}, found none")


def test_a_package_of_another_environment_is_one_line(foreign: Path, tmp_path: Path) -> None:
    (foreign / "shared/__init__.py").unlink()
    (foreign / "shared").rmdir()
    other = bare(tmp_path / "bare", ROOT, foreign)
    done = ran([other, "-m", "experiments", "trial"], cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"found {foreign / 'numpy/__init__.py'}" in line


def test_what_a_lock_names_and_is_not_installed_is_told() -> None:
    numpy = version("numpy")
    lock = f"""
numpy=={numpy} \\
    --hash=sha256:0
pin[extra]==0.0.1 ; python_full_version >= '3.10' \\
nothing-of-this-name==1.0 \\
tomli==9.9 ; python_full_version < '3.0' \\
"""
    assert missing(lock) == [
        f"pin 0.0.1 ({version('pin')})",
        "nothing-of-this-name 1.0 (none)",
    ]
    assert missing((ROOT / "requirements.lock").read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_a_closed_output_is_none(tmp_path: Path, name: str) -> None:
    done = ran(["sh", "-c", 'exec "$@" >&-', "sh", *COMMANDS[name]], cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_output_is_one_line(tmp_path: Path, name: str) -> None:
    done = ran(["sh", "-c", 'exec "$@" >/dev/full', "sh", *COMMANDS[name]], cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "error: cannot write to standard output: No space left on device\n"


def test_a_terminal_that_cannot_show_a_character_shows_another(tmp_path: Path) -> None:
    script = (
        "import sys; from shared.process.entry import enter\n"
        "sys.stdout.reconfigure(encoding='latin-1'); enter(); print('é → Ω')"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", script], cwd=tmp_path, capture_output=True, check=True
    )
    assert done.stdout == b"\xe9 ? ?\n"


def test_an_interrupt_before_commands_can_handle_it_is_silent() -> None:
    script = (
        "import os, signal, sys, remote_wbc\n"
        "class Interrupts:\n"
        "    def find_spec(self, name, *others):\n"
        "        if name == 'shared.process.entry':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "sys.meta_path.insert(0, Interrupts())\n"
        "remote_wbc.begin('__main__')\n"
    )
    done = subprocess.run(python("-c", script), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize(
    ("script", "printed"),
    [
        # An import that has begun ends: a native module would turn the exception into another.
        ("run(lambda: __import__('interrupted') and time.sleep(60.0))", "imported\n"),
        # Nothing else has begun.
        ("run(lambda: run_command(None, [Subcommand('some', '', 'interrupted')]))", ""),
    ],
)
def test_an_interrupt_within_an_import_is_silent(tmp_path: Path, script: str, printed: str) -> None:
    (tmp_path / "interrupted.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    print('imported')\n"
        "except KeyboardInterrupt:\n"
        "    print('as a native module')\n"
    )
    begun = (
        # A test run in the background ignores the signal.
        "import signal, sys, time; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from shared.process.entry import enter; enter();"
        "from shared.process.cli import Subcommand, run, run_command;"
        f"sys.path.append({str(tmp_path)!r}); {script}"
    )
    done = subprocess.run(python("-c", begun, "some"), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, printed, "")


@pytest.mark.parametrize(
    ("name", "seconds"), [("ps", 0.1), ("ps", 0.2), ("up", 0.2), ("up", 0.5), ("up", 0.8)]
)
def test_an_interrupt_at_any_moment_is_silent(tmp_path: Path, name: str, seconds: float) -> None:
    commands = {**COMMANDS, "up": [str(ROOT / "deploy/up"), "--config", str(tmp_path / "none")]}
    process = subprocess.Popen(
        commands[name],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(seconds)
    # As a terminal does: all of the command's processes get it.
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=300.0)
    ended = {"ps": (0, "nothing is running\n", ""), "up": (2, "", "cannot read")}[name]
    if process.returncode not in (130, -signal.SIGINT):
        # It had ended already.
        assert (process.returncode, output) == ended[:2], errors
        assert ended[2] in errors
    assert len(errors.splitlines()) <= 1
    assert "Traceback" not in errors
