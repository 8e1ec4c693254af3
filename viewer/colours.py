"""The colours of the view. A colour has one meaning in the scene, the plots and the lanes.

Lanes have their state written on them, so their colours are dark. In a comparison the lines and
marks of a run have the colour of the run instead; red keeps its meaning.
"""

from __future__ import annotations

from shared.telemetry.outages import OUTAGE, PASSING, SILENT
from shared.telemetry.schema import Source
from shared.wbc.contacts import ContactMode

Colour = tuple[int, int, int]

LIMIT: Colour = (235, 72, 72)
"""A limit is reached or broken: an outage, a lost message, an overrun, full friction, a fall."""
LINE: Colour = (214, 220, 230)
"""The line of a plot with one line, which its title names."""
SECOND_LINE: Colour = (122, 132, 148)
"""The second line of a plot, or of less importance: the title names it second."""
PLAN: Colour = (76, 142, 247)
COM: Colour = (255, 158, 44)
FORCE: Colour = (64, 191, 128)
PRESSURE: Colour = (178, 122, 240)
SUPPORT: Colour = (250, 214, 80)
PUSH: Colour = (190, 242, 60)
CHOSEN: Colour = (240, 64, 214)
"""The foothold that the step law has chosen."""
LANDED: Colour = (138, 126, 104)
"""A sole that has landed."""
LEFT_FOOT: Colour = (244, 130, 176)
RIGHT_FOOT: Colour = (72, 202, 228)

FALLEN = "fallen"
LINK_STATES: dict[str, Colour] = {PASSING: (38, 70, 54), OUTAGE: LIMIT, SILENT: (56, 58, 64)}
SOURCES: dict[Source, Colour] = {
    Source.FRESH: (46, 112, 58),
    Source.CACHED: (48, 82, 150),
    Source.HELD: (146, 104, 20),
    Source.ON_BOARD: (104, 66, 150),
    Source.CORRECTED: (30, 108, 118),
    Source.STOPPING: (160, 82, 26),
}
MODES: dict[ContactMode, Colour] = {
    ContactMode.DOUBLE_SUPPORT: (90, 96, 106),
    ContactMode.LEFT_SUPPORT: (160, 70, 110),
    ContactMode.RIGHT_SUPPORT: (24, 126, 146),
}
# A side of a sole is at its friction, or only its least normal force keeps it on the ground.
SOLES: dict[str, Colour] = {"friction": LIMIT, "unloaded": (78, 84, 104)}
RUNS = (PLAN, COM, FORCE, PRESSURE, SUPPORT, RIGHT_FOOT)
"""The colours of compared runs, in their order."""
