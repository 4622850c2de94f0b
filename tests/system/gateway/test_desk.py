"""The desk in a real browser: what it shows, and every way to let go of a robot."""

from __future__ import annotations

import http.client
import re
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import urlparse

import msgspec
import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from gateway.authority.enrolment import read_request, request_fingerprint
from schemas.settings import ZenohSettings
from schemas.zenoh_session import open_session
from tests.support.messages import STATE
from tests.support.metrics import received
from tests.support.nights import by_night
from tests.support.processes.desk import (
    ATTEMPTS,
    DeskScene,
    desk_scene,
    drive,
    is_driven,
    open_robot,
    profile,
    reset,
    take_control,
    texts,
    wait_ready,
)
from tests.support.processes.letting_go import WAYS
from tests.support.provisioning import ProvisionedFleet
from tests.support.provisioning import run as provision
from tests.support.waiting import wait_until

DESK_ENDED = ("ERR_CONNECTION_REFUSED", "Connection closed before receiving a handshake response")
"""What the browser itself writes to the console when a test ends the desk: before, or while, the page connects."""


@pytest.fixture
def context(running_browser: Browser) -> Iterator[BrowserContext]:
    with profile(running_browser, *DESK_ENDED) as context:
        yield context


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DeskScene]:
    """A robot and its desk, for tests that leave both as they were."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        with desk_scene() as scene:
            yield scene


def test_a_robot_is_seen_at_once_with_why_it_stands(scene: DeskScene, context: BrowserContext) -> None:
    page = context.new_page()
    page.goto(scene.address)
    row = page.locator("tr[data-robot=cruiser-1]")
    row.get_by_text("ready").wait_for()
    page.get_by_text("1 ready", exact=True).wait_for()
    # It is found by a part of its name; filters leave out what is fine.
    page.get_by_role("searchbox").fill("cruiser-7")
    row.wait_for(state="detached")
    page.get_by_role("searchbox").fill("ser-1")
    row.wait_for()
    page.get_by_label("State").select_option("needs_person")
    row.wait_for(state="detached")
    page.get_by_label("State").select_option("all")
    row.get_by_role("link", name="cruiser-1").click()
    wait_ready(page)
    wait_until(lambda: texts(page, ".now .big") == ["0.00 m/s", "0.0 °"])
    page.get_by_role("link", name="Wall").click()
    page.locator(".tile", has_text="cruiser-1").wait_for()


@pytest.mark.night
def test_it_speaks_chinese_and_remembers_it(scene: DeskScene, context: BrowserContext) -> None:
    page = open_robot(context, scene)
    page.get_by_role("button", name="中文").click()
    page.locator(".band .word", has_text="就绪").wait_for()
    page.reload()
    page.locator(".band .word", has_text="就绪").wait_for()
    assert page.locator("html").get_attribute("lang") == "zh"
    assert page.get_by_role("button", name="全部停车").is_visible()


# All ways, each of them twenty times over, by night: tests/nightly/test_desk.py.
@pytest.mark.parametrize("way", ["let go of the pointer", by_night("shut the lid")])
def test_whatever_takes_the_pointer_away_stops_the_robot(
    scene: DeskScene, running_browser: Browser, way: str
) -> None:
    """The frames on the bus are the judge."""
    context = running_browser.new_context(locale="en-GB")
    try:
        page = open_robot(context, scene)
        drive(scene, page)
        WAYS[way](page)
        scene.wait_told_zero()
    finally:
        context.close()
    # Nobody holds it any more, as whoever opens the page next sees.
    with running_browser.new_context(locale="en-GB") as context:
        open_robot(context, scene)


def test_keys_drive_while_they_are_held(scene: DeskScene, context: BrowserContext) -> None:
    page = open_robot(context, scene)
    drive(scene, page, "ArrowUp")
    page.keyboard.up("ArrowUp")
    scene.wait_told_zero()
    drive(scene, page, "w")
    WAYS["lose the focus"](page)
    for _ in range(20):
        page.keyboard.down("w")  # held on: it repeats
    scene.wait_told_zero()
    page.keyboard.up("w")
    drive(scene, page, "s")
    page.keyboard.up("s")
    scene.wait_told_zero()


def speed_mps(page: Page) -> float:
    """The speed that the page shows, without its sign; 0 if it shows none."""
    return float(re.sub(r"[^0-9.]", "", texts(page, ".now .big")[0]) or 0)


def test_the_remote_stop_is_one_key_and_says_what_is_known(scene: DeskScene, context: BrowserContext) -> None:
    page, other = open_robot(context, scene), open_robot(context, scene)
    # Below 0.05 m/s no feedback has shown that the robot moves, so a stop could not be confirmed by measurement. A
    # busy machine may let it stop by its deadman first.
    for _ in range(ATTEMPTS):
        drive(scene, page)
        wait_until(lambda: speed_mps(other) > 0.1 or not scene.is_told_to_move)
        if scene.is_told_to_move:
            break
        page.mouse.up()
    other.keyboard.press("Escape")
    other.get_by_text("cruiser-1: stopped and latched (measured)").wait_for()
    page.mouse.up()
    page.get_by_text("You are no longer driving: a remote stop was received").wait_for()
    page.locator(".band", has_text="stopped by").wait_for()
    other.get_by_text("a remote stop was received (remote_stop)").wait_for()
    reset(other)


@pytest.mark.night
def test_stop_all_never_says_more_than_is_known(context: BrowserContext) -> None:
    with desk_scene() as scene:
        page = open_robot(context, scene)
        page.goto(scene.address)
        page.locator("tr[data-robot=cruiser-1]").wait_for()
        scene.gateway.process.send_signal(signal.SIGSTOP)
        try:
            page.get_by_role("button", name="STOP ALL").click()
            page.get_by_text("cruiser-1: no reply: not confirmed stopped").wait_for()
        finally:
            scene.gateway.process.send_signal(signal.SIGCONT)
        assert scene.desk.stop() == 0
        page.get_by_text("No contact with the desk for").wait_for()
        page.locator("tr[data-robot=cruiser-1]", has_text="offline").wait_for()
        page.get_by_text("1 offline, 1 not acknowledged").wait_for()
        page.get_by_role("button", name="STOP ALL").click()
        page.get_by_text("NOT SENT").wait_for()


@pytest.mark.parametrize("number", [by_night(signal.SIGKILL), signal.SIGSTOP])
def test_a_desk_that_dies_while_somebody_drives_stops_the_robot(
    number: signal.Signals, context: BrowserContext
) -> None:
    with desk_scene() as scene:
        page = open_robot(context, scene)
        drive(scene, page)
        scene.desk.process.send_signal(number)
        scene.wait_told_zero()
        if number is signal.SIGSTOP:
            stood = len(scene.told_mps())
            scene.desk.process.send_signal(signal.SIGCONT)
            page.get_by_text("You are no longer driving").wait_for()
            assert max(map(abs, scene.told_mps()[stood:])) == 0
            assert scene.desk.stop() == 0


def flood(address: str, said: bytes, ended: threading.Event) -> None:
    """Open the WebSocket from a raw socket, and send these bytes repeatedly; reconnect when it is closed."""
    host = urlparse(address).netloc
    place = ("127.0.0.1", int(host.rpartition(":")[2]))
    head = "".join(f"{name}: {value}\r\n" for name, value in upgrade(f"http://{host}", host).items())
    while not ended.is_set():
        with closing(socket.create_connection(place)) as loud, suppress(OSError):
            loud.sendall(f"GET /link HTTP/1.1\r\n{head}\r\n".encode())
            loud.recv(1)
            loud.settimeout(0.05)
            left = said
            while not ended.is_set():
                with suppress(TimeoutError):
                    left = left[loud.send(left) :] or said
                    loud.recv(1 << 20)


@pytest.mark.parametrize("opcode", [by_night(0x89), 0x8A, by_night(0x82)], ids=["pings", "pongs", "messages"])
def test_no_flood_of_other_connections_stops_a_driven_robot(opcode: int, context: BrowserContext) -> None:
    """Megabytes of the smallest frames, from the browser's address; a stop from its page still works."""
    with desk_scene() as scene:
        page = open_robot(context, scene)
        ended = threading.Event()
        said = bytes([opcode, 0x80, 0, 0, 0, 0]) * 10_000
        flooding = [threading.Thread(target=flood, args=(scene.address, said, ended)) for _ in range(8)]
        for one in flooding:
            one.start()
        try:
            # A busy machine may let it stop once or twice; a flood that is read as it comes does so each time.
            for _ in range(ATTEMPTS):
                drive(scene, page)
                told = len(scene.told_mps())
                wait_until(lambda told=told: len(scene.told_mps()) > told + 300 or not scene.is_told_to_move)  # type: ignore[misc]
                if scene.is_told_to_move:
                    break
                page.mouse.up()
            assert min(scene.told_mps()[told:]) > 0
            page.keyboard.press("Escape")
            page.get_by_text("cruiser-1: stopped and latched (measured)").wait_for()
            page.mouse.up()
        finally:
            ended.set()
            for one in flooding:
                one.join()


def test_a_desk_that_hangs_shows_nothing_as_current_and_no_stop_as_made(context: BrowserContext) -> None:
    with desk_scene() as scene:
        page = context.new_page()
        page.goto(scene.address)
        row = page.locator("tr[data-robot=cruiser-1]")
        row.wait_for()
        scene.desk.process.send_signal(signal.SIGSTOP)
        try:
            page.get_by_role("button", name="STOP ALL").click()
            page.get_by_text("use the button on it").wait_for()
            page.get_by_text("No contact with the desk for").wait_for()
            assert row.locator(".pill").inner_text() == "offline"
        finally:
            scene.desk.process.send_signal(signal.SIGCONT)
        row.locator(".pill", has_not_text="offline").wait_for()
        assert scene.desk.stop() == 0


@pytest.mark.night
def test_a_stop_fails_for_no_name(scene: DeskScene, context: BrowserContext) -> None:
    page = open_robot(context, scene)
    page.evaluate("localStorage.setItem('operator', 'an/n *')")
    page.keyboard.press("Escape")
    page.get_by_text("cruiser-1: stopped and latched (measured)").wait_for()
    reset(page)


LEAVE_WHILE_IT_ASKS = """() => {
    const send = WebSocket.prototype.send;
    WebSocket.prototype.send = function (data) {
        send.call(this, data);
        const said = new TextDecoder().decode(data);
        if (said.includes("acquire")) setTimeout(() => (location.hash = "#/"));
        if (said.includes("release")) window.hasReleased = true;
    };
}"""


@pytest.mark.night
def test_who_leaves_while_the_lease_is_asked_for_engages_nothing(
    scene: DeskScene, context: BrowserContext
) -> None:
    page = open_robot(context, scene)
    page.evaluate(LEAVE_WHILE_IT_ASKS)
    before = len(scene.listener.bursts)
    page.get_by_role("button", name="Take control").click()
    wait_until(lambda: page.evaluate("window.hasReleased"))
    page.locator("tr[data-robot=cruiser-1]", has_text="ready").wait_for()
    assert len(scene.listener.bursts) == before


def test_two_browsers_never_drive_one_robot(scene: DeskScene, context: BrowserContext) -> None:
    first, second = open_robot(context, scene), open_robot(context, scene)
    name_page(first, "ann")
    name_page(second, "bob")
    take_over = second.locator("button:enabled:visible", has_text="Take over from ann")
    take_control(first)
    # A busy machine may have let the first stop by its deadman: then nobody is taken over.
    wait_until(lambda: take_over.count() or not is_driven(first))
    if not take_over.count():
        take_control(first)
    take_over.click()
    wait_until(lambda: is_driven(second))
    wait_until(lambda: not is_driven(first))
    drive(scene, second)
    second.mouse.up()
    scene.wait_told_zero()
    second.get_by_role("button", name="Give back").click()
    wait_ready(second)


def name_page(page: Page, name: str) -> None:
    page.get_by_label("Your name").fill(name)
    page.get_by_label("Your name").blur()


@pytest.mark.night
def test_two_browsers_have_two_names_and_are_asked_for_them_once(
    scene: DeskScene, running_browser: Browser
) -> None:
    with (
        running_browser.new_context(locale="en-GB") as one,
        running_browser.new_context(locale="en-GB") as another,
    ):
        first, second = open_robot(one, scene), open_robot(another, scene)
        names = [page.get_by_label("Your name").input_value() for page in (first, second)]
        assert len(set(names)) == 2
        assert all(re.fullmatch("desk-[0-9a-f]{4}", name) for name in names)
        first.get_by_role("button", name="Take control").click()
        first.get_by_text(f"You drive as {names[0]}. Others see this name").wait_for()
        assert not is_driven(first)
        name_page(first, "ann")
        take_control(first)
        first.get_by_text("you are in control").wait_for()
        second.get_by_text("ann is in control").wait_for()
        second.locator(".events", has_text="ann has acquired the lease").first.wait_for()
        first.get_by_role("button", name="Give back").click()
        wait_ready(first)
        first.reload()
        wait_ready(first)
        first.get_by_role("button", name="Take control").click()
        wait_until(lambda: is_driven(first))


@pytest.mark.night
def test_lamps_and_horn_are_the_driver_s(scene: DeskScene, context: BrowserContext) -> None:
    page = open_robot(context, scene)
    lights = page.get_by_role("button", name="Lights")
    assert lights.is_hidden()
    take_control(page)
    lights.click()
    page.locator("dd", has_text="headlamp").wait_for()
    page.get_by_role("button", name="Horn").click()
    lights.click()
    page.locator("dt:has-text('Lamps') + dd", has_text="off").wait_for()
    page.get_by_role("button", name="Give back").click()
    wait_ready(page)


@pytest.mark.night
def test_an_alarm_is_acknowledged_for_all_and_cured_beside_its_reason(
    scene: DeskScene, context: BrowserContext
) -> None:
    overview = context.new_page()
    overview.goto(scene.address)
    page = open_robot(context, scene)
    page.keyboard.press("Escape")
    row = overview.locator("tr[data-robot=cruiser-1]")
    row.get_by_text("stopped - needs reset", exact=True).wait_for()
    overview.get_by_text("1 needs reset, 1 not acknowledged").wait_for()
    wait_until(lambda: overview.title() == page.title().replace("cruiser-1 · ", "") == "(1) Cruiser")
    row.get_by_role("button", name="Acknowledge cruiser-1").click()
    row.get_by_text("acknowledged by desk-").wait_for()
    wait_until(lambda: overview.title() == "Cruiser")
    reset(page)
    row.get_by_text("acknowledged by desk-").wait_for(state="hidden")


@pytest.mark.night
def test_a_kiosk_shows_one_robot_and_leads_nowhere(scene: DeskScene, context: BrowserContext) -> None:
    page = context.new_page()
    page.goto(f"{scene.address}#/kiosk/cruiser-1")
    wait_ready(page)
    assert page.get_by_role("button", name="STOP cruiser-1").is_visible()
    assert [link for link in page.get_by_role("link").all() if link.is_visible()] == []


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[tuple[DeskScene, ProvisionedFleet]]:
    fleet = ProvisionedFleet(tmp_path)
    directory = fleet.let_in("robot", "cruiser-1")
    settings = tmp_path / "robot.toml"
    settings.write_text(
        f'[authority]\nmode = "signed"\ndirectory = "{directory}"\n[gateway]\nstate_dir = "{tmp_path / "state"}"\n'
    )
    with desk_scene("--config", str(settings)) as scene:
        yield scene, fleet


def let_ann_in(page: Page, fleet: ProvisionedFleet, directory: Path) -> None:
    """Have this browser's key granted to ann."""
    name_page(page, "ann")
    page.get_by_text("Keys", exact=True).click()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save request").click()
    request = directory / "operator-ann.request"
    download.value.save_as(request)
    bundle = fleet.sign(request, "--speed-limit", "0.4")
    fingerprint = request_fingerprint(read_request(request.read_bytes()))
    page.get_by_text(f"request {fingerprint}: 'cruiser provision sign' must show the same").wait_for()
    page.get_by_label("Load bundle").set_input_files(bundle)
    page.get_by_text(
        f"ann: request {fingerprint}, authority {fleet.fingerprint}. Before you accept, compare"
    ).wait_for()
    assert page.get_by_text("Open mode").is_visible()
    page.get_by_role("button", name="The fingerprints match").click()
    page.get_by_text(re.compile("Signs as ann, operator, at most 0.4 m/s, until ")).wait_for()


NOTE_WHAT_IS_SHOWN = """() => {
    let beganMs = null; // what is shown for a second after the beginning may be of before it
    window.shown = [];
    setInterval(() => {
        beganMs = document.querySelector(".robot.driving") && (beganMs ?? performance.now());
        const is = beganMs !== null && performance.now() - beganMs > 1500;
        if (is) window.shown.push(document.querySelector(".now .big").textContent);
    }, 20);
}"""


def test_who_drives_is_shown_no_speed_that_the_robot_did_not_sign(
    signed: tuple[DeskScene, ProvisionedFleet], context: BrowserContext, tmp_path: Path
) -> None:
    scene, fleet = signed
    page = open_robot(context, scene)
    let_ann_in(page, fleet, tmp_path)
    with closing(open_session(ZenohSettings(mode="client"), [scene.endpoint], [])) as stranger:
        forged = received(msgspec.structs.replace(STATE, speed_mps=9.99, sequence=2**30))

        def put() -> None:
            stranger.put(forged.key, forged.payload, encoding=forged.encoding)

        # Nobody drives: what is shown is believed of the desk.
        wait_until(lambda: texts(page, ".now .big")[0] == "9.99 m/s", put)
        page.evaluate(NOTE_WHAT_IS_SHOWN)

        def forge() -> None:
            # On a busy machine the robot may have stopped by its deadman.
            if not is_driven(page):
                take_control(page)
            put()

        wait_until(lambda: page.evaluate("window.shown.length") > 20, forge)
        shown = set(page.evaluate("window.shown"))
    assert "9.99 m/s" not in shown
    assert "0.00 m/s" in shown


def test_a_browser_signs_with_a_key_of_its_own(
    signed: tuple[DeskScene, ProvisionedFleet], context: BrowserContext, tmp_path: Path
) -> None:
    scene, fleet = signed
    page = open_robot(context, scene)
    page.get_by_role("button", name="Take control").click()
    page.get_by_text("This robot accepts only signed commands").wait_for()
    assert set(map(abs, scene.told_mps())) <= {0.0}
    let_ann_in(page, fleet, tmp_path)
    drive(scene, page, forward=1.0)
    wait_until(lambda: texts(page, ".now .big")[0].startswith("0.4"))
    assert max(map(abs, scene.told_mps())) <= 0.4
    page.mouse.up()
    scene.wait_told_zero()
    page.get_by_role("button", name="Give back").click()
    wait_ready(page)
    # The key cannot be taken out, by no script of the page either.
    taken = page.evaluate(
        """async () => {
            const opening = indexedDB.open("cruiser");
            await new Promise((resolve) => { opening.onsuccess = resolve; });
            const asked = opening.result.transaction("operator").objectStore("operator").get("pair");
            const pair = await new Promise((resolve) => { asked.onsuccess = () => resolve(asked.result); });
            return crypto.subtle.exportKey("pkcs8", pair.privateKey).then(() => "taken", (error) => error.name);
        }"""
    )
    assert taken == "InvalidAccessError"


@pytest.mark.night
def test_a_bundle_of_somebody_else_is_refused(
    signed: tuple[DeskScene, ProvisionedFleet], context: BrowserContext
) -> None:
    scene, fleet = signed
    page = open_robot(context, scene)
    page.get_by_text("Keys", exact=True).click()
    page.get_by_label("Load bundle").set_input_files(fleet.sign(fleet.request("operator", "bob")))
    page.get_by_text("this bundle is for another key").wait_for()
    assert page.get_by_text("Open mode").is_visible()


@pytest.mark.night
def test_a_bundle_that_was_changed_or_swapped_on_its_way_lets_nobody_in(
    signed: tuple[DeskScene, ProvisionedFleet], context: BrowserContext, tmp_path: Path
) -> None:
    scene, fleet = signed
    page = open_robot(context, scene)
    let_ann_in(page, fleet, tmp_path)
    bundle, takes = tmp_path / "operator-ann.bundle", page.get_by_role("button", name="The fingerprints match")
    changed, thieves = tmp_path / "changed.bundle", ProvisionedFleet(tmp_path / "thieves")
    changed.write_bytes(bundle.read_bytes().replace(b'"root":"fleet"', b'"root":"fleeT"'))
    page.get_by_label("Load bundle").set_input_files(changed)
    page.get_by_text("the bundle was changed after it was signed").wait_for()
    assert not takes.is_visible()
    provision(
        "sign", tmp_path / "operator-ann.request", "--directory", thieves.authority, "-o", changed, "--replace"
    )
    page.get_by_label("Load bundle").set_input_files(changed)
    page.get_by_text(f"authority {thieves.fingerprint}. Before you accept, compare").wait_for()
    page.get_by_label("Load bundle").set_input_files(bundle)
    page.get_by_text(re.compile(f"authority {fleet.fingerprint}$")).wait_for()
    assert not takes.is_visible()
    assert page.get_by_text("Signs as ann, operator, at most 0.4 m/s").is_visible()


def ask(address: str, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    place = urlparse(address)
    with closing(http.client.HTTPConnection(str(place.hostname), place.port, timeout=30)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as response:
            return response


def upgrade(origin: str, host: str) -> dict[str, str]:
    return {
        "Origin": origin,
        "Host": host,
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }


def test_no_other_page_gets_in(scene: DeskScene) -> None:
    host = urlparse(scene.address).netloc
    page = ask(scene.address)
    assert page.status == 200
    assert "default-src 'none'" in page.headers["Content-Security-Policy"]
    assert "unsafe" not in page.headers["Content-Security-Policy"]
    assert ask(scene.address, Host="evil.example").status == 400
    assert ask(scene.address, "/link", **upgrade(f"http://{host}", host)).status == 101
    # As a proxy of this machine that ends TLS says it.
    behind = {"X-Forwarded-Proto": "https", **upgrade(f"https://{host}", host)}
    assert ask(scene.address, "/link", **behind).status == 101
    for origin in ("http://evil.example", f"https://{host}", "null", ""):
        assert ask(scene.address, "/link", **upgrade(origin, host)).status == 403
    assert ask(scene.address, "/link", **upgrade("http://evil.example", "evil.example")).status in {400, 403}
    for path in ("/../pyproject.toml", "/..%2f..%2fcli/desk.py", "/%2e%2e/words.py", "/words.py"):
        assert ask(scene.address, path).status == 404


def test_the_page_weighs_less_than_300_kilobytes() -> None:
    root = Path(__file__).parents[3]
    pages = [root / "gateway" / "desk" / "page", root / "schemas" / "web" / "page"]
    assert sum(file.stat().st_size for page in pages for file in page.rglob("*") if file.is_file()) < 300_000
