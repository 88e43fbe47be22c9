"""What may be said of an endpoint, and what is said of what may not."""

from __future__ import annotations

from typing import Any

import pytest

from ground.gcs.options import Options, parse_endpoint, read_rate
from zmav.errors import BadConfig


def test_an_endpoint_is_on_loopback_unless_its_host_is_written_out() -> None:
    end = parse_endpoint("tcp", "5760", Options())
    assert (end.host, end.port, str(end)) == ("127.0.0.1", 5760, "tcp 127.0.0.1:5760")
    assert parse_endpoint("udpin", "0.0.0.0:14550", Options()).host == "0.0.0.0"
    assert str(parse_endpoint("udp", "[::1]:14550", Options())) == "udp [::1]:14550"
    assert parse_endpoint("serial", "/dev/ttyUSB0,57600?rate=4kB/s", Options()).text == "/dev/ttyUSB0,57600"


def test_options_go_before_the_defaults() -> None:
    defaults = Options(rate=500.0)
    text = "5760?rate=4kB/s&vehicles=quad*,rover1&read_only=1"
    options = parse_endpoint("tcp", text, defaults).options
    assert options == Options(
        rate=4000.0,
        vehicles=("quad*", "rover1"),
        read_only=True,
    )
    assert options.sees("quad7") and not options.sees("rover2")


def test_a_rate_is_read_as_a_budget_is_with_a_least_of_its_own() -> None:
    rates = {"100 B/s": 100.0, "4kB/s": 4000.0, "57600 bit/s": 7200.0, " 0.5 MB/s ": 5e5}
    assert {text: read_rate(text) for text in rates} == rates
    with pytest.raises(BadConfig, match="100 B/s at least"):
        read_rate("99 B/s")


@pytest.mark.parametrize(
    ("kind", "text", "field", "words"),
    [
        ("tcp", "99999", "tcp", "1 to 65535"),
        ("udp", "0", "udp", "1 to 65535"),
        ("tcp", "host:", "tcp", "PORT"),
        ("serial", "?rate=4kB/s", "serial", "/dev/ttyUSB0"),
        ("tcp", "5760?rte=4kB/s", "option", "did you mean rate?"),
        ("tcp", "5760?rate=1kB/s&rate=2kB/s", "option", "each once"),
        ("tcp", "5760?rate=fast", "rate", "4kB/s"),
        ("tcp", "5760?rate=4", "rate", "4kB/s"),
        ("tcp", "5760?rate=5B/s", "rate", "100 B/s at least"),
        ("tcp", "5760?vehicles=Quad", "vehicles", "lower-case"),
        ("tcp", "5760?read_only=yes", "read_only", "0 or 1"),
    ],
)
def test_bad_ones_name_the_field_and_what_was_expected(kind: Any, text: str, field: str, words: str) -> None:
    with pytest.raises(BadConfig) as caught:
        parse_endpoint(kind, text, Options())
    assert caught.value.detail["field"] == field and words in str(caught.value)
