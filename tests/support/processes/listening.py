"""What a process really listens on, as the kernel sees it."""

from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address
from pathlib import Path
from typing import Final

LISTENS: Final = "0A"
UNCONNECTED: Final = "07"


def listening(pid: int) -> set[str]:
    """Addresses at which others reach a process: TCP that listens, UDP that is bound."""
    found = set()
    sockets = _sockets(pid)
    for table, state in (("tcp", LISTENS), ("tcp6", LISTENS), ("udp", UNCONNECTED), ("udp6", UNCONNECTED)):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[3] == state and columns[9] in sockets:
                host, port = columns[1].split(":")
                found.add(f"{_address(host)}:{int(port, 16)}")
    return found


def _sockets(pid: int) -> set[str]:
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            target = str(descriptor.readlink())
            if target.startswith("socket:["):
                inodes.add(target.removeprefix("socket:[").removesuffix("]"))
    return inodes


def _address(text: str) -> str:
    # Words of four bytes, each in the machine's order.
    words = [bytes.fromhex(text[at : at + 8]) for at in range(0, len(text), 8)]
    packed = b"".join(int.from_bytes(word, "big").to_bytes(4, "little") for word in words)
    return str(IPv4Address(packed)) if len(packed) == 4 else f"[{IPv6Address(packed)}]"
