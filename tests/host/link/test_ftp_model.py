"""The board's FTP server against a model of it: two hosts, one on the radio, one on the wire, who
open, read, write, remove and give up as hypothesis likes, with power cycles in between.

``FTP_MODEL_EXAMPLES`` asks for more than the suite's sequences of requests.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tailbeat.core.records import crc32
from tailbeat.link import _dialect as mavlink
from tailbeat.sim.board import CONSOLE, RADIO, SimBoard

NONE, TERMINATE, RESET, LIST, OPEN, READ, CREATE, WRITE, REMOVE = range(9)
OPEN_TO_WRITE, CRC, BURST, ACK, NAK = 11, 14, 15, 128, 129
OK, ERRNO, BAD_SIZE, BAD_SESSION, NO_SESSIONS, EOF, PROTECTED, NOT_FOUND = 0, 2, 3, 4, 5, 6, 9, 10
FILE_MAX = 16384
DATA_MAX = 239
SILENT_S = 5.0

UPLOADS = ("/in/reference.bin", "/in/amplitudes.bin", "/in/speeds.bin", "/in/learned.bin")
RECORDS = ("/reference.bin", "/crash.bin", "/past0.bin", "/past7.bin")
HIDDEN = ("/params.bin", "/key.bin", "/in/other.bin", "/in/../key.bin", "/nothing", "/in", "")

HOSTS = {"laptop": (RADIO, 255), "tablet": (CONSOLE, 250)}
hosts = st.sampled_from(sorted(HOSTS))
paths = st.sampled_from((*UPLOADS, *UPLOADS, *RECORDS, *HIDDEN))
sessions = st.integers(0, 2)
offsets = st.one_of(
    st.integers(0, 700), st.sampled_from([FILE_MAX - 100, FILE_MAX - 1, FILE_MAX, 0xFFFFFFFF])
)
sizes = st.integers(0, DATA_MAX)


@dataclass
class Reply:
    """What came back."""

    error: int
    session: int
    offset: int
    data: bytes
    complete: bool


@dataclass
class Session:
    """The one that is open."""

    owner: str
    number: int
    path: str
    writing: bool
    content: bytearray
    removed: bool = False  # its file was, while it was open


@dataclass
class Model:
    """What a server must hold."""

    files: dict[str, bytes] = field(default_factory=dict)
    session: Session | None = None
    used_s: float = 0.0

    def close(self) -> None:
        if self.session and self.session.writing and not self.session.removed:
            self.files[self.session.path] = bytes(self.session.content)
        self.session = None

    def owned(self, host: str, number: int) -> Session | None:
        session = self.session
        owned = session and session.owner == host and session.number == number
        return session if owned else None


class Wire:
    """Both hosts' ends of the lines."""

    def __init__(self) -> None:
        self.board = SimBoard("tank", seed=1)
        self.board.world.set_imu(False)
        self.booted()
        self._pack = {
            name: mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
            for name, (_, system) in HOSTS.items()
        }
        self._parse = {name: mavlink.MAVLink(None) for name in HOSTS}
        for parser in self._parse.values():
            parser.robust_parsing = True  # what overflows the line while nobody reads is cut
        self._seq = 0

    def booted(self) -> None:
        """Waits until the board listens."""
        while self.board.board_time_s < 0.1:
            self.board.run(0.1)

    def frame(self, host: str, opcode: int, session: int, offset: int, size: int, data: bytes):
        self._seq = (self._seq + 1000) & 0xFFFF
        payload = struct.pack("<HBBBBBBI", self._seq, session, opcode, size, 0, 0, 0, offset) + data
        message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload.ljust(251, b"\0"))
        return message.pack(self._pack[host])

    def replies(self, host: str, frame: bytes, patience_s: float = 2.0) -> list[Reply]:
        """Those that follow, up to the last of a burst."""
        port, _ = HOSTS[host]
        self._parse[host].parse_buffer(self.board.read(port))  # the rest of a frame, too
        self.board.write(frame, port)
        end_s = self.board.time_s + patience_s
        found: list[Reply] = []
        while self.board.time_s < end_s:
            self.board.run(0.05, port)
            for message in self._parse[host].parse_buffer(self.board.read(port)) or ():
                if message.get_type() == "FILE_TRANSFER_PROTOCOL":
                    found.append(self._reply(bytes(message.payload)))
                    end_s = self.board.time_s + patience_s
            if found and (
                found[-1].complete or found[-1].error or (len(found) == 1 and not_burst(frame))
            ):
                break
        return found

    def _reply(self, payload: bytes) -> Reply:
        _, session, opcode, size, _, complete, _, offset = struct.unpack_from("<HBBBBBBI", payload)
        assert opcode in (ACK, NAK)
        assert size <= DATA_MAX
        data = payload[12 : 12 + size]
        return Reply(data[0] if opcode == NAK else OK, session, offset, data, bool(complete))


def not_burst(frame: bytes) -> bool:
    """By the opcode within the frame."""
    return frame[10 + 3 + 3] != BURST


class FtpModel(RuleBasedStateMachine):
    """Each rule asks the board and the model, and compares."""

    def __init__(self) -> None:
        super().__init__()
        self.wire = Wire()
        self.model = Model()
        self.last: tuple[str, bytes, Reply] | None = None  # changed something, was acknowledged

    def ask(
        self,
        host: str,
        opcode: int,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
    ) -> Reply:
        frame = self.wire.frame(
            host, opcode, session, offset, len(data) if size is None else size, data
        )
        (reply,) = self.wire.replies(host, frame)
        changes = opcode in (TERMINATE, OPEN, CREATE, OPEN_TO_WRITE, WRITE, REMOVE)
        self.last = (host, frame, reply) if changes and reply.error == OK else None
        return reply

    def settle(self) -> None:
        """Whether the owner counts as silent must not depend on some milliseconds."""
        if 4.0 < self.wire.board.time_s - self.model.used_s < SILENT_S + 1.0:
            self.wire.board.run(2.0)

    def use(self, host: str) -> None:
        if self.model.session and self.model.session.owner == host:
            self.model.used_s = self.wire.board.time_s

    def may_take(self, host: str) -> bool:
        session = self.model.session
        silent = self.wire.board.time_s - self.model.used_s >= SILENT_S
        return session is None or session.owner == host or silent

    def expect(self, reply: Reply, error: int) -> bool:
        assert reply.error == error, (reply, error)
        return error == OK

    def shown(self, path: str) -> bool:
        return path in UPLOADS or path in RECORDS

    @rule(host=hosts, path=paths, number=sessions)
    def open(self, host: str, path: str, number: int) -> None:
        self.settle()
        takes = self.may_take(host)
        error = NOT_FOUND
        if self.shown(path):
            error = NO_SESSIONS
            if takes:
                self.model.close()
                error = OK if path in self.model.files else NOT_FOUND
        reply = self.ask(host, OPEN, number, data=path.encode())
        if self.expect(reply, error):
            content = self.model.files[path]
            self.model.session = Session(host, number, path, False, bytearray(content))
            assert int.from_bytes(reply.data, "little") == len(content)
        self.use(host)

    @rule(host=hosts, path=paths, number=sessions, opcode=st.sampled_from([CREATE, OPEN_TO_WRITE]))
    def create(self, host: str, path: str, number: int, opcode: int) -> None:
        self.settle()
        takes = self.may_take(host)
        error = OK if path in UPLOADS else PROTECTED
        if error == OK and not takes:
            error = NO_SESSIONS
        if error == OK:
            self.model.close()
        if self.expect(self.ask(host, opcode, number, data=path.encode()), error):
            self.model.files.setdefault(path, b"")
            self.model.session = Session(host, number, path, True, bytearray())
        self.use(host)

    @rule(host=hosts, number=sessions, offset=offsets, size=sizes, seed=st.integers(0, 255))
    def write(self, host: str, number: int, offset: int, size: int, seed: int) -> None:
        session = self.model.owned(host, number)
        data = bytes((seed + i) & 0xFF for i in range(size))
        error = OK
        if session is None or not session.writing:
            error = BAD_SESSION
        elif size == 0:
            error = BAD_SIZE
        elif offset + size > FILE_MAX:
            error = ERRNO
        if self.expect(self.ask(host, WRITE, number, offset, data), error):
            assert session is not None
            session.content.extend(bytes(max(0, offset - len(session.content))))
            session.content[offset : offset + size] = data
        self.use(host)

    @rule(host=hosts, number=sessions, offset=offsets, size=sizes)
    def read(self, host: str, number: int, offset: int, size: int) -> None:
        session = self.model.owned(host, number)
        reply = self.ask(host, READ, number, offset, size=size)
        if session is None or session.writing:
            self.expect(reply, BAD_SESSION)
        elif not session.removed:
            wanted = bytes(session.content[offset : offset + (size or DATA_MAX)])
            if self.expect(reply, OK if wanted else EOF):
                assert reply.data == wanted
        self.use(host)

    @rule(host=hosts, number=sessions, offset=offsets, size=st.integers(20, DATA_MAX))
    def burst(self, host: str, number: int, offset: int, size: int) -> None:
        session = self.model.owned(host, number)
        self.last = None
        replies = self.wire.replies(host, self.wire.frame(host, BURST, number, offset, size, b""))
        if session is None or session.writing:
            self.expect(replies[0], BAD_SESSION)
        elif not session.removed:
            wanted = bytes(session.content[offset : offset + 160 * size])
            if self.expect(replies[0], OK if wanted else EOF):
                assert b"".join(reply.data for reply in replies) == wanted
                assert [reply.complete for reply in replies].index(True) == len(replies) - 1
                assert [r.offset for r in replies] == [
                    offset + i * size for i in range(len(replies))
                ]
        self.use(host)

    @rule(host=hosts, path=paths)
    def remove(self, host: str, path: str) -> None:
        error = OK if path in self.model.files else NOT_FOUND
        if path in RECORDS or path in ("/in", ""):
            error = PROTECTED
        if self.expect(self.ask(host, REMOVE, data=path.encode()), error):
            del self.model.files[path]
            if self.model.session and self.model.session.path == path:
                self.model.session.removed = True
        self.use(host)

    @rule(host=hosts, path=paths)
    def checksum(self, host: str, path: str) -> None:
        known = self.shown(path) and path in self.model.files
        reply = self.ask(host, CRC, data=path.encode())
        if self.expect(reply, OK if known else NOT_FOUND):
            assert int.from_bytes(reply.data, "little") == crc32(self.model.files[path])
        self.use(host)

    @rule(host=hosts, number=sessions)
    def terminate(self, host: str, number: int) -> None:
        owned = self.model.owned(host, number)
        if self.expect(self.ask(host, TERMINATE, number), OK if owned else BAD_SESSION):
            self.model.close()
        self.use(host)

    @rule(host=hosts)
    def reset(self, host: str) -> None:
        self.settle()
        takes = self.may_take(host)
        self.expect(self.ask(host, RESET), OK)
        if takes:
            self.model.close()
        self.use(host)

    @rule(host=hosts)
    def list_uploads(self, host: str) -> None:
        reply = self.ask(host, LIST, data=b"/in")
        if self.expect(reply, OK if self.model.files else EOF):
            rows = {row.decode() for row in reply.data.split(b"\0") if row}
            wanted = {
                f"F{path.removeprefix('/in/')}\t{len(content)}"
                for path, content in self.model.files.items()
            }
            assert rows == wanted
        self.use(host)

    @precondition(lambda self: self.last is not None)
    @rule()
    def answer_was_lost(self) -> None:
        """The same request again says the same and does nothing."""
        assert self.last is not None
        host, frame, before = self.last
        assert self.wire.replies(host, frame) == [before]

    @rule(duration_s=st.sampled_from([0.5, 2.0, 7.0]))
    def time_passes(self, duration_s: float) -> None:
        self.wire.board.run(duration_s)
        self.last = None

    @rule()
    def power_cycle(self) -> None:
        """What was not closed is lost; a file that was made stays, empty."""
        self.wire.board.world.power_cycle()
        self.wire.booted()
        self.model.session = None
        self.last = None

    @invariant()
    def never_more_than_uploads(self) -> None:
        assert set(self.model.files) <= set(UPLOADS)

    def teardown(self) -> None:
        self.power_cycle()
        self.list_uploads("tablet")
        for path in UPLOADS:
            self.checksum("laptop", path)


FtpModel.TestCase.settings = settings(
    max_examples=int(os.environ.get("FTP_MODEL_EXAMPLES", "15")),
    stateful_step_count=30,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
test_the_server_does_what_the_model_does = FtpModel.TestCase
