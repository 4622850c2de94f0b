"""Limits on a server's connections and rates."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.peers import (
    BURST_S,
    CONNECT_BURST_S,
    FRAME_BYTES,
    PEER_CONNECTIONS_MAX,
    PEER_CONNECTS_PER_S,
    PORTION_BYTES,
    Peers,
    RateLimit,
    SocketFrames,
    peer_of,
)

HOUR_S = 3600.0


def fill(peers: Peers[str], peer: str, count: int) -> list[str]:
    names = [f"{peer}/{number}" for number in range(count)]
    for number, name in enumerate(names):
        assert peers.enter(name, peer, number * HOUR_S) == []
    return names


def test_no_peer_has_more_than_its_share_and_its_oldest_silent_one_goes_first() -> None:
    peers = Peers[str](4 * PEER_CONNECTIONS_MAX)
    first, second, *others = fill(peers, "a", PEER_CONNECTIONS_MAX)
    peers.asks(first)
    assert peers.enter("new", "a", HOUR_S**2) == [second]
    assert len(peers) == PEER_CONNECTIONS_MAX
    for name in (*others, "new"):
        peers.asks(name)
    assert peers.enter("newer", "a", 2 * HOUR_S**2) is None
    assert peers.enter("other", "b", 2 * HOUR_S**2) == []
    peers.rests(first)
    assert peers.enter("newer", "a", 3 * HOUR_S**2) == [first]
    peers.leave("new")
    assert peers.enter("newest", "a", 4 * HOUR_S**2) == []


def test_where_all_places_are_taken_the_peer_with_the_most_gives_one() -> None:
    peers = Peers[str](10)
    fill(peers, "b", 1)
    oldest, *_ = fill(peers, "a", 9)
    assert peers.enter("new", "c", HOUR_S**2) == [oldest]


def test_no_peer_connects_faster_than_its_rate() -> None:
    peers = Peers[int](10_000)
    at_once = sum(peers.enter(number, "a", HOUR_S) is not None for number in range(10_000))
    assert 1 < at_once <= PEER_CONNECTS_PER_S * CONNECT_BURST_S + 1
    assert peers.enter(-1, "b", HOUR_S) is not None
    assert peers.enter(-2, "a", HOUR_S + 1.5 / PEER_CONNECTS_PER_S) is not None


@pytest.mark.parametrize(
    ("host", "peer"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
    ],
)
def test_a_network_of_ipv6_is_one_peer(host: str, peer: str) -> None:
    assert peer_of(host) == peer


def frame(opcode: int, size: int, *, is_last: bool = True, is_masked: bool = True) -> bytes:
    short = size if size < 126 else 126 if size < 1 << 16 else 127
    length = size.to_bytes({126: 2, 127: 8}[short]) if short > 125 else b""
    head = bytes([0x80 * is_last | opcode, 0x80 * is_masked | short])
    return head + length + (b"mask" if is_masked else b"") + bytes(size)


FRAMES = st.builds(
    frame, st.sampled_from([1, 2, 9, 10]), st.sampled_from([0, 1, 125, 126, 4000, 70_000]), is_masked=st.booleans()
)


@given(st.lists(FRAMES, max_size=12), st.data())
def test_each_frame_counts_and_no_portion_is_large(frames: list[bytes], data: st.DataObject) -> None:
    left, total, counts = b"".join(frames), 0, SocketFrames()
    carried = sum(len(one) for one in frames)
    while left:
        piece = left[: data.draw(st.integers(1, 5000))]
        place, cost = counts.portion(piece)
        assert 0 < place <= len(piece)
        assert FRAME_BYTES <= cost < PORTION_BYTES + FRAME_BYTES
        assert place <= cost + 14  # of its head, which counts with its frame
        left, total = left[place:], total + cost
    assert total >= len(frames) * FRAME_BYTES + carried - 14 * len(frames)


def test_pieces_of_a_message_are_counted() -> None:
    counts = SocketFrames()
    seen = []
    for one in (frame(2, 3, is_last=False), frame(9, 0), frame(0, 0, is_last=False), frame(0, 0), frame(1, 1)):
        counts.portion(one)
        seen.append(counts.pieces)
    assert seen == [1, 1, 2, 0, 0]


@given(
    st.lists(st.tuples(st.integers(1, 100_000), st.floats(0, 5)), min_size=1, max_size=50),
    st.integers(1000, 10**6),
)
def test_no_more_goes_than_the_rate_and_a_moment(steps: list[tuple[int, float]], rate: int) -> None:
    pace, now_s, went = RateLimit(rate), 1000.0, 0
    for count, pause_s in steps:
        now_s += pause_s
        now_s += pace.delay_s(count, now_s)
        went += count
        assert went <= rate * (now_s - 1000.0 + BURST_S) * (1 + 1e-9) + 1
