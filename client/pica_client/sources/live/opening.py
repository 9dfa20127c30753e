"""The live kinds of ``--source``.

livelink[:[HOST:]PORT][/SUBJECT]   Live Link Face, ARKit mode; one of several phones by its name
vmc[:[HOST:]PORT]                  VTuber programs that speak VMC
ifacialmocap:PHONE                 the app of that name, at the phone's address
facemotion3d:PHONE                 the app of that name
webcam[:DEVICE|FILE]               a camera of this machine, or a video that stands in for one
"""

import ipaddress
from collections.abc import Callable
from typing import Final

from pica_client.errors import SourceError
from pica_client.sources.live import ifacialmocap, livelink, vmc
from pica_client.sources.live.calibration import Calibration
from pica_client.sources.live.live_face import LiveFace
from pica_client.sources.live.tracker import SampleTap, Tracker
from pica_client.sources.live.udp import Decode, UdpOptions, UdpTracker

LIVE_HELP: Final = (
    "livelink[:PORT][/SUBJECT], vmc[:PORT], ifacialmocap:PHONE_IP, facemotion3d:PHONE_IP or "
    "webcam[:DEVICE|FILE] for a face as it moves"
)
REQUESTS: Final = {
    "ifacialmocap": ifacialmocap.IFACIALMOCAP,
    "facemotion3d": ifacialmocap.FACEMOTION3D,
}


def decoder_of(kind: str) -> Decode:
    """A new decoder for the datagrams of a kind of tracker."""
    decoders: dict[str, Callable[[], Decode]] = {
        "livelink": lambda: lambda packet: (livelink.decode(packet),),
        "vmc": lambda: vmc.VmcDecoder().decode,
        "ifacialmocap": lambda: lambda packet: (ifacialmocap.decode(packet),),
        "facemotion3d": lambda: lambda packet: (ifacialmocap.decode(packet),),
    }
    return decoders[kind]()


LIVE_KINDS: Final = ("livelink", "vmc", *REQUESTS)
"""Trackers that send datagrams."""
TRACKER_KINDS: Final = (*LIVE_KINDS, "webcam")
"""All live sources."""


def open_live(
    kind: str, rest: str, calibration: Calibration | None = None, tap: SampleTap | None = None
) -> Tracker:
    """Begin to read a tracker.

    Args:
        kind: One of `TRACKER_KINDS`.
        rest: What the user wrote behind the kind, without the colon.
        tap: Sees what arrives.

    Raises:
        SourceError: The text is of another form, or the port or the camera is not to be had.
    """
    if kind == "webcam":
        # Only here: its networks need packages of their own.
        from pica_client.sources.webcam.webcam import open_webcam

        return open_webcam(rest, calibration, tap)
    return UdpTracker(parse_live(kind, rest), decoder_of(kind), LiveFace(calibration), tap)


def parse_live(kind: str, rest: str) -> UdpOptions:
    """Read what stands behind the kind.

    Raises:
        SourceError: It is of another form.
    """
    if kind in REQUESTS:
        try:
            phone = ipaddress.IPv4Address(rest)
        except ValueError:
            raise SourceError(
                f"{kind}:{rest} needs the phone's address, which the app shows: {kind}:192.168.0.7"
            ) from None
        request = REQUESTS[kind]
        # A program that plays the phone on this machine has the same port, at another address.
        host = "127.0.0.1" if phone.is_loopback else "0.0.0.0"
        return UdpOptions(kind, request.port, phone=str(phone), request=request, host=host)
    place, _, subject = rest.partition("/")
    host, colon, port = place.rpartition(":")
    usual = livelink.DEFAULT_PORT if kind == "livelink" else vmc.DEFAULT_PORT
    if port and not (port.isdecimal() and int(port) < 65_536):
        raise SourceError(f"{kind}:{rest}: {port!r} is no port; write {kind}:{usual}")
    if colon:
        try:
            host = str(ipaddress.IPv4Address(host))
        except ValueError:
            raise SourceError(f"{kind}:{rest}: {host!r} is no address of this machine") from None
    return UdpOptions(
        kind, int(port) if port else usual, subject=subject, host=host if colon else "0.0.0.0"
    )
