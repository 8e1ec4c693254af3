"""Your own link: write delays from an array into a profile file, and run a robot over them.

    ./deploy/python -m examples.own_trace

A profile holds the one-way delay, each way, of a message *sent* in each millisecond, and repeats.
`./wbc netem convert` makes a profile from other tools' measurements, and `./wbc netem record` from
your own link. `docs/profiles.md` describes the file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from netem.profile import LOST, DelayProfile
from netem.profile_file import read_profile, write_profile
from netem.statistics import delay_spikes, delays_ms
from shared.config.config_file import load_config


def my_link() -> DelayProfile:
    """Return two seconds: 5 ms each way, an outage of 0.2 s, and one answer in 100 is lost."""
    ms = np.arange(2000)
    delay_ms = np.full(len(ms), 5.0)
    stalled = (ms >= 1000) & (ms < 1200)
    delay_ms[stalled] += 1200 - ms[stalled]  # a message sent then waits for the end
    delays_ns = np.tile(np.rint(delay_ms * 1e6).astype(np.int64), (2, 1))  # uplink, downlink
    delays_ns[1, ::100] = LOST
    return DelayProfile("mine", delays_ns, metadata={"scenario": "an example"})


def main(duration: float = 4.0, folder: Path = Path("runs")) -> tuple[DelayProfile, TrialResult]:
    """Write the profile, read it back, print its numbers, and let a robot balance over it."""
    path = folder / "mine.csv"  # or .npz, in whole microseconds
    write_profile(my_link(), path)
    print(f"{path}, as ./deploy/up --network {path} replays it live:")
    print(*path.read_text(encoding="utf-8").splitlines()[:5], "…", sep="\n")

    profile = read_profile(path)
    round_trip_ms = delays_ms(profile, "round trip")
    longest = max(each.peak_ms for each in delay_spikes(round_trip_ms) if each.peak_ms < np.inf)
    print(f"round trip {np.median(round_trip_ms):g} ms, in the outage up to {longest:g} ms")

    # The seed draws where in the profile the run begins.
    config = load_config(None, {"duration": duration, "link.network": str(path), "seed": 0})
    result = Lockstep(config).run()
    age, downlink = result.summary["projector_age_ms"], result.summary["link"]["downlink"]
    print(f"Romeo {'falls' if result.summary['fell'] else 'stands'}; its projectors were up to")
    print(f"{age['max']:.0f} ms old, and {downlink['dropped_by_profile']} were lost on the way")
    return profile, result


if __name__ == "__main__":
    main()
