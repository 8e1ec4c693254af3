"""Your own trace: delays from an array to a profile file, and a robot on the link it describes.

    ./deploy/python -m examples.own_trace

A profile holds the one-way delay, each way, of a message *sent* in each millisecond, and repeats.
Measurements of other tools become one by `./wbc netem convert`, your own link by `./wbc
netem record`; `docs/profiles.md` describes the file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from netem.profile import LOST, DelayProfile
from netem.profile_file import read_profile, write_profile
from netem.statistics import delays_ms, outages
from shared.config.config_file import load_config


def my_link() -> DelayProfile:
    """Two seconds: 5 ms each way, 0.2 s in which nothing passes, and one answer in 100 is lost."""
    ms = np.arange(2000)
    delay_ms = np.full(len(ms), 5.0)
    stalled = (ms >= 1000) & (ms < 1200)
    delay_ms[stalled] += 1200 - ms[stalled]  # what is sent then waits for the end
    delays_ns = np.tile(np.rint(delay_ms * 1e6).astype(np.int64), (2, 1))  # uplink, downlink
    delays_ns[1, ::100] = LOST
    return DelayProfile("mine", delays_ns, metadata={"scenario": "an example"})


def main(duration: float = 4.0, folder: Path = Path("runs")) -> tuple[DelayProfile, TrialResult]:
    """Write the profile, read it back, look at it, and let a robot balance over it."""
    path = folder / "mine.csv"  # or .npz, in whole microseconds
    write_profile(my_link(), path)
    print(f"{path}, as ./deploy/up --network {path} replays it live:")
    print(*path.read_text(encoding="utf-8").splitlines()[:5], "…", sep="\n")

    profile = read_profile(path)
    round_trip_ms = delays_ms(profile, "round trip")
    longest = max(outage.peak_ms for outage in outages(round_trip_ms) if outage.peak_ms < np.inf)
    print(f"round trip {np.median(round_trip_ms):g} ms, in the stall up to {longest:g} ms")

    # Where in the profile a run begins, its seed draws.
    config = load_config(None, {"duration": duration, "link.network": str(path), "seed": 0})
    result = Lockstep(config).run()
    age, downlink = result.summary["projector_age_ms"], result.summary["link"]["downlink"]
    print(f"Romeo {'falls' if result.summary['fell'] else 'stands'}; its projectors were up to")
    print(f"{age['max']:.0f} ms old, and {downlink['dropped_by_profile']} were lost on the way")
    return profile, result


if __name__ == "__main__":
    main()
