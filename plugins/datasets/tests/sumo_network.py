"""Writes small networks of SUMO: two one-way streets that cross, with right of way or with lights."""

from __future__ import annotations

import math
from pathlib import Path

#: m, from the crossing to the ends of the streets.
REACH = 600


def write_network(folder: Path, lights: str = "", traffic: str = "", options: str = "") -> Path:
    """Write crossing.sumocfg and its files; returns its path.

    The street from west to east has the right of way over that from south to north, unless there are lights.
    lights:  phases of the traffic light, such as '<phase duration="1000" state="rG"/>': south first; "": none
    traffic: elements of the file of routes, in which the routes "eastward" and "northward" exist
    options: elements of the configuration
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "crossing.net.xml").write_text(_network(lights))
    (folder / "crossing.rou.xml").write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<routes>
    <vType id="steady" vClass="passenger" length="4.5" width="1.8" sigma="0" speedFactor="1" speedDev="0"/>
    <route id="eastward" edges="west east"/>
    <route id="northward" edges="south north"/>
{traffic}
</routes>
"""
    )
    path = folder / "crossing.sumocfg"
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<configuration>
    <input>
        <net-file value="crossing.net.xml"/>
        <route-files value="crossing.rou.xml"/>
    </input>
    {options}
</configuration>
"""
    )
    return path


def vehicle(name: str, route: str, depart_s: float, at_m: float, speed: float = 10.0) -> str:
    """A car that begins `at_m` m along its route, when it departs."""
    return (
        f'<vehicle id="{name}" type="steady" route="{route}" depart="{depart_s:g}" departPos="{at_m:g}" '
        f'departSpeed="{speed:g}"/>'
    )


def _network(lights: str) -> str:
    light = ' tl="C" linkIndex="{}"' if lights else ""
    kind, states = ("traffic_light", ("o", "o")) if lights else ("priority", ("m", "M"))
    logic = f'<tlLogic id="C" type="static" programID="0" offset="0">{lights}</tlLogic>' if lights else ""
    far, near = REACH, 4

    def edge(name: str, ends: str, begin: tuple[int, int], end: tuple[int, int]) -> str:
        shape = f"{begin[0]},{begin[1]} {end[0]},{end[1]}"
        lane = f'<lane id="{name}_0" index="0" speed="13.89" length="{math.dist(begin, end):g}" shape="{shape}"/>'
        return f"""<edge id="{name}" {ends or 'function="internal"'}>{lane}</edge>"""

    return f"""<?xml version="1.0" encoding="UTF-8"?>
<net version="1.20" junctionCornerDetail="5" limitTurnSpeed="5.50">
    <location netOffset="0.00,0.00" convBoundary="-{far},-{far},{far},{far}" origBoundary="0,0,0,0" projParameter="!"/>
    {edge(":C_0", "", (0, -near), (0, near))}
    {edge(":C_1", "", (-near, 0), (near, 0))}
    {edge("south", 'from="S" to="C" priority="1"', (0, -far), (0, -near))}
    {edge("north", 'from="C" to="N" priority="1"', (0, near), (0, far))}
    {edge("west", 'from="W" to="C" priority="3"', (-far, 0), (-near, 0))}
    {edge("east", 'from="C" to="E" priority="3"', (near, 0), (far, 0))}
    {logic}
    <junction id="C" type="{kind}" x="0" y="0" incLanes="south_0 west_0" intLanes=":C_0_0 :C_1_0"
              shape="-{near},-{near} {near},-{near} {near},{near} -{near},{near}">
        <request index="0" response="{"00" if lights else "10"}" foes="10" cont="0"/>
        <request index="1" response="00" foes="01" cont="0"/>
    </junction>
    <junction id="S" type="dead_end" x="0" y="-{far}" incLanes="" intLanes="" shape="0,-{far} 1,-{far}"/>
    <junction id="W" type="dead_end" x="-{far}" y="0" incLanes="" intLanes="" shape="-{far},0 -{far},1"/>
    <junction id="N" type="dead_end" x="0" y="{far}" incLanes="north_0" intLanes="" shape="0,{far} 1,{far}"/>
    <junction id="E" type="dead_end" x="{far}" y="0" incLanes="east_0" intLanes="" shape="{far},0 {far},1"/>
    <connection from="south" to="north" fromLane="0" toLane="0" via=":C_0_0" dir="s"
                state="{states[0]}"{light.format(0)}/>
    <connection from="west" to="east" fromLane="0" toLane="0" via=":C_1_0" dir="s"
                state="{states[1]}"{light.format(1)}/>
    <connection from=":C_0" to="north" fromLane="0" toLane="0" dir="s" state="M"/>
    <connection from=":C_1" to="east" fromLane="0" toLane="0" dir="s" state="M"/>
</net>
"""
