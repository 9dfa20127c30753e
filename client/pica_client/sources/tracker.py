"""What all live sources share: samples go in when they come, a face comes out when it is asked
for."""

import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from pica_client.errors import SourceError
from pica_client.sources.calibration import Calibration
from pica_client.sources.datagrams import REQUESTS, decoder_of
from pica_client.sources.live_face import LiveFace, PacketError, TrackerSample
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.types import Image

SampleTap = Callable[[TrackerSample, float], None]
"""Sees a sample, and when it arrived on this machine's monotonic clock; called by the thread that
reads."""
END_S = 1.0
"""How long a reader has to end: a call waits meanwhile."""


class Tracker(ABC):
    """A live source: its face is that of now, whatever time is asked for. What reads it is for
    those that inherit from this, which start the thread.

    Attributes:
        refused: How often something came that is not the tracker's, by reason.
    """

    def __init__(self, calibration: Calibration | None, tap: SampleTap | None) -> None:
        self.face = LiveFace(calibration)
        self.refused: Counter[str] = Counter()
        self._tap = tap
        self._begin_s: float | None = None
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, name=type(self).__name__, daemon=True)

    def frame_at(self, time_s: float) -> ExpressionFrame:
        """The face of now; see `Source.frame_at`."""
        now = time.monotonic()
        with self._lock:
            frame = self.face.face_at(now)
        if self._begin_s is None:
            self._begin_s = now - time_s
        return replace(frame, captured_us=frame.captured_us - round(self._begin_s * 1e6))

    @property
    @abstractmethod
    def trouble(self) -> str:
        """Why there is no face, in one line for its user; empty while there is one."""

    @abstractmethod
    def _read(self) -> None:
        """Take samples until it is closing."""

    def close(self) -> None:
        """Stop reading, and free what was taken; a reader that stands still is not waited for."""
        self._closing.set()
        self._thread.join(timeout=END_S)

    def preview(self) -> Image | None:
        """What a camera sees, uint8 ``[H, W, 3]``; None of other trackers."""
        return None

    def _push(self, sample: TrackerSample, arrived_s: float) -> None:
        with self._lock:
            self.face.push(sample, arrived_s)
        if self._tap is not None:
            self._tap(sample, arrived_s)


READ_BYTES: Final = 16_384
"""Longest datagram that is read whole; a longer one is damaged."""
POLL_S: Final = 0.2
"""How often the thread looks whether it should end, while nothing comes."""
SILENT_S: Final = 3.0
"""After this long without a datagram the user is told where the tracker must send to, and a phone
that was asked is asked again."""

LOOPBACK, ANY_HOST = "127.0.0.1", "0.0.0.0"


class UdpTracker(Tracker):
    """A live source on a UDP port; it listens from its making to `close`.

    The first address that sends a face is the tracker; others are refused until it is silent.

    Attributes:
        sender: Address that sends the face; empty before the first one.
    """

    def __init__(
        self,
        kind: str,
        port: int,
        calibration: Calibration | None = None,
        tap: SampleTap | None = None,
        *,
        host: str = LOOPBACK,
        phone: str = "",
    ) -> None:
        """Listen.

        Args:
            kind: The source's name, as the user writes it.
            port: Ours, and the phone's that is asked; 0 takes a free one.
            host: Our address that receives; programs of other machines reach `ANY_HOST` alone.
            phone: Address of a phone that sends only when asked; empty for other programs.

        Raises:
            SourceError: The port is in use, or is not ours to take.
        """
        super().__init__(calibration, tap)
        self._kind, self._host, self._phone = kind, host, phone
        self._decode = decoder_of(kind)
        self.sender = ""
        self._last_address = ""
        self._heard_s = time.monotonic()
        self._has_heard = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise SourceError(
                f"{kind}: UDP port {port}: {error.strerror}; end the program that has it, or name "
                f"another one: {kind}:PORT"
            ) from error
        self._socket.settimeout(POLL_S)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that the tracker must send to."""
        port: int = self._socket.getsockname()[1]
        return port

    @property
    def trouble(self) -> str:
        """Say what is wrong, see `Tracker.trouble`."""
        kind = self._kind
        if time.monotonic() - self._heard_s < SILENT_S:
            return ""
        if self._phone:
            return f"{kind}: {self._phone} does not answer; is the app open there?"
        if self.refused and not self._has_heard:
            reason, _ = self.refused.most_common(1)[0]
            return f"{kind}: datagrams come, but: {reason}"
        silent = "no more datagrams" if self._has_heard else "no datagram yet"
        if self._host == LOOPBACK:
            return (
                f"{kind}: {silent} of this machine at port {self.port}; for a phone or another "
                f"machine use {kind}:lan"
            )
        return f"{kind}: {silent}; the tracker must send to {own_address()}, port {self.port}"

    def close(self) -> None:
        """Stop listening, and free the port."""
        super().close()
        self._socket.close()

    def _read(self) -> None:
        asked_s = -SILENT_S
        while not self._closing.is_set():
            now = time.monotonic()
            if self._phone and now - max(asked_s, self._heard_s) > SILENT_S:
                self._ask()
                asked_s = now
            try:
                packet, (address, _) = self._socket.recvfrom(READ_BYTES)
            except OSError:  # the wait is over; or a port is closed, as Windows reports
                continue
            if self._phone in ("", address):
                self._take(packet, address, time.monotonic())

    def _ask(self) -> None:
        port, request = REQUESTS[self._kind]
        try:
            self._socket.sendto(request, (self._phone, port))
        except OSError as error:
            self.refused[f"the phone cannot be reached: {error.strerror}"] += 1

    def _take(self, packet: bytes, address: str, arrived_s: float) -> None:
        is_silent = not self._has_heard or arrived_s - self._heard_s > SILENT_S
        if not is_silent and address != self.sender:
            self.refused["another machine sends, too"] += 1
            return
        if address != self._last_address:
            self._last_address, self._decode = address, decoder_of(self._kind)
        try:
            samples = self._decode(packet)
        except PacketError as error:
            self.refused[str(error)] += 1
            return
        for sample in samples:
            self._heard_s, self._has_heard, self.sender = arrived_s, True, address
            self._push(sample, arrived_s)


def own_address() -> str:
    """The address of this machine that others in its network most likely reach. Sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # only picks a route; no datagram leaves
            address: str = probe.getsockname()[0]
        except OSError:
            return "127.0.0.1"
    return address
