"""A trial from Python: PR, LA and LC under a push, over a link that stalls.

    ./deploy/python -m examples.trial

A trial is a configuration, played under simulated time. The same configuration gives the same
result to the last bit. `docs/configuration.md` lists the settings; a key has a dot after its
section. All other settings have their defaults.
"""

from __future__ import annotations

import numpy as np

from experiments.lockstep import Lockstep, TrialResult
from shared.config.config_file import load_config
from shared.output.summary import summary_in_words


def play(controller: str, *, duration: float) -> TrialResult:
    """Play a balance of Romeo. An outage of 0.3 s begins just when it is pushed sideways."""
    config = load_config(
        None,
        {
            "controller": controller,
            "duration": duration,  # s
            "push": ["100N@1s:0.2s:+y"],
            "link.network": "factory/011",
            "seed": 0,
        },
    )
    return Lockstep(config).run()


def main(duration: float = 5.0) -> dict[str, TrialResult]:
    """Play the three controllers, and print the outcomes."""
    results = {name: play(name, duration=duration) for name in ("pr", "la", "lc")}
    for result in results.values():
        print(summary_in_words(result.summary), end="\n\n")

    print("age of the answer in use, and error of the CoM, every 0.1 s:")
    for name, result in results.items():
        # A row per tick, a millisecond each; the columns are those of telemetry.parquet.
        age_ms = result.schema.column(result.rows, "projector_age_ns") / 1e6
        error_cm = result.schema.column(result.rows, "com_error_m") * 100
        print(name, "age ms", np.round(age_ms[1000:1600:100]).astype(int), end="  ")
        print("error cm", np.round(error_cm[1000:1600:100], 1))
    return results


if __name__ == "__main__":
    main()
