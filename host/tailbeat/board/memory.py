"""What a board stores: its reference, what it has learned, trial logs, and its crash report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.core import records
from tailbeat.core.errors import InputError, Refused, TransferError
from tailbeat.core.faults import BAD_DATA, BAD_FILE, NO_REFERENCE, refusal
from tailbeat.core.lazy_arrays import F32, ArrayLike, NDArray, np
from tailbeat.core.native import ffi, lib
from tailbeat.core.records import Amplitudes
from tailbeat.link import _dialect as mavlink
from tailbeat.link.ftp.client import FtpClient
from tailbeat.link.ftp.wire import FtpError, Progress
from tailbeat.link.mavlink import Link, Message
from tailbeat.link.messages import BoardStatus, TrialFile

if TYPE_CHECKING:
    from tailbeat.core.reference import Reference

TRIALS = "/trials"
_FTP_NOT_FOUND = 10
_PER_PIECE = 32
_NEXT = mavlink.TAILBEAT_AMPLITUDE_SET_NEXT
_BEST = mavlink.TAILBEAT_AMPLITUDE_SET_BEST
_VISITS = mavlink.TAILBEAT_AMPLITUDE_SET_VISITS
_PEAKS = mavlink.TAILBEAT_AMPLITUDE_SET_PEAKS
_VISITS_MAX = 255
_STEADY_TRIES = 5


_CRASH_PATH = "/crash.bin"
_CRASH_KINDS = {
    1: "assertion",
    2: "hard fault",
    3: "memory fault",
    4: "bus fault",
    5: "usage fault",
    6: "unexpected interrupt",
}
# Configurable Fault Status Register (ARMv7-M, B3.2.15): bit, meaning.
_CFSR = {
    0: "instruction fetch not allowed",
    1: "access not allowed (stack guard)",
    4: "stacking ran into the stack guard",
    8: "instruction fetch failed",
    9: "no such address",
    10: "no such address (buffered write)",
    12: "stacking failed",
    16: "undefined instruction",
    17: "invalid state",
    18: "invalid return from an exception",
    24: "unaligned access",
    25: "division by zero",
}


@dataclass(frozen=True)
class CrashReport:
    """``registers``: those of the moment: pc, lr (the return address), sp, and what else the
    board's core has, by name."""

    kind: str
    where: str  # "file:line" of a failed assertion, else ""
    reasons: list[str]  # what the fault status register of ARMv7-M says, where there is one
    time_s: float  # since the boot that crashed
    crashes: int  # since power-on
    build_id: str
    registers: dict[str, int]
    stack: list[int]


def decode_crash(record: bytes) -> CrashReport:
    """Raises InputError when ``record`` is no sound /crash.bin."""
    report = ffi.new("crash_report_t *")
    if lib.record_decode_crash(ffi.from_buffer(record), len(record), report):
        raise InputError("not a sound crash record", "Pull it again: tailbeat board crash")
    crash = report.crash
    registers = {"pc": crash.pc, "lr": crash.return_address, "sp": crash.sp}
    for name, value in zip(report.register_names, crash.registers, strict=True):
        registers[ffi.string(name).decode("ascii", "replace")] = value
    registers.pop("", None)
    return CrashReport(
        kind=_CRASH_KINDS.get(crash.kind, f"kind {crash.kind}"),
        where=ffi.string(crash.where).decode("ascii", "replace"),
        reasons=[text for bit, text in _CFSR.items() if registers.get("cfsr", 0) >> bit & 1],
        time_s=crash.time_us * 1e-6,
        crashes=crash.crashes,
        build_id=ffi.string(report.build_id).decode("ascii", "replace"),
        registers=registers,
        stack=[int(word) for word in crash.stack[0 : crash.stack_words]],
    )


class BoardMemory:
    """The content of a board: records and trial logs by file transfer, input and counts by message.

    Parameters
    ----------
    link : Link
        The MAVLink conversation with the board.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.ftp = FtpClient(link)
        self._counts_visits: bool | None = None  # None: not asked yet

    def status(self) -> BoardStatus:
        """Where the board stands now."""
        return BoardStatus.of(self.link.request("TAILBEAT_STATUS"))

    def reference_record(self) -> bytes | None:
        """The board's reference as it is stored, see records.decode_reference."""
        return self._record("/reference.bin")

    def upload_reference(
        self, reference: bytes | Reference, progress: Progress | None = None
    ) -> int:
        """Make a reference the board's; do nothing when the board has it already.

        Parameters
        ----------
        reference : Reference or bytes
            The reference, or its record (``TBRF`` of the protocol).
        progress : callable, optional
            Gets how many bytes of how many are sent.

        Returns
        -------
        int
            The CRC by which the reference is known.

        Raises
        ------
        Refused
            The board does not take it: too fast, too long, a trial is pending, ...
        """
        record = reference if isinstance(reference, bytes) else reference.record()
        crc = records.record_crc(record)
        if self.status().reference_crc != crc:
            self._upload(records.FILE_REFERENCE, record, progress)
        return crc

    def upload_amplitudes(self, amplitude_rad: ArrayLike) -> None:
        """Make amplitudes computed elsewhere the input of the next trial.

        Parameters
        ----------
        amplitude_rad : array_like, shape (beats,)
            Amplitudes, rad, 0 or more, for the board's reference.

        Raises
        ------
        Refused
            The board has no reference, or does not take them.
        """
        crc = self.status().reference_crc
        if crc is None:
            raise refusal(NO_REFERENCE)
        self._upload(records.FILE_AMPLITUDES, records.encode_amplitudes(crc, amplitude_rad))

    def amplitudes(self, best: bool = False) -> Amplitudes:
        """Read the feedforward input of the next trial or of the best so far, bit for bit.

        Parameters
        ----------
        best : bool
            The best input as it was applied, instead of the next one (unsaturated).

        Returns
        -------
        Amplitudes
            ``values`` of float32, shape (beats,), rad.
        """
        stored = self._stored(_BEST if best else _NEXT)
        # A board that does not report what made its input counts no updates either, and sends 0.
        if stored.input == 0 and self._counts_visits is None:
            self.visit_counts()
        return stored if stored.input or self._counts_visits else replace(stored, input=None)

    def visits(self) -> NDArray[np.uint8] | None:
        """Read how many trials have corrected each beat.

        Returns
        -------
        ndarray of uint8, shape (beats,), or None
            At most 255; None when the board does not count them.
        """
        counts = self.visit_counts()
        return None if counts is None else np.array(counts, dtype=np.uint8)

    def visit_counts(self) -> tuple[int, ...] | None:
        """As ``visits``, as whole numbers."""
        counts = self._known(_VISITS)
        self._counts_visits = counts is not None
        if counts is None:
            return None
        if not all(0 <= count <= _VISITS_MAX for count in counts):
            raise TransferError(
                "the board's update counts are no numbers from 0 to 255",
                "Its firmware or its storage is damaged: tailbeat board check",
            )
        return tuple(map(int, counts))

    def peaks(self) -> F32 | None:
        """Read the best trial's largest errors.

        Returns
        -------
        ndarray of float32, shape (beats,), or None
            |e| at their beats, m/s, 0 at all others; negative where it is an earlier best's, at a
            beat that the best did not measure. None: the board does not keep them.
        """
        peaks = self._known(_PEAKS)
        return None if peaks is None else np.array(peaks, dtype=np.float32)

    def learned_record(self) -> bytes | None:
        """All that was learned, as upload_learned takes it; None when there is nothing."""
        status = self.status()
        if status.iteration == 0:
            return None
        visits = self.visits()
        best = self.amplitudes(best=True) if status.best_iteration else None
        peaks = None if visits is None or best is None else self.peaks()
        return records.encode_learned(status, self.amplitudes(), best, visits, peaks)

    def upload_learned(self, record: bytes) -> None:
        """Make a record all that the board has learned.

        Parameters
        ----------
        record : bytes
            Of ``learned_record``, for the board's reference.

        Raises
        ------
        Refused
            It is of another reference, or damaged.
        """
        self._upload(records.FILE_LEARNED, record)

    def upload_speeds(self, trial: int, speed_m_s: ArrayLike, sigma_m_s: ArrayLike) -> None:
        """Give the pending trial its speeds.

        Parameters
        ----------
        trial : int
            Its number.
        speed_m_s : array_like, shape (beats,)
            Mean speed of each beat, m/s; NaN = not measured.
        sigma_m_s : array_like
            Their standard deviations, m/s; a scalar or shape (beats,).

        Raises
        ------
        Refused
            Another trial is pending, or none.
        """
        record = records.encode_speeds(trial, speed_m_s, sigma_m_s)
        self._upload(records.FILE_SPEEDS, record)

    def past_record(self, path: str) -> bytes | None:
        """Read a past trial that the board's average includes.

        Parameters
        ----------
        path : str
            As ``records.past_path`` gives it.

        Returns
        -------
        bytes or None
            The record; None: there is none.
        """
        return self._record(path)

    def crash_report(self) -> CrashReport | None:
        """How the firmware last died; None when it never has."""
        record = self.crash_record()
        return None if record is None else decode_crash(record)

    def crash_record(self) -> bytes | None:
        """The same as it is stored."""
        return self._record(_CRASH_PATH)

    def trials(self) -> list[TrialFile]:
        """Trial logs on the board, oldest first."""
        found = []
        for entry in self.ftp.list(TRIALS):
            stem, _, kind = entry.name.partition(".")
            if kind == "ulg" and stem.isascii() and stem.isdigit():
                found.append(TrialFile(int(stem), f"{TRIALS}/{entry.name}", entry.size))
        return sorted(found, key=lambda trial: trial.number)

    def pull_trial(self, number: int, folder: Path, progress: Progress | None = None) -> Path:
        """Copy a trial's log; resume what an earlier call began.

        Parameters
        ----------
        number : int
            Of the trial.
        folder : Path
            Where ``NNNN.ulg`` is written.
        progress : callable, optional
            Gets how many bytes of how many have come.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        TransferError
            There is no such trial, or the copy failed.
        """
        local = folder / f"{number:04d}.ulg"
        stored = f"{TRIALS}/{number:04d}"
        try:
            self.ftp.pull(f"{stored}.ulz", local, progress, records.unpack_log)
        except FtpError as error:
            if error.code != _FTP_NOT_FOUND:
                raise
            # earlier firmware has no packed logs
            self.ftp.pull(f"{stored}.ulg", local, progress, records.unpack_log)
        return local

    def _record(self, path: str) -> bytes | None:
        try:
            return self.ftp.read(path)
        except FtpError as error:
            if error.code == _FTP_NOT_FOUND:
                return None
            raise

    def _upload(self, file: int, record: bytes, progress: Progress | None = None) -> None:
        self.ftp.write(records.PATHS[file], record, progress)
        crc = records.crc32(record)
        signed = crc - (1 << 32) if crc & 0x80000000 else crc
        try:
            self.link.command_int(mavlink.TAILBEAT_CMD_COMMIT, float(file), len(record), signed)
        except Refused as refused:
            if refused.number != BAD_FILE or self._is_there(file):
                raise  # one that came twice finds the file gone: it was taken over at the first

    def _is_there(self, file: int) -> bool:
        try:
            self.ftp.crc32(records.PATHS[file])
        except FtpError as error:
            if error.code == _FTP_NOT_FOUND:
                return False
            raise
        return True

    def _known(self, kind: int) -> list[float] | None:
        """None: older firmware does not know this kind."""
        try:
            return self._steady(kind)[1]
        except Refused as refused:
            if refused.number != BAD_DATA:
                raise
            return None

    def _stored(self, kind: int) -> Amplitudes:
        """One value per beat, of one moment. Raises TransferError while they change."""
        first, values = self._steady(kind)
        return Amplitudes(*_series(first), np.array(values, dtype=np.float32), first.input)

    def _steady(self, kind: int) -> tuple[Message, list[float]]:
        for _ in range(_STEADY_TRIES):
            first = self._piece(0, kind)
            series = _series(first)
            values = list(first.amplitude_rad[: first.count])
            steady = True
            while steady and len(values) < first.beats:
                piece = self._piece(len(values), kind)
                steady = piece.count > 0 and _series(piece) == series
                values += piece.amplitude_rad[: piece.count]
            if steady:
                return first, values
        raise TransferError(
            "the board's amplitudes change while they are read", "Try again when it is idle."
        )

    def _piece(self, first: int, kind: int) -> Message:
        """The values of some beats from ``first`` on."""
        return self.link.request(
            "TAILBEAT_AMPLITUDES",
            first,
            kind,
            where=lambda m: m.first == first and m.set == kind and m.count <= _PER_PIECE,
        )


def _series(piece: Message) -> tuple[int, int, int]:
    """What is the same in all pieces of one series of values."""
    return piece.iteration, piece.beats, piece.reference_crc
