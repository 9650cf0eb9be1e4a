"""What SUMO is given: options of configurations, and copies of files without what writes or reads others."""

from __future__ import annotations

import contextlib
import gzip
import io
from pathlib import Path

import pytest
from damages import DAMAGE, damaged
from hypothesis import given, settings
from hypothesis import strategies as st
from mast_datasets import SumoTrace, SumoTraffic, sumo_simulation
from mast_datasets.sumo_simulation import copy_input, read_configuration
from sumo_network import vehicle, write_network

from mast_zenoh.config.registry import parse_scene, recognised
from mast_zenoh.errors import SceneError


def copied(path: Path) -> str:
    target = io.BytesIO()
    copy_input(path, target)
    return target.getvalue().decode()


def xml(tmp_path: Path, content: str, name: str = "some.add.xml") -> Path:
    path = tmp_path / name
    path.write_text(content)
    return path


def test_a_configuration_names_its_files_and_the_options_of_the_traffic_alone(tmp_path: Path) -> None:
    written = '<output><fcd-output value="/nowhere/fcd.xml"/></output><report><log value="log.txt"/></report>'
    processing = '<processing><step-length value="1"/><collision.action value="teleport"/></processing>'
    options = '<time><begin value="30"/><end value="90"/></time><scale value="0.5"/>' + written + processing
    path = write_network(tmp_path, options=options)
    inputs = read_configuration(path)
    assert inputs.net == tmp_path / "crossing.net.xml"
    assert inputs.files == (tmp_path / "crossing.net.xml", tmp_path / "crossing.rou.xml")
    assert (inputs.begin_s, inputs.options) == (30.0, {"begin": "30", "scale": "0.5"})
    assert set(SumoTraffic(path=str(path)).inputs()) >= {path, *inputs.files}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("<routes/>", "line 1: <routes>: found this root, expected <configuration> or <sumoConfiguration>"),
        ("<configuration/>", "found 0 files in net-file, expected one"),
        ('<configuration><net-file value="a,b"/></configuration>', "found 2 files in net-file, expected one"),
        ('<configuration>\n<lateral-resolution value="0.8"/></configuration>', "line 2: .*sublanes"),
        ('<configuration><begn value="1"/></configuration>', "option begn is not supported; did you mean 'begin'?"),
        ('<configuration><begin value="-1"/></configuration>', "begin>.value: found '-1', expected `float` >= 0"),
        ('<configuration><scale value="&#10;"/></configuration>', "scale>.value: found '\\\\n', expected 1 to 200"),
        ('<configuration><scale value="1e9"/></configuration>', "scale>.value: found '1e9', expected .* <= 1000"),
        ("<configuration><input><net-file/></input></configuration>", "<input>.net-file: found '', expected an object"),
        ("<configuration>", "not XML: no element found"),
        ("<!DOCTYPE a><configuration/>", "document type"),
    ],
)
def test_an_invalid_configuration_is_refused_by_line_and_option(tmp_path: Path, content: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem) as raised:
        read_configuration(xml(tmp_path, content, "bad.sumocfg"))
    assert str(raised.value).startswith(f"{tmp_path}/bad.sumocfg: ")


def test_elements_stay_in_their_lines(tmp_path: Path) -> None:
    content = '<?xml version="1.0"?>\n<!-- a\ncomment -->\n<routes>\n\n<route id="a&lt;b" edges="x\ny"/>\n</routes>'
    path = xml(tmp_path, content)
    assert copied(path).splitlines()[3:] == ["<additional>", "", '<route id="a&lt;b" edges="x y"></route></additional>']


def test_what_measures_writes_or_draws_is_left_out(tmp_path: Path) -> None:
    path = xml(
        tmp_path,
        '<additional><e1Detector id="d" lane="l" file="/nowhere/out.xml"><param key="a" value="b"/></e1Detector>'
        '<poly id="p" shape="0,0 1,1"/><timedEvent type="SaveTLSStates" dest="/nowhere/x"/>'
        '<vType id="t" color="red" imgFile="/nowhere/x.png"><param key="device.ssm.file" value="/nowhere/s"/></vType>'
        '<tlLogic id="l" type="actuated"><param key="max-gap" value="3"/><param key="File" value="/nowhere/t"/>'
        "</tlLogic></additional>",
    )
    assert copied(path) == (
        '<additional><vType id="t"></vType><tlLogic id="l" type="actuated"><param key="max-gap" value="3"></param>'
        "</tlLogic></additional>"
    )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ('<additional>\n<include href="/etc/passwd"/></additional>', "line 2: <include>: this element is not supp"),
        ('<additional>\n<rerouter id="a" file="/etc/x"/></additional>', "line 2: <rerouter>: file names a file"),
        ("<additional><vehicel/></additional>", "<vehicel>: this element is not supported; did you mean 'vehicle'?"),
        ('<routes>\n<vType id="nan" length="NaN"/></routes>', "line 2: <vType>: length: found 'NaN', expected a"),
        ('<routes><vehicle departPos="1e999"/></routes>', "<vehicle>: departPos: found '1e999', expected a finite"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "line 1: found a document type declaration"),
        ("<additional>" + "<stop>" * 30, "<stop>: found more than 20 nested elements"),
        ("<additional><stop></additional>", "line 1: not XML: mismatched tag"),
        ("", "not XML: no element found"),
        ("\x00\x01", "not XML"),
    ],
)
def test_what_is_unknown_or_names_a_file_is_refused(tmp_path: Path, content: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem) as raised:
        copied(xml(tmp_path, content))
    assert str(raised.value).startswith(f"{tmp_path}/some.add.xml: ")


def test_a_file_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sumo_simulation, "MAX_BYTES", 1_000_000)
    path = tmp_path / "bomb.rou.xml.gz"
    path.write_bytes(gzip.compress(b"<routes>" + b" " * 2_000_000 + b"</routes>"))
    with pytest.raises(SceneError, match=r"found more than 1000000 bytes unpacked"):
        copied(path)


@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_copied_as_xml_or_refused(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    write_network(folder, traffic=vehicle("a", "eastward", 0, 0))
    path = data.draw(st.sampled_from(sorted(folder.iterdir())))
    path.write_bytes(damaged(path.read_bytes(), data.draw(DAMAGE)))
    with contextlib.suppress(SceneError):
        if path.suffix == ".sumocfg":
            read_configuration(path)
        else:
            again = xml(folder, copied(path), "again.xml")
            assert copied(again) == copied(path)


def test_one_short_name_means_traces_and_configurations(tmp_path: Path) -> None:
    path = write_network(tmp_path / "net")
    assert recognised(str(path)) == f"sumo:{path}"
    assert parse_scene(f"sumo:{path}") == {"type": "SumoTraffic", "path": str(path)}
    assert parse_scene(f"sumo:{path.parent}")["type"] == "SumoTraffic"
    assert parse_scene("sumo:town.sumocfg")["type"] == "SumoTraffic"
    assert parse_scene("sumo:fcd.xml.gz")["type"] == "SumoTrace"
    (path.parent / "fcd.xml").write_text("<fcd-export/>")
    assert parse_scene(f"sumo:{path.parent}")["type"] == "SumoTrace"
    assert SumoTrace.recognises(path.parent)


def test_a_missing_configuration_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=f"{tmp_path}/nowhere: no such file or folder"):
        SumoTraffic(path=str(tmp_path / "nowhere")).record(0, None)
    with pytest.raises(SceneError, match=r"found 0 configurations of SUMO \(none\), expected one"):
        SumoTraffic(path=str(tmp_path)).record(0, None)
