"""What may be written as a source, and what is refused, with the reason and without the password."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground.rtk.options import (
    PASSWORD,
    Caster,
    Fixed,
    Receiver,
    Recording,
    Survey,
    parse_place,
    parse_source,
    parse_survey,
)
from ground.rtk.program import RtkSettings, check
from zmav.errors import BadInput, BadUrl

pytestmark = pytest.mark.unit
CASTER = Caster(host="caster.example", port=2101, mountpoint="BASE")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("ntrip://caster.example/BASE", CASTER),
        ("ntrip://me:pa%40ss@caster.example:2102/B?version=1", None),
        ("ntrips://caster.example/BASE", None),
        ("/dev/ttyACM0", Receiver("serial:/dev/ttyACM0:115200")),
        ("/dev/ttyUSB0,57600", Receiver("serial:/dev/ttyUSB0:57600")),
        ("tcp:10.0.0.5:2102", Receiver("tcp:10.0.0.5:2102")),
    ],
)
def test_sources(text: str, wanted: object) -> None:
    found = parse_source(text, {})
    if wanted is not None:
        assert found == wanted
    elif "version" in text:
        assert isinstance(found, Caster)
        assert (found.user, found.password, found.port, found.version) == ("me", "pa@ss", 2102, "1.0")
        assert "pa@ss" not in found.words
    else:
        assert isinstance(found, Caster)
        assert (found.tls, found.port) == (True, 443)


def test_the_password_may_come_from_the_environment() -> None:
    found = parse_source("ntrip://me@caster.example/BASE", {PASSWORD: "quiet"})
    assert isinstance(found, Caster)
    assert found.password == "quiet"


def test_a_file(tmp_path: Path) -> None:
    path = tmp_path / "base.rtcm"
    path.write_bytes(b"x")
    assert parse_source(str(path), {}) == Recording(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nowhere",
        "udpout:1.2.3.4:5",
        "replay:x.tlog",
        "ntrip://",
        "ntrip:///BASE",
        "ntrip:me:secret@host/BASE",
        "ntrip://me:secret/@host/BASE",
        "ntrip://me:1/secret@host/BASE",
        "ntrip://me:1/secret@host",
        "ntrip://me:secret@host:port/BASE",
        "ntrip://me:secret@host/A/B",
        "ntrip://me:secret@host/A%0d%0aX: y",
        "ntrip://me:secret@host/BASE?version=3",
        "ntrip://me:secret@host/BASE?colour=red",
        "ntrip://me:secret@host/BASE?ca=/nowhere.pem",
        "ntrip://me:1?secret=2@host/BASE",
        "ntrip://me:1?version=secret@host/BASE",
        "ntrip://me:1#secret@host/BASE",
        "ntrip://me:secret%40host/BASE",
        "NTRIP://me:secret@host/BASE",
        "nrtip://me:secret@host/BASE",
        "ntrip//me:secret@host/BASE",
        "ntrip//secret@host/BASE",
        "secret@host:2101/BASE",
        "me:secret@host:2101",
        "tcp:me:secret@host:2101",
        "udpout:me:secret@host:2101",
    ],
)
def test_others_are_refused_without_the_password(text: str) -> None:
    with pytest.raises(BadUrl) as error:
        parse_source(text, {})
    assert "secret" not in str(error.value) + str(error.value.detail)
    assert error.value.__suppress_context__ or error.value.__context__ is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ntrip:me:12@host/BASE", "ntrip:…@host/BASE: no host after //"),
        ("ntrip:///BASE", "ntrip:///BASE: no host after //"),
        ("ntrip://me:1/2@host/BASE", "ntrip://…@host/BASE: in a name or a password / is written %2F, ? %3F, # %23"),
        ("ntrip://me:x/2@host/BASE", "in a name or a password / is written %2F, ? %3F, # %23"),
        ("ntrip://me:1?x=2@host/BASE", "ntrip://…@host/BASE: in a name or a password / is written %2F, ? %3F, # %23"),
        ("ntrip://me:12#34@host/BASE", "ntrip://…@host/BASE: in a name or a password / is written %2F, ? %3F, # %23"),
        ("ntrip://host/BASE#1", "ntrip://host/BASE#1: in a name or a password / is written %2F, ? %3F, # %23"),
        ("nrtip://me:12@host/BASE", "no source of corrections 'nrtip://…@host/BASE'"),
    ],
)
def test_what_is_wrong_with_a_url_is_said(text: str, says: str) -> None:
    with pytest.raises(BadUrl) as error:
        parse_source(text, {})
    assert says in str(error.value)


def test_surveys_and_places() -> None:
    assert parse_survey("120,1.5") == Survey(120, 1.5)
    assert parse_survey("60") == Survey(60, 2.0)
    assert parse_place("50.123456789,8.5,152.341") == Fixed(50.123456789, 8.5, 152.341)
    for wrong in ("", "0,1", "60,0", "x", "60,y", "1e9,1"):
        with pytest.raises(BadInput):
            parse_survey(wrong)
    for wrong in ("", "1,2", "91,0,0", "0,181,0", "0,0,99999", "nan,0,0", "a,b,c"):
        with pytest.raises(BadInput):
            parse_place(wrong)


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        (RtkSettings(where=Receiver("tcp:h:1"), name="g", rover="quad1"), "gga"),
        (RtkSettings(where=CASTER, name="g", base=Survey(60, 2.0)), "survey"),
        (RtkSettings(where=Recording(Path("x")), name="g", base=Fixed(0.0, 0.0, 0.0)), "at"),
        (RtkSettings(where=Receiver("tcp:h:1"), name="g", port="USB"), "port"),
    ],
)
def test_options_that_do_not_go_with_the_source(settings: RtkSettings, field: str) -> None:
    with pytest.raises(BadInput) as error:
        check(settings)
    assert error.value.detail["field"] == field
