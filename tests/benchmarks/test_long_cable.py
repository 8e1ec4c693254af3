from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.real_path.long_cable import bytes_per_ms, cable_options
from netem.networks import load_network
from netem.profile import DOWNLINK, UPLINK
from shared.config.config_file import load_config
from shared.errors import ConfigError

MS = 1_000_000


@pytest.mark.parametrize(
    ("rate", "expected"), [("8kbit", 1.0), ("100mbit", 12_500.0), ("1gbit", 125_000.0)]
)
def test_a_rate_is_read_as_tc_reads_it(rate: str, expected: float) -> None:
    assert bytes_per_ms(rate) == expected


@pytest.mark.parametrize("rate", ["", "100", "100mbps", "0mbit", "-1mbit", "fast"])
def test_what_is_no_rate_is_refused(rate: str) -> None:
    with pytest.raises(ConfigError, match="rate: expected 100mbit"):
        bytes_per_ms(rate)


@pytest.mark.parametrize("way", [UPLINK, DOWNLINK])
def test_a_packet_takes_the_delay_and_its_bytes_time_and_waits_no_longer_than_the_queue(
    tmp_path: Path, way: int
) -> None:
    network, _, config_file = cable_options(tmp_path, carried=12_500.0, one_way_ms=5.0)
    config = load_config(config_file, {})
    # 50 ms of queue, and what is on the cable.
    assert config.link.queue_bytes == 55 * 12_500
    delay_ns = load_network(network).source(way, queue_bytes=config.link.queue_bytes)
    assert delay_ns(0, 1_250) == pytest.approx(5.1 * MS, abs=10)
    # Ten milliseconds' worth behind it, then one that waits for all of that.
    assert delay_ns(0, 125_000) == pytest.approx(15.1 * MS, abs=10)
    assert delay_ns(0, 1_250) == pytest.approx(15.2 * MS, abs=10)
