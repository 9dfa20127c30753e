"""How frames travel between two nodes of a room: once, and only those that somebody there wants.

A node tells each other node of a room which of its streams it wants and up to which layer: the most
that any of its own peers wants. The other node treats it like a peer that reads: an outbox that
holds what is fresh, drops as for a slow reader when NATS does not take more, and begins with the
kept keyframe and what depends on it. What waits at the end of a turn leaves in one
message.

The messages from one node to another about one room are numbered. A hole means that NATS dropped
some, because a reader or the server was overrun: the receiver takes nothing more, names a new epoch
in its subscriptions, and gets every stream from its keyframe on. Until then its peers see a
still face and nothing that they could not decode. Pure.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Final

from pica_protocol.stream_queue import Put
from pica_server.cluster.messages import Interest, MediaHeader, encode_media, slot_of
from pica_server.room.outbox import ArrivedFrame, Outbox

EPOCH_INTERVAL_S: Final = 0.5
"""Shortest time between two new epochs: who is overrun must not ask for ever more."""
ANNOUNCE_S: Final = 10.0
"""Wishes are repeated after that, in case one was lost without a trace."""
_NO_LAYER: Final = -1


class NodeLink:
    """Another node as a receiver of a room's frames.

    Attributes:
        layers: What it wants: stream to highest layer.
        epoch: Of its subscriptions; -1 before the first ones.
    """

    def __init__(self, node: str, my_slot: int, room_key: str, drops: Counter[str]) -> None:
        self.node = node
        self.slot = slot_of(node)
        self.room_key = room_key
        self._my_slot = my_slot
        self._drops = drops
        self.restart(-1)

    def restart(self, epoch: int) -> None:
        """Forget what waits and was sent: the receiver begins anew."""
        self.outbox = Outbox(0, self._drops)
        self.layers: dict[int, int] = {}
        self.epoch = epoch
        self._number = 0

    def put(self, frame: ArrivedFrame) -> Put | None:
        """Queue a frame, or drop it; None if the node does not want it."""
        if frame.layer > self.layers.get(frame.stream, _NO_LAYER):
            return None
        return self.outbox.put(frame)

    def want(self, stream: int, layer: int | None) -> bool:
        """Follow a subscription; return whether the stream begins, or begins again."""
        if layer is None:
            if self.layers.pop(stream, None) is not None:
                self.outbox.want(stream, None)
            return False
        before = self.layers.get(stream)
        self.layers[stream] = layer
        self.outbox.want(stream, layer)
        return before is None

    def forget_stream(self, stream: int) -> int:
        """Forget a stream that has ended; return how many of its frames waited."""
        self.layers.pop(stream, None)
        return self.outbox.forget_stream(stream)

    def take(self, now: float) -> tuple[bytes, int] | None:
        """Take the next message for the node, and how many frames are in it."""
        message = self.outbox.take(now)
        if message is None:
            return None
        header = MediaHeader(self._my_slot, self.epoch, self._number)
        self._number += 1
        return encode_media(header, message.data), len(message.received_s)


class Exchange:
    """What this node has told the others of a room, and what it has got from them.

    Attributes:
        is_lossy: Whether something was lost, and a new epoch is due.
        layers: What the others were told: stream to highest wanted layer.
    """

    def __init__(self, room_key: str, me: str, epoch: int) -> None:
        """Begin with an epoch that is higher than any that this node used for this room before."""
        self.is_lossy = False
        self._is_stale = False
        self._room_key = room_key
        self._me = me
        self._epoch = epoch
        self._number = 0
        self._expected: dict[int, int] = {}
        self._told: set[str] = set()
        self._answers: set[str] = set()
        self._heard: dict[str, tuple[int, int]] = {}
        self.layers: Mapping[int, int] = {}
        self._announced_s = float("-inf")
        self._epoch_s = float("-inf")

    def receive_header(self, header: MediaHeader) -> bool:
        """Say whether the frames behind this header may be taken."""
        if header.epoch != self._epoch:
            self._is_stale = True  # either under way, or the sender has not heard of the new one
            return False
        if self.is_lossy:
            return False
        expected = self._expected.get(header.slot, 0)
        if header.number != expected:
            self.is_lossy = True
            return False
        self._expected[header.slot] = expected + 1
        return True

    def receive_interest(self, interest: Interest) -> bool:
        """Say whether these are the latest subscriptions of that node."""
        latest = (interest.epoch, interest.number)
        if latest <= self._heard.get(interest.node, (-1, -1)):
            return False
        self._heard[interest.node] = latest
        if interest.wants_answer:
            self._answers.add(interest.node)
        return True

    def suspect_loss(self) -> None:
        """Begin a new epoch as soon as may be, and ask everybody for their subscriptions."""
        self.is_lossy = True
        self._told.clear()

    def is_due(self, now: float) -> bool:
        """Say whether ``announce`` has something to say although nothing has happened."""
        age_s = now - self._announced_s
        is_unheard = self._is_stale and age_s >= EPOCH_INTERVAL_S
        return self.is_lossy or is_unheard or age_s >= ANNOUNCE_S

    def announce(
        self, layers: Mapping[int, int], revision: int, nodes: Iterable[str], epoch: int, now: float
    ) -> list[tuple[str, Interest]]:
        """Return what must be told, and to which nodes; ``epoch`` is the next one, if one is
        due."""
        nodes = set(nodes)
        self._told &= nodes
        self._answers &= nodes
        for node in [n for n in self._heard if n not in nodes]:
            del self._heard[node]
        is_due = layers != self.layers or (self.is_due(now) and not self.is_lossy)
        if self.is_lossy and now - self._epoch_s >= EPOCH_INTERVAL_S:
            self.is_lossy = False
            self._epoch, self._epoch_s = epoch, now
            self._expected.clear()
            is_due = True
        receivers = nodes if is_due else (nodes - self._told) | self._answers
        if is_due:
            self.layers, self._announced_s, self._is_stale = dict(layers), now, False
        if not receivers:
            return []
        self._number += 1
        told = [
            (
                node,
                Interest(
                    self._room_key,
                    self._me,
                    self._number,
                    self._epoch,
                    revision,
                    node not in self._told,
                    self.layers,
                ),
            )
            for node in sorted(receivers)
        ]
        self._told |= receivers
        self._answers.clear()
        return told
