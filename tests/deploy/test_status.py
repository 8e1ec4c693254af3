"""The status line and the events, from rows as the services publish them."""

from __future__ import annotations

import stat
from pathlib import Path

import numpy as np
import pytest

from deploy.console.events import Events
from deploy.console.status import Status, sparkline
from deploy.console.terminal import Terminal
from deploy.console.watch import open_hub, private_socket, tell
from shared.bus.base import Delivery
from shared.errors import LinkError
from shared.telemetry.row_log import encode_rows
from shared.telemetry.schema import LINK_SCHEMA, Column, Schema, tick_schema

TICKS = tick_schema(nq=38, nv=37)
MS = 1_000_000
# The machine's clock when the task begins.
BEGIN_NS = 7_000 * MS


def ticks(first_ms: int, last_ms: int, **columns) -> np.ndarray:
    """A row per millisecond of the task."""
    times_ms = np.arange(first_ms, last_ms + 1)
    rows = np.zeros((len(times_ms), TICKS.width))
    rows[:, TICKS.slices["time_ns"]] = times_ms[:, None] * MS
    rows[:, TICKS.slices["wall_ns"]] = BEGIN_NS + times_ms[:, None] * MS
    for name, value in columns.items():
        rows[:, TICKS.slices[name]] = value
    return rows


def messages(*sent_and_delay_ms: tuple[float, float], direction: int = 0) -> np.ndarray:
    """A row per message through the shim; a negative delay is that of a lost one."""
    rows = np.zeros((len(sent_and_delay_ms), LINK_SCHEMA.width))
    for row, (sent_ms, delay_ms) in zip(rows, sent_and_delay_ms, strict=True):
        row[LINK_SCHEMA.slices["wall_ns"]] = BEGIN_NS + sent_ms * MS
        row[LINK_SCHEMA.slices["direction"]] = direction
        row[LINK_SCHEMA.slices["achieved_ns"]] = delay_ms * MS if delay_ms >= 0 else -1
    return rows


def texts(events: Events) -> list[str]:
    return [event.text for event in events.take()]


@pytest.fixture
def events() -> Events:
    """The task has begun, and the link passes messages."""
    begun = Events()
    begun.take_ticks(TICKS, ticks(0, 99))
    begun.take_link(LINK_SCHEMA, messages(*((sent, 10) for sent in range(80))))
    assert texts(begun) == []
    return begun


def test_a_push_is_told_once_when_it_begins(events):
    pushed = ticks(100, 199)
    pushed[50:, TICKS.slices["push_n"]] = [0.0, -80.0, 0.0]
    events.take_ticks(TICKS, pushed)
    assert texts(events) == ["pushed with 80 N to -y at 0.15 s"]
    events.take_ticks(TICKS, ticks(200, 299, push_n=[0.0, -80.0, 0.0]))
    events.take_ticks(TICKS, ticks(300, 399))
    assert texts(events) == []
    events.take_ticks(TICKS, ticks(400, 499, push_n=[30.0, 40.0, 0.0]))
    assert texts(events) == ["pushed with (30, 40, 0) N at 0.40 s"]
    assert "80 N to -y at 0.15 s, (30, 40, 0) N" in events.in_words()


def test_an_outage_is_told_while_it_lasts_and_with_its_length_when_it_ends(events):
    for first in range(100, 700, 100):
        events.take_ticks(TICKS, ticks(first, first + 99))
    # The last state came out at 89 ms.
    assert texts(events) == ["no message has passed the uplink since 0.09 s"]
    events.take_link(LINK_SCHEMA, messages((80, 620), (400, 300), (690, 11)))
    assert texts(events) == ["the uplink passes again at 0.70 s, after 0.61 s"]
    assert events.in_words() == "uplink outage 1 ×, at most 0.61 s"


def test_a_short_outage_is_told_when_it_is_over(events):
    events.take_ticks(TICKS, ticks(100, 199))
    events.take_link(LINK_SCHEMA, messages((80, 160), (200, 41)))
    assert texts(events) == ["the uplink passes again at 0.24 s, after 0.15 s"]


def test_an_outage_in_which_all_states_were_lost_is_told_when_it_is_over(events):
    events.take_ticks(TICKS, ticks(100, 399))
    lost = [(sent, -1) for sent in range(80, 380)]
    events.take_link(LINK_SCHEMA, messages(*lost, (380, 10)))
    assert texts(events) == ["the uplink passes again at 0.39 s, after 0.30 s"]


def test_an_outage_of_the_downlink_alone_is_told(events):
    events.take_link(LINK_SCHEMA, messages(*((sent, 10) for sent in range(80)), direction=1))
    events.take_ticks(TICKS, ticks(100, 499))
    stalled = messages(*((sent, 410 - sent) for sent in range(80, 400)), direction=1)
    passing = messages(*((sent, 10) for sent in range(80, 400)))
    events.take_link(LINK_SCHEMA, np.concatenate([passing, stalled]))
    assert texts(events) == ["the downlink passes again at 0.41 s, after 0.32 s"]
    assert events.in_words() == "downlink outage 1 ×, at most 0.32 s"


def test_a_link_that_was_cut_passes_nothing_though_messages_are_reported_lost(events):
    for first in range(100, 700, 100):
        events.take_ticks(TICKS, ticks(first, first + 99))
        events.take_link(LINK_SCHEMA, messages((first, -1), (first + 50, -1)))
    assert texts(events) == ["no message has passed the uplink since 0.09 s"]
    assert events.in_words() == "no message passed the uplink after 0.09 s"


def test_a_report_that_was_late_is_no_outage(events):
    events.take_ticks(TICKS, ticks(100, 699))
    events.take_link(LINK_SCHEMA, messages(*((sent, 10) for sent in range(80, 690))))
    assert texts(events)[1:] == ["the uplink had no outage; the shim's rows came late"]
    assert events.in_words() == ""


def test_answers_may_be_rare_and_a_delay_is_no_outage(events):
    events.take_ticks(TICKS, ticks(100, 199))
    events.take_link(LINK_SCHEMA, messages((0, 10), (400, 10), direction=1))
    far = Events()
    far.take_ticks(TICKS, ticks(0, 1999))
    far.take_link(LINK_SCHEMA, messages(*((sent, 1000) for sent in range(900))))
    assert texts(events) == texts(far) == []


def test_nothing_is_told_before_the_task_begins():
    waiting = Events()
    waiting.take_ticks(TICKS, ticks(0, 99, time_ns=-1.0))
    waiting.take_link(LINK_SCHEMA, messages((0, 1), (900, 1)))
    assert texts(waiting) == []


def test_bars_are_by_powers_of_ten_from_a_millisecond_to_a_second():
    assert sparkline([0.0, 1.0, 30.0, 999.0, 5000.0]) == "▁▁▄██"


@pytest.fixture
def status() -> Status:
    shown = Status(TICKS, duration=5.0, walks=True)
    for first in range(0, 3000, 100):
        link = messages(*((first + k, 10) for k in range(100)))
        shown.take_link(Delivery(encode_rows(LINK_SCHEMA, link), envelope=None))
        rows = ticks(first, first + 99, mode=1, projector_age_ns=20 * MS)
        shown.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
    return shown


def test_the_line_is_as_wide_as_it_may_be(status):
    whole = status.line(200)
    assert "t  3.00/5 s | fresh " in whole
    assert "link up 10.0 down - ms " + "▃" * 30 in whole
    assert "left foot" in whole
    assert "projector age 20.0 ms" in whole
    for columns in (160, 130, 100, 80, 40, 1):
        assert len(status.line(columns)) <= columns


def test_at_eighty_columns_delay_age_error_and_overruns_are_there(status):
    narrow = status.line(79)
    for part in ("10.0/- ms", "age 20 ms", "CoM 0.0 cm", "overruns 0", "left foot"):
        assert part in narrow
    assert "▃" * 8 not in narrow
    wide = status.line(110)
    assert "10.0/- ms ▃▃▃▃▃▃▃▃" in wide
    assert "overruns 0" in wide


def test_at_eighty_columns_a_slow_link_leaves_no_number_out(status):
    link = messages(*((3000 + k, 1234.5) for k in range(100)))
    link = np.concatenate([link, messages(*((3000 + k, 1234.5) for k in range(100)), direction=1)])
    status.take_link(Delivery(encode_rows(LINK_SCHEMA, link), envelope=None))
    rows = ticks(600_000, 600_099, source=5, projector_age_ns=9e10, overruns=99_999)
    status.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
    narrow = status.line(79)
    for part in ("1234/1234 ms", "age 90000 ms", "CoM 0.0 cm", "overruns 99999"):
        assert part in narrow


def test_a_link_that_passes_nothing_is_a_growing_bar(status):
    rows = ticks(3000, 3999)
    status.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
    assert "▃█" in status.line(200)


def test_an_answer_in_use_that_grows_old_is_a_growing_bar_too(status):
    # The uplink passes: what is missing are answers.
    link = messages(*((3000 + k, 10) for k in range(1000)))
    status.take_link(Delivery(encode_rows(LINK_SCHEMA, link), envelope=None))
    for source, bar in ((4, "▃▃"), (1, "▃█")):
        rows = ticks(3000, 3999, source=source, projector_age_ns=999 * MS)
        status.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
        assert f"{bar} " in status.line(200)


def test_without_a_shim_the_bars_are_the_age_of_answers_that_are_used_as_they_came():
    direct = Status(TICKS, duration=5.0)
    for source, age_ms in ((4, 900), (1, 30), (2, 900), (0, 1)):
        rows = ticks(0, 99, source=source, projector_age_ns=age_ms * MS)
        direct.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
    assert "link up - down - ms ▄▁  " in direct.line(200)


def test_what_is_lost_is_called_so(status):
    lost = messages((3000, -1))
    status.take_link(Delivery(encode_rows(LINK_SCHEMA, lost), envelope=None))
    assert "link up lost down - ms" in status.line(200)


def test_a_robot_that_waits_says_so():
    empty = Status(TICKS, duration=5.0)
    assert empty.line() == "waiting for the robot"
    rows = ticks(0, 9, time_ns=-1.0)
    empty.take_ticks(Delivery(encode_rows(TICKS, rows), envelope=None))
    assert empty.line() == "robot waits for its first projector"


def changed(schema: Schema, rows: np.ndarray, **columns: float) -> np.ndarray:
    rows = rows.copy()
    for name, value in columns.items():
        rows[-1, schema.slices[name]] = value
    return rows


OTHER = Schema(Column("tick"), Column("q", 3))
BAD_TICKS = {
    "no rows": encode_rows(TICKS, ticks(0, 9)[:0]),
    "other columns": encode_rows(OTHER, np.zeros((3, OTHER.width))),
    "rows of the shim": encode_rows(LINK_SCHEMA, messages((0, 10))),
    "no number": encode_rows(TICKS, changed(TICKS, ticks(0, 9), wall_ns=np.nan)),
    "no time": encode_rows(TICKS, changed(TICKS, ticks(0, 9), time_ns=1e30)),
    "no source": encode_rows(TICKS, changed(TICKS, ticks(0, 9), source=99)),
    "an infinite push": encode_rows(TICKS, changed(TICKS, ticks(0, 9), push_n=np.inf)),
    "garbage": b"garbage",
}
BAD_LINK = {
    "no rows": encode_rows(LINK_SCHEMA, messages((0, 10))[:0]),
    "rows of the robot": encode_rows(TICKS, ticks(0, 9)),
    "no number": encode_rows(
        LINK_SCHEMA, changed(LINK_SCHEMA, messages((0, 9)), achieved_ns=np.nan)
    ),
    "garbage": b"",
}


@pytest.mark.parametrize("block", BAD_TICKS.values(), ids=BAD_TICKS)
def test_a_block_of_the_robot_that_cannot_be_used_changes_nothing(status, block):
    before = status.line(200)
    status.take_ticks(Delivery(block, envelope=None))
    assert status.refused == 1
    assert status.take_events() == []
    assert "1 blocks refused" in status.line(200)
    assert status.line(200).startswith(before.split(" | overruns")[0])


@pytest.mark.parametrize("block", BAD_LINK.values(), ids=BAD_LINK)
def test_a_block_of_the_shim_that_cannot_be_used_changes_nothing(status, block):
    status.take_link(Delivery(block, envelope=None))
    assert status.refused == 1
    assert status.take_events() == []


def test_an_error_in_the_status_is_shown_and_ends_nothing(status, monkeypatch, capsys):
    monkeypatch.setattr(status, "line", lambda columns: [][0])
    tell(status, Terminal(), degraded=("edge",))
    assert (
        "edge degraded | no status: IndexError: list index out of range" in capsys.readouterr().out
    )


@pytest.mark.parametrize("name", ["run", "a name with blanks", "long" * 30, "a#b"])
def test_the_hub_is_a_socket_that_no_other_user_can_reach(status, name: str, tmp_path: Path):
    folder = tmp_path / name
    folder.mkdir(0o700)
    with private_socket(folder) as endpoint:
        hub = open_hub(endpoint, status, "romeo")
        try:
            file = Path(endpoint.removeprefix("unixsock-stream/"))
            assert stat.S_ISSOCK(file.stat().st_mode)
            assert stat.S_IMODE(file.stat().st_mode) == 0o600
            assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        finally:
            hub.close()
    assert not file.exists()
    # Nothing is left in a temporary folder.
    assert not file.parent.exists() or list(folder.iterdir()) == []


def test_a_hub_that_others_could_reach_is_refused(status):
    with pytest.raises(LinkError, match="expected unixsock-stream/FILE"):
        open_hub("tcp/127.0.0.1:7450", status, "romeo")
