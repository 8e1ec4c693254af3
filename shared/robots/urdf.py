"""The tree of a URDF and its checks, before Pinocchio's parser sees it.

The parser makes independent motors of mimic joints, accepts links without mass and joints without
limits, and prints rather than raises. So these are looked for first.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as Xml

from shared.errors import ConfigError
from shared.regular_file import read_regular

_MAX_BYTES = 20_000_000
_FIXED = "fixed"
# The attributes that hold numbers, and how many.
_NUMBERS = {"xyz": 3, "rpy": 3, "value": 1, "effort": 1, "velocity": 1, "lower": 1, "upper": 1}
_NUMBERS |= dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1)
# Moments of inertia of published robots are below 0 by rounding [kg m²].
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF. Limits are NaN where the URDF has none; `mimics` names another joint.

    `axis` is the joint's in its frame, (1, 0, 0) if the URDF has none.
    """

    name: str
    kind: str
    parent: str
    child: str
    effort: float
    velocity: float
    lower: float
    upper: float
    axis: tuple[float, ...]
    mimics: str | None


@dataclass(frozen=True)
class Urdf:
    """Links with their masses [kg], 0 without one, and the joints between them.

    `least_moments` are the least of each link's moments of inertia about its axes [kg m²].
    `repeated` are links and joints with the name of another one, `unread` the attributes that are
    no finite numbers, in words.
    """

    masses: dict[str, float]
    least_moments: dict[str, float]
    joints: tuple[Joint, ...]
    repeated: tuple[str, ...]
    unread: tuple[str, ...]

    @property
    def moving(self) -> list[Joint]:
        return [joint for joint in self.joints if joint.kind != _FIXED]

    def carried(self, link: str) -> float:
        """The mass of a link with all links that are fixed to it [kg]."""
        fixed = [
            joint.child for joint in self.joints if (joint.parent, joint.kind) == (link, _FIXED)
        ]
        return self.masses.get(link, 0.0) + sum(self.carried(child) for child in fixed)


def read_xml(path: Path, *, what: str) -> Xml.Element:
    """Return the root of an XML file. Raise `ConfigError`, which begins with `what`, for others."""
    try:
        return Xml.fromstring(read_regular(path, at_most=_MAX_BYTES))
    except OSError as error:
        raise ConfigError(f"{what}: cannot read {path}: {error.strerror}") from None
    except Xml.ParseError as error:
        raise ConfigError(f"{what}: {path} is not valid XML: {error}") from None


def read_urdf(path: Path, *, what: str) -> Urdf:
    """Read a URDF; raise `ConfigError`, which begins with `what`, if it is none."""
    root = read_xml(path, what=what)
    links = [each for each in root.iterfind("link") if each.get("name")]
    if root.tag != "robot" or not links:
        raise ConfigError(f"{what}: expected a URDF, a <robot> with links, got {path}")
    joints = root.findall("joint")
    parts = [*links, *joints]
    names = Counter((part.tag, part.get("name", "")) for part in parts)
    inertias = {link.get("name", ""): link.find("inertial/inertia") for link in links}
    return Urdf(
        masses={
            link.get("name", ""): _number(link.find("inertial/mass"), "value") for link in links
        },
        least_moments={
            name: min(_number(inertia, key) for key in ("ixx", "iyy", "izz"))
            for name, inertia in inertias.items()
        },
        joints=tuple(_joint(each) for each in joints),
        repeated=tuple(f"{tag} {name}" for (tag, name), count in names.items() if count > 1),
        unread=tuple(text for part in parts for text in _unread(part)),
    )


def _unread(part: Xml.Element) -> Iterator[str]:
    """Yield the attributes of a link or joint, in words, that have not their finite numbers."""
    for element in part.iter():
        for key, count in _NUMBERS.items():
            text = element.get(key)
            if text is None or (key == "value" and element.tag != "mass"):
                continue
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError:
                numbers = []
            # Other checks refuse infinite limits and masses.
            bad = math.isnan if count == 1 else _is_not_finite
            if len(numbers) != count or any(bad(number) for number in numbers):
                wanted = "a number" if count == 1 else f"{count} numbers"
                yield (
                    f"expected {wanted}, got {key}={text!r} in <{element.tag}> of {part.tag} "
                    f"{part.get('name')}; correct it in the URDF"
                )


def _is_not_finite(number: float) -> bool:
    return not math.isfinite(number)


def _joint(element: Xml.Element) -> Joint:
    def link(tag: str) -> str:
        found = element.find(tag)
        return "" if found is None else found.get("link", "")

    limit, mimic = element.find("limit"), element.find("mimic")
    return Joint(
        name=element.get("name", ""),
        kind=element.get("type", ""),
        parent=link("parent"),
        child=link("child"),
        effort=_number(limit, "effort", math.nan),
        velocity=_number(limit, "velocity", math.nan),
        lower=_number(limit, "lower"),
        upper=_number(limit, "upper"),
        axis=_axis(element.find("axis")),
        mimics=None if mimic is None else mimic.get("joint", ""),
    )


def _axis(element: Xml.Element | None) -> tuple[float, ...]:
    words = ["1", "0", "0"] if element is None else element.get("xyz", "1 0 0").split()
    try:
        return tuple(float(word) for word in words)
    except ValueError:
        return (math.nan,)


def _number(element: Xml.Element | None, name: str, missing: float = 0.0) -> float:
    text = None if element is None else element.get(name)
    if text is None:
        return missing
    try:
        return float(text)
    except ValueError:
        return math.nan


def numbers(urdf: Urdf) -> Iterator[str]:
    """Yield the attributes that are no finite numbers."""
    yield from urdf.unread


def one_tree(urdf: Urdf) -> Iterator[str]:
    """Yield names that two parts have, and links that make a loop, have no place, or are a second
    root.
    """
    for part in urdf.repeated:
        yield f"expected a name for each link and joint, got {part} twice; rename one of them"
    parents: dict[str, Joint] = {}
    for joint in urdf.joints:
        for link in (joint.parent, joint.child):
            if link not in urdf.masses:
                yield f"expected a link of the URDF, got {link!r} in joint {joint.name}"
        if joint.child in parents:
            yield (
                f"expected a tree, got link {joint.child} below two joints, "
                f"{parents[joint.child].name} and {joint.name}; remove one of them"
            )
        parents[joint.child] = joint
    roots = [link for link in urdf.masses if link not in parents]
    if len(roots) != 1:
        yield (
            f"expected one root link, got {', '.join(roots) or 'a loop of all links'}; "
            "connect the links by joints"
        )
    children: dict[str, list[str]] = {}
    for joint in urdf.joints:
        children.setdefault(joint.parent, []).append(joint.child)
    reached, coming = set[str](), roots[:1]
    while coming:
        link = coming.pop()
        if link not in reached:
            reached.add(link)
            coming += children.get(link, [])
    if len(roots) == 1 and (lost := [link for link in urdf.masses if link not in reached]):
        yield (
            f"expected all links below {roots[0]}, got the links {', '.join(lost)} in a loop of "
            "their own; correct the parents of their joints"
        )


def hinges(urdf: Urdf) -> Iterator[str]:
    """Yield the joints that are no hinges with a range, and the joints that mimic another one."""
    if not urdf.moving:
        yield "expected a URDF with hinges, got fixed joints only"
    for joint in urdf.moving:
        if joint.mimics is not None:
            yield (
                f"expected independent joints, got {joint.name}, which mimics {joint.mimics}; make "
                "it fixed in the URDF"
            )
        elif joint.kind != "revolute":
            yield (
                f"expected hinges with limits, got {joint.name}, which is "
                f"{joint.kind or 'of no type'}; make it revolute with a range, or fixed"
            )
        elif not -math.inf < joint.lower < joint.upper < math.inf:
            yield (
                f"expected a range of angles, got lower {joint.lower:g} and upper {joint.upper:g} "
                f"at joint {joint.name}; write its limits into the URDF [rad]"
            )
        elif not any(joint.axis):
            yield (
                f"expected an axis, got {joint.axis} at joint {joint.name}; write it into the URDF"
            )


def efforts(urdf: Urdf) -> Iterator[str]:
    """Yield the joints without a finite positive limit of torque or velocity."""
    for joint in urdf.moving:
        for name, value, unit in (
            ("effort", joint.effort, "N m"),
            ("velocity", joint.velocity, "rad/s"),
        ):
            if not 0.0 < value < math.inf:
                got = "none" if math.isnan(value) else f"{value:g}"
                yield (
                    f"expected a finite positive {name} limit, got {got} at joint {joint.name}; "
                    f"write that of its motor into the URDF [{unit}]"
                )


def masses(urdf: Urdf) -> Iterator[str]:
    """Yield the links that move by themselves and have no positive mass."""
    for link, mass in urdf.masses.items():
        if mass < 0.0 or math.isnan(mass) or mass == math.inf:
            yield f"expected a finite mass of at least 0, got {mass:g} kg at link {link}"
        if urdf.least_moments[link] < -_ROUNDING:
            yield (
                f"expected moments of inertia of at least 0, got {urdf.least_moments[link]:g} "
                f"kg m² at link {link}; correct its inertia in the URDF"
            )
    for joint in urdf.moving:
        mass = urdf.carried(joint.child)
        if mass == 0.0:
            yield (
                f"expected a mass above 0, got none at link {joint.child}, which joint "
                f"{joint.name} moves; give it an inertial in the URDF, or make the joint fixed"
            )
