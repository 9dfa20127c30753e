"""A voice through a bad network and a jitter buffer, on a clock of its own.

You learn: the encoder, packets, the jitter buffer, and what a mixer tells a display.

Run it with: python examples/19_a_voice.py
"""

import random

from pica_client.voice.mixer import VoiceMixer
from pica_client.voice.opus import FRAME_S, FRAME_SAMPLES, OpusEncoder, available
from pica_client.voice.source import shipped_speech
from pica_protocol.frames import Frame

SECONDS = 7


def main() -> None:
    """Send, delay, play, and say what came of it."""
    if (trouble := available()) is not None:
        print(trouble)
        return
    speech, encoder, chance = shipped_speech(), OpusEncoder(bitrate=24_000), random.Random(0)
    arrivals: list[tuple[float, Frame]] = []
    for index in range(round(SECONDS / FRAME_S)):
        frame = speech[index * FRAME_SAMPLES : (index + 1) * FRAME_SAMPLES]
        payload = encoder.encode(frame)
        if payload is None:
            continue  # silence: nothing is sent
        packet = Frame(
            stream=1,
            sequence=len(arrivals),
            captured_us=round(index * FRAME_S * 1e6),
            payload=payload,
        )
        late_s = 0.02 + 0.06 * chance.random() ** 4
        arrivals.append(((index + 1) * FRAME_S + late_s, packet))
    sent_bytes = sum(len(packet.payload) for _, packet in arrivals)
    arrivals.sort(key=lambda arrival: arrival[0])

    mixer = VoiceMixer()
    mixer.seat({"ann": -0.6})  # radians: to the left
    loudest = 126
    for tick in range(round(SECONDS / FRAME_S)):
        now = tick * FRAME_S
        while arrivals and arrivals[0][0] <= now:
            arrived_s, packet = arrivals.pop(0)
            mixer.receive("ann", packet, arrived_s)
        mixer.mix(now)  # 20 ms for both ears
        ann = mixer.voices().get("ann")
        if ann is not None and ann.moment is not None:
            loudest = min(loudest, ann.level)
            leaves_s, captured_us, _ = ann.moment
            if tick % 50 == 0:
                said_s = leaves_s - captured_us / 1e6
                print(f"{now:4.1f} s: said {said_s:.3f} s ago; ann at -{ann.level} dB")
    print(f"{sent_bytes * 8 / SECONDS / 1e3:.1f} kbit/s, at most -{loudest} dB")
    print(mixer.voices()["ann"].report)


if __name__ == "__main__":
    main()
