"""Agreement of recorded and replayed delays, over two generations of the same link.

The shim replays a profile and `./wbc netem record` records it. Then the shim replays the recording,
and that is recorded in turn. An error is the distance between the recorded and the replayed delay
of the same period, from every period in which both have one.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.link_paths import READY_SECONDS, shim, started
from benchmarks.timing import cores_busy, header_of_processes
from netem.networks import load_profile
from netem.profile import DIRECTIONS, LOST
from shared.errors import LinkError
from shared.output.text_table import aligned
from shared.telemetry.parquet import read_parquet

NETWORKS = ("constant:20ms", "factory/011")
_GENERATIONS = 2
# The expected accuracy of a recording [ms].
_BOUND_MS = 0.5


def run(*, seconds: float) -> str:
    """Record and replay every network. Return the table as text."""
    busy = cores_busy(seconds=2.0)
    within = f"within {_BOUND_MS:g} ms"
    lines = [["network", "generation", "way", "periods", "lost", "p50", "p99", "max", within]]
    for network in NETWORKS:
        with tempfile.TemporaryDirectory() as folder:
            source = network
            for generation in range(1, _GENERATIONS + 1):
                out = Path(folder) / f"{generation}.npz"
                replayed, recorded = record_replay(source, out, seconds=seconds)
                for way, name in enumerate(DIRECTIONS):
                    row = _row(replayed[way], recorded[way])
                    lines.append([network, str(generation), name, *row])
                source = str(out)
    return "\n".join(
        [
            header_of_processes(busy),
            f"{seconds:g} s each; |recorded − replayed| delay [ms]; lost: by the recording alone",
            "",
            *aligned(lines, left=3),
        ]
    )


def record_replay(network: str, out: Path, *, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Record a network while the shim replays it.

    Return the replayed and the recorded delays of the same periods, each (2, n) [ns]. `out` is the
    file of the recording. Raise `LinkError` if it is not written.
    """
    log = out.with_suffix("")
    with shim(network, out=log) as path:
        assert path.between is not None
        with (
            started("netem", "record", "--listen", path.listen),
            started(
                *("netem", "record", "--connect", path.dial, "--out", str(out)),
                *("--seconds", f"{seconds:g}"),
                wait=False,
            ) as near,
        ):
            path.between.wait_for("READY")
            near.wait_for(" periods of ", seconds=seconds + READY_SECONDS)
    return same_periods(network, out, log / "link.parquet")


def same_periods(network: str, out: Path, log: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the delays that the shim replayed and those recorded in `out` in the same periods.

    Both are (2, n) [ns]. `log` is the shim's log of the replay.
    """
    schema, rows = read_parquet(log)
    replayed, recorded = load_profile(network), load_profile(str(out))
    began_ns = int(schema.column(rows, "wall_ns")[0]) - replayed.start_offset_ns(0)
    middles = np.arange(recorded.delays_ns.shape[1]) + 0.5
    elapsed_ns = recorded.metadata["start_ns"] + middles * recorded.period_ns - began_ns
    periods = (elapsed_ns // replayed.period_ns).astype(int) % replayed.delays_ns.shape[1]
    return replayed.delays_ns[:, periods], recorded.delays_ns


def _row(replayed: np.ndarray, recorded: np.ndarray) -> list[str]:
    passed = replayed != LOST
    both = passed & (recorded != LOST)
    if not both.any():
        raise LinkError("nothing was recorded")
    lost = np.mean(recorded[passed] == LOST)
    size_ms = np.abs(recorded[both] - replayed[both]) * 1e-6
    quantiles = (f"{value:.3f}" for value in np.percentile(size_ms, [50, 99, 100]))
    return [str(len(recorded)), f"{lost:.2%}", *quantiles, f"{np.mean(size_ms <= _BOUND_MS):.1%}"]
