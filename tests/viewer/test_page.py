"""The light page: who gets in, what leaves, and what a slow browser costs."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Awaitable, Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect as connect_sync

from deploy.drive import KEYS
from shared.bus.operator import CommandServer
from shared.bus.zenoh_bus import ZenohBus
from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.robots import Robot
from shared.telemetry.row_log import encode_rows
from shared.wire.channels import TICKS_KEY
from shared.wire.operator.commands import Accepted, Command
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import EVENTS_KEY, ROBOT_COMMANDS_KEY, VIEW_KEY, encode_event
from shared.wire.operator.texts import parse_command
from tests.processes import PATIENCE_SECONDS, Process, until
from tests.telemetry_hub import is_heard
from tests.viewer.synthetic import WALL_START_NS, link_rows, solve_rows, step_rows, tick_rows
from viewer.meshes import load_meshes
from viewer.page.feed import Feed
from viewer.page.hulls import load_hulls, make_hulls
from viewer.page.server import FILES, MAX_BROWSERS, PageServer
from viewer.rerun_process import free_port

ROBOT = json.dumps(
    {"joints": [1], "shapes": [], "words": ["Romeo", "balance"], "focus": 0.5, "drives": True}
)


def served(check: Callable[[PageServer], Awaitable[None]], lines: list[str] | None = None) -> None:
    """Run a check against a server whose commands are answered by their text in capitals.

    They are added to `lines`.
    """

    def command(line: str) -> str:
        if lines is not None:
            lines.append(line)
        if line == "nonsense":
            raise ConfigError("command: expected one of push, link, got 'nonsense'")
        return line.upper()

    async def run() -> None:
        server = PageServer(ROBOT, '{"time": -1}', command)
        await server.open(0)
        try:
            await asyncio.wait_for(check(server), PATIENCE_SECONDS)
        finally:
            await server.close()

    asyncio.run(run())


async def get(address: str, **headers: str) -> tuple[int, str, str]:
    """The status, the head and the body of a response."""
    _, port, path = re.fullmatch(r"http://([\d.]+):(\d+)(/.*)", address).groups()
    reader, writer = await asyncio.open_connection("127.0.0.1", int(port))
    sent = {"Host": f"127.0.0.1:{port}", **headers}
    lines = "".join(f"{name}: {value}\r\n" for name, value in sent.items())
    writer.write(f"GET {path} HTTP/1.1\r\n{lines}\r\n".encode())
    head, _, body = (await reader.read()).decode().partition("\r\n\r\n")
    writer.close()
    return int(head.split()[1]), head, body


def stream(address: str) -> str:
    return address.replace("http:", "ws:") + "stream"


def without_token(address: str, token: str = "") -> str:
    return re.sub(r"(:\d+/)[^/]+/", rf"\g<1>{token}", address)


def test_without_the_token_nothing_is_answered() -> None:
    async def check(server: PageServer) -> None:
        assert server.address.startswith("http://127.0.0.1:")
        for wrong in ("", "page.js", "guess/", "guess/robot.json", "/stream", "%00/"):
            status, _, body = await get(without_token(server.address, wrong))
            assert (status, "Romeo" in body) == (403, False)
        with pytest.raises(InvalidStatus, match="403"):
            await connect(stream(without_token(server.address, "guess/")))

    served(check)


def test_another_page_gets_nothing_even_with_the_token() -> None:
    async def check(server: PageServer) -> None:
        assert (await get(server.address, Host="evil.example"))[0] == 403
        with pytest.raises(InvalidStatus, match="403"):
            await connect(stream(server.address), origin="http://evil.example")  # type: ignore[arg-type]

    served(check)


def test_the_page_comes_from_the_package_and_names_no_other_place() -> None:
    async def check(server: PageServer) -> None:
        for name in FILES:
            status, head, body = await get(server.address + name)
            assert status == 200
            assert body == files("viewer.page").joinpath(FILES[name][0]).read_text("utf-8")
            assert not re.search(r"https?://|[\"'(]//|@import", body), "nothing from elsewhere"
            assert "default-src 'none'" in head
        assert (await get(server.address + "robot.json"))[2] == ROBOT
        assert (await get(server.address + "../server.py"))[0] == 404

    served(check)


def test_a_browser_that_comes_late_gets_the_newest_state_at_once() -> None:
    async def check(server: PageServer) -> None:
        server.show('{"time": 1}')
        server.show('{"time": 2}')
        async with connect(stream(server.address)) as browser:
            assert await browser.recv() == '{"time": 2}'
            await browser.send("taken")
            server.show('{"time": 3}')
            assert await browser.recv() == '{"time": 3}'

    served(check)


def test_a_slow_browser_misses_the_states_in_between() -> None:
    async def check(server: PageServer) -> None:
        async with connect(stream(server.address)) as browser:
            assert await browser.recv() == '{"time": -1}'
            for k in range(100):
                server.show(json.dumps({"time": k}))
            # Nothing is on the way to it: an answer overtakes all states.
            await browser.send("link cut")
            assert json.loads(await browser.recv())["answer"] == "LINK CUT"
            await browser.send("taken")
            assert await browser.recv() == '{"time": 99}'

    served(check)


def test_commands_are_answered_and_refusals_are_told() -> None:
    async def check(server: PageServer) -> None:
        async with connect(stream(server.address)) as browser:
            await browser.recv()
            for line, answer in (
                ("link cut", {"answer": "LINK CUT", "refused": False}),
                (
                    "nonsense",
                    {
                        "answer": "command: expected one of push, link, got 'nonsense'",
                        "refused": True,
                    },
                ),
            ):
                await browser.send(line)
                assert json.loads(await browser.recv()) == answer
            await browser.send("x" * 301)
            await browser.wait_closed()
            while server.browsers:
                await asyncio.sleep(0.01)

    served(check)


def test_more_browsers_than_can_be_are_turned_away() -> None:
    async def check(server: PageServer) -> None:
        browsers = [await connect(stream(server.address)) for _ in range(MAX_BROWSERS)]
        for browser in browsers:
            await browser.recv()
        with pytest.raises(InvalidStatus, match="503"):
            await connect(stream(server.address))
        for browser in browsers:
            await browser.close()

    served(check)


def feed_of(robot: Robot, *blocks: bytes) -> dict[str, Any]:
    feed = Feed(robot, RunConfig(), [1, 2])
    feed.take(blocks)
    state: dict[str, Any] = json.loads(feed.state)
    state["refused"] = feed.refused
    return state


def test_a_state_has_the_newest_poses_numbers_and_outages(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 1100)
    state = feed_of(
        robot,
        encode_rows(*link_rows(400, lost_every=10)),
        encode_rows(*solve_rows(10)),
        *(encode_rows(schema, rows[k : k + 100]) for k in range(0, 1100, 100)),
    )
    assert (state["verdict"], state["fallen"]) == ("stands", False)
    assert state["time"] == pytest.approx(1.099)
    assert state["push"] == [0.0, 100.0, 0.0]
    # A pose for each 25 ms of the last block, in order, the last one at its end.
    times = [pose["at"] for pose in state["poses"]]
    assert len(times) == 4
    assert times == sorted(times)
    assert times[-1] == pytest.approx(WALL_START_NS * 1e-9 + 1.099)
    base = state["poses"][-1]["joints"][:3]
    np.testing.assert_allclose(base, schema.column(rows, "q")[-1, :3], atol=1e-4)
    strip = state["strip"]
    assert [age for _, age in strip["ages"]][:2] == pytest.approx([8.94, 14.94], abs=0.01)
    ((begin, end),) = strip["outages"]["up"]
    assert begin == pytest.approx(0.4 + 0.0151 - 1.1, abs=0.01)
    assert end == 0.0, "the link is silent since"


def test_a_state_has_the_soles_after_the_last_rows(robot: Robot) -> None:
    schema, rows = step_rows()
    soles = feed_of(robot, encode_rows(schema, rows[:5]))["soles"]
    assert {kind: len(each) for kind, each in soles.items()} == {
        "planned": 2,
        "chosen": 1,
        "landed": 2,
    }
    (chosen,) = soles["chosen"]
    # A closed outline around the foothold, above the ground.
    assert chosen[0] == chosen[4]
    (low_x, low_y, height), (high_x, high_y, _) = np.min(chosen, axis=0), np.max(chosen, axis=0)
    assert low_x < 0.15 < high_x
    assert low_y < 0.1 < high_y
    assert height == pytest.approx(4e-3)


def test_a_push_stays_in_the_picture_for_a_while(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 2000)
    feed = Feed(robot, RunConfig(), [1])
    shown = []
    for k in range(0, 2000, 100):
        feed.take([encode_rows(schema, rows[k : k + 100])])
        shown.append(json.loads(feed.state)["push"][1])
    # The push lasts from 1 s to 1.2 s.
    assert shown == 10 * [0.0] + 7 * [100.0] + 3 * [0.0]


def test_states_are_numbers_whatever_comes(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 100)
    rows[60:] = np.nan
    spoilt = encode_rows(schema, rows)
    rows[:, schema.slices["q"]] = np.inf
    state = feed_of(robot, b"no block", spoilt, encode_rows(schema, rows))
    assert state["refused"] >= 1
    assert "NaN" not in json.dumps(state)
    assert "Infinity" not in json.dumps(state)


def test_after_a_fall_the_page_names_no_command(robot: Robot) -> None:
    schema, rows = tick_rows(robot, 100)
    rows[50:, schema.slices["com"]] *= 0.5
    rows[50:, schema.slices["source"]] = 2
    state = feed_of(robot, encode_rows(schema, rows))
    assert (state["verdict"], state["source"], state["contact"]) == ("fell at 0.05 s", "", "")


def test_a_state_before_the_first_row_has_all_that_the_page_reads(robot: Robot) -> None:
    state = feed_of(robot)
    assert state["verdict"] == "waits for the edge"
    assert state["strip"]["ages"] == state["events"] == []
    assert state["soles"] == {"planned": [], "chosen": [], "landed": []}
    assert state["strip"]["outages"] == state["strip"]["delays_ms"] == {}


def test_a_velocity_that_is_given_again_is_one_event(robot: Robot) -> None:
    feed = Feed(robot, RunConfig(), [1])
    texts = ("drive 0.1 0 0", "drive 0.1 0 0", "drive 0.1 0 0", "drive 0 0 0", "drive 0.1 0 0")
    events = [CommandEvent(k * 10**9, parse_command(text)) for k, text in enumerate(texts)]
    feed.take_events([encode_event(event, wall_ns=WALL_START_NS) for event in events])
    shown = json.loads(feed.state)["events"]
    assert shown == ["0.00 s: drive 0.1 0 0", "3.00 s: drive 0 0 0", "4.00 s: drive 0.1 0 0"]


def test_events_are_kept_for_late_browsers_and_bounded(robot: Robot) -> None:
    feed = Feed(robot, RunConfig(), [1])
    cut = parse_command("link cut")
    messages = [
        encode_event(CommandEvent(k * 1_000_000_000, cut), wall_ns=WALL_START_NS) for k in range(9)
    ]
    assert feed.take_events([*messages, messages[-1], b"no event"])
    events = json.loads(feed.state)["events"]
    assert len(events) == 6
    assert events[-1] == "8.00 s: link cut"
    assert feed.refused == 1


def test_hulls_are_few_triangles_that_look_outwards_and_fill_their_meshes(
    robot: Robot, tmp_path: Path
) -> None:
    meshes = load_meshes(robot)
    hulls = make_hulls(meshes)
    assert sum(len(shape["faces"]) for shape in hulls["shapes"]) < 1200
    assert {hulls["joints"][shape["joint"]] for shape in hulls["shapes"]} == {
        mesh.joint for mesh in meshes
    }
    for shape in hulls["shapes"]:
        vertices, faces = np.array(shape["vertices"]), np.array(shape["faces"])
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        outwards = np.cross(b - a, c - a)
        assert ((outwards * (a - vertices.mean(axis=0))).sum(axis=1) > 0.0).all()


def test_hulls_are_made_once(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "hulls-1.json").write_text('{"joints": [1], "shapes": []}', encoding="utf-8")
    assert load_hulls(robot, cache=tmp_path) == {"joints": [1], "shapes": []}


class Browser:
    """A page in a headless Chromium, over its debugging protocol."""

    def __init__(self, folder: Path) -> None:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        if chromium is None:
            pytest.skip("there is no chromium here")
        self._port = folder / "DevToolsActivePort"
        self._number = 0
        flags = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0")
        self._process = subprocess.Popen(
            [chromium, *flags, f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def open(self, address: str) -> None:
        until(self._port.exists, "Chromium does not start")
        lines = until(lambda: self._port.read_text().splitlines()[1:], "Chromium has no port")
        port = self._port.read_text().splitlines()[0]
        self._session = None
        self._socket = connect_sync(f"ws://127.0.0.1:{port}{lines[0]}", max_size=None)
        target = self.ask("Target.createTarget", url=address)["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        session = {} if self._session is None else {"sessionId": self._session}
        request = {"id": self._number, "method": method, "params": parameters, **session}
        self._socket.send(json.dumps(request))
        answer: dict[str, Any] = {}
        while answer.get("id") != self._number:
            answer = json.loads(self._socket.recv(timeout=PATIENCE_SECONDS))
        result: dict[str, Any] = answer["result"]
        return result

    def value(self, expression: str) -> Any:
        return self.ask("Runtime.evaluate", expression=expression)["result"].get("value")

    def key(self, kind: str, key: str) -> None:
        self.ask("Input.dispatchKeyEvent", type=kind, key=key)

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


def test_in_a_browser_the_robot_is_driven_while_a_key_is_held(tmp_path: Path) -> None:
    lines: list[str] = []
    browser = Browser(tmp_path)

    def drive(address: str) -> None:
        browser.open(address)
        until(lambda: browser.value("document.title") == "Romeo · balance", "it does not load")
        until(lambda: browser.value("document.body.innerText").count("↑ w"), "no drive buttons")
        browser.key("keyDown", "w")
        # While it is held, the velocity is given again.
        until(lambda: len(lines) > 2, "a held key drives nothing")
        browser.key("keyDown", "q")
        until(lambda: "drive 0.15 0 0.25" in lines, "two keys are not added")
        browser.key("keyUp", "w")
        browser.key("keyUp", "q")
        until(lambda: lines[-1] == "drive 0 0 0", "the robot is not stopped")
        before = len(lines)
        browser.key("keyDown", "d")
        until(lambda: lines[-1] == "drive 0 -0.06 0", "it does not drive again")
        # A page that is left sends no key up.
        browser.value("dispatchEvent(new Event('blur'))")
        until(lambda: lines[-1] == "drive 0 0 0", "the robot is not stopped when the page is left")
        assert lines[before - 1] == "drive 0 0 0"
        browser.key("keyDown", "c")
        until(lambda: lines[-1] == "link cut", "the other keys are not commands")

    async def check(server: PageServer) -> None:
        await asyncio.to_thread(drive, server.address)

    try:
        served(check, lines)
    finally:
        browser.end()
    assert set(lines[:3]) == {"drive 0.15 0 0"}


def test_the_page_drives_as_fast_as_the_terminal() -> None:
    page = files("viewer.page").joinpath("index.html").read_text(encoding="utf-8")
    buttons = re.findall(r'data-drive="([^"]+)" data-held="(.)"', page)
    assert {key: parse_command(f"drive {text}") for text, key in buttons} == KEYS


@pytest.mark.live
def test_a_run_is_seen_and_pushed_from_the_page(robot: Robot, tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "config.toml").write_text(dump_config(RunConfig(), versions={}))
    hub = ZenohBus(listen=[endpoint], mode="router")
    ticks = hub.publisher(TICKS_KEY.format(robot=robot.name), wait_when_full=True)
    events = hub.publisher(EVENTS_KEY)
    carried_out: list[Command] = []
    seen: list[bytes] = []

    def carry_out(command: Command) -> Accepted:
        carried_out.append(command)
        events.publish(encode_event(CommandEvent(7_000_000, command), wall_ns=WALL_START_NS))
        return Accepted(7_000_000)

    CommandServer(hub, ROBOT_COMMANDS_KEY, carry_out)
    hub.subscribe(VIEW_KEY, lambda delivery: seen.append(delivery.data))
    viewer = Process(
        *("viewer", "live", "--config", str(tmp_path / "config.toml")),
        *("--telemetry", endpoint, "--view", "page"),
        env=dict(os.environ),
    )
    try:
        viewer.wait_for("READY in a browser")
        address = viewer.wait_for("http://127.0.0.1:").strip()
        until(lambda: is_heard(ticks) and is_heard(events), "the page does not subscribe")
        with connect_sync(stream(address)) as browser:
            until(lambda: bool(seen), "nobody learns that the page is open")
            ticks.publish(encode_rows(*tick_rows(robot, 100)))
            state: dict[str, Any] = {}
            while not state.get("poses"):
                state = json.loads(browser.recv(timeout=PATIENCE_SECONDS))
                browser.send("taken")
            assert state["verdict"] == "stands"
            browser.send("push 100N +y")
            while not state.get("events"):
                state = json.loads(browser.recv(timeout=PATIENCE_SECONDS))
                browser.send("taken")
            assert state["events"] == ["0.01 s: push 100N +y --for 200ms"]
            assert carried_out == [parse_command("push 100N +y")]
            browser.send("push 100N up")
            while not state.get("refused"):
                state = json.loads(browser.recv(timeout=PATIENCE_SECONDS))
            assert "direction" in state["answer"]
        viewer.signal(signal.SIGTERM)
        assert viewer.wait() == 0
    finally:
        viewer.end()
        hub.close()
