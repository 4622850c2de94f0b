"""Everything that the page shows exists in Chinese too."""

import re
from enum import Enum
from pathlib import Path

import msgspec
import pytest

import gateway.desk
import schemas
from gateway.client.fleet import WORDS
from gateway.client.refusal import state_line
from gateway.desk.fleet_view import reasons_in_words
from schemas.decisions import ArbiterState, EventKind, StopPhase
from schemas.messages import BrakingStatus, GearPosition, Mode, ParkingStatus
from schemas.reasons import OF_A_ROBOT, TEXTS, Reason
from schemas.recording import RecorderState
from tests.support.messages import STANDBY
from tests.support.rigs.scenarios import Scenario, acted, deadman, front_bumper, guard_acts, hand_transmitter

PLACE = Path(gateway.desk.__file__).parent / "page"
PAGE = (Path(schemas.__file__).parent / "page" / "words.js").read_text("utf-8")
ENGLISH, CHINESE = re.findall(r"^const (?:EN|ZH) = \{\n(.*?)^\};$", PAGE, flags=re.DOTALL | re.MULTILINE)
HAN = re.compile(r"[\u4e00-\u9fff]")


def table(name: str) -> str:
    [rows] = re.findall(rf"^  {name}: [{{\[]\n(.*?)^  [}}\]],$", CHINESE, flags=re.DOTALL | re.MULTILINE)
    return str(rows)


def texts(language: str) -> dict[str, str]:
    return dict(re.findall(r"\b(\w+): \"([^\"]*)\"", language.partition("  word: {")[0]))


def reasons(name: str) -> dict[str, tuple[str, str]]:
    """Return meaning and cure of the reasons in a table."""
    return {one: (means, cure) for one, means, cure in re.findall(r'(\w+): \["([^"]*)", "([^"]*)"\]', table(name))}


def sentences() -> dict[str, list[re.Pattern[str]]]:
    """Return the known sentences by kind of event."""
    kinds = re.split(r"^    (\w+): ", table("event"), flags=re.MULTILINE)[1:]
    patterns = ([re.compile(one) for one in re.findall(r"\[/(.*?)/, \"", rows)] for rows in kinds[1::2])
    return dict(zip(kinds[::2], patterns, strict=True))


def test_every_reason_has_a_meaning_and_a_cure_in_chinese() -> None:
    assert reasons("reason").keys() == {reason.value for reason in Reason}
    assert reasons("of_robot").keys() == {one.value for one in Reason if OF_A_ROBOT[one] != TEXTS[one]}
    for name in ("reason", "of_robot"):
        for reason, (means, cure) in reasons(name).items():
            assert HAN.search(means)
            assert bool(HAN.search(cure)) == bool(TEXTS[Reason(reason)].cure), reason


def test_a_cure_in_chinese_names_the_same_buttons() -> None:
    buttons = {"press Reset": texts(CHINESE)["reset"], "Take control": texts(CHINESE)["take_control"]}
    cures = reasons("reason")
    for reason, (_, cure) in reasons_in_words().items():
        for english, chinese in buttons.items():
            assert english not in cure or f"“{chinese}”" in cures[reason][1], (reason, chinese)


def test_every_kind_of_event_has_a_sentence_in_chinese() -> None:
    assert sentences().keys() == {kind.value for kind in EventKind}
    assert all(sentences().values())


@pytest.mark.parametrize("scenario", [deadman, front_bumper, guard_acts, hand_transmitter])
def test_what_a_robot_reports_is_a_sentence_that_is_known(scenario: Scenario) -> None:
    known = [pattern for patterns in sentences().values() for pattern in patterns]
    meanings = {text.means for text in TEXTS.values()}
    events = acted(scenario).events
    assert events
    for event in events:
        assert event.text in meanings or any(pattern.fullmatch(event.text) for pattern in known), event


def test_a_stop_in_a_robot_s_row_is_a_sentence_that_is_known() -> None:
    """Phase, cause and figures, each with and without figures."""
    known = [re.compile(one) for one in re.findall(r"\[/(.*?)/, \"", table("said"))]
    detail = "an earlier stop could not be carried out"
    stop = {"stop_reason": Reason.FOUND_MOVING, "lease_holder": ""}
    last = msgspec.structs.replace(STANDBY, stop_detail=detail, **stop)
    assert f"last stop: uncommanded motion ({detail})" in state_line(last).split("; ")
    for phase in StopPhase:
        for figures in ("", detail):
            state = ArbiterState.STANDBY if phase is StopPhase.IDLE else ArbiterState.STOPPING
            changed = {"state": state, "stop_phase": phase, "stop_detail": figures, **stop}
            _, *parts = state_line(msgspec.structs.replace(STANDBY, **changed)).split("; ")
            assert all(any(one.fullmatch(part) for one in known) for part in parts), parts


def test_every_word_and_value_is_there_in_chinese() -> None:
    words, values = (table(name) for name in ("word", "value"))
    assert set(re.findall(r"(\w+): \"", words)) == WORDS.keys()
    kinds: list[type[Enum]] = [Mode, GearPosition, BrakingStatus, ParkingStatus, RecorderState]
    assert {one.value for kind in kinds for one in kind} <= set(re.findall(r"(\w+): \"", values))
    assert texts(CHINESE).keys() == texts(ENGLISH).keys()


def test_each_error_of_the_page_is_a_sentence_in_chinese() -> None:
    known = [re.compile(one) for one in re.findall(r"\[/(.*?)/, \"", table("said"))]
    scripts = [path.read_text("utf-8") for path in PLACE.glob("*.js") if path.name != "words.js"]
    thrown = [text for script in scripts for _, text in re.findall(r"new Error\(([\"`])(.*?)\1\)", script)]
    assert len(thrown) >= 10
    for text in thrown:
        assert any(pattern.fullmatch(re.sub(r"\$\{.*?\}", "cruiser", text)) for pattern in known), text
