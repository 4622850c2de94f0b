"""The check of the digest at the end of a log: stores are asked by it, so it has to say what the log says."""

from __future__ import annotations

from collections import Counter
from typing import BinaryIO

from mcap import records

from recorder.encoding.event_digest import DIGEST_NAME, SPARED, Digest, DigestUnreadableError, digested_kind
from recorder.mcap.columns import Messages
from recorder.mcap.reader import DamagedError, record_at
from recorder.mcap.summary_reader import LogSummary, read_summary
from recorder.review.checking.findings import Findings


class DigestCheck:
    """Holds a digest against the messages of its log, which are taken as they are read.

    Args:
        stream: the log.
        findings: takes what is wrong.
    """

    def __init__(self, stream: BinaryIO, findings: Findings) -> None:
        self._findings = findings
        self._digest: Digest | None = None
        self._expected: Counter[int] = Counter()
        """Hashes of the digest's messages that have not been found in the log yet."""
        self._whole: set[int] = set()
        """The channels of which it leaves nothing out..."""
        self._lacking = 0
        """...and messages of them that it does not hold."""
        summary = read_summary(stream)
        if summary is not None and any(one.name == DIGEST_NAME for one in summary.attachments):
            self._read(stream, summary)

    def _read(self, stream: BinaryIO, summary: LogSummary) -> None:
        places = [one for one in summary.attachments if one.name == DIGEST_NAME]
        count = 0 if summary.statistics is None else summary.statistics.message_count
        try:
            found = [record_at(stream, one.offset, records.Attachment) for one in places]
            digest = Digest([one.data for one in found if one is not None], count)
        except (DamagedError, DigestUnreadableError) as error:
            self._findings.file(f"the digest of events cannot be read: {error}", places[0].offset)
            return
        for one in digest.messages:
            self._expected[hash((one.channel_id, one.sequence, one.log_ns, one.publish_ns, one.data))] += 1
        for channel_id in digest.channels:
            channel = summary.channels.get(channel_id)
            schema = None if channel is None else summary.schemas.get(channel.schema_id)
            kind = None if schema is None else digested_kind(schema.name)
            if kind is not None and kind not in SPARED:
                self._whole.add(channel_id)
        # Its places are needed to the end, its messages no longer.
        digest.messages.clear()
        self._digest = digest

    def take(self, found: Messages, offset: int) -> None:
        """The messages of the chunk at an offset of the file."""
        if self._digest is None:
            return
        stretch = self._digest.stretch(found.start_ns, found.end_ns + 1)
        if stretch is None or offset < stretch[0] or (stretch[1] is not None and offset >= stretch[1]):
            self._findings.file("the digest of events says that this time is elsewhere", offset)
        for messages in found.by_channel:
            channel_id = messages.channel_id
            if channel_id not in self._digest.channels:
                continue
            is_whole = channel_id in self._whole
            columns = messages.sequences, messages.log_ns, messages.publish_ns, messages.datas
            for sequence, log_ns, publish_ns, data in zip(*columns, strict=True):
                one = hash((channel_id, sequence, log_ns, publish_ns, data))
                if one in self._expected:
                    self._expected[one] -= 1
                    if not self._expected[one]:
                        del self._expected[one]
                else:
                    self._lacking += is_whole

    def settle(self) -> None:
        """All has been read."""
        if self._expected:
            count = self._expected.total()
            self._findings.file("the digest of events holds messages that the log does not", count=count)
        if self._lacking:
            self._findings.file("the digest of events lacks messages of the log", count=self._lacking)
