"""Run a command cut off from every network, and list all that it looked up or connected to.

    seen = watch([sys.executable, "-m", "pica_command", "doctor"], home=tmp_path)

``unshare`` gives the command user, mount and network namespaces of its own. Loopback is the only
interface there, and *every* address is routed to it: nothing leaves, nothing fails for want of a
route, and a raw socket on loopback sees each packet, whether Python or a native library sent it.
The name server is an address of the same kind, so a look-up is a packet, too.

Not seen: what goes through a unix socket to a daemon of the machine (nsswitch.conf is replaced, so
that none is asked for names), and a connection over IPv6 where the kernel has none.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from ipaddress import ip_address
from pathlib import Path

NAME_SERVER = "192.0.2.53"
"""An address for documentation (RFC 5737): nobody has it."""
PACKET_OUTGOING, ETH_P_ALL, SOL_PACKET, PACKET_STATISTICS = 4, 3, 263, 6
IPV4, IPV6, TCP, UDP, ICMP, ICMPV6 = 0x0800, 0x86DD, 6, 17, 1, 58
SYN, ACK = 0x02, 0x10


def reason_not_to_watch() -> str | None:
    """Why this machine cannot watch a command, or None if it can."""
    if any(shutil.which(tool) is None for tool in ("unshare", "ip", "mount")):
        return "needs Linux with unshare, ip and mount"
    done = subprocess.run(
        ["unshare", "-rnm", "ip", "link", "set", "lo", "up"], capture_output=True, check=False
    )
    return None if done.returncode == 0 else "namespaces of one's own are not permitted here"


def watch(command: Sequence[str], *, home: Path, timeout_s: float = 120.0) -> list[str]:
    """Run `command` to its end and return what it sent beyond loopback.

    Args:
        command: Program and arguments; it must end with status 0.
        home: Home and working folder of the command.
        timeout_s: Real seconds it may take.

    Returns:
        One line for each look-up ("look-up NAME"), each connection and each datagram ("tcp
        ADDRESS:PORT", "udp ADDRESS:PORT"), without repetitions, in order.
    """
    report = home / "network.json"
    environment = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    done = subprocess.run(
        ["unshare", "-rnm", sys.executable, __file__, str(report), *command],
        cwd=home,
        env={**environment, "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(report.read_text())
    assert found["lost_packets"] == 0
    seen: list[str] = found["seen"]
    return seen


def _isolate() -> None:
    """Make every address this machine's own, and every look-up a packet to `NAME_SERVER`."""
    run: Callable[..., object] = subprocess.check_call
    run(["ip", "link", "set", "lo", "up"])
    run(["ip", "route", "add", "local", "0.0.0.0/0", "dev", "lo"])
    if Path("/proc/net/if_inet6").exists():
        run(["ip", "-6", "route", "add", "local", "::/0", "dev", "lo"])
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (
            ("resolv.conf", f"nameserver {NAME_SERVER}\noptions timeout:1 attempts:1\n"),
            ("nsswitch.conf", "hosts: files dns\n"),
        ):
            target = Path("/etc", name)
            if target.exists():
                (Path(folder) / name).write_text(text)
                run(["mount", "--bind", str(Path(folder) / name), str(target.resolve())])


def _describe(packet: bytes, kind: int) -> str | None:
    """What a packet asks for; None within loopback, for an answer, and for the kernel's own."""
    if kind == IPV4:
        target, protocol, rest = packet[16:20], packet[9], packet[(packet[0] & 15) * 4 :]
    elif kind == IPV6:
        target, protocol, rest = packet[24:40], packet[6], packet[40:]
    else:
        return None
    address = ip_address(target)
    if address.is_loopback or protocol in (ICMP, ICMPV6):
        return None
    port = int.from_bytes(rest[2:4], "big")
    if protocol == UDP and str(address) == NAME_SERVER and port == 53:
        return f"look-up {_question(rest[20:])}"
    if protocol == TCP:
        return f"tcp {address}:{port}" if rest[13] & (SYN | ACK) == SYN else None
    return f"udp {address}:{port}" if protocol == UDP else f"protocol {protocol} {address}"


def _question(message: bytes) -> str:
    """The name that a DNS question asks for; `message` begins behind the header of 12 bytes."""
    labels, at = [], 0
    while length := message[at]:
        labels.append(message[at + 1 : at + 1 + length].decode("ascii", "replace"))
        at += length + 1
    return ".".join(labels)


def main(report: str, command: Sequence[str]) -> int:
    """Isolate this process, watch `command` and write the report; return its exit status."""
    _isolate()
    seen: dict[str, None] = {}
    with socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(ETH_P_ALL)) as sniffer:
        sniffer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
        sniffer.bind(("lo", 0))
        sniffer.settimeout(0.2)
        has_ended = threading.Event()

        def listen() -> None:
            while True:
                try:
                    packet, (_, kind, direction, *_) = sniffer.recvfrom(65535)
                except TimeoutError:
                    if has_ended.is_set():
                        return
                    continue
                if direction == PACKET_OUTGOING and (what := _describe(packet, kind)):
                    seen[what] = None

        listener = threading.Thread(target=listen)
        listener.start()
        status = subprocess.run(command, check=False).returncode
        has_ended.set()
        listener.join()
        size = 2 * ctypes.sizeof(ctypes.c_uint)
        lost = sniffer.getsockopt(SOL_PACKET, PACKET_STATISTICS, size)[4:]
    found = {"seen": list(seen), "lost_packets": int.from_bytes(lost, sys.byteorder)}
    Path(report).write_text(json.dumps(found))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
