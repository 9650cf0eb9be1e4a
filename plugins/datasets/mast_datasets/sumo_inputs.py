"""What SUMO is given to simulate: the options of a configuration, and copies of its files without anything that writes.

SUMO parses with entities, follows includes, and writes files that its inputs name. So it never opens a user's file: it
reads copies that hold known elements alone, with the line numbers of their originals.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import quoteattr
from xml.sax.xmlreader import AttributesImpl

from mast_datasets.xml_files import XmlElement, XmlHandler, read_xml
from mast_zenoh.errors import SceneError, nearest

#: Roots of configurations.
ROOTS = ("configuration", "sumoConfiguration")
#: Bytes of one file, unpacked.
MAX_BYTES = 200_000_000
_MAX_FILES = 100
_MAX_VALUE = 200  # characters of an option
_MAX_DEPTH = 20
_MAX_SCALE = 1000.0  # of the demand: SUMO prepares each vehicle that waits
_SECTIONS_LEFT_OUT = ("output", "report", "gui_only")
_FILES = {"net-file": "net", "route-files": "routes", "additional-files": "additional"}
#: Options that decide about the traffic.
_PASSED = """begin scale max-depart-delay route-steps extrapolate-departpos eager-insert sloppy-insert
random-depart-offset ignore-route-errors ignore-accidents ignore-junction-blocker default.carfollowmodel
default.speeddev default.emergencydecel time-to-impatience pedestrian.model junction-taz routing-algorithm
weights.random-factor tls.actuated.jam-threshold tls.actuated.detector-length device.rerouting.probability
device.rerouting.period device.rerouting.adaptation-interval device.rerouting.adaptation-steps
step-method.ballistic"""
#: Options that are switched off by 0 or less, and what they switch on, which is not supported.
_NOT_SUPPORTED = {
    "lateral-resolution": "sublanes",
    "lanechange.duration": "gradual changes of lanes",
    "default.action-step-length": "steps without an action",
}
#: Beginnings of options that the scene sets itself, or that decide about messages and pictures.
_OWN = ("end", "step-length", "seed", "random", "time-to-teleport", "collision.", "xml-validation", "no-", "verbose")
#: Elements that are copied, of all kinds of files: SUMO does not tell them apart either.
_COPIED = """location type restriction edge lane neigh stopOffset junction request connection roundabout prohibition
tlLogic phase param WAUT wautSwitch wautJunction vTypeDistribution vType routeDistribution route vehicle trip flow stop
interval carFollowing-Krauss carFollowing-KraussOrig1 carFollowing-PWagner2009 carFollowing-BKerner carFollowing-IDM
carFollowing-IDMM carFollowing-EIDM carFollowing-Wiedemann carFollowing-W99 carFollowing-ACC carFollowing-CACC person
personFlow personTrip walk ride busStop trainStop containerStop access parkingArea space taz tazSource tazSink
variableSpeedSign step rerouter closingReroute closingLaneReroute destProbReroute routeProbReroute parkingAreaReroute"""
#: Elements that only measure, write or draw.
_LEFT_OUT = """poly poi inductionLoop e1Detector instantInductionLoop laneAreaDetector e2Detector entryExitDetector
e3Detector detEntry detExit edgeData laneData edgeRelation timedEvent routeProbe"""
_OPTIONS, _ELEMENTS, _SILENT = (frozenset(words.split()) for words in (_PASSED, _COPIED, _LEFT_OUT))
#: Attributes that name files, and those of pictures.
_NAME_FILES = ("file", "href", "output", "dest")
_OF_PICTURES = ("imgFile", "osgFile", "color", "guiShape")
#: Attributes that are numbers; SUMO takes "nan" and "inf" for numbers, too.
_NUMERIC = """length width height minGap minGapLat maxSpeed maxSpeedLat accel decel emergencyDecel apparentDecel sigma
tau speedFactor speedDev impatience depart departPos departSpeed arrivalPos arrivalSpeed begin end period probability
vehsPerHour speed startPos endPos pos duration minDur maxDur offset"""
_NUMBERS = frozenset(_NUMERIC.split())


@dataclass(frozen=True)
class SumoInputs:
    """A configuration of SUMO.

    path:    of the configuration;  begin_s: s, of the simulation
    options: that decide about the traffic, by name without dashes
    net, routes, additional: files, in the order of the configuration
    """

    path: Path
    begin_s: float
    options: Mapping[str, str]
    net: Path
    routes: Sequence[Path]
    additional: Sequence[Path]

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that SUMO reads copies of."""
        return (self.net, *self.routes, *self.additional)


def read_configuration(path: Path) -> SumoInputs:
    """The configuration in a file of SUMO (.sumocfg).

    Raises SceneError, with file, line and reason, for a file that is none, and for an option that is not supported.
    """
    options: dict[str, str] = {}
    files: dict[str, list[Path]] = {kind: [] for kind in _FILES.values()}
    begin_s = 0.0
    for option in _options(path):
        name = option.tag
        if name in _FILES:
            text = option.attribute("value").text()
            files[_FILES[name]] += [path.parent / part for part in text.replace(",", " ").split()]
        elif name in _OPTIONS:
            value = option.attribute("value")
            if not 0 < len(value.text()) <= _MAX_VALUE or not value.text().isprintable():
                value.fail(f"1 to {_MAX_VALUE} characters")
            if name == "begin":
                begin_s = value.number(0.0, 1e7)
            if name == "scale":
                value.number(0.0, _MAX_SCALE)
            options[name] = value.text()
        elif name in _NOT_SUPPORTED:
            if option.attribute("value").number(-1e7, 1e7) > 0.0:
                option.fail(f"not supported: {_NOT_SUPPORTED[name]} ({name}), expected a configuration without them")
        elif not name.startswith(_OWN):
            misspelt = difflib.get_close_matches(name, _OPTIONS, 1, cutoff=0.8)  # a name far from all is another option
            option.fail(f"option {name} is not supported{nearest(name, _OPTIONS) if misspelt else ''}")
    if len(files["net"]) != 1:
        raise SceneError(f"{path}: found {len(files['net'])} files in net-file, expected one")
    if sum(map(len, files.values())) > _MAX_FILES:
        raise SceneError(f"{path}: found more than {_MAX_FILES} files, expected at most as many")
    return SumoInputs(path, begin_s, options, files["net"][0], files["routes"], files["additional"])


def _options(path: Path) -> Iterator[XmlElement]:
    """The options of a configuration, whether they are in sections or not."""
    elements = read_xml(path, None, None, 1_000_000)
    root = next(elements)
    if root.tag not in ROOTS:
        root.fail(f"found this root, expected <{'> or <'.join(ROOTS)}>")
    for element in elements:
        if "value" in element.attributes:
            yield element
        elif element.tag not in _SECTIONS_LEFT_OUT:
            yield from element.children


def copy_input(path: Path, target: BinaryIO) -> None:
    """Write a copy of a file of a network, of routes or of additional objects, with known elements alone.

    Elements that measure, write or draw are left out, and so are parameters outside of traffic lights. Raises
    SceneError, with file, line and reason, for a file that is no XML or is too large, and for any other element.
    """
    for _ in _ElementCopy(path, target).parse(MAX_BYTES):
        pass
    target.flush()


def _is_finite(text: str) -> bool:
    """Whether a text is a finite number, or none, such as "random": then SUMO judges it."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return True


class _ElementCopy(XmlHandler):
    """Writes the elements that it is given by a parser, if they are known."""

    def __init__(self, path: Path, target: BinaryIO) -> None:
        super().__init__(path)
        self._target = target
        self._open: list[str] = []
        self._left_out = 0  # open elements that are left out
        self._written = 1  # lines

    def startElement(self, tag: str, attrs: AttributesImpl) -> None:
        attributes: Mapping[str, str] = dict(attrs.items())
        if self._left_out or tag in _SILENT or (tag == "param" and not self._is_of_lights(attributes)):
            self._left_out += 1
            return
        if len(self._open) >= _MAX_DEPTH:
            self._fail(tag, f"found more than {_MAX_DEPTH} nested elements, expected at most as many")
        if not self._open:
            tag = tag if tag == "net" else "additional"
            attributes = attributes if tag == "net" else {}
        elif tag not in _ELEMENTS:
            self._fail(tag, f"this element is not supported{nearest(tag, _ELEMENTS)}")
        for name in _NAME_FILES:
            if name in attributes:
                self._fail(tag, f"{name} names a file, expected none: SUMO may not read or write others")
        for name in attributes.keys() & _NUMBERS:
            if not _is_finite(attributes[name]):
                self._fail(tag, f"{name}: found {attributes[name]!r}, expected a finite number")
        self._open.append(tag)
        lines = self.line - self._written
        self._written += lines
        values = [
            f" {name}={quoteattr(value)}"
            for name, value in attributes.items()
            if ":" not in name and not name.startswith("xmlns") and name not in _OF_PICTURES
        ]
        self._target.write(("\n" * lines + f"<{tag}{''.join(values)}>").encode())

    def _is_of_lights(self, attributes: Mapping[str, str]) -> bool:
        """Whether a parameter is one of a traffic light that names no file."""
        return bool(self._open) and self._open[-1] == "tlLogic" and "file" not in attributes.get("key", "").lower()

    def endElement(self, tag: str) -> None:
        if self._left_out:
            self._left_out -= 1
            return
        self._target.write(f"</{self._open.pop()}>".encode())

    def _fail(self, tag: str, reason: str) -> None:
        raise SceneError(f"{self.path}: line {self.line}: <{tag}>: {reason}")
