"""The test that a gateway in signed mode makes of itself before anybody engages the robot.

What needs no network is tested at once, and everything else on a thread of its own: the loop goes on meanwhile. A
robot that has no network waits for one, and nobody could engage it either. One that had passed and lost its router
stays as it was; by a router that it was not connected to before, nobody engages it until that one is tested.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from gateway.authority.self_test import UNDER_WAY, access_fault, admission_fault
from gateway.authority.transport import SHUT_OUT_FILE, TLS_KEY_FILE, TransportRole
from gateway.provisioning.key_files import directory_of
from gateway.provisioning.tls_files import check_shut_out
from gateway.zenoh.intruder import Attempt, access_of, enters_without_certificate, has_certificates, intrude
from schemas.authority.trust import Trust
from schemas.exit_codes import CommandError
from schemas.printable import plain
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_link import is_loopback, own_endpoint

log = logging.getLogger(__name__)

LOOK_S: Final = 0.5
"""Period at which a new router is looked for, and at which one that is away is tried again."""

AGAIN_S: Final = 10.0
"""Period at which a test that has failed is made again: a router may be mended."""

CLOSE_TIMEOUT_S: Final = 3.0
"""The longest wait of a gateway that ends for an attempt that is under way."""

ANY_NAME: Final = "verify_name_on_connect=false"
"""An option of an endpoint by which any machine of the network passes for the router."""

INSTALL: Final = "'cruiser provision install --replace' writes it"


class SessionHolder(Protocol):
    """A session of the gateway's."""

    @property
    def session(self) -> Any:  # noqa: ANN401 - Zenoh's
        """The session; None as long as the robot is off the network."""
        ...


class RoutedSession(SessionHolder, Protocol):
    """The gateway's session for telemetry."""

    def routers(self) -> frozenset[str]:
        """The routers that it is connected to."""
        ...


class Reached(msgspec.Struct, frozen=True):
    """Where a gateway is reached.

    Attributes:
        connect: where it dials out to.
        listen: where it listens, for telemetry and for commands.
    """

    connect: list[str]
    listen: list[str]

    @property
    def is_secured(self) -> bool:
        """Does anything but this machine's own plain connections reach it?"""
        return any(has_certificates(one) or not is_loopback(one) for one in (*self.connect, *self.listen))


class SelfTest:
    """The test, and its verdict."""

    def __init__(
        self,
        settings: Settings,
        place: Reached,
        node: RoutedSession,
        inbox: SessionHolder,
        report: Callable[[str], None],
    ) -> None:
        """Nothing is tested yet.

        Args:
            settings: the gateway's.
            place: where it is reached.
            node: its session for telemetry.
            inbox: that for commands.
            report: is given the verdict whenever it changes, on any thread: why the test has not passed, with the
                file and the cure; empty once it has.
        """
        self._settings = settings
        self._place = place
        self._node = node
        self._inbox = inbox
        self._report = report
        self._verdict: str | None = None
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="self-test", daemon=True)

    def begin(self, trust: Trust) -> None:
        """Test what needs no network, then the rest aside.

        Args:
            trust: the robot's.
        """
        fault = self._local_fault(trust)
        if fault or not self._place.is_secured:
            self._give(fault)
            return
        self._give(files_fault(self._settings) or UNDER_WAY)
        self._thread.start()

    def close(self) -> None:
        """End, within a bounded time."""
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_TIMEOUT_S)

    def _local_fault(self, trust: Trust) -> str:
        fault = admission_fault(self._settings, trust)
        if fault:
            return f"{fault}: the installation is damaged; install the cruiser-gateway again"
        if not self._place.is_secured:
            # Only this machine reaches it, as in open mode; and whoever commands it signs.
            return ""
        return endpoint_fault(self._place)

    def _run(self) -> None:
        away = plain(", ".join((*self._place.connect, *self._place.listen)))
        waits = f"it waits for {away}, where no node answers; it is tried on"
        result: str | None = None
        known: frozenset[str] = frozenset()
        due_s = 0.0
        while not self._ends.is_set():
            routers = self._node.routers()
            is_new = result is None or bool(routers - known)
            if is_new and self._verdict == result:
                # Nobody engages the robot by a router of which nothing is known.
                self._give(UNDER_WAY)
            if is_new or (result and time.monotonic() >= due_s):
                fault = self._network_fault()
                if fault is not None:
                    result, known = fault, known | routers
                    due_s = time.monotonic() + AGAIN_S
            self._give(waits if result is None or routers - known else result)
            self._ends.wait(LOOK_S)

    def _network_fault(self) -> str | None:
        """Return an act that is not denied at some endpoint; empty if all are, None if no endpoint is reached.

        First of all what is wrong with the files, which may be mended since, or be right once the clock is set.
        """
        if fault := files_fault(self._settings):
            return fault
        if self._node.session is None:
            return None
        try:
            return self._try_endpoints()
        except CommandError as error:
            return str(error)

    def _try_endpoints(self) -> str | None:
        is_answered = False
        for endpoint in (*self._place.connect, *map(own_endpoint, filter(has_certificates, self._place.listen))):
            attempt = self._intrude(endpoint)
            is_answered |= attempt.is_connected
            if attempt.deeds:
                return self._words(endpoint, attempt.deeds)
        for listener in filter(has_certificates, self._place.listen):
            entrance = enters_without_certificate(self._settings.zenoh, listener)
            if entrance:
                return (
                    f"{plain(entrance)} lets in who shows no certificate: leave out what the endpoint "
                    f"{plain(listener)} says against {self._file}"
                )
        return "" if is_answered else None

    def _intrude(self, endpoint: str) -> Attempt:
        directory, key = self._directory, TLS_KEY_FILE.format(who=TransportRole.ROBOT.value)
        sessions = self._node.session, self._inbox.session
        return intrude(
            self._settings, endpoint, directory / SHUT_OUT_FILE, directory / key, sessions, self._ends.wait
        )

    def _words(self, endpoint: str, deeds: list[str]) -> str:
        where = (
            f"the router at {plain(endpoint)} has to run from the router.json5 that 'cruiser provision install' "
            "writes there"
            if endpoint in self._place.connect
            else f"{self._file} is not as it has to be; {INSTALL}"
        )
        return f"a certificate without any right is not shut out: {deeds[0]}: {where}"

    @property
    def _directory(self) -> Path:
        return directory_of(self._settings.authority)

    @property
    def _file(self) -> str:
        return plain(self._settings.zenoh.config)

    def _give(self, verdict: str) -> None:
        if verdict == self._verdict:
            return
        if not verdict and self._verdict is not None:
            log.info("the test of itself has passed")
        self._verdict = verdict
        self._report(verdict)


def endpoint_fault(place: Reached) -> str:
    """An endpoint that others reach without a certificate; empty if there is none."""
    for endpoint in (*place.connect, *place.listen):
        if not has_certificates(endpoint) and not is_loopback(endpoint):
            return (
                f"{plain(endpoint)} is reached without a certificate: use tls/ or quic/, with the Zenoh file that "
                "'cruiser provision robot' and 'install' make"
            )
        if ANY_NAME in endpoint:
            return f"{plain(endpoint)} is whoever answers there: leave out {ANY_NAME}"
    return ""


def files_fault(settings: Settings) -> str:
    """Return the fault of the files that rule access; empty if there is none."""
    zenoh: ZenohSettings = settings.zenoh
    if not zenoh.config:
        return "zenoh.config is not set: 'cruiser provision robot' and 'install' make robot.json5"
    try:
        fault = access_fault(*access_of(zenoh))
        if fault:
            return f"{plain(zenoh.config)}: {fault}; {INSTALL}"
        check_shut_out(directory_of(settings.authority), time.time())
    except CommandError as error:
        return str(error)
    return ""
