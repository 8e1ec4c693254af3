"""`open`, `compare` and `snapshot`: what they take, and what they say about what they cannot."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from experiments.lockstep import Lockstep
from experiments.trial import write_run
from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import UserError
from shared.robots import Robot
from shared.telemetry.parquet import write_parquet
from tests.processes import Typed
from tests.viewer.reading import entities, static
from tests.viewer.synthetic import tick_rows
from viewer.recording import save
from viewer.run_folder import read_run
from viewer.show import show
from viewer.snapshot import animation, picture
from viewer.video import write_mp4


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two runs of 50 ms as `./wbc trial --out` leaves them: LA and PR."""
    folders = {}
    for controller in ("la", "pr"):
        config = RunConfig(controller=controller, duration=0.05)
        folders[controller] = tmp_path_factory.mktemp("runs") / controller
        result = Lockstep(config, all_active_sets=False).run()
        write_run(folders[controller], config, result)
    return folders


def test_a_lockstep_run_is_read_without_a_recording(runs: dict[str, Path]) -> None:
    run = read_run(runs["la"])
    assert run.name == "la"
    assert run.duration == pytest.approx(0.049)
    assert len(run.tables) == 3


def test_compared_runs_are_in_one_recording_under_their_names(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    save([read_run(folder) for folder in runs.values()], tmp_path / "both.rrd")
    found = entities(tmp_path / "both.rrd")
    for name in ("LA", "PR"):
        assert {f"/world/{name}/joints", f"/plots/com_error/{name}", f"/robot/command/{name}"} <= (
            found
        )
    (title,) = static(tmp_path / "both.rrd", "/title", "TextDocument:text")
    assert title == ["### Romeo · balance · factory/001 · LA stands, PR stands"]


def test_runs_of_the_same_name_are_told_apart_by_their_folders(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    twin = tmp_path / "la"
    twin.symlink_to(runs["la"], target_is_directory=True)
    save([read_run(runs["la"]), read_run(twin)], tmp_path / "both.rrd")
    joints = [each for each in entities(tmp_path / "both.rrd") if each.endswith("/joints")]
    assert len(joints) == 2


def test_a_run_beside_itself_is_refused(runs: dict[str, Path]) -> None:
    with pytest.raises(UserError, match="expected different runs"):
        save([read_run(runs["la"])] * 2, runs["la"] / "never.rrd")


@pytest.mark.parametrize("command", ["open", "compare", "snapshot"])
def test_a_wrong_folder_is_refused_in_one_line(typed: Typed, command: str, tmp_path: Path) -> None:
    extra = ["--out", str(tmp_path / "x.png")] if command == "snapshot" else []
    done = typed("viewer", command, str(tmp_path), *extra)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "got one without config.toml and telemetry.parquet" in done.stderr


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda run, out: picture([run], out / "x.jpg"), r"ending in \.png"),
        (lambda run, out: picture([run], out / "x.png", at=3.0), r"0 to 0\.049 s, got 3"),
        (lambda run, out: film(run, out / "x.avi"), r"\.gif, \.webp, \.mp4"),
        (lambda run, out: film(run, out / "x.gif", begin=0.2), "span of the run"),
        (lambda run, out: film(run, out / "x.gif", speed=0.0), "above 0"),
        (lambda run, out: film(run, out / "x.gif", speed=1e-5), "at most 600 frames"),
        (lambda run, out: film(run, out / "x.gif", speed=1e-320), "at most 600 frames"),
    ],
)
def test_pictures_that_cannot_be_are_refused_before_anything_is_drawn(
    runs: dict[str, Path], tmp_path: Path, make: Callable[[Path, Path], None], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        make(runs["la"], tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_run_that_never_began_has_no_pictures(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text(dump_config(RunConfig(), versions={}))
    write_parquet(*tick_rows(robot, 20, waiting=100), tmp_path / "telemetry.parquet")
    with pytest.raises(UserError, match="expected a run whose task began"):
        picture([tmp_path], tmp_path / "x.png")


def film(run: Path, out: Path, *, begin: float = 0.0, speed: float = 1.0) -> None:
    animation([run], out, begin=begin, end=None, speed=speed)


def test_without_graphics_the_package_to_install_is_named(
    runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, str(tmp_path / "none.json"))
    with pytest.raises(UserError, match="apt install mesa-vulkan-drivers") as message:
        picture([runs["la"]], tmp_path / "x.png")
    assert "\n" not in str(message.value)


def test_an_mp4_has_every_picture_in_its_order(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="the optional package for mp4")
    shades = [0, 120, 250]
    write_mp4(
        tmp_path / "x.mp4",
        [Image.new("RGB", (65, 33), (shade, shade, shade)) for shade in shades],
        frames_per_second=12,
    )
    with av.open(str(tmp_path / "x.mp4")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert [frame.shape for frame in frames] == [(32, 64, 3)] * 3
    # Lossy, and of another range.
    assert [float(frame.mean()) for frame in frames] == pytest.approx(shades, abs=6.0)


@pytest.mark.parametrize("size", ["1600", "0x900", "99999x10", "x", "1600x-9"])
def test_a_size_that_cannot_be_is_told_by_example(
    typed: Typed, runs: dict[str, Path], tmp_path: Path, size: str
) -> None:
    out = str(tmp_path / "x.png")
    done = typed("viewer", "snapshot", str(runs["la"]), "--out", out, f"--size={size}")
    assert done.returncode == 2
    assert f"expected WIDTHxHEIGHT in pixels, each 200 to 4096, as in 1600x960, got '{size}'" in (
        done.stderr
    )


@pytest.mark.live
def test_a_picture_shows_the_robot_and_the_plots(runs: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "both.png"
    try:
        picture(list(runs.values()), out, at=0.04)
    except UserError as error:
        pytest.skip(f"nothing here can draw: {error}")
    with Image.open(out) as image:
        scene = image.crop((0, 40, image.width * 2 // 5, image.height - 60)).convert("L")
        plots = image.crop((image.width // 2, 40, image.width, image.height - 60))
        # Romeo is white on a dark floor; two of them fill some percent of their half.
        bright = sum(scene.histogram()[170:]) / (scene.width * scene.height)
        colours = plots.quantize(32).getcolors() or []
    assert 0.03 < bright < 0.5
    assert len(colours) > 8


@pytest.mark.live
def test_a_run_opens_in_a_browser_and_ends_when_told(runs: dict[str, Path]) -> None:
    output: list[str] = []
    show([runs["la"]], view="web", stopped=lambda: len(output) > 1, say=output.append)
    assert output[0] == "la: in a browser, at the address below; Ctrl-C ends"
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?url=[\w.%]+%2Fproxy", output[1])
