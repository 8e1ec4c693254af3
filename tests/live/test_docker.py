"""`deploy/compose.yaml` on a Docker daemon of our own: built, run, its files read, taken down.

It takes many minutes and gigabytes, and so runs only by `./deploy/test -m docker`, as root, on a
Debian with `docker.io`, `docker-compose` and `debootstrap`. The base image is made here, from
Debian's packages, and has the name that the Dockerfile asks for.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from deploy.services import load_services
from tests.processes import ROOT, descendants_naming

pytestmark = [pytest.mark.live, pytest.mark.docker]

DEPLOY = ROOT / "deploy"
NEEDED = ("dockerd", "docker", "debootstrap", "tar")
SUITE = "bookworm"
PACKAGES = "python3,python3-pip,python3-venv,ca-certificates"
# How this machine's pip gets to the package index, and what it trusts.
PIP_SETTINGS = ("index-url", "extra-index-url", "trusted-host", "proxy", "timeout")
CERTIFICATES = Path("etc/ssl/certs/ca-certificates.crt")
PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY", "http_proxy", "https_proxy", "no_proxy")
RTPRIO = 40
DEVELOPMENT = ("mypy", "ruff", "pytest", "mkdocs", "distributed", "matplotlib")

MINUTE = 60.0
# Without a push and with LC, the run does not rest on how late a loaded machine is.
SETTINGS = """controller = "lc"
push = []
[link]
network = "factory/001"
"""


@dataclass(frozen=True)
class Docker:
    """A daemon of our own."""

    folder: Path
    compose_command: tuple[str, ...]

    def run(self, *command: str, seconds: float = 5 * MINUTE, **environment: str) -> str:
        """The output of a command that has to succeed."""
        done = self.attempt(*command, seconds=seconds, **environment)
        assert done.returncode == 0, f"{' '.join(command)}: exit {done.returncode}\n{done.stdout}"
        return done.stdout

    def attempt(
        self, *command: str, seconds: float = 5 * MINUTE, **environment: str
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            env={
                **os.environ,
                "DOCKER_HOST": f"unix://{self.folder}/socket",
                # To compose 1: the storage copies whole images, and takes minutes to remove them.
                "COMPOSE_HTTP_TIMEOUT": str(round(10 * MINUTE)),
                **environment,
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=seconds,
            check=False,
        )

    def compose(self, *arguments: str) -> tuple[str, ...]:
        return (*self.compose_command, "-f", str(DEPLOY / "compose.yaml"), *arguments)

    def left(self) -> dict[str, list[str]]:
        """Containers, volumes and networks that are not Docker's own."""
        networks = self.run("docker", "network", "ls", "--format", "{{.Name}}").split()
        return {
            "containers": self.run("docker", "ps", "--all", "--quiet").split(),
            "volumes": self.run("docker", "volume", "ls", "--quiet").split(),
            "networks": [each for each in networks if each not in ("bridge", "host", "none")],
        }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Of all that the daemon has; gigabytes, so it is gone with the test."""
    made = tmp_path_factory.mktemp("docker")
    yield made
    shutil.rmtree(made)


@pytest.fixture(scope="module")
def docker(folder: Path) -> Iterator[Docker]:
    if os.geteuid() != 0:
        pytest.skip("a Docker daemon needs root")
    if missing := [name for name in NEEDED if shutil.which(name) is None]:
        pytest.skip(f"needs {', '.join(missing)} (Debian: docker.io, debootstrap)")
    docker = Docker(folder, _compose_command())
    log = folder / "dockerd.log"
    with log.open("w") as output:
        daemon = subprocess.Popen(
            [
                *("dockerd", "--storage-driver=vfs", "--bridge=none"),
                *("--data-root", str(folder / "data"), "--exec-root", str(folder / "exec")),
                *("--pidfile", str(folder / "pid"), "--host", f"unix://{folder}/socket"),
            ],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        _wait_until_it_answers(docker, daemon, log)
        yield docker
    finally:
        _end(daemon)
        _unmount(folder)
    assert descendants_naming(str(folder)) == []


@pytest.fixture(scope="module")
def image(docker: Docker) -> str:
    """The image, built on a Debian under the name of the Dockerfile's own base."""
    (base,) = re.findall(r"^FROM (\S+)$", (DEPLOY / "Dockerfile").read_text(), re.M)
    root = docker.folder / "root"
    docker.run(
        *("debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(root)),
        seconds=15 * MINUTE,
    )
    (root / "usr/bin/python").symlink_to("python3")
    for mark in (root / "usr/lib").glob("python3*/EXTERNALLY-MANAGED"):
        mark.unlink()
    _reach_the_index(root)
    archive = docker.folder / "root.tar"
    docker.run("tar", "-C", str(root), "-cf", str(archive), ".", seconds=5 * MINUTE)
    docker.run("docker", "import", str(archive), base, seconds=5 * MINUTE)
    shutil.rmtree(root)
    archive.unlink()
    proxies = [f"--build-arg={name}" for name in PROXIES if name in os.environ]
    docker.run(
        *("docker", "build", "--network", "host", *proxies, "--file", str(DEPLOY / "Dockerfile")),
        *("--tag", "remote-wbc", str(ROOT)),
        seconds=45 * MINUTE,
    )
    return "remote-wbc"


def test_it_has_what_the_services_import_and_nothing_to_develop_with(
    docker: Docker, image: str
) -> None:
    commands = sorted({each.command[0] for each in load_services().values()})
    modules = [name if "." in name else f"{name}.__main__" for name in commands]
    # In one container: with this storage each is a copy of the whole image.
    code = f"""import importlib.util, {", ".join(modules)}, deploy.console.watch
print([name for name in {DEVELOPMENT} if importlib.util.find_spec(name)])"""
    run = ("docker", "run", "--rm", "--network", "none", "--workdir", "/tmp", "--entrypoint")
    message = docker.run(*run, "python", image, "-I", "-c", code, seconds=10 * MINUTE)
    assert message.splitlines()[-1] == "[]"


def test_romeo_stands_through_both_networks_and_all_is_in_its_files(
    docker: Docker, image: str, tmp_path: Path
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text(SETTINGS)
    try:
        up = docker.attempt(
            *docker.compose("up", "--no-build", "--exit-code-from", "robot"),
            seconds=20 * MINUTE,
            RTPRIO=str(RTPRIO if _may_raise_rtprio() else 0),
            RUN_CONFIG=str(settings),
        )
        assert up.returncode == 0, up.stdout
        assert re.search(r"robot.*\|.* stands after 5\.00 s", up.stdout), up.stdout
        robot = docker.run(*docker.compose("ps", "--all", "--quiet", "robot")).strip()
        docker.run("docker", "cp", f"{robot}:/runs", str(tmp_path / "runs"))
        assert _networks(docker, "robot") == {"remote-wbc_robot-side"}
        assert _networks(docker, "edge") == {"remote-wbc_edge-side"}
    finally:
        docker.run(*docker.compose("down", "--volumes"), seconds=15 * MINUTE)
    assert not any(docker.left().values())

    files = {file.name for file in (tmp_path / "runs").iterdir()}
    tables = {"telemetry.parquet", "link.parquet", "edge.parquet"}
    assert files == {"summary.json", "recording.rrd", *tables}
    summary = json.loads((tmp_path / "runs/summary.json").read_text())
    assert summary["fell"] is False
    assert sum(summary["commands"].values()) == 5000
    for way in summary["link"].values():
        assert way["received"] > 0
        assert way["refused"] == {}
    assert summary["edge_solve_ms"]["p50"] > 0.0
    # For those who compare machines; a loaded one is late without real-time priority.
    print(f"overruns {summary['overruns']} of 5000, {summary['realtime_factor']} × real time")


def _compose_command() -> tuple[str, ...]:
    """Of either kind, the plugin of today or the program of old."""
    plugin = ("docker", "compose")
    if subprocess.run([*plugin, "version"], capture_output=True, check=False).returncode == 0:
        return plugin
    if shutil.which("docker-compose") is None:
        pytest.skip("needs docker compose or docker-compose (Debian: docker-compose)")
    return ("docker-compose",)


def _wait_until_it_answers(docker: Docker, daemon: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + 2 * MINUTE
    while docker.attempt("docker", "version").returncode != 0:
        if daemon.poll() is not None:
            pytest.skip(f"no Docker daemon starts here: {log.read_text().splitlines()[-1]}")
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.5)


def _end(daemon: subprocess.Popen[bytes]) -> None:
    """It ends what it has started."""
    daemon.send_signal(signal.SIGTERM)
    try:
        daemon.wait(timeout=2 * MINUTE)
    except subprocess.TimeoutExpired:
        os.killpg(daemon.pid, signal.SIGKILL)
        daemon.wait(timeout=10.0)


def _unmount(folder: Path) -> None:
    """What a daemon that was killed has left mounted."""
    mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    for mount in reversed([each for each in mounts if each.startswith(f"{folder}/")]):
        subprocess.run(["umount", mount], capture_output=True, timeout=30.0, check=False)


def _reach_the_index(root: Path) -> None:
    """Have pip and apt in `root` reach what those of this machine do."""
    settings = _pip_settings()
    lines = [f"{name} = {settings[name]}" for name in PIP_SETTINGS if name in settings]
    for bundle in filter(None, (settings.get("cert"), os.environ.get("SSL_CERT_FILE"))):
        with contextlib.suppress(OSError):
            shutil.copy(bundle, root / CERTIFICATES)
            break
    (root / "etc/pip.conf").write_text("\n".join(["[global]", f"cert = /{CERTIFICATES}", *lines]))


def _pip_settings() -> dict[str, str]:
    """From files or the environment, without folders of this machine."""
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        capture_output=True,
        text=True,
        timeout=MINUTE,
        check=True,
    ).stdout.splitlines()
    settings = {}
    # The environment overrules files.
    for line in sorted(listed, key=lambda line: line.startswith(":env:")):
        name, _, value = line.partition("=")
        words = [word for word in ast.literal_eval(value).split() if not word.startswith("file:")]
        if words:
            settings[name.rpartition(".")[2]] = " ".join(words)
    return settings


def _may_raise_rtprio() -> bool:
    """Whether this machine grants the limit to a process, and so may Docker to a container."""
    command = f"import resource; resource.setrlimit({resource.RLIMIT_RTPRIO}, ({RTPRIO}, {RTPRIO}))"
    return subprocess.run([sys.executable, "-c", command], capture_output=True).returncode == 0


def _networks(docker: Docker, service: str) -> set[str]:
    container = docker.run(*docker.compose("ps", "--all", "--quiet", service)).strip()
    form: Sequence[str] = ("--format", "{{json .NetworkSettings.Networks}}")
    return set(json.loads(docker.run("docker", "inspect", *form, container)))
