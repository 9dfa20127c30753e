"""Give a program a voice and a face, as a voice agent in a call.

You learn: whatever makes speech writes 16-bit PCM into `pica agent`, which does the rest. Put your
own text-to-speech in the place of `speak`; a relay and someone who looks on stand in for a call.

Run it with: python examples/25_an_agent.py
"""

import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Children
from pica_client.transport.connect import LinkConfig
from pica_client.voice.opus import available
from pica_client.voice.source import shipped_speech

RATE_HZ = 48_000


def speak() -> Iterator[bytes]:
    """Two sentences with a thought between them: 16-bit samples as they are made, in any pieces."""
    sound = (shipped_speech() * 32767).astype("<i2")
    yield sound[: 2 * RATE_HZ].tobytes()
    time.sleep(1.0)
    yield sound[2 * RATE_HZ : 4 * RATE_HZ].tobytes()


def main() -> None:
    """Let an agent say something, and say what arrived."""
    if (trouble := available()) is not None:
        print(trouble)
        return
    faces: list[float] = []
    call = Call(AvatarLibrary(), on_face=lambda face: faces.append(face.sample.latent.mean()))
    with Children() as children:
        _, url = children.start_relay()
        command = [sys.executable, "-m", "pica_command", "agent", "--url", url, "--name", "Amara"]
        with (
            Receiver(LinkConfig(url=url, name="Ada"), call),
            subprocess.Popen([*command, "--pcm", "-", "--rate", str(RATE_HZ)],
                             stdin=subprocess.PIPE, stderr=subprocess.DEVNULL) as agent,
        ):  # fmt: skip
            assert agent.stdin is not None
            for samples in speak():
                agent.stdin.write(samples)  # waits while the agent has enough to say
            agent.stdin.close()
            agent.wait(60)
    print(f"{len(faces)} faces arrived; they differ by {np.std(faces):.3f}")


if __name__ == "__main__":
    main()
