"""The WebSocket server of foxglove-sdk: channels and records go out, and nothing comes in.

It has no capability, so it refuses what viewers publish, call or set, with a status message. Records wait for each
viewer in a ring of its own; of a viewer who is too slow the oldest go.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Self

import foxglove
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509 import load_pem_x509_certificates
from foxglove.websocket import ChannelView, Client, ServerListener, StatusLevel

from recorder.mcap.channel import LogChannel
from schemas.command_line import CommandError, ExitCode, plain, shown_address

RECORDS_WAITING: Final = 2048
"""Records that wait for a viewer; beyond it the oldest go. A saturated bus has 375 frames in a batch."""

SUBSCRIPTIONS_WAITING: Final = 10_000


class _Subscriptions(ServerListener):
    """Remembers which channels somebody has just subscribed to. Called on the server's threads."""

    def __init__(self) -> None:
        self.channels: deque[int] = deque(maxlen=SUBSCRIPTIONS_WAITING)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - the SDK's form
        """Remember it; the loop asks for it."""
        self.channels.append(channel.id)


class ViewServer:
    """Viewers, as ``LiveChannels`` wants them. Ends at the end of a ``with``.

    Attributes:
        where: its address, as it is typed into a viewer.
    """

    def __init__(self, name: str, host: str, port: int, certificate: tuple[Path, Path] | None = None) -> None:
        """Listen.

        Args:
            name: shown by viewers.
            host: the IP address.
            port: 0 is a free one.
            certificate: the files of a chain and its key, PEM; without them there is no TLS.

        Raises:
            CommandError: the address is taken or not one of this machine, or a file cannot be used.
        """
        # Its lines are about what viewers send; they are told themselves.
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._context = foxglove.Context()
        self._channels: dict[int, foxglove.Channel] = {}
        self._ids: dict[int, int] = {}
        """Our id of a channel, by the SDK's."""
        self._subscriptions = _Subscriptions()
        chain, key = (None, None) if certificate is None else _read(*certificate)
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=[],
                server_listener=self._subscriptions,
                context=self._context,
                message_backlog_size=RECORDS_WAITING,
                tls_cert=chain,
                tls_key=key,
            )
        except RuntimeError as error:
            # It has no other exception.
            text = plain(str(error).removeprefix("FoxgloveError: "))
            raise CommandError(
                f"cannot listen on {shown_address(host, port)}: {text}", ExitCode.UNREACHABLE
            ) from error
        scheme = "ws" if certificate is None else "wss"
        self.where = f"{scheme}://{shown_address(host, self._server.port)}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._server.stop()

    def declare(self, channel: LogChannel) -> None:
        """Add a channel."""
        schema = foxglove.Schema(
            name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data
        )
        added = foxglove.Channel(
            channel.topic, message_encoding=channel.message_encoding, schema=schema, context=self._context
        )
        self._ids[added.id()] = channel.channel_id
        self._channels[channel.channel_id] = added

    def is_wanted(self, channel_id: int) -> bool:
        """True if somebody has subscribed to a channel."""
        return self._channels[channel_id].base.has_sinks()

    def write(self, channel_id: int, log_ns: int, data: bytes) -> None:
        """Send a record to those who have subscribed to its channel."""
        self._channels[channel_id].log(data, log_time=log_ns)

    def subscribed(self) -> Iterator[int]:
        """The channels to which somebody has subscribed since the last call."""
        waiting = self._subscriptions.channels
        while waiting:
            channel_id = self._ids.get(waiting.popleft())
            if channel_id is not None:
                yield channel_id

    def warn(self, about: str, text: str) -> None:
        """Show a warning to all viewers, in place of an earlier one about the same."""
        self._server.publish_status(text, StatusLevel.Warning, about)

    def clear(self, about: str) -> None:
        """Take a warning back."""
        self._server.remove_status([about])


def _read(chain: Path, key: Path) -> tuple[bytes, bytes]:
    """A certificate chain and its key, the key in the form that the SDK reads.

    Raises:
        CommandError: a file cannot be read, or is not what it should be.
    """
    files = f"{plain(str(chain))} and {plain(str(key))}"
    try:
        found = chain.read_bytes()
        certificate = load_pem_x509_certificates(found)[0]
        private = load_pem_private_key(key.read_bytes(), None)
    except (OSError, TypeError, ValueError) as error:
        raise CommandError(f"{files} are no certificate with its key: {error}", ExitCode.USAGE) from error
    if private.public_key() != certificate.public_key():
        raise CommandError(f"{files} do not belong together", ExitCode.USAGE)
    return found, private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
