"""Settings, from wherever they come."""

import re
import string
import tomllib

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from schemas.command_line import GONE_SETTINGS, CommandError, ExitCode
from schemas.configuration import (
    SETTINGS,
    TomlSource,
    merge,
    to_toml,
)
from schemas.settings import (
    DOWNSAMPLING,
    NEEDED_FEEDBACK,
    OPERATOR,
    PROFILES,
    CanSettings,
    RecorderSettings,
    RobotSettings,
    Settings,
    ZenohSettings,
    zenoh_rules,
)

TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
OPTIONS = st.dictionaries(
    TEXTS, TEXTS | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.booleans()
)


def merged(
    text: str = "", environ: dict[str, str] | None = None, flags: dict[str, object] | None = None
) -> Settings:
    return merge(TomlSource("robot.toml", text), environ or {}, flags or {})


def problem(text: str = "", environ: dict[str, str] | None = None, flags: dict[str, object] | None = None) -> str:
    with pytest.raises(CommandError) as caught:
        merged(text, environ, flags)
    assert caught.value.code is ExitCode.USAGE
    message = str(caught.value)
    assert message.isprintable()
    return message


def test_a_flag_wins_over_the_environment_and_that_over_the_file() -> None:
    text = '[can]\nchannel = "file"\nbus = "file"\ninterface = "file"\n'
    settings = merged(text, {"CRUISER_CAN_BUS": "env", "CRUISER_CAN_INTERFACE": "env"}, {"can.interface": "flag"})
    assert settings.can == CanSettings(interface="flag", channel="file", bus="env")


def test_which_zenoh_settings_a_source_gave_is_known() -> None:
    assert merged().zenoh.given == frozenset()
    settings = merged("[zenoh]\nmode = 'peer'\n", {"CRUISER_ZENOH_LEASE_MS": "1000"}, {"zenoh.listen": []})
    assert settings.zenoh.given == {"mode", "lease_ms", "listen"}


def _complaint(text: str, environ: dict[str, str]) -> str:
    try:
        merged(text, environ)
    except CommandError as error:
        return str(error)
    return "right"


@pytest.mark.parametrize(
    ("variable", "text", "key", "value"),
    [
        ("CRUISER_CAN_BITRATE", "500000", "can.bitrate", 500_000),
        ("CRUISER_RECORDER_FLUSH_S", "0.25", "recorder.flush_s", 0.25),
        ("CRUISER_RECORDER_FLUSH_S", "2", "recorder.flush_s", 2.0),
        ("CRUISER_GATEWAY_LISTEN_ONLY", "No", "gateway.listen_only", False),
        ("CRUISER_GATEWAY_LISTEN_ONLY", "1", "gateway.listen_only", True),
        ("CRUISER_ZENOH_CONNECT", "tcp/a:1, tcp/b:2", "zenoh.connect", ["tcp/a:1", "tcp/b:2"]),
        ("CRUISER_ZENOH_CONNECT", "", "zenoh.connect", []),
        (
            "CRUISER_CAN_OPTIONS",
            "a=1, b=x=y, c=true, d=0.5",
            "can.options",
            {"a": 1, "b": "x=y", "c": True, "d": 0.5},
        ),
        ("CRUISER_CHASSIS_VARIANT", "fine", "chassis.variant", "fine"),
    ],
)
def test_a_variable_is_read_in_the_type_of_its_setting(variable: str, text: str, key: str, value: object) -> None:
    for settings in (merged(environ={variable: text}), merged(flags={key: text})):
        section, name = key.split(".")
        assert getattr(getattr(settings, section), name) == value


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[can]\n\nbitrat = 1\n", ("robot.toml:3:", "can.bitrat'", "did you mean 'can.bitrate'")),
        ("[cann]\nbitrate = 1\n", ("robot.toml:1:", "'cann'", "did you mean 'can'")),
        ('[robot]\nchannel = "x"\n', ("robot.toml:2:", "'robot.channel'", "did you mean 'can.channel'")),
        ('can."bit rate" = 1\n', ("robot.toml:1:", "'can.bit rate'", "did you mean 'can.bitrate'")),
        ("can = { bus = 'a', bitrat = 1 }\n", ("robot.toml:1:", "did you mean 'can.bitrate'")),
        (
            '[can]\nbitrate = "fast"\n',
            ("robot.toml:2:", "can.bitrate", "a whole number from 0 to 1000000", '"fast"'),
        ),
        ("[can]\nbitrate = true\n", ("robot.toml:2:", "can.bitrate", "a whole number")),
        ("[can]\nbitrate = 2000000\n", ("robot.toml:2:", "can.bitrate", "from 0 to 1000000", "2000000")),
        ("[recorder]\nflush_s = nan\n", ("robot.toml:2:", "recorder.flush_s", "from 0.05 to 10", "nan")),
        (
            '[chassis]\nvariant = "corse"\n',
            ("robot.toml:2:", "one of auto, coarse, fine", "did you mean 'coarse'"),
        ),
        ('[robot]\nname = "A B"\n', ("robot.toml:2:", "robot.name", "[a-z0-9-]+", '"A B"')),
        ('[robot]\nname = "a\\n"\n', ("robot.toml:2:", "robot.name", "[a-z0-9-]+")),
        ("[robot]\nname = 2020-01-01\n", ("robot.toml:2:", "robot.name", "a date")),
        ('[can]\nchannel = ""\n', ("robot.toml:2:", "can.channel", "not empty")),
        ('[recorder]\ndirectory = "a\\u0000"\n', ("robot.toml:2:", "recorder.directory", "NUL")),
        ("[zenoh]\nconnect = [\n1,\n]\n", ("robot.toml:2:", "zenoh.connect", "a list of texts")),
        ("[can.options]\nx = [1]\n", ("robot.toml:1:", "can.options", "a table of texts")),
        ("can = 3\n", ("robot.toml:1:", "can is a table")),
        ("[[can]]\nbus = 'a'\n", ("robot.toml:1:", "can is a table")),
        ("[can]\nbus = \n", ("robot.toml:2:", "not TOML")),
        ("[can]\nbus = [1,\n", ("robot.toml:2:", "not TOML", "end of the file")),
        (f"x = {'9' * 5000}\n", ("robot.toml:", "not TOML")),
        (f"x = {'[' * 5000}\n", ("robot.toml:", "not TOML")),
    ],
)
def test_a_wrong_file_names_the_line_the_key_and_the_cure(text: str, parts: tuple[str, ...]) -> None:
    message = problem(text)
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("environ", "parts"),
    [
        ({"CRUISER_CAN_CHANEL": "x"}, ("CRUISER_CAN_CHANEL", "did you mean 'CRUISER_CAN_CHANNEL'")),
        ({"CRUISER_CONFG": "x"}, ("CRUISER_CONFG", "did you mean 'CRUISER_CONFIG'")),
        ({"CRUISER_CAN_BITRATE": "fast"}, ("CRUISER_CAN_BITRATE", "can.bitrate", "from 0 to 1000000")),
        ({"CRUISER_CAN_BITRATE": "9" * 5000}, ("CRUISER_CAN_BITRATE", "from 0 to 1000000", "...")),
        ({"CRUISER_GATEWAY_LISTEN_ONLY": "maybe"}, ("CRUISER_GATEWAY_LISTEN_ONLY", "true or false")),
        ({"CRUISER_CAN_OPTIONS": "a"}, ("CRUISER_CAN_OPTIONS", "a table")),
        ({"CRUISER_RECORDER_DIRECTORY": "\udcff"}, ("CRUISER_RECORDER_DIRECTORY", "UTF-8")),
    ],
)
def test_a_wrong_variable_is_named_with_its_cure(environ: dict[str, str], parts: tuple[str, ...]) -> None:
    message = problem(environ=environ)
    for part in ("environment", *parts):
        assert part in message


def test_a_stop_at_once_may_not_be_the_gentler_one() -> None:
    flags = {"command.deceleration_mps2": 1.5, "command.emergency_deceleration_mps2": 1.4}
    with pytest.raises(CommandError, match=r"emergency_deceleration_mps2 is 1\.4, .*deceleration_mps2 1\.5"):
        merge(None, {}, flags)
    assert merge(None, {}, flags | {"command.emergency_deceleration_mps2": 1.5}).command.deceleration_mps2 == 1.5


@pytest.mark.parametrize("name", NEEDED_FEEDBACK)
def test_feedback_that_is_needed_cannot_be_left_out(name: str) -> None:
    """Row 'engage: every feedback that chassis.required_feedback names': more may be named, and not less."""
    needed = [one for one in NEEDED_FEEDBACK if one != name]
    with pytest.raises(
        CommandError, match=rf"chassis\.required_feedback .* leaves out {name}, which every robot needs"
    ) as caught:
        merge(None, {}, {"chassis.required_feedback": needed})
    assert caught.value.code is ExitCode.USAGE
    merge(None, {}, {"chassis.required_feedback": [*NEEDED_FEEDBACK, "Auto_BrakingFeedBack"]})


def test_a_wrong_value_is_an_error_even_where_a_later_source_overrides_it() -> None:
    assert "robot.toml:2" in problem("[can]\nbitrate = -1\n", flags={"can.bitrate": 5})


@given(text=st.text() | st.text("abcnrobus.=[]{}'\"\\\n #1,"))
@example("[can]\nbus = '\x1b[31m'\n")
@example('"\\u001b[31m" = 1\n')
def test_no_file_does_more_than_fail_with_one_line(text: str) -> None:
    message = _complaint(text, {})
    assert message.isprintable()
    assert message.startswith(("robot.toml", "right"))


@given(
    variable=st.sampled_from([setting.variable for setting in SETTINGS.values()])
    | st.text(string.ascii_uppercase + "_").map("CRUISER_{}".format),
    text=st.text(st.characters()),
)
def test_no_environment_does_more_than_fail_with_one_line(variable: str, text: str) -> None:
    message = _complaint("", {variable: text})
    assert message.isprintable()
    assert variable in message or message == "right"


@given(
    root=st.from_regex(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", fullmatch=True),
    channel=TEXTS.filter(lambda text: bool(text) and "\0" not in text),
    flush_s=st.floats(0.05, 10),
    connect=st.lists(TEXTS),
    options=OPTIONS,
)
def test_settings_as_toml_read_back_equal(
    root: str, channel: str, flush_s: float, connect: list[str], options: dict[str, str | int | float | bool]
) -> None:
    settings = Settings(
        robot=RobotSettings(root=root),
        can=CanSettings(channel=channel, options=options),
        zenoh=ZenohSettings(connect=connect),
        recorder=RecorderSettings(flush_s=flush_s),
    )
    assert msgspec.convert(tomllib.loads(to_toml(settings)), Settings) == settings


def test_written_settings_name_every_setting() -> None:
    """Not the desk's, which earlier reviews do not know, nor the upload's, which may contain secrets."""
    document = tomllib.loads(to_toml(Settings()))
    keys = [f"{section}.{name}" for section, table in document.items() for name in table]
    assert keys == [key for key in SETTINGS if not key.startswith(("desk.", "upload."))]


@pytest.mark.parametrize("key", GONE_SETTINGS)
def test_a_setting_that_is_gone_grounds_no_robot_and_hides_no_log(
    key: str, caplog: pytest.LogCaptureFixture
) -> None:
    table, name = key.split(".")
    text = f"[{table}]\n{name} = 30.0\n" + "[command]\n" * (table != "command") + "speed_limit_mps = 0.5\n"
    assert merge(TomlSource("log", text, is_recorded=True), {}, {}).command.speed_limit_mps == 0.5
    assert not caplog.messages
    assert merge(TomlSource("robot.toml", text), {}, {}).command.speed_limit_mps == 0.5
    assert len(caplog.messages) == 1
    assert re.match(rf"robot\.toml:2: {key} was removed and has no effect: ", caplog.messages[0])


@pytest.mark.parametrize("text", ["a" + ".b" * 30_000 + " = 1", "# " + "x" * 70_000])
def test_a_configuration_out_of_a_log_is_no_longer_than_any_of_ours(text: str) -> None:
    """A key with very many parts could take a gigabyte."""
    with pytest.raises(CommandError, match="no settings are that long"):
        merge(TomlSource("log", text, is_recorded=True), {}, {})


# Profiles of thin links: what is in each, and the rules that Zenoh gets.


def test_events_are_never_reduced_nor_what_an_operator_drives_by() -> None:
    assert all("safety/event" not in rates for rates in PROFILES.values())
    assert PROFILES[OPERATOR]["safety/state"] >= 20
    assert "safety/decision" not in PROFILES[OPERATOR]


def test_no_two_rules_fit_one_key() -> None:
    """Zenoh uses any one of the rules that fit."""
    for item in zenoh_rules(["*=thin", "wwan0=operator"], "fleet", "r-1")[DOWNSAMPLING]:
        keys = [rule["key_expr"] for rule in item["rules"]]
        assert len(set(keys)) == len(keys)
        assert all(key.startswith("fleet/r-1/") for key in keys)
        assert not any("**" in key for key in keys)


def test_rules_are_those_of_the_interface_at_the_robots_end_of_what_leaves() -> None:
    assert zenoh_rules([], "fleet", "r-1") == {}
    assert zenoh_rules(["wwan0=full"], "fleet", "r-1") == {}
    rules = zenoh_rules(["wwan0=operator", "*=thin"], "fleet", "r-1")[DOWNSAMPLING]
    assert [one.get("interfaces") for one in rules] == [["wwan0"], ["wwan0"], None, None]
    assert len({one["id"] for one in rules}) == 4
    assert all(one["flows"] == ["egress"] for one in rules)
    for item in rules:
        is_left_out = {rule["freq"] == 0 for rule in item["rules"]}
        assert is_left_out == {"reply" in item["messages"]}, "replies of what leaves are never reduced"


@pytest.mark.parametrize(
    "wrong", ["thin", "wwan0", "wwan0=thick", "=thin", "a=b=thin", "much-too-long-a-name=thin"]
)
def test_what_is_no_profile_of_an_interface_is_an_error(wrong: str) -> None:
    with pytest.raises(CommandError, match=r"zenoh\.profiles"):
        merge(TomlSource("", f'[zenoh]\nprofiles = ["{wrong}"]\n'), {}, {})
