"""Of two vehicles of one name the one that an order names has the last word, whichever answers first."""

from __future__ import annotations

import pytest

from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import Refused, ZmavError
from zmav.session import SessionSettings
from zmav.vehicle import Vehicle
from zmav.wire.orders import OTHER

DONE = Answer(
    "zmav/demo/quad1/do/hold", wire.encode(wire.Outcome(verb="hold", status="done", took=0.1, result={"mode": "BRAKE"}))
)
NOT_ME = Refused("the order is for the autopilot 2, and this one is 1", field="uid", value="2", reason=OTHER)


class Scripted(Client):
    """Its questions are answered by what it was made with; the last of them again and again."""

    def __init__(self, *answers: list[Answer | ZmavError]) -> None:
        super().__init__(SessionSettings(), "demo", "ardupilotmega")
        self._script, self.questions = [*answers], 0

    async def ask(self, *_: object, **__: object) -> list[Answer | ZmavError]:
        self.questions += 1
        return self._script.pop(0) if len(self._script) > 1 else self._script[0]

    def present(self, name: str, fleet: str) -> bool:
        return True


async def hold(client: Client) -> dict[str, object]:
    return await Vehicle(client, keys.check_name("quad1"), "demo").order("hold", wire.Order(uid="2"))


@pytest.mark.parametrize(
    "answers", [[[DONE, NOT_ME]], [[NOT_ME, DONE]], [[NOT_ME], [DONE]], [[NOT_ME], [], [NOT_ME, DONE]]]
)
async def test_the_answer_of_the_one_that_is_meant_wins(answers: list[list[Answer | ZmavError]]) -> None:
    assert await hold(Scripted(*answers)) == {"mode": "BRAKE"}


async def test_the_others_refusal_stands_where_nobody_else_answers() -> None:
    client = Scripted([NOT_ME])
    with pytest.raises(Refused, match="the order is for the autopilot 2"):
        await hold(client)
    assert client.questions > 1, "the one that is meant may not have been found yet"


async def test_a_refusal_by_the_one_that_is_meant_wins_too() -> None:
    low = Refused("its battery is low")
    with pytest.raises(Refused, match="battery"):
        await hold(Scripted([low, NOT_ME]))
