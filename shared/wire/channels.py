"""The table of channels: key, nominal rate and size bound of every publication."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Channel:
    """A key expression with `{robot}` to fill in, its nominal rate and its size bound."""

    name: str
    key: str
    rate_hz: int
    max_bytes: int

    def key_for(self, robot: str) -> str:
        """The key of one robot."""
        return self.key.format(robot=robot)


UPLINK = Channel(name="uplink", key="wbc/{robot}/state", rate_hz=1000, max_bytes=1_000)
DOWNLINK = Channel(name="downlink", key="wbc/{robot}/projector", rate_hz=1000, max_bytes=40_000)
# Plans and step laws have a separate key, so that they never queue behind projectors.
PLANS = Channel(name="plans", key="wbc/{robot}/plan", rate_hz=50, max_bytes=4_000)

# Telemetry runs on a separate session and never crosses the link under test.
TICKS_KEY = "telemetry/{robot}/ticks"
STEPS_KEY = "telemetry/{robot}/steps"
LINK_KEY = "telemetry/netem/link"
SOLVES_KEY = "telemetry/edge/solves"
