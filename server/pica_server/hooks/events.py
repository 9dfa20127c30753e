"""What happens in rooms, for whoever keeps books about them: see ``webhooks``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class RoomEvent:
    """Something that happened in a room. A peer that is away for a moment has not left."""

    event: str
    """``room_started``, ``room_ended``, ``peer_joined`` or ``peer_left``."""
    room: str
    peer_id: str = ""
    """Empty for events of the room."""
    identity: str = ""
    """Who it is for sure; empty without tokens."""
    name: str = ""
    """What they are called."""
    reason: str = ""
    """Why a peer left: ``left``, ``lost`` or ``removed``."""
