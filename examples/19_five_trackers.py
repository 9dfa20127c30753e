"""Hold a call of five people who use five different trackers, and draw it.

You learn what each tracker sends: packets are made here, from a performance, and go over UDP to
real senders (`pica send --source ...`); the fifth plays a take that was recorded of such packets.
"""

import socket
import struct
import sys
import threading
import time
from pathlib import Path

from pythonosc.osc_message_builder import build_msg

from pica_client.local_call.processes import Children
from pica_client.sources import open_source
from pica_client.sources.live.take import TakeRecorder
from pica_client.sources.registry import open_live
from pica_core.avatar.arkit import ARKIT_NAMES, ExpressionFrame
from pica_core.avatar.shipped import shipped_avatar_files

HERE, PHONES, FPS = "127.0.0.1", ("127.0.0.2", "127.0.0.3"), 60
AVATARS = tuple(path.stem for path in shipped_avatar_files()[:5])
LIVE_LINK, RECORDED, VMC = 11911, 11912, 39939  # ports that no real tracker of yours uses


def live_link(face: ExpressionFrame, number: int) -> bytes:
    names = b"".join(struct.pack(">i", len(name)) + name for name in (b"a-device", b"me"))
    when = struct.pack(">ifii", number, 0.0, FPS, 1)
    return b"\x06" + names + when + struct.pack(">B61f", 61, *face.arkit, *[0.0] * 9)


def vmc(face: ExpressionFrame) -> list[bytes]:
    values = zip(ARKIT_NAMES, face.arkit.tolist(), strict=True)
    messages = [build_msg("/VMC/Ext/Blend/Val", [name, value]) for name, value in values]
    return [each.dgram for each in (*messages, build_msg("/VMC/Ext/Blend/Apply"))]


def line(face: ExpressionFrame, mark: str) -> bytes:
    """What iFacialMocap and Facemotion3d send: hundredths, and degrees."""
    values = zip(ARKIT_NAMES, face.arkit.tolist(), strict=True)
    shapes = "".join(f"{name}{mark}{round(100 * value)}|" for name, value in values)
    return f"{shapes}=head#0,0,0,0,0,0|rightEye#0,0,0|leftEye#0,0,0|".encode()


def play(stopping: threading.Event) -> None:
    """Be the trackers, until told to stop. Phones answer from addresses of their own."""
    faces = [open_source(f"performance:talk#{seed}") for seed in range(4)]
    ours, *phones = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
    for phone, address, port in zip(phones, PHONES, (49983, 49993), strict=True):
        phone.bind((address, port))
    begin_s = time.monotonic()
    while not stopping.wait(1 / FPS):
        number = round((time.monotonic() - begin_s) * FPS)
        first, second, third, fourth = (each.frame_at(number / FPS) for each in faces)
        for port in (LIVE_LINK, RECORDED):
            ours.sendto(live_link(first, number), (HERE, port))
        for message in vmc(second):
            ours.sendto(message, (HERE, VMC))
        phones[0].sendto(line(third, "-"), (HERE, 49983))
        phones[1].sendto(line(fourth, "&"), (HERE, 49993))
    for each in (ours, *phones):
        each.close()


def record(file: Path) -> None:
    """Keep a second of what a tracker sends, as `pica track --record` does."""
    recorder = TakeRecorder()
    tracker = open_live("livelink", f"{HERE}:{RECORDED}", tap=recorder)
    time.sleep(1.0)
    tracker.close()
    recorder.save(file)


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "trackers-out")
    out.mkdir(parents=True, exist_ok=True)
    stopping = threading.Event()
    threading.Thread(target=play, args=(stopping,)).start()
    try:
        with Children() as children:
            record(take := children.folder / "ada.take")
            sources = [f"livelink:{HERE}:{LIVE_LINK}", f"vmc:{HERE}:{VMC}", f"take:{take}"]
            sources += [f"ifacialmocap:{PHONES[0]}", f"facemotion3d:{PHONES[1]}"]
            _, url = children.start_relay()
            senders = []
            for source, avatar in zip(sources, AVATARS, strict=True):
                kind = source.partition(":")[0]
                arguments = ("--url", url, "--name", kind, "--source", source, "--avatar", avatar)
                senders.append(children.start(kind, "send", *arguments))
            view = ("--url", url, "--headless", "--expect", "5", "--seconds", "2")
            viewer = children.start("viewer", "view", *view, "--png", str(out / "five.png"))
            viewer.wait(threading.TIMEOUT_MAX)
            print(f"{viewer.result()['rendered_peers']} of {len(senders)} trackers were drawn")
    finally:
        stopping.set()


main()
