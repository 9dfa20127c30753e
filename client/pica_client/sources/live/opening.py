"""The live kinds of ``--source``.

livelink[:[HOST:]PORT][/SUBJECT]   Live Link Face, ARKit mode; one of several phones by its name
vmc[:[HOST:]PORT]                  VTuber programs that speak VMC
livelink:lan, vmc:lan[:PORT]       the same from other machines, such as a phone
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
from pica_client.sources.live.ifacialmocap import REQUESTS
from pica_client.sources.live.tracker import SampleTap, Tracker
from pica_client.sources.live.udp import ANY_HOST, LOOPBACK, Decode, UdpOptions, UdpTracker

LIVE_HELP: Final = (
    "livelink[:lan][:PORT][/SUBJECT], vmc[:lan][:PORT], ifacialmocap:PHONE_IP, "
    "facemotion3d:PHONE_IP or webcam[:DEVICE|FILE] for a face as it moves"
)
LIVE_KINDS: Final = ("livelink", "vmc", *REQUESTS)
"""Trackers that send datagrams."""
TRACKER_KINDS: Final = (*LIVE_KINDS, "webcam")
"""All live sources."""


def decoder_of(kind: str) -> Callable[[], Decode]:
    """What makes a decoder for the datagrams of one sender, by the kind of tracker."""
    if kind == "vmc":
        return lambda: vmc.VmcDecoder().decode
    read = livelink.decode if kind == "livelink" else ifacialmocap.decode
    return lambda: lambda packet: (read(packet),)


def open_live(
    kind: str, rest: str, calibration: Calibration | None = None, tap: SampleTap | None = None
) -> Tracker:
    """Begin to read a tracker.

    Args:
        kind: One of `TRACKER_KINDS`.
        rest: What the user wrote behind the kind, without the colon.
        tap: Sees what arrives.

    Raises:
        SourceError: The text is of another form, or the port, the camera or what it needs is not to
            be had; says what to do.
    """
    if kind == "webcam":
        # Only here: its networks need packages of their own.
        from pica_client.sources.webcam.model import load_networks
        from pica_client.sources.webcam.webcam import Webcam

        return Webcam(rest, load_networks(), calibration, tap)
    return UdpTracker(parse_live(kind, rest), decoder_of(kind), calibration, tap)


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
        port, request = REQUESTS[kind]
        # A program that plays the phone on this machine has the same port, at another address.
        host = LOOPBACK if phone.is_loopback else ANY_HOST
        return UdpOptions(kind, port, phone=str(phone), request=request, host=host)
    place, _, subject = rest.partition("/")
    host, colon, number = ("lan", ":", "") if place == "lan" else place.rpartition(":")
    port = livelink.DEFAULT_PORT if kind == "livelink" else vmc.DEFAULT_PORT
    if number and not (number.isdecimal() and int(number) < 65_536):
        raise SourceError(f"{kind}:{rest}: {number!r} is no port; write {kind}:{port}")
    if host == "lan":
        host = ANY_HOST
    elif colon:
        try:
            host = str(ipaddress.IPv4Address(host))
        except ValueError:
            raise SourceError(f"{kind}:{rest}: {host!r} is no address of this machine") from None
    port = int(number) if number else port
    return UdpOptions(kind, port, subject=subject, host=host or LOOPBACK)
