"""The radio channel between access point and robot: its signal-to-noise ratio over time.

    SNR = P − PL(d) − SF + G + 79 dB,

with path loss PL and shadow fading SF of TR 38.901 Table 7.4.1-1. G is the gain of both antennas
with small-scale fading. −79 dBm is the noise of 1 GHz at a noise figure of 5 dB. Blockers decide
whether PL and SF are those with or without a line of sight; see `blockage`. Both directions have
the same SNR. `docs/network-model.md` has the source of each number.

The model has no antenna pattern, no interference and no reflection off the blockers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from netem.generator.blockage import Blockers, covers, knife_edge_loss_db

CARRIER_GHZ = 28.0
NOISE_DBM = -79.0
BLOCKERS = 4
BLOCKER_SPEED = 2.0
ROBOT_SPEED = 0.5
# The robot walks this distance and back again [m].
ROBOT_TRACK = 3.0
# Small-scale fading is drawn again after this time [ms].
FADING_MS = 100
# Every blocker crosses at least this part of the path away from either antenna.
MARGIN = 0.1


@dataclass(frozen=True)
class Scenario:
    """The parameters of one place. Lengths are in m. Ranges are (lowest, highest).

    `heights`: of access point and robot. Three pairs are (with, without) a line of sight:
    `shadow_db`, the standard deviation of shadow fading; `shadow_distance`, its correlation
    distance; `gain_db`, the mean gain. `k_factor_db`: mean and standard deviation of the Rician
    K-factor. `scatter_db`: standard deviation of the gain without a line of sight. `width`: range
    of a blocker's width. `half_track`: a blocker's largest distance from the path. `longest_ms`:
    the longest one-way delay that the paper reports.
    """

    name: str
    indoor: bool
    distance: tuple[float, float]
    heights: tuple[float, float]
    transmit_dbm: float
    shadow_db: tuple[float, float]
    shadow_distance: tuple[float, float]
    gain_db: tuple[float, float]
    k_factor_db: tuple[float, float]
    deepest_fade_db: float
    scatter_db: float
    width: tuple[float, float]
    half_track: float
    longest_ms: float


FACTORY = Scenario(
    name="factory",
    indoor=False,
    distance=(20.0, 100.0),
    heights=(10.0, 1.5),
    transmit_dbm=15.0,
    shadow_db=(4.0, 7.82),
    shadow_distance=(10.0, 13.0),
    gain_db=(24.1, 14.6),
    k_factor_db=(9.0, 5.0),
    deepest_fade_db=30.0,
    scatter_db=1.8,
    width=(0.20, 0.42),
    half_track=6.0,
    longest_ms=389.0,
)
BUILDING = Scenario(
    name="building",
    indoor=True,
    distance=(5.0, 30.0),
    heights=(5.0, 1.0),
    transmit_dbm=5.0,
    shadow_db=(3.0, 8.03),
    shadow_distance=(10.0, 6.0),
    gain_db=(23.3, 14.9),
    k_factor_db=(7.0, 4.0),
    deepest_fade_db=15.0,
    scatter_db=3.7,
    width=(0.03, 0.075),
    half_track=2.0,
    longest_ms=91.0,
)
SCENARIOS = {scenario.name: scenario for scenario in (FACTORY, BUILDING)}


@dataclass(frozen=True)
class RadioChannel:
    """A run of the channel, a value per millisecond: arrays (n,).

    `distance`: between the antennas, in space [m]. `n_block`: number of blockers that cut the line.
    """

    distance: np.ndarray
    n_block: np.ndarray
    snr_db: np.ndarray
    blockers: Blockers


def draw_channel(scenario: Scenario, rng: np.random.Generator, milliseconds: int) -> RadioChannel:
    """Draw a channel: the places of robot and blockers, and the fading."""
    blockers = _draw_blockers(scenario, rng)
    start, heading = rng.uniform(*scenario.distance), rng.uniform(0.0, 2.0 * np.pi)
    seconds = np.arange(milliseconds) * 1e-3
    walked = ROBOT_TRACK - np.abs((ROBOT_SPEED * seconds) % (2.0 * ROBOT_TRACK) - ROBOT_TRACK)
    along, across = start + walked * np.cos(heading), walked * np.sin(heading)
    ground = np.hypot(along, across)
    # The tracks are square to the path at time 0. Later the path has turned with the robot.
    offset = blockers.positions(seconds) - blockers.fraction[:, None] * across
    screen = blockers.screens(across / along)
    n_block = covers(offset, screen).sum(axis=0)
    clear = n_block == 0

    before = blockers.fraction[:, None] * ground
    edges = knife_edge_loss_db(offset, screen, before=before, behind=ground - before).sum(axis=0)
    distance = np.hypot(ground, scenario.heights[0] - scenario.heights[1])
    losses = [
        path_loss_db(
            distance,
            indoor=scenario.indoor,
            line_of_sight=line_of_sight,
            robot_height=scenario.heights[1],
        )
        for line_of_sight in (True, False)
    ]
    loss = np.where(clear, losses[0] + edges, losses[1])
    loss += _shadow_fading_db(scenario, rng, clear)
    gain = _gain_db(scenario, rng, clear)
    snr_db = scenario.transmit_dbm - loss + gain - NOISE_DBM
    return RadioChannel(distance, n_block, snr_db, blockers)


def path_loss_db(
    distance: np.ndarray, *, indoor: bool, line_of_sight: bool, robot_height: float = 1.5
) -> np.ndarray:
    """Path loss [dB] of TR 38.901 Table 7.4.1-1; `distance` in space [m].

    Indoors it is InH-Office, else UMi-StreetCanyon. UMi holds up to its breakpoint (1.7 km at
    28 GHz).
    """
    log_d, log_f = np.log10(distance), np.log10(CARRIER_GHZ)
    free: np.ndarray = 32.4 + (17.3 if indoor else 21.0) * log_d + 20.0 * log_f
    if line_of_sight:
        return free
    if indoor:
        blocked = 17.3 + 38.3 * log_d + 24.9 * log_f
    else:
        blocked = 22.4 + 35.3 * log_d + 21.3 * log_f - 0.3 * (robot_height - 1.5)
    loss: np.ndarray = np.maximum(free, blocked)
    return loss


def _draw_blockers(scenario: Scenario, rng: np.random.Generator) -> Blockers:
    return Blockers(
        fraction=rng.uniform(MARGIN, 1.0 - MARGIN, BLOCKERS),
        width=rng.uniform(*scenario.width, BLOCKERS),
        depth=rng.uniform(*scenario.width, BLOCKERS),
        start=rng.uniform(0.0, 4.0 * scenario.half_track, BLOCKERS),
        half_track=scenario.half_track,
        speed=BLOCKER_SPEED,
    )


def _gain_db(scenario: Scenario, rng: np.random.Generator, clear: np.ndarray) -> np.ndarray:
    """Gain of the antennas with small-scale fading, drawn again every `FADING_MS`, (n,) [dB].

    With a line of sight the fading is |√(K/(K+1)) + CN(0, 1/(K+1))|² with a log-normal K. Without
    one it is normal in dB.
    """
    blocks = -(-len(clear) // FADING_MS)
    k = 10.0 ** (rng.normal(*scenario.k_factor_db, blocks) / 10.0)
    scattered = rng.normal(size=(2, blocks)) / np.sqrt(2.0 * (k + 1.0))
    amplitude = np.hypot(np.sqrt(k / (k + 1.0)) + scattered[0], scattered[1])
    gains = [
        scenario.gain_db[0] + np.maximum(20.0 * np.log10(amplitude), -scenario.deepest_fade_db),
        rng.normal(scenario.gain_db[1], scenario.scatter_db, blocks),
    ]
    with_line, without = (np.repeat(gain, FADING_MS)[: len(clear)] for gain in gains)
    return np.where(clear, with_line, without)


def _shadow_fading_db(
    scenario: Scenario, rng: np.random.Generator, clear: np.ndarray
) -> np.ndarray:
    """Log-normal shadow fading, drawn again at each change of the line of sight, (n,) [dB].

    Between changes the fading follows the walk of the robot, with correlation exp(−Δd/d_corr) after
    a distance Δd: TR 38.901 clause 7.4.4.
    """
    flips = np.flatnonzero(np.diff(clear)) + 1
    shadow = np.empty(len(clear))
    for stretch in np.split(np.arange(len(clear)), flips):
        kind = 0 if clear[stretch[0]] else 1
        step = ROBOT_SPEED * FADING_MS * 1e-3
        kept = np.exp(-step / scenario.shadow_distance[kind])
        value = rng.normal()
        values = [value]
        for innovation in rng.normal(size=len(stretch) // FADING_MS):
            value = kept * value + np.sqrt(1.0 - kept**2) * innovation
            values.append(value)
        shadow[stretch] = scenario.shadow_db[kind] * np.repeat(values, FADING_MS)[: len(stretch)]
    return shadow
